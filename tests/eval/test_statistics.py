"""Medians, intervals and standard errors over seeds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pmc_sampler.eval.statistics import mean_error, median_interval, ratio_interval


def test_median_lies_in_its_interval() -> None:
    interval = median_interval([3.0, 1.0, 4.0, 1.5, 9.0, 2.6, 5.0, 3.5])
    assert interval.median == 3.25
    assert 1.0 <= interval.low < interval.median < interval.high <= 9.0
    assert interval == median_interval([3.0, 1.0, 4.0, 1.5, 9.0, 2.6, 5.0, 3.5])


def test_one_value_has_no_width() -> None:
    interval = median_interval([2.0])
    assert (interval.low, interval.median, interval.high) == (2.0, 2.0, 2.0)


def test_interval_covers_the_true_median() -> None:
    """Of 200 intervals over 12 normal values 95 % should cover 0; the percentile interval of so few covers a
    little less. At a true coverage of 90 % or more, fewer than 165 cover with probability under 1e-4. The
    negative control, intervals of 50 %, must fall short.
    """
    rng = np.random.default_rng(2)
    data = rng.standard_normal((200, 12))

    def covered(confidence: float) -> int:
        found = [median_interval(row, confidence, resamples=1000) for row in data.tolist()]
        return sum(interval.low <= 0.0 <= interval.high for interval in found)

    assert covered(0.95) >= 165
    assert covered(0.5) < 165


def test_ratios_are_taken_seed_by_seed() -> None:
    # Each seed's ratio is 2, though the seeds differ a hundredfold.
    interval = ratio_interval([2.0, 20.0, 200.0], [1.0, 10.0, 100.0])
    assert (interval.low, interval.median, interval.high) == (2.0, 2.0, 2.0)
    with pytest.raises(ValueError, match="seed by seed"):
        ratio_interval([1.0], [1.0, 2.0])


def test_mean_error_is_the_textbook_one() -> None:
    mean, error = mean_error([1.0, 2.0, 3.0, 6.0])
    assert mean == 3.0
    assert error == pytest.approx(math.sqrt((4 + 1 + 0 + 9) / 3 / 4))
    assert math.isnan(mean_error([1.0])[1])


@pytest.mark.parametrize("function", [median_interval, mean_error])
def test_nothing_is_refused(function: object) -> None:
    with pytest.raises(ValueError, match="at least one"):
        function([])  # type: ignore[operator]
