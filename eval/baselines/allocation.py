"""Dividing samples among pixels."""

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import tvi


def threshold_deviation(
    variance: NDArray[np.float64], mean: NDArray[np.float64], white_luminance: float
) -> NDArray[np.float64]:
    """Standard deviation of one sample's luminance in visibility thresholds, ``s = sigma / tvi(I)``.

    The tvi error of an image whose pixels p have n_p independent samples is the mean of ``s_p^2 / n_p``. ``variance``
    and ``mean`` of luminance in radiance units, any shape; ``white_luminance`` cd/m2 of luminance 1.
    """
    s: NDArray[np.float64] = np.sqrt(variance) * white_luminance / tvi(mean * white_luminance)
    return s


def waterfill(n: NDArray[np.int64], s: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """How many of ``size`` further samples each pixel gets so that the sum of ``s^2 / n`` is least, in fractions.

    The least is at ``max(n, c s)`` (Neyman 1934, doi:10.2307/2342192, with what was spent already). The set of pixels
    that get none grows until no pixel has more than its share, as in projections onto a simplex (Michelot 1986,
    doi:10.1007/BF00938486). Where all ``s`` are 0 they count as equal.
    """
    if not s.any():
        s = np.ones(len(n))
    total = float(n.sum()) + size
    below, above, held = s > 0.0, -1, 0.0
    while above != (above := int(np.count_nonzero(below))):
        held = float(n[~below].sum())
        c = (total - held) / float(s[below].sum())
        below = below & (c * s > n)
    return np.where(below, c * s - n, 0.0)


def whole(shares: NDArray[np.float64], size: int, offset: float) -> NDArray[np.int64]:
    """Whole numbers that differ from ``shares`` by less than one and sum to ``size``, by systematic sampling.

    ``shares`` sum to ``size`` but for rounding. With ``offset`` uniform in [0, 1) the expectation is the share (Madow
    1949, doi:10.1214/aoms/1177730062).
    """
    edges = np.cumsum(shares)
    edges *= size / edges[-1]
    steps = np.minimum(np.floor(edges + offset), size).astype(np.int64)
    steps[-1] = size
    counts = steps.copy()
    counts[1:] -= steps[:-1]
    return counts
