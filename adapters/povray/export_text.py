"""Numbers, vectors and images as POV-Ray reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

__all__ = ["number", "rows", "times", "vector", "write_image"]

# Colours of an image are halves in POV-Ray, whatever the file holds.
LARGEST_HALF = 65504.0


def number(value: float) -> str:
    """A number, exact to single precision at least."""
    return f"{float(value):.9g}"


def vector(values: Iterable[float]) -> str:
    """A vector or a colour: `<1,2,3>`."""
    return "<" + ",".join(map(number, values)) + ">"


def times(values: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    """Three numbers, each times `factor`."""
    x, y, z = values
    return x * factor, y * factor, z * factor


def rows(keyword: str, values: NDArray[Any]) -> str:
    """A list of mesh2: its keyword, the count and one vector for each row of `values`, shape (n, k)."""
    pattern = "<" + ",".join(["%d" if values.dtype.kind in "ui" else "%.9g"] * values.shape[1]) + ">"
    # One string for all rows: a tenth of the time of one after the other.
    text = ",\n".join([pattern] * len(values)) % tuple(values.ravel().tolist())
    return f"{keyword} {{ {len(values)},\n{text}\n}}\n"


def write_image(file: Path, pixels: NDArray[np.float32]) -> None:
    """Writes (height, width, 3 or 4) linear values as a float EXR; alpha, if any, is not multiplied into the colours.

    Raises ValueError for values that a half cannot hold, OSError if the file cannot be written.
    """
    if pixels.max(initial=0.0) > LARGEST_HALF:
        raise ValueError(
            f"{file.name} holds {pixels.max():g}: POV-Ray reads textures up to {LARGEST_HALF:g}; scale its values down"
        )
    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, OpenImageIO.FLOAT)
    out = OpenImageIO.ImageOutput.create(str(file))
    if out is None or not out.open(str(file), spec):
        raise OSError(f"{file} cannot be written: {out.geterror() if out else OpenImageIO.geterror()}")
    if not out.write_image(np.ascontiguousarray(pixels, np.float32)) or not out.close():
        raise OSError(f"{file} cannot be written: {out.geterror()}")
