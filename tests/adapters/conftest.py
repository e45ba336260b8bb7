"""Batches made by hand, and the comparison of two ways to render a scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]
VARIANT = "llvm_ad_rgb"


@dataclass
class HandMade:
    """What a renderer reads of a batch."""

    positions: Array
    pixel: Array
    index: Array
    scramble: Array
    number: int = 0

    def __len__(self) -> int:
        return len(self.pixel)

    def __getitem__(self, which: Any) -> HandMade:
        return HandMade(*(array[which] for array in (self.positions, self.pixel, self.index, self.scramble)))


def uniform_batch(width: int, height: int, spp: int, seed: int) -> HandMade:
    """`spp` samples in each pixel, in the pixels' order, uniform in the pixel and independent of each
    other."""
    rng = np.random.default_rng(seed)
    pixel = np.repeat(np.arange(width * height, dtype=np.uint32), spp)
    corner = np.stack([pixel % width, pixel // width], axis=1).astype(np.float32)
    offset = rng.integers(0, 1 << 12, corner.shape).astype(np.float32) / (
        1 << 12
    )  # exact: no rounding to the next pixel
    scramble = rng.integers(0, 1 << 32, width * height, np.uint32)
    index = np.tile(np.arange(spp, dtype=np.uint32), width * height)
    return HandMade(corner + offset, pixel, index, scramble[pixel])


def image_of(radiance: Array, width: int, height: int) -> Array:
    """The image of a `uniform_batch`."""
    return radiance.reshape(height, width, -1, radiance.shape[1]).mean(axis=2)


def p_value(ours: Array, theirs: Array, tile: int = 16) -> float:
    """Whether two stacks of images, shape (seeds, height, width, channels), have one mean: a p-value.

    Welch's t-test on the mean of the image and of each tile, in each channel; the smallest p-value, corrected
    for their number by Sidak's formula. Without a difference it is below a in a share of about a of all
    cases.
    """
    from scipy import stats

    def regions(images: Array) -> Array:
        seeds, height, width, channels = images.shape
        tiles = images.reshape(seeds, height // tile, tile, width // tile, tile, channels).mean(axis=(2, 4))
        return np.concatenate([tiles.reshape(seeds, -1), images.mean(axis=(1, 2))], axis=1).astype(np.float64)

    a, b = regions(ours), regions(theirs)
    varies = a.std(axis=0) + b.std(axis=0) > 1e-5 * a.mean(axis=0)  # the sky is constant
    assert np.allclose(a[:, ~varies].mean(axis=0), b[:, ~varies].mean(axis=0), rtol=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a tile may be constant in one of the stacks
        smallest = stats.ttest_ind(a[:, varies], b[:, varies], equal_var=False).pvalue.min()
    return float(-np.expm1(varies.sum() * np.log1p(-smallest)))


@pytest.fixture(scope="session")
def mi(require: Callable[[str], Any]) -> Any:
    """Mitsuba, with a variant active."""
    mitsuba = require("mitsuba")
    mitsuba.set_variant(VARIANT)
    return mitsuba


@pytest.fixture(scope="session")
def batch_of() -> Any:
    return uniform_batch


@pytest.fixture(scope="session")
def p_value_of(require: Callable[[str], Any]) -> Callable[..., float]:
    require("scipy")
    return p_value


@pytest.fixture(scope="session")
def image_from() -> Callable[..., Array]:
    return image_of
