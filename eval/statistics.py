"""Statistics over seeds: the seed is the unit of replication, ratios are taken seed by seed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

ENOUGH = 6
"""Seeds from which a bootstrap interval of a median holds it about as often as it says; of 3 it does 7 times in 10."""


def few(seeds: int) -> str:
    """What is to be said after the word interval where there are too few seeds for one; else nothing."""
    return "" if seeds >= ENOUGH else ", which of so few seeds is little more than their range"


@dataclass(frozen=True)
class Interval:
    """A median over seeds with its bootstrap interval; ``low`` and ``high`` equal it for a single seed."""

    median: float
    low: float
    high: float


def median_interval(
    values: Sequence[float], confidence: float = 0.95, resamples: int = 10_000, seed: int = 0
) -> Interval:
    """Median with its percentile bootstrap interval (Efron 1979, doi:10.1214/aos/1176344552).

    The same values and ``seed`` give the same interval. Raises ``ValueError`` for no values at all.
    """
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1 or not data.size:
        raise ValueError(f"an interval needs at least one value; the shape that came is {data.shape}.")
    return _median_interval(tuple(data.tolist()), confidence, resamples, seed)


@lru_cache(maxsize=4096)  # tables and plots of a report ask for the same numbers
def _median_interval(values: tuple[float, ...], confidence: float, resamples: int, seed: int) -> Interval:
    data = np.array(values)
    medians = np.median(data[_drawn(data.size, resamples, seed)], axis=1)
    low, high = np.quantile(medians, [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    return Interval(float(np.median(data)), float(low), float(high))


@lru_cache(maxsize=4)
def _drawn(size: int, resamples: int, seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(size, size=(resamples, size))


def ratio_interval(numerator: Sequence[float], denominator: Sequence[float]) -> Interval:
    """Median and interval of ``numerator[s] / denominator[s]`` over seeds ``s``, both in one order."""
    if len(numerator) != len(denominator):
        raise ValueError(f"ratios are taken seed by seed; {len(numerator)} values came for {len(denominator)}.")
    return median_interval([a / b for a, b in zip(numerator, denominator, strict=True)])


def mean_error(values: Sequence[float]) -> tuple[float, float]:
    """Mean and its standard error over seeds; NaN for a single seed, which says nothing of spread."""
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1 or not data.size:
        raise ValueError(f"a mean needs at least one value; the shape that came is {data.shape}.")
    spread = float(data.std(ddof=1) / np.sqrt(data.size)) if data.size > 1 else float("nan")
    return float(data.mean()), spread


def neyman_limit(s: ArrayLike) -> float:
    """Error of uniform sampling over the least that any counts can give, at equal samples: ``mean(s^2) / mean(s)^2``.

    ``s``, any shape, is each pixel's standard deviation of one sample times the weight that the error gives it (for the
    tvi error ``sigma / tvi(I)``). Neyman 1934 (doi:10.2307/2342192), for independent samples and counts that do not
    depend on them. 1 where nothing varies.
    """
    values = np.asarray(s, dtype=np.float64)
    mean = float(values.mean())
    return float((values**2).mean()) / mean**2 if mean > 0.0 else 1.0


def slope_interval(budgets: Sequence[float], errors: ArrayLike) -> Interval:
    """Slope of log error against log budget, by least squares for each seed: median and interval over seeds.

    ``budgets`` of length b, in samples or seconds; ``errors`` (seeds, b), above 0. Independent samples give -1
    for squared errors. Raises ``ValueError`` for fewer than two budgets and for errors that have no logarithm.
    """
    x, y = np.asarray(budgets, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if x.size < 2 or y.ndim != 2 or y.shape[1] != x.size:
        raise ValueError(
            f"a slope needs two budgets or more and an error of each seed at each; {x.size} budgets and errors of "
            f"shape {y.shape} came."
        )
    if not (np.isfinite(y).all() and (y > 0).all()):
        raise ValueError("a slope needs errors above 0: these are as small as the reference's noise.")
    slopes = np.polyfit(np.log(x), np.log(y.T), 1)[0]
    return median_interval(slopes.tolist())


@dataclass(frozen=True)
class Welch:
    """A test of bias at each place: differences of the means, their ``t`` and two-sided ``p``.

    ``threshold`` is what a ``p`` has to stay under to count, at a false-alarm rate of ``alpha`` over all places
    together (Sidak 1967, doi:10.1080/01621459.1967.10482935).
    """

    difference: NDArray[np.float64]
    t: NDArray[np.float64]
    p: NDArray[np.float64]
    alpha: float
    threshold: float

    @property
    def biased(self) -> NDArray[np.bool_]:
        """Where the bias is more than chance explains."""
        return self.p < self.threshold


def welch(
    replicates: ArrayLike,
    reference: ArrayLike,
    reference_variance: ArrayLike,
    reference_replicates: int,
    alpha: float = 0.01,
) -> Welch:
    """Welch's unequal-variances t-test of replicated means against a reference's, at each place.

    Welch 1947 (doi:10.1093/biomet/34.1-2.28), by scipy. ``replicates`` (seeds, ...), at least two;
    ``reference`` and ``reference_variance`` (...) are a mean of ``reference_replicates`` replicates and the
    variance of that mean, 0 where it is exact. Per-pixel values of rendered images have tails too heavy for the
    test: give means over tiles of 16x16 pixels or more. Places where nothing varies and nothing differs get p = 1.
    Raises ``ValueError`` for fewer than two seeds.
    """
    from scipy.stats import ttest_ind_from_stats

    data = np.asarray(replicates, dtype=np.float64)
    if data.ndim < 1 or len(data) < 2:
        raise ValueError(f"a test of bias needs two seeds or more; the shape that came is {data.shape}.")
    mean, spread = data.mean(axis=0), data.std(axis=0, ddof=1)
    other = np.asarray(reference, dtype=np.float64)
    deviation = np.sqrt(np.asarray(reference_variance, dtype=np.float64) * reference_replicates)
    with np.errstate(divide="ignore", invalid="ignore"):
        t, p = ttest_ind_from_stats(
            mean, spread, len(data), other, deviation, max(reference_replicates, 2), equal_var=False
        )
    still = (spread == 0) & (deviation == 0)
    same = still & (mean == other)
    t = np.where(still, np.where(same, 0.0, np.where(mean > other, np.inf, -np.inf)), t)
    p = np.where(still, np.where(same, 1.0, 0.0), p)
    return Welch(mean - other, t, p, alpha, float(-np.expm1(np.log1p(-alpha) / max(p.size, 1))))
