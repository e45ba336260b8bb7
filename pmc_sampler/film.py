"""Pictures of what a sampler has been told."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pmc_sampler import _core

FloatImage = npt.NDArray[np.float32]


class Film:
    """The film of a sampler: every picture is computed from its sums when it is read, and is the caller's to keep.

    Arrays are (height, width, 3) float32 linear RGB in the renderer's radiance units unless said otherwise; row 0 is
    the top.
    """

    def __init__(self, native: _core.Sampler) -> None:
        self._native = native

    @property
    def mean(self) -> FloatImage:
        """The image: the plain mean with the energy that steering cost it.

        With P the plain mean, U the mean of the stratified pool's samples, w a weight that falls to 0 where P is black
        and B a symmetric smoother:  P + w B((U - P) / B(w)), channel by channel. Its sum over the image is that of U,
        which is unbiased, at `Config.correction` 1 and but for results below zero, which are set to zero.
        """
        return self._native.mean()

    @property
    def plain_mean(self) -> FloatImage:
        """The mean of all samples of each pixel, 0 where there is none; consistent, biased low at finite counts."""
        return self._native.plain_mean()

    @property
    def pool_mean(self) -> FloatImage:
        """The mean of each pixel's samples from the stratified pool alone: unbiased at every count, and noisier."""
        return self._native.pool_mean()

    @property
    def standard_error(self) -> FloatImage:
        """Standard error of the plain mean; infinity where fewer than two samples leave it unknown."""
        return self._native.standard_error()

    @property
    def samples(self) -> npt.NDArray[np.uint32]:
        """Samples in each pixel, (height, width)."""
        return self._native.counts()

    @property
    def strategy(self) -> FloatImage:
        """The paper's strategy image (its Figure 3), in [0, 1].

        Red, green and blue are how often the kernel's first, second and third radius proposed the pixel's samples,
        grey where none did; the brightness is the pixel's sample count over the largest in the image.
        """
        return self._native.strategy()

    @property
    def beta(self) -> FloatImage:
        """What the sampler draws pixels by, before normalisation (`Config.beta`), (height, width)."""
        return self._native.beta()

    @property
    def alpha(self) -> FloatImage:
        """Kernel weights alpha that members there have learned, a running mean over 8x8 pixels: (height, width, number
        of radii); they sum to one, and are equal where no member was.
        """
        return self._native.alpha()

    @property
    def halves(self) -> tuple[FloatImage, FloatImage]:
        """Means of two disjoint halves of each pixel's samples, for an error estimate or a denoiser.

        Halves of `plain_mean`, so that they lack the energy that `mean` gives back: they are darker than it where
        steering was strong (docs/method.md, "The image"). Let a denoiser filter `mean` and take from the halves how
        noisy it is; where it filters the halves, add `mean - plain_mean` to what it makes of them.
        """
        return self._native.halves()

    @property
    def aovs(self) -> FloatImage:
        """Means of the channels after RGB, (height, width, aovs)."""
        return self._native.aovs()
