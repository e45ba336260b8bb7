"""Batches made by hand, scenes small enough for tests, and the comparison of two ways to render one."""

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


@pytest.fixture(autouse=True)
def same_variant(mi: Any) -> Any:
    """Every test finds the same variant active."""
    mi.set_variant(VARIANT)
    yield
    mi.set_variant(VARIANT)


@pytest.fixture(scope="session")
def batch_of(mi: Any) -> Any:
    return uniform_batch


@pytest.fixture(scope="session")
def p_value_of(mi: Any) -> Callable[..., float]:
    return p_value


@pytest.fixture(scope="session")
def agreement(mi: Any) -> Callable[..., float]:
    """A function from a renderer to the p-value of its agreeing with `mi.render` on a scene, its own by
    default."""

    def p_of(renderer: Any, scene: Any = None, sensor: Any = None, spp: int = 32, tile: int = 16) -> float:
        width, height, seeds = renderer.width, renderer.height, 16
        ours = [
            image_of(renderer(uniform_batch(width, height, spp, seed)), width, height)[..., :3] for seed in range(seeds)
        ]
        with mi.util.variant_context(renderer.variant):
            theirs = [
                np.array(
                    mi.render(
                        scene or renderer.scene,
                        sensor=sensor or renderer.sensor,
                        integrator=renderer.integrator,
                        spp=spp,
                        seed=1000 + seed,
                    )
                )
                for seed in range(seeds)
            ]
        return p_value(np.array(ours), np.broadcast_to(theirs, (seeds, height, width, 3)), tile)

    return p_of


@pytest.fixture
def small_scene(mi: Any) -> Callable[..., dict[str, Any]]:
    """A function that gives a Cornell box with a glass ball as a dictionary, 32x32; what it is given replaces
    or joins."""

    def make(sensor: dict[str, Any] | None = None, film: dict[str, Any] | None = None, **parts: Any) -> dict[str, Any]:
        scene = mi.cornell_box()
        for box in ("small-box", "large-box"):
            del scene[box]
        scene["ball"] = {
            "type": "sphere",
            "center": [0.1, -0.5, 0.2],
            "radius": 0.4,
            "bsdf": {"type": "dielectric", "int_ior": 1.5},
        }
        own = {
            "type": "hdrfilm",
            "width": 32,
            "height": 32,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        }
        scene["sensor"]["film"] = {**own, **(film or {})}
        scene["sensor"].update(sensor or {})
        scene.update(parts)
        return {key: value for key, value in scene.items() if value is not None}

    return make
