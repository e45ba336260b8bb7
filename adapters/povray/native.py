"""POV-Ray's own anti-aliasing, to compare with."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .images import clamp, read
from .program import TIMEOUT, private_folder, run

__all__ = ["render"]

METHODS = (1, 2)  # +AM: a grid where neighbours differ; recursive halving of it


def render(
    scene: Path,
    size: tuple[int, int],
    *,
    method: int | None = 2,
    depth: int = 3,
    threshold: float = 0.3,
    jitter: bool = True,
    threads: int | None = None,
    options: Sequence[str] = (),
    libraries: Sequence[Path] = (),
    timeout: float = TIMEOUT,
) -> tuple[NDArray[np.float32], float]:
    """Renders a scene file with its own camera, as people do without the sampler.

    POV-Ray compares and averages pixels in the space of the scene's `assumed_gamma`: where that is not 1.0, the mean of
    its samples is not the light's.

    Parameters
    ----------
    scene
        The `.pov` file.
    size
        (width, height) in pixels.
    method
        1 (`+AM1`: pixels that differ from their neighbours get depth x depth samples), 2 (`+AM2`: recursive, up to
        (2^depth + 1)^2), or None for one sample in the middle of each pixel.
    depth
        `+R`, 1 to 9.
    threshold
        `+A`: the sum of the differences of red, green and blue from which neighbours differ; 0 or more, where 0 gives
        all pixels all samples with method 1.
    jitter
        Whether samples are moved within their cells (`+J`).
    threads
        How many POV-Ray uses, by default as many as there are processors; more than one is not deterministic where
        a scene has random light.
    options
        Further switches, such as "Declare=NAME=1".
    libraries
        Folders in which the scene finds its files besides its own.
    timeout
        Seconds after which POV-Ray is ended.

    Returns
    -------
    (height, width, 3) float32 image, linear, infinite values made 65504; and the seconds that POV-Ray took, its start,
    the parsing of the scene and the writing of the image included.

    Raises
    ------
    FileNotFoundError
        If there is no such scene file.
    ValueError
        For settings out of range, and for what POV-Ray cannot render, with its message.
    TimeoutError
        If it takes longer than `timeout`.
    OSError
        If POV-Ray's image cannot be read.
    RuntimeError
        If there is no POV-Ray.
    """
    if not scene.is_file():
        raise FileNotFoundError(f"there is no scene file {scene}")
    width, height = size
    if not (1 <= width <= 65535 and 1 <= height <= 65535):
        raise ValueError(f"the image is {width}x{height}: expected 1 to 65535 pixels a side")
    arguments = [f"+W{width}", f"+H{height}", "+Oimage.exr", "+FE", "-GD", "-GR"]
    arguments += _anti_aliasing(method, depth, threshold, jitter)
    if threads is not None:
        if not 1 <= threads <= 512:
            raise ValueError(f"threads is {threads}: POV-Ray takes 1 to 512")
        arguments.append(f"+WT{threads}")
    else:
        arguments.append(f"+WT{_processors()}")
    with private_folder() as folder:
        began = time.perf_counter()
        run(folder, scene, [*arguments, *options], timeout, libraries).check(str(scene))
        seconds = time.perf_counter() - began
        return _read(folder / "image.exr", width, height, scene), seconds


def _anti_aliasing(method: int | None, depth: int, threshold: float, jitter: bool) -> list[str]:
    if method is None:
        return ["-A"]
    if method not in METHODS:
        raise ValueError(f"POV-Ray's anti-aliasing method is {method!r}: expected 1, 2 or None")
    if not 1 <= depth <= 9:
        raise ValueError(f"the depth of anti-aliasing is {depth}: POV-Ray takes 1 to 9")
    if not 0.0 <= threshold <= 3.0:
        raise ValueError(f"the threshold of anti-aliasing is {threshold:g}: expected 0 to 3")
    return [f"+AM{method}", f"+A{threshold:.9f}", f"+R{depth}", "+J1.0" if jitter else "-J"]


def _processors() -> int:
    return min(len(os.sched_getaffinity(0)), 512)


def _read(file: Path, width: int, height: int, scene: Path) -> NDArray[np.float32]:
    if not file.is_file():
        raise ValueError(f"POV-Ray ended without an error and without an image of {scene}")
    pixels = read(file)
    clamp(pixels)
    if pixels.shape[:2] != (height, width):
        raise ValueError(
            f"POV-Ray's image of {scene} is {pixels.shape[1]}x{pixels.shape[0]}, not {width}x{height}: does the "
            "scene's INI file or an option set its size?"
        )
    return pixels
