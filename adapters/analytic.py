"""Radiance by formula, of known mean, to stress samplers with: any brightness, black parts, one hot pixel, rare bright
samples, samples that are no radiance.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import _core, toml

from .inputs import check_size

__all__ = ["AnalyticRenderer"]

_RANGES = {  # setting: default, lowest, highest
    "brightness": (1.0, 0.0, 1e37),
    "decades": (0.0, 0.0, 30.0),
    "black": (0.0, 0.0, 1.0),
    "hot": (1.0, 0.0, 1e30),
    "rare": (0.0, 0.0, 0.5),
    "gain": (1.0, 0.0, 1e6),
    "invalid": (0.0, 0.0, 0.2),
}
_TINT = np.array([1.0, 0.5, 0.25])


class AnalyticRenderer:
    """A callable from a `Batch` to radiance, (n, 3) float32, whose mean in every pixel is `mean`, (height, width, 3).

    scene: a TOML file, of numbers that all may be left out. The mean is `brightness` at the left border and grows by
        `decades` powers of ten to the right; a share `black` of the pixels is black; the pixel in the middle is `hot`
        times brighter. A sample is `gain` times its pixel's mean with probability `rare`, others make up for it and
        vary by half of theirs to both sides. A share `invalid` of the samples is NaN, infinite or negative.
    size: (width, height) in pixels.
    sampler: "sobol" for scrambled Sobol points, "independent" for independent random numbers.

    Raises OSError for a file that cannot be read, ValueError for one that is no such scene and for other arguments.
    """

    takes_batch = True

    def __init__(
        self, scene: str | os.PathLike[str], size: tuple[int, int] | None = None, sampler: str = "sobol"
    ) -> None:
        if sampler not in ("sobol", "independent"):
            raise ValueError(f"sampler is {sampler!r}: expected 'sobol' or 'independent'")
        check_size(size := (64, 48) if size is None else size)
        self.width, self.height = (int(side) for side in size)
        self._independent = sampler == "independent"
        settings = _settings(scene)
        self._rare, self._gain, self._invalid = (settings[name] for name in ("rare", "gain", "invalid"))
        y, x = np.divmod(np.arange(self.width * self.height), self.width)
        mean = settings["brightness"] * 10.0 ** (settings["decades"] * x / max(self.width - 1, 1))
        mean[_uniform(_words(x), _words(y)) < settings["black"]] = 0.0
        mean[self.height // 2 * self.width + self.width // 2] *= settings["hot"]
        self._mean = mean

    @property
    def mean(self) -> NDArray[np.float64]:
        """The expected radiance of valid samples."""
        mean: NDArray[np.float64] = (self._mean[:, None] * _TINT).reshape(self.height, self.width, 3)
        return mean

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of a batch's samples."""
        if self._independent:
            u, v = (_uniform(_core.mix(batch.scramble, _words(batch.index * 2 + k)), batch.index) for k in (0, 1))
        else:
            u, v = _core.sobol_points(batch.scramble, batch.index, 1).T.astype(np.float64)
        rest = (1.0 - self._rare * self._gain) / (1.0 - self._rare)
        factor = np.where(u < self._rare, self._gain, rest * (0.5 + v))
        radiance: NDArray[np.float32] = ((self._mean[batch.pixel] * factor)[:, None] * _TINT).astype(np.float32)
        bad = np.flatnonzero(_uniform(_core.mix(batch.scramble, batch.index), batch.index) < self._invalid)
        radiance[bad, bad % 3] = np.resize(np.array([np.nan, np.inf, -1.0], np.float32), len(bad))
        return radiance


def _settings(scene: str | os.PathLike[str]) -> Mapping[str, float]:
    given = toml.read(os.fspath(scene))
    settings = {name: default for name, (default, _, _) in _RANGES.items()}
    for name, value in given.items():
        if name not in _RANGES:
            raise ValueError(f"{str(scene)!r} has {name!r}: expected {', '.join(_RANGES)}")
        _, low, high = _RANGES[name]
        if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
            raise ValueError(f"{str(scene)!r}: {name} is {value!r}: expected a number from {low:g} to {high:g}")
        settings[name] = float(value)
    if settings["rare"] * settings["gain"] > 1.0:
        raise ValueError(f"{str(scene)!r}: rare x gain is {settings['rare'] * settings['gain']:g}: expected 1 at most")
    brightest = settings["brightness"] * 10.0 ** settings["decades"] * settings["hot"] * max(settings["gain"], 2.0)
    if brightest > 3e38:
        raise ValueError(f"{str(scene)!r}: samples of {brightest:g}: expected 3e38 at most, which floats can hold")
    return settings


def _words(values: NDArray[Any]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(values, dtype=np.uint32)


def _uniform(a: NDArray[np.uint32], b: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Numbers in [0, 1), by the core's hash of two words."""
    hashed: NDArray[np.uint32] = _core.mix(_words(a), _words(b))
    return hashed / 2.0**32
