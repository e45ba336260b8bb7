"""Images that POV-Ray writes: whether one is whole, and its pixels.

OpenEXR, since POV-Ray writes it linear whatever the scene's gamma, and its other formats with less than half floats.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from numpy.typing import NDArray

__all__ = ["LARGEST", "clamp", "finished", "read", "whole"]

LARGEST = 65504.0  # of half floats
_MAGIC = 20000630


def whole(file: Path) -> bool:
    """Whether an EXR file of scan lines is complete.

    POV-Ray is done with its image a third of a second before it ends. OpenEXR writes the table of offsets last, at
    first with zeros in the place of those that it does not know.
    """
    try:
        data = file.read_bytes()[: 1 << 16]
        size = file.stat().st_size
    except FileNotFoundError:
        return False
    try:
        attributes, place = _header(data)
        _, low, _, high = struct.unpack("<4i", attributes["dataWindow"])
        lines = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16}[attributes["compression"][0]]
        offsets = struct.unpack_from(f"<{-(-(high - low + 1) // lines)}Q", data, place)
        if not all(0 < offset <= size - 8 for offset in offsets):
            return False
        with file.open("rb") as stream:
            stream.seek(offsets[-1] + 4)
            (length,) = struct.unpack("<i", stream.read(4))
    except (struct.error, KeyError, IndexError, ValueError):  # of a header that is not yet there
        return False
    return bool(offsets[-1] + 8 + length <= size)


def read(file: Path) -> NDArray[np.float32]:
    """The pixels of an image file, shape (height, width, 3), linear RGB.

    Raises OSError for a file that cannot be read.
    """
    source = oiio.ImageInput.open(str(file))
    if source is None:
        raise OSError(f"the image that POV-Ray wrote cannot be read: {oiio.geterror()}")
    pixels: Any = source.read_image("float")
    source.close()
    if pixels is None or pixels.shape[2] < 3:
        raise OSError(f"the image that POV-Ray wrote cannot be read: {source.geterror() or 'it is not in colour'}")
    return np.ascontiguousarray(pixels[:, :, :3], np.float32)


def finished(file: Path, scene: Path, width: int, height: int) -> NDArray[np.float32]:
    """The pixels of what POV-Ray made of `scene`, shape (height, width, 3), infinite values made 65504.

    Raises ValueError if there is no whole image or one of another size, OSError for a file that cannot be read.
    """
    if not whole(file):
        raise ValueError(f"POV-Ray ended without an error and without an image of {scene}")
    pixels = read(file)
    if pixels.shape[:2] != (height, width):
        raise ValueError(f"POV-Ray's image of {scene} is {pixels.shape[1]}x{pixels.shape[0]}, not {width}x{height}")
    clamp(pixels)
    return pixels


def clamp(pixels: NDArray[np.float32]) -> int:
    """Makes infinite values 65504, in place; returns in how many pixels (of the last axis) there were any."""
    infinite = np.isposinf(pixels)
    pixels[infinite] = LARGEST
    return int(infinite.any(axis=-1).sum())


def _header(data: bytes) -> tuple[dict[str, bytes], int]:
    """The attributes of an EXR file by name, and where its header ends. Raises ValueError if there is none."""
    if struct.unpack_from("<i", data)[0] != _MAGIC:
        raise ValueError("no EXR file")
    attributes, place = {}, 8
    while data[place]:
        name = data.index(b"\0", place)
        kind = data.index(b"\0", name + 1)
        (length,) = struct.unpack_from("<i", data, kind + 1)
        attributes[data[place:name].decode()] = data[kind + 5 : kind + 5 + length]
        place = kind + 5 + length
    return attributes, place + 1
