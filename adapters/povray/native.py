"""POV-Ray's own anti-aliasing, to compare with."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..inputs import check_whole
from .images import finished
from .program import private_folder, processors
from .source import Source, image

__all__ = ["Native", "render"]

_COUNTS = re.compile(r"^Pixels:\s+(\d+)\s+Samples:\s+(\d+)", re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Native:
    """What POV-Ray made by itself.

    Attributes
    ----------
    mean
        (height, width, 3) float32, linear RGB; infinite values are 65504.
    samples
        Rays through the image, as POV-Ray counts them; not those within a pixel for focal blur.
    seconds
        Wall time, POV-Ray's start, the parsing of the scene and the writing of the image included.
    """

    mean: NDArray[np.float32]
    samples: int
    seconds: float


def render(
    source: Source,
    size: tuple[int, int],
    *,
    antialiasing: int = 2,
    depth: int = 3,
    threshold: float = 0.3,
    jitter: bool = True,
    threads: int | None = None,
    camera: str = "",
) -> Native:
    """Renders a scene with POV-Ray's own anti-aliasing, as people do without the sampler.

    POV-Ray compares and averages pixels in the space of the scene's `assumed_gamma`: where that is not 1.0, the mean of
    its samples is not the light's.

    Parameters
    ----------
    source
        The scene.
    size
        (width, height) in pixels.
    antialiasing
        1 (`+AM1`: pixels that differ from their neighbours get depth x depth samples), 2 (`+AM2`: recursive, up to
        (2^depth + 1)^2), or 0 for one sample in the middle of each pixel.
    depth
        `+R`, 1 to 9.
    threshold
        `+A`: the sum of the differences of red, green and blue from which neighbours differ; 0 to 3, where 0 gives all
        pixels all samples with method 1.
    jitter
        Whether samples are moved within their cells (`+J`).
    threads
        How many POV-Ray uses, by default as many as there are processors; more than one is not deterministic where
        a scene has random light.
    camera
        A `camera` statement in place of the scene's.

    Raises
    ------
    ValueError
        For settings out of range, and for what POV-Ray cannot render, with its message.
    TimeoutError
        If it takes longer than the source's time-out.
    OSError
        If POV-Ray's image cannot be read.
    RuntimeError
        If there is no POV-Ray.
    """
    width, height = size
    if not (1 <= width <= 65535 and 1 <= height <= 65535):
        raise ValueError(f"the image is {width}x{height}: expected 1 to 65535 pixels a side")
    if threads is not None:
        check_whole("threads", threads, 1, 512)
    # The statistics come with +GS; `Source` has them off.
    arguments = [f"+W{width}", f"+H{height}", "+GS", f"+WT{threads or min(processors(), 512)}"]
    arguments += _switches(antialiasing, depth, threshold, jitter)
    with private_folder() as folder:
        began = time.perf_counter()
        result = source.run(folder, arguments, camera)
        seconds = time.perf_counter() - began
        pixels = finished(image(folder), source.file, width, height)
    counts = _COUNTS.search(result.messages)
    if counts is None:
        raise RuntimeError(f"POV-Ray does not say how many samples its image of {source.file} has")
    return Native(pixels, int(counts[1]) + int(counts[2]), seconds)


def _switches(antialiasing: int, depth: int, threshold: float, jitter: bool) -> list[str]:
    check_whole("antialiasing", antialiasing, 0, 2)
    check_whole("depth", depth, 1, 9)
    if not isinstance(threshold, int | float) or not 0.0 <= threshold <= 3.0:
        raise ValueError(f"threshold is {threshold!r}: expected a number from 0 to 3")
    if antialiasing == 0:
        return ["-A"]
    return [f"+AM{antialiasing}", f"+A{threshold:.9f}", f"+R{depth}", "+J1.0" if jitter else "-J"]
