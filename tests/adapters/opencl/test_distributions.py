"""The alias table: the distribution it draws from is the one that was asked for, to the rounding of its thresholds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pyopencl")


def drawn_from(thresholds: Any, aliases: Any) -> Any:
    """The probabilities that a table stands for."""
    kept = thresholds.astype(np.float64)
    return (kept + np.bincount(aliases, 1.0 - kept, len(kept))) / len(kept)


@pytest.mark.parametrize(
    "weights",
    [
        [1.0],
        [2.0, 2.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 5.0],
        [1e-30, 1.0, 1e30],
        [3.0, 1.0, 3.0, 1.0, 0.0, 0.0, 7.0],
        list(range(100)),
        list(range(100, 0, -1)),
        np.random.default_rng(0).random(5000) ** 8,
        np.random.default_rng(1).pareto(0.8, 100_000),
        np.r_[np.full(99_999, 1e-9), 1.0],
    ],
    ids=range(11),
)
def test_probabilities(opencl: Any, weights: Any) -> None:
    from pmc_sampler.adapters.opencl.distributions import alias_table

    weights = np.asarray(weights, np.float64)
    thresholds, aliases = alias_table(weights)
    assert thresholds.min() >= 0.0
    assert thresholds.max() <= 1.0
    np.testing.assert_allclose(drawn_from(thresholds, aliases), weights / weights.sum(), rtol=1e-6, atol=1e-7)
    assert not np.isin(aliases[thresholds < 1.0], np.flatnonzero(weights == 0.0)).any()
    assert (thresholds[weights == 0.0] == 0.0).all()


@pytest.mark.parametrize("weights", [[0.0, 0.0], [1.0, -1.0], [1.0, np.nan], [np.inf, 1.0]])
def test_no_distribution(opencl: Any, weights: Any) -> None:
    from pmc_sampler.adapters.opencl.distributions import alias_table

    with pytest.raises(ValueError, match="weights of a distribution"):
        alias_table(np.array(weights))
