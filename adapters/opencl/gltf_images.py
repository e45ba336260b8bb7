"""The images of a glTF file as texels of the OpenCL tracer."""

from __future__ import annotations

import contextlib
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from pmc_sampler import limits

from .gltf_file import Document
from .gltf_values import pick, title
from .scene import Floats

__all__ = ["pixels"]

_LARGEST = 16384  # texels a side, what graphics hardware takes
_PNG_SIZE = struct.Struct(">16xII")  # width and height in IHDR, the first chunk (PNG specification, section 11.2.1)
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"


def pixels(document: Document, index: Any, srgb: bool) -> Floats:
    """The image number `index` (section 3.8.2), (height, width, 4) float32, linear RGB and alpha, the top row first.

    srgb: whether its colours are coded with the transfer function of sRGB; else they are linear. Grey is repeated,
    missing alpha is 1, and profiles and gamma inside the image are ignored, as the specification has it.

    Raises ValueError for what is no PNG, JPEG or WebP image, is broken, or has more than 16384 texels a side; and as
    `Document.beside` does.
    """
    image = pick(document.model.images, index, "the image of a texture")
    label = title("image", index, image.name)
    with _file(document, image, label) as (file, label):
        config = OpenImageIO.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)
        source = OpenImageIO.ImageInput.open(str(file), config)
        if source is None:
            raise ValueError(f"{label} cannot be decoded ({_line(OpenImageIO.geterror())}); export it anew")
        with contextlib.closing(source):
            spec = source.spec()
            _check_size(spec.width, spec.height, label)
            limits.check(label, spec.image_bytes(True), file.stat().st_size)
            stored = source.read_image(0, 0, 0, spec.nchannels, OpenImageIO.UNKNOWN)
            if stored is None:
                raise ValueError(f"{label} cannot be decoded ({_line(source.geterror())}); export it anew")
    return _texels(stored, srgb, label)


@contextlib.contextmanager
def _file(document: Document, image: Any, label: str) -> Iterator[tuple[Path, str]]:
    """A file with the image, and how messages call it. OpenImageIO's Python module reads from files alone."""
    if image.uri is not None and not str(image.uri).startswith("data:"):
        path = document.beside(image.uri, label)
        label = f"{label} in {image.uri!r}"
        _checked_suffix(path.read_bytes(), label)
        yield path, label
        return
    data = document.content(image.bufferView, label) if image.uri is None else document.read(image.uri, label)
    suffix = _checked_suffix(data, label)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{suffix}"
        path.write_bytes(data)
        yield path, label


def _checked_suffix(data: bytes, label: str) -> str:
    """By the first bytes: `mimeType` may be missing, or wrong, and OpenImageIO reads much that is no glTF's.

    What libpng would complain of past Python, on the terminal, is looked for here: a file that is cut short, and sizes
    that no file of its length could fill.
    """
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        if len(data) >= _PNG_SIZE.size:
            width, height = _PNG_SIZE.unpack_from(data)
            _check_size(width, height, label)
        if data.rfind(_PNG_END) < 0:
            raise ValueError(
                f"{label} cannot be decoded (the PNG is truncated: it lacks its last chunk); export it anew"
            )
        return ".png"
    if data.startswith(b"\xff\xd8\xff"):
        return ".jpg"
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return ".webp"
    raise ValueError(f"{label} starts with {data[:8]!r}: expected a PNG, JPEG or WebP image")


def _check_size(width: int, height: int, label: str) -> None:
    if max(width, height) > _LARGEST:
        raise ValueError(f"{label} has {width}x{height} texels: expected {_LARGEST} a side at most; scale it down")


def _texels(stored: NDArray[Any], srgb: bool, label: str) -> Floats:
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{label} holds {stored.dtype.name}: expected 8 or 16 bits a channel")
    plain = np.linspace(0.0, 1.0, int(np.iinfo(stored.dtype).max) + 1)
    # IEC 61966-2-1
    curve = np.where(plain <= 0.04045, plain / 12.92, ((plain + 0.055) / 1.055) ** 2.4) if srgb else plain
    channels = stored.shape[2]
    made = np.ones((*stored.shape[:2], 4), np.float32)
    made[..., :3] = curve.astype(np.float32)[stored[..., :3] if channels >= 3 else stored[..., :1]]
    if channels in (2, 4):
        made[..., 3] = plain.astype(np.float32)[stored[..., channels - 1]]
    return made


def _line(text: str) -> str:
    """Each line but those that another one holds."""
    lines = list(dict.fromkeys(line.strip() for line in text.split("\n")))
    kept = [line for line in lines if not any(line in other for other in lines if other != line)]
    return "; ".join(kept) or "no reason given"
