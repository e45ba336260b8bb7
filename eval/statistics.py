"""Statistics over seeds: the seed is the unit of replication, ratios are taken seed by seed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


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
    drawn = np.random.default_rng(seed).integers(data.size, size=(resamples, data.size))
    medians = np.median(data[drawn], axis=1)
    low, high = np.quantile(medians, [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    return Interval(float(np.median(data)), float(low), float(high))


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


def neyman_share(gain: float, limit: float) -> float:
    """How much of the gain that :func:`neyman_limit` leaves a method reached: 0 as uniform sampling, 1 as the best.

    ``gain`` is uniform sampling's error over the method's. ``(gain - 1) / (limit - 1)``; NaN where there is nothing to
    gain.
    """
    return (gain - 1.0) / (limit - 1.0) if limit > 1.0 else float("nan")
