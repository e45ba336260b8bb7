"""The oracle: what is best if every pixel's variance is known."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmc_sampler import luminance

from ..statistics import neyman_limit
from .allocation import threshold_deviation, waterfill
from .film import Film


class Neyman:
    """Samples in proportion to the known standard deviation in visibility thresholds (Neyman 1934), at least one each.

    The least tvi error that counts which do not look at the samples can give, for independent samples.
    """

    name = "neyman"
    initial_spp: float | None = 1.0

    def __init__(self, mean: ArrayLike, luminance_variance: ArrayLike, white_luminance: float = 100.0) -> None:
        rgb = np.asarray(mean, np.float64)
        variance = np.asarray(luminance_variance, np.float64)
        self._s = threshold_deviation(variance, np.asarray(luminance(rgb), np.float64), white_luminance).ravel()

    @classmethod
    def for_radiance(cls, radiance: Any, white_luminance: float = 100.0) -> "Neyman":
        """Of a renderer that knows its ``mean`` and ``luminance_variance``, such as a recording; else ValueError."""
        try:
            known = radiance.mean, radiance.luminance_variance
        except AttributeError as error:
            raise ValueError(
                "neyman needs the variance of every pixel, which this renderer does not know: give it a recording"
            ) from error
        return cls(*known, white_luminance=white_luminance)

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """What brings the counts nearest to the best ones, of one sample a pixel, 4096 at least."""
        return waterfill(drawn, self._s, min(at_most, max(4096, len(drawn))))


def neyman_limit_of(radiance: Any, white_luminance: float = 100.0) -> float:
    """Error of independent uniform sampling over the least possible, at equal samples (``neyman_limit``)."""
    mean = np.asarray(luminance(np.asarray(radiance.mean, np.float64)), np.float64)
    return neyman_limit(threshold_deviation(np.asarray(radiance.luminance_variance), mean, white_luminance))
