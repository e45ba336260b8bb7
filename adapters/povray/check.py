"""Whether the rays that are given to POV-Ray are those of the scene's own camera: a small image by both ways."""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import images
from .camera import Camera
from .numbers import lens
from .prepare import sized
from .program import Process, private_folder
from .ray_mesh import mesh_camera
from .scene_text import has_radiosity
from .sdl import texts
from .source import Source, image

__all__ = ["Agreement", "check", "small"]

Image = NDArray[np.float32]
_WIDTH = 64  # pixels
_SHIFT = 2e-3  # pixels by which rays are moved at most: ten times their error
_LENS = 16  # rays through the lens for each pixel
_SAME = 0.01  # relative difference of values that count as the same
_SHARE = 0.97  # of the pixels that are the same where there is no noise
_NOISE = 3.0  # times as far apart as two images of ours, at most, where there is
# Apart at most where radiosity is interpolated: between points that an image of each shape adds where it lacks them.
_INTERPOLATED = 0.015


def small(width: int, height: int) -> tuple[int, int]:
    """The size of the small image: 64 pixels wide, of that shape."""
    return _WIDTH, max(1, min(4 * _WIDTH, round(_WIDTH * height / width)))


@dataclass(frozen=True)
class Agreement:
    """How far POV-Ray's image by the scene's own camera and ours agree.

    Attributes
    ----------
    same
        The share of the pixels that are the same within 1 %.
    apart
        The mean difference relative to the mean.
    noise
        The same between two images of ours with other random numbers, and moved by less than can be seen; None if
        nearly all pixels are the same, and the others hardly differ.
    radiosity
        Whether the images are lit by radiosity.
    black
        Whether POV-Ray's image is.
    """

    same: float
    apart: float
    noise: float | None = None
    radiosity: bool = False
    black: bool = False

    @property
    def good(self) -> bool:
        """Whether nearly all pixels are the same, or they are as close to each other as two images of ours."""
        limit = _SAME if self.same >= _SHARE else _INTERPOLATED if self.radiosity else 0.0
        return self.noise is None or self.apart <= max(_NOISE * self.noise, limit)


def check(source: Source, camera: Camera, width: int, height: int) -> Agreement:
    """Compares images of `width` by `height` pixels, for which `camera` is the scene's; without radiosity, where there
    is other light.

    Raises ValueError if they do not agree, and as `Source.run`.
    """
    radiosity = any(map(has_radiosity, texts(source)))
    agreement = None
    if radiosity:  # the quality without it
        agreement = _compared(dataclasses.replace(source, switches=(*source.switches, "+Q8")), camera, width, height)
    if agreement is None or agreement.black:
        agreement = dataclasses.replace(_compared(source, camera, width, height), radiosity=radiosity)
    if not agreement.good:
        raise ValueError(
            f"the camera found in {source.file} is not the one that POV-Ray uses: in images of {width}x{height} pixels "
            f"the two differ by {agreement.apart:.1%} on average, and by {agreement.noise:.1%} from one time to the "
            "next; give the camera (its location, right, up and direction), or leave out the check"
        )
    return agreement


def _compared(source: Source, camera: Camera, width: int, height: int) -> Agreement:
    with contextlib.ExitStack() as stack:
        folders = [stack.enter_context(private_folder()) for _ in range(4)]
        scene = sized(source, width, height, folders[0])
        own = source.start(folders[1], (f"+W{width}", f"+H{height}"))
        stack.callback(own.kill)
        ours = _Rays(scene, camera, width, height, 1).image(folders[2])  # while the other runs
        theirs = _image(own, folders[1], source, width, height)
        same, apart, black = _same(theirs, ours), _apart(theirs, ours), not theirs.any()
        if not camera.has_lens and same >= _SHARE and apart <= _SAME:
            return Agreement(same, apart, black=black)
        again = _Rays(scene, camera, width, height, 2, _SHIFT).image(folders[3])
    return Agreement(same, apart, _apart(ours, again), black=black)


class _Rays:
    """Rays through the centres of all pixels in an order that `seed` gives, moved by `shift` pixels at most.

    Moved ones show how much an image means where it is finer than its pixels, as that of a fractal is.
    """

    def __init__(self, source: Source, camera: Camera, width: int, height: int, seed: int, shift: float = 0.0) -> None:
        self._source, self._size = source, (height, width, 3)
        self._rays = _LENS if camera.has_lens else 1
        pixel = np.repeat(np.arange(width * height, dtype=np.uint32), self._rays)
        rng = np.random.default_rng(seed)
        pixel = rng.permutation(pixel)
        positions = np.stack([pixel % width + 0.5, pixel // width + 0.5], axis=1)
        positions += rng.uniform(-shift, shift, positions.shape)
        seen = camera.sees(width, height, positions)
        self._pixel = pixel[seen]
        through = lens("independent", np.full(len(pixel), seed, np.uint32), np.arange(len(pixel), dtype=np.uint32))
        self._text = mesh_camera(camera, width, height, positions[seen], through[seen]) if seen.any() else ""

    def image(self, folder: Path) -> Image:
        """Their radiance, averaged in each pixel."""
        out = np.zeros((self._size[0] * self._size[1], 3), np.float32)
        if len(self._pixel):
            process = self._source.start(folder, (f"+W{len(self._pixel)}", "+H1"), self._text)
            np.add.at(out, self._pixel, _image(process, folder, self._source, len(self._pixel), 1)[0])
        out /= np.float32(self._rays)
        return out.reshape(self._size)


def _image(process: Process, folder: Path, source: Source, width: int, height: int) -> Image:
    """What POV-Ray renders in `folder`, as soon as it is there."""
    process.wait(source.timeout, lambda: images.whole(image(folder))).check(str(source.file))
    return images.finished(image(folder), source.file, width, height)


def _same(a: Image, b: Image) -> float:
    """The share of the pixels that are the same."""
    near = np.abs(a - b) <= _SAME * (np.maximum(np.abs(a), np.abs(b)) + 0.1 * np.abs(a).mean())
    return float(near.all(axis=2).mean())


def _apart(a: Image, b: Image) -> float:
    """The mean difference, relative to the mean; large values count by their logarithm."""
    a, b = np.log1p(np.maximum(a, 0)), np.log1p(np.maximum(b, 0))
    return float(np.abs(a - b).mean() / max(float((a + b).mean() / 2), 1e-9))
