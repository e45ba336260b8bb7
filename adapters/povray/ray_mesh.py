"""A `mesh_camera` for any positions in the image: POV-Ray as a function from rays to radiance.

Each ray leaves the centroid of a triangle along its normal. The triangles are written in the camera's own frame, for
POV-Ray keeps vertices and normals as 32-bit floats, and placed by a matrix, which it keeps as doubles.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .camera import Array, Camera

__all__ = ["mesh_camera"]

_TRIANGLES = 1000  # in a mesh: POV-Ray takes a time that grows with the square to read one
_DIGITS = 10
_STEEP = 8.0  # slope of a triangle up to which it is written over the frame's first two coordinates
# Corners of a triangle over the two coordinates beside its normal's greatest one, about its centroid.
_CORNERS = ((-1.0, 2.0), (2.0, -1.0), (-1.0, -1.0))
_SMALL = 2.0**-6  # size of triangles whose place matters, for what 32 bits lose grows with it
# Size of triangles that are all in one place, by their matrix: a ray is off by it at most, less than 1e-5 pixels.
_POINT = 2.0**-30


def mesh_camera(
    camera: Camera, width: int, height: int, positions: NDArray[Any], lens: NDArray[Any] | None = None
) -> str:
    """SDL of a camera whose pixel k, in an image of n by 1 pixels, is the ray of position k.

    Parameters
    ----------
    width, height
        Size of the image in which positions count, pixels.
    positions
        (n, 2), pixels from the upper left corner. `Camera.sees` must be true for each: POV-Ray has no means to leave
        a pixel out.
    lens
        (n, 2) in [0, 1): a point of the lens for each ray, if the camera has one; uniform ones are POV-Ray's blur.

    Raises ValueError for shapes that do not fit, and for a camera with a lens if there are no points of it.
    """
    if camera.has_lens and (lens is None or np.shape(lens) != np.shape(positions)):
        raise ValueError(
            f"a camera with an aperture needs points of the lens in the shape {np.shape(positions)} of the positions, "
            f"not {None if lens is None else np.shape(lens)}"
        )
    origins, directions = camera.local_rays(width, height, positions, lens)
    frame = camera.frame
    # After the matrix a normal n points along n times the frame's inverse transposed; this one so along the ray.
    metric = frame @ frame.T
    off = metric - np.diag(np.diag(metric))
    if np.abs(off).max() <= 1e-12 * np.diag(metric).min():
        metric = np.diag(np.diag(metric))  # rounding in perpendicular vectors
    normals = directions @ metric
    # On a lens the normal matters more: the triangle is as large as the lens, and a power of two, so that 32 bits hold
    # the sums with `Camera.local_rays`'s origins.
    size = _SMALL
    if camera.has_lens and origins is not None:
        size = max(size, 2.0 ** np.ceil(np.log2(max(float(np.abs(origins).max(initial=0)), _SMALL))))
    X, Y, ahead = normals.T
    if len(normals) and (ahead.min() <= 0 or max(np.abs(X / ahead).max(), np.abs(Y / ahead).max()) > _STEEP):
        rows = _general(normals, origins, size)
    elif origins is None:
        frame = frame * _POINT
        # The third corner is the origin, and so the other two are the slopes. The vectors x, y, z and 0 are read in
        # half the time that three numbers in brackets take.
        rows = _rows(("triangle{y", -Y / ahead, "*z,x", -X / ahead, "*z,0}"))
    else:
        rows = _ahead(X / ahead, Y / ahead, origins, size)
    place = ",".join(f"{value:.17g}" for value in (*frame.ravel(), *camera.location))
    parts = ["\n#declare pmc_version=version;\n#version 3.7;\ncamera{mesh_camera{1 1\n"]
    for start in range(0, len(rows), _TRIANGLES):
        text = rows[start : start + _TRIANGLES].tobytes().decode("ascii")
        parts += ("mesh{", text, f"hierarchy off matrix<{place}>}}\n")
    parts.append("}}\n#version pmc_version;\n")
    return "".join(parts)


def _ahead(X: Array, Y: Array, origins: Array, size: float) -> NDArray[np.uint8]:
    """(n, length) characters: triangles with the normals (X, Y, 1) about any points."""
    x, y, z = origins.T
    sides = (x - size, x + 2 * size, y - size, y + 2 * size)
    exponent = _exponent(*sides)
    a, b, c, d = (_numbers(side, exponent) for side in sides)
    X, Y = X * size, Y * size
    parts = ("triangle{<", a, ",", d, ",", z + X - 2 * Y, ">,<", b, ",", c, ",", z + Y - 2 * X, ">,<")
    return _rows((*parts, a, ",", c, ",", z + X + Y, ">}"))


def _general(normals: Array, origins: Array | None, size: float) -> NDArray[np.uint8]:
    """Triangles with any normals about any points. The plane is written over the two other coordinates than the
    normal's greatest, in cyclic order, which keeps its sense; a normal that points back swaps two corners."""
    greatest = np.abs(normals).argmax(axis=1)
    which = (greatest[:, None] + (1, 2, 0)) % 3
    back = (np.arange(3) - greatest[:, None] - 1) % 3  # puts coordinates in order again
    a, b, c = (np.take_along_axis(normals, which, 1)[:, k] for k in range(3))
    slope_a, slope_b = a / c, b / c
    swapped = (c < 0)[:, None]
    corners = []
    for u, v in _CORNERS:
        u, v = u * size, v * size
        corner = np.stack([np.full_like(a, u), np.full_like(a, v), -(slope_a * u + slope_b * v)], axis=1)
        corners.append(np.take_along_axis(corner, back, 1) + (0 if origins is None else origins))
    corners[0], corners[1] = np.where(swapped, corners[1], corners[0]), np.where(swapped, corners[0], corners[1])
    parts: list[str | Array | NDArray[np.uint8]] = ["triangle{<"]
    for corner in corners:
        for k in range(3):
            parts += [corner[:, k], ","]
        parts[-1] = ">,<"
    parts[-1] = ">}"
    return _rows(tuple(parts))


