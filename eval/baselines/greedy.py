"""Greedy variance-driven allocation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .allocation import threshold_deviation, waterfill
from .film import Film


class Greedy:
    """Every sample goes where the estimated tvi error falls most, ``var / (tvi(I)^2 n^2)``.

    Where many samples are drawn at once, the batch is filled as the greedy choice would, one by one, from the
    estimates at its beginning. ``var`` is the variance of the pixel's own samples. ``batch``: samples in a batch; None:
    a quarter of a sample a pixel, 4096 at least.
    """

    name = "greedy"
    initial_spp: float | None = None

    def __init__(self, radiance: Any, *, white_luminance: float = 100.0, batch: int | None = None) -> None:
        if not white_luminance > 0.0 or (batch is not None and batch < 1):
            raise ValueError(
                f"white_luminance is {white_luminance!r} and batch {batch!r}: expected above 0 and at least 1"
            )
        self._white = float(white_luminance)
        self._batch = max(4096, int(radiance.width) * int(radiance.height) // 4) if batch is None else int(batch)

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """The next batch's shares."""
        s = threshold_deviation(film.luminance_variance, film.mean_luminance, self._white)
        return waterfill(drawn, s, min(at_most, self._batch))
