"""Greedy variance-driven allocation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .allocation import threshold_deviation, waterfill
from .film import Film


class Greedy:
    """Every sample goes where the estimated tvi error falls most, ``var / (tvi(I)^2 n^2)``.

    Where many samples are drawn at once, the batch is filled as the greedy choice would, one by one, from the
    estimates at its beginning. ``var`` is the variance of the pixel's own samples, blended with that of its
    surroundings as if that stood for ``prior`` samples more: a pixel that has not seen the bright paths of its
    neighbourhood is not starved. ``prior`` 0 uses the pixel's own alone.
    """

    name = "greedy"
    initial_spp: float | None = None

    def __init__(
        self,
        radiance: Any,
        *,
        white_luminance: float = 100.0,
        prior: float = 4.0,
        sigma: float = 1.0,
        batch: int | None = None,
    ) -> None:
        self._shape = (int(radiance.height), int(radiance.width))
        self._white, self._prior, self._sigma = float(white_luminance), float(prior), float(sigma)
        pixels = self._shape[0] * self._shape[1]
        self._batch = max(4096, pixels // 2) if batch is None else int(batch)

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """Half a sample a pixel, 4096 at least."""
        variance = film.luminance_variance
        if self._prior > 0.0:
            from scipy.ndimage import gaussian_filter

            around = gaussian_filter(variance.reshape(self._shape), self._sigma, mode="nearest").ravel()
            own = np.maximum(film.n - 1, 0)
            variance = (own * variance + self._prior * around) / (own + self._prior)
        s = threshold_deviation(variance, film.mean_luminance, self._white)
        return waterfill(drawn, s, min(at_most, self._batch))