def _rows(parts: tuple[str | Array | NDArray[np.uint8], ...]) -> NDArray[np.uint8]:
    """(n, length) characters: in each row the strings of `parts`, its numbers, and what is characters already."""
    numbers: list[Any] = [part for part in parts if not isinstance(part, str) and part.ndim == 1]
    exponent = _exponent(*numbers)
    columns: list[NDArray[np.uint8]] = []
    for part in parts:
        whole: Any = np.frombuffer(part.encode("ascii"), np.uint8) if isinstance(part, str) else part
        columns.append(_numbers(whole, exponent) if whole.dtype == np.float64 else whole)
    rows = np.empty((len(numbers[0]), sum(column.shape[-1] for column in columns)), np.uint8)
    start = 0
    for column in columns:
        rows[:, start : start + column.shape[-1]] = column
        start += column.shape[-1]
    return rows


def _exponent(*numbers: Array) -> int:
    """The power of ten just above all numbers: they share it, and the greatest gets ten digits."""
    greatest = max(float(np.abs(part).max(initial=0)) for part in numbers)
    return int(np.floor(np.log10(greatest))) + 1 if greatest > 0 else 0


def _numbers(values: Array, exponent: int) -> NDArray[np.uint8]:
    """(n, length) characters: the sign, ".", ten digits and the exponent; faster by far than formatting one by one."""
    whole = np.rint(np.abs(values) * 10.0 ** (_DIGITS - exponent)).astype(np.int64)
    # The greatest number may round to 10^10, which has a digit more.
    whole = np.minimum(whole, 10**_DIGITS - 1)
    high, low = np.divmod(whole, 10**5)
    suffix = b"" if exponent == 0 else b"e%d" % exponent
    characters = np.empty((len(values), 2 + _DIGITS + len(suffix)), np.uint8)
    characters[:, 0] = np.where(values < 0, ord("-"), ord("+"))
    characters[:, 1] = ord(".")
    characters[:, 2:7] = _digits()[high]
    characters[:, 7:12] = _digits()[low]
    characters[:, 12:] = np.frombuffer(suffix, np.uint8)
    return characters


@functools.cache
def _digits() -> NDArray[np.uint8]:
    """(100000, 5): the characters of each number below 100000."""
    numbers = np.arange(10**5)
    return np.stack([numbers // 10**k % 10 + ord("0") for k in (4, 3, 2, 1, 0)], axis=1).astype(np.uint8)
