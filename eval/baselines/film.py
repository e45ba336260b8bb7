"""Sums of what was sampled, pixel by pixel."""

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import luminance


class Film:
    """Sums of radiance in every pixel, and the pictures that follow from them.

    Pictures are (height, width, 3) linear RGB in the renderer's units unless said otherwise. What rules read is flat,
    one value a pixel: ``n`` samples (int64), sums and sums of squares (float64).
    """

    def __init__(self, width: int, height: int) -> None:
        self._shape = (height, width)
        pixels = width * height
        self.n = np.zeros(pixels, np.int64)
        self.n_half = np.zeros(pixels, np.int64)
        # R, G, B and luminance; their squares; R, G and B of the samples of even index.
        self._sums = np.zeros((pixels, 11))

    def add(self, pixel: NDArray[np.uint32], index: NDArray[np.uint32], radiance: NDArray[np.float64]) -> None:
        """Samples (n, 3), sorted by pixel, each the ``index``-th of its own."""
        if not len(pixel):
            return
        values = np.empty((len(pixel), 11))
        values[:, :3] = radiance
        values[:, 3] = luminance(radiance)
        np.square(values[:, :4], out=values[:, 4:8])
        even = index % 2 == 0
        np.multiply(radiance, even[:, None], out=values[:, 8:])
        starts = np.flatnonzero(np.concatenate([[True], pixel[1:] != pixel[:-1]]))
        where = pixel[starts]
        self._sums[where] += np.add.reduceat(values, starts, axis=0)
        self.n[where] += np.diff(starts, append=len(pixel))
        self.n_half[where] += np.add.reduceat(even.astype(np.int64), starts)

    @property
    def mean_luminance(self) -> NDArray[np.float64]:
        """(pixels,), 0 where there is no sample."""
        return self._sums[:, 3] / np.maximum(self.n, 1)

    @property
    def luminance_variance(self) -> NDArray[np.float64]:
        """(pixels,), of one sample, unbiased; 0 where there are fewer than two."""
        return self._variance(self._sums[:, 3], self._sums[:, 7], self.n)

    @property
    def means(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(pixels, 3) twice: the mean of all samples, and of those of even index."""
        whole = self._sums[:, :3] / np.maximum(self.n, 1)[:, None]
        return whole, self._sums[:, 8:] / np.maximum(self.n_half, 1)[:, None]

    @property
    def plain_mean(self) -> NDArray[np.float32]:
        """The mean of all samples of each pixel, 0 where there is none; float32."""
        return self._picture(self.means[0])

    @property
    def mean(self) -> NDArray[np.float32]:
        """The image, which is the plain mean."""
        return self.plain_mean

    @property
    def standard_error(self) -> NDArray[np.float32]:
        """Standard error of the mean; infinity where fewer than two samples leave it unknown."""
        n = self.n[:, None]
        error = np.sqrt(self._variance(self._sums[:, :3], self._sums[:, 4:7], n) / np.maximum(n, 1))
        return self._picture(np.where(n < 2, np.inf, error))

    @property
    def samples(self) -> NDArray[np.uint32]:
        """Samples in each pixel, (height, width)."""
        return self.n.reshape(self._shape).astype(np.uint32)

    def _picture(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        return values.reshape(*self._shape, 3).astype(np.float32)

    @staticmethod
    def _variance(sums: NDArray[np.float64], squares: NDArray[np.float64], n: NDArray[np.int64]) -> NDArray[np.float64]:
        deviations = squares - sums**2 / np.maximum(n, 1)
        return np.maximum(deviations, 0.0) / np.maximum(n - 1, 1)
