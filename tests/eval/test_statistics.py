"""Medians, intervals and standard errors over seeds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pmc_sampler.eval.statistics import (
    mean_error,
    median_interval,
    ratio_interval,
    slope_interval,
    welch,
)


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


def test_slopes_are_those_of_power_laws() -> None:
    budgets = [4.0, 16.0, 64.0]
    errors = [[scale * budget**-1.5 for budget in budgets] for scale in (1.0, 7.0, 0.1)]
    interval = slope_interval(budgets, errors)
    assert interval.low == pytest.approx(-1.5)
    assert interval.median == pytest.approx(-1.5)
    assert interval.high == pytest.approx(-1.5)
    with pytest.raises(ValueError, match="two budgets or more"):
        slope_interval([4.0], [[1.0]])
    with pytest.raises(ValueError, match="above 0"):
        slope_interval(budgets, [[1.0, 0.1, -0.01]])


def test_welch_is_scipy_s_test_of_the_samples() -> None:
    """The reference as its mean and the variance of that gives what its replicates themselves give."""
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(5)
    replicates, reference = rng.normal(1.0, 0.1, (6, 3, 4)), rng.normal(1.05, 0.3, (16, 3, 4))
    found = welch(replicates, reference.mean(axis=0), reference.var(axis=0, ddof=1) / 16, 16, alpha=0.05)
    expected = stats.ttest_ind(replicates, reference, equal_var=False)
    np.testing.assert_allclose(found.t, expected.statistic)
    np.testing.assert_allclose(found.p, expected.pvalue)
    # Sidak: with 12 places the chance of no false alarm is 0.95.
    assert (1 - found.threshold) ** 12 == pytest.approx(0.95)


def test_welch_against_an_exact_mean_is_the_one_sample_test() -> None:
    stats = pytest.importorskip("scipy.stats")
    replicates = np.random.default_rng(6).normal(1.0, 0.1, (9, 5))
    found = welch(replicates, np.full(5, 1.02), np.zeros(5), 1)
    expected = stats.ttest_1samp(replicates, 1.02)
    np.testing.assert_allclose(found.t, expected.statistic)
    np.testing.assert_allclose(found.p, expected.pvalue)


def test_welch_where_nothing_varies() -> None:
    found = welch(np.ones((3, 2)), np.array([1.0, 2.0]), np.zeros(2), 1)
    assert found.biased.tolist() == [False, True]
    with pytest.raises(ValueError, match="two seeds"):
        welch(np.ones((1, 2)), np.ones(2), np.zeros(2), 1)
