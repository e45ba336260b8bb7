"""Image files by OpenImageIO: EXR with layers and metadata, tone-mapped PNG, reading of what people have.

Every file is written beside its place and renamed into it, so that a reader sees the old image or the new
one.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmc_sampler import limits

from .display import display, srgb_decode

READABLE = (".exr", ".hdr", ".pfm", ".png", ".tif", ".tiff", ".jpg", ".jpeg")
"""Suffixes that :func:`read` takes; the last five hold display-encoded values unless they store floats."""


class ImageError(ValueError):
    """An image file that cannot be read or written; the message says which, why and what to do."""


@dataclass(frozen=True)
class Image:
    """What a file holds: ``rgb`` (height, width, 3) float32, linear; layers and metadata by name.

    ``encoded`` says that the file's values were display-encoded, and ``rgb`` is what decoding them gave.
    """

    rgb: NDArray[np.float32]
    layers: dict[str, NDArray[np.float32]]
    metadata: dict[str, str | float | int]
    encoded: bool = False


def require() -> ModuleType:
    """OpenImageIO's module; raises :class:`ImageError` naming the extra that brings it."""
    try:
        import OpenImageIO
    except ImportError as error:
        raise ImageError(
            f"image files need OpenImageIO, which cannot be imported ({error}): pip install 'pmc-sampler[eval]'."
        ) from error
    module: ModuleType = OpenImageIO
    return module


def check_writable(path: str | os.PathLike[str], suffix: str = ".exr") -> Path:
    """The path, once it is sure that a file can be made there; called before hours of rendering, not after.

    Raises :class:`ImageError` where the suffix is another, the folder is missing or takes no file, or the
    path is a folder.
    """
    target = Path(path)
    if target.suffix.lower() != suffix:
        raise ImageError(f"the output must be a {suffix} file; {str(target)!r} is none.")
    if not target.parent.is_dir():
        trouble = "is a file; name" if target.parent.exists() else "does not exist; make it first or name"
        raise ImageError(f"the folder {str(target.parent)!r} of the output {trouble} another.")
    if target.is_dir():
        raise ImageError(f"the output {str(target)!r} is a folder; name a file in it.")
    if target.exists() and not target.is_file():
        raise ImageError(f"the output {str(target)!r} is no regular file; name another.")
    probe = _beside(_real(target))
    try:
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise ImageError(f"no file can be written in {str(target.parent)!r}: {error.strerror}.") from error
    return target


def write_exr(
    path: str | os.PathLike[str],
    rgb: ArrayLike,
    layers: Mapping[str, ArrayLike] | None = None,
    metadata: Mapping[str, str | float | int] | None = None,
) -> None:
    """Write linear RGB and named layers to one EXR file, 32-bit floats, ZIP-compressed.

    Parameters: ``rgb`` (height, width, 3); ``layers`` of shape (height, width) become the channel ``name``,
    those of (height, width, 3) the channels ``name.R``, ``name.G``, ``name.B``; ``metadata`` becomes
    attributes of the file (integers are stored as text, since EXR's have 32 bits). Raises
    :class:`ImageError`.
    """
    main = np.asarray(rgb, dtype=np.float32)
    if main.ndim != 3 or main.shape[2] != 3:
        raise ImageError(f"the image must have the shape (height, width, 3); its shape is {main.shape}.")
    names, planes = ["R", "G", "B"], [main]
    for name, layer in (layers or {}).items():
        values = np.asarray(layer, dtype=np.float32)
        if values.shape == main.shape[:2]:
            names.append(name)
            planes.append(values[..., None])
        elif values.shape == main.shape:
            names += [f"{name}.{channel}" for channel in "RGB"]
            planes.append(values)
        else:
            raise ImageError(
                f"layer {name!r} must have the image's size {main.shape[:2]}, with 1 or 3 channels; "
                f"its shape is {values.shape}."
            )
    _write(path, np.concatenate(planes, axis=2), names, {"compression": "zip", **(metadata or {})})


def write_exr_plane(
    path: str | os.PathLike[str], values: ArrayLike, metadata: Mapping[str, str | float | int] | None = None
) -> None:
    """Write values of shape (height, width) as the channel ``Y`` of an EXR file, as :func:`write_exr` does."""
    plane = np.asarray(values, dtype=np.float32)
    if plane.ndim != 2:
        raise ImageError(f"the values must have the shape (height, width); their shape is {plane.shape}.")
    _write(path, plane[..., None], ["Y"], {"compression": "zip", **(metadata or {})})


def write_png(path: str | os.PathLike[str], rgb: ArrayLike, exposure: float = 1.0) -> None:
    """Write linear RGB of shape (height, width, 3) as an 8-bit PNG, tone-mapped by :func:`display`."""
    write_png_encoded(path, display(rgb, exposure))


def write_png_encoded(path: str | os.PathLike[str], values: ArrayLike) -> None:
    """Write values in [0, 1] of shape (height, width, 3), already display-encoded, as an 8-bit PNG."""
    clipped = np.clip(np.asarray(values, dtype=np.float64), 0.0, 1.0)
    _write(path, (clipped * 255.0 + 0.5).astype(np.uint8), ["R", "G", "B"], {"oiio:ColorSpace": "sRGB"})


def read(path: str | os.PathLike[str]) -> Image:
    """Read an image file of a suffix in ``READABLE`` as linear RGB.

    8- and 16-bit files are taken as sRGB and decoded. A grey image becomes three equal channels; an alpha
    channel is left out. Raises :class:`ImageError` for a missing, foreign or damaged file.
    """
    source = Path(path)
    channels, spec = _open(source)
    rgb = _main_channels(channels, source)
    encoded = str(spec.format) not in ("float", "half", "double")
    if encoded:
        rgb = srgb_decode(rgb)
    metadata = {item.name: item.value for item in spec.extra_attribs}
    return Image(rgb, _layers(channels), metadata, encoded)


def planes(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Every channel of an image file of a suffix in ``READABLE`` by its name, (height, width), as stored.

    Raises :class:`ImageError` for a missing, foreign or damaged file.
    """
    return _open(Path(path))[0]


def _open(source: Path) -> tuple[dict[str, NDArray[np.float32]], Any]:
    """The channels of a file, and OpenImageIO's description of it."""
    oiio = require()
    if source.suffix.lower() not in READABLE:
        raise ImageError(f"images are read from {', '.join(READABLE)} files; {str(source)!r} is none.")
    if not source.is_file():
        raise ImageError(f"there is no image file {str(source)!r}.")
    wishes = oiio.ImageSpec()
    # PFM stores the bottom row first; OpenImageIO turns it only for callers that pass a configuration.
    wishes.attribute("pnm:pfmflip", 1)
    stream = oiio.ImageInput.open(str(source), wishes)
    if stream is None:
        raise ImageError(f"{str(source)!r} cannot be read as an image: {oiio.geterror().strip()}.")
    spec = stream.spec()
    try:
        limits.check(f"the image {str(source)!r}", spec.image_bytes(True), source.stat().st_size)
        pixels = stream.read_image(oiio.FLOAT)
    except (ValueError, MemoryError) as error:
        raise ImageError(f"{error or 'there is too little memory'}; name another file than {str(source)!r}.") from error
    failure = stream.geterror().strip()
    stream.close()
    if pixels is None:
        raise ImageError(f"{str(source)!r} is damaged: {failure}.")
    values = np.asarray(pixels, dtype=np.float32).reshape(spec.height, spec.width, -1)
    return dict(zip(spec.channelnames, np.moveaxis(values, 2, 0), strict=True)), spec


def _main_channels(planes: dict[str, NDArray[np.float32]], source: Path) -> NDArray[np.float32]:
    if all(channel in planes for channel in "RGB"):
        return np.stack([planes.pop(channel) for channel in "RGB"], axis=2)
    grey = next((name for name in ("Y", "I") if name in planes), None)
    if grey is None:
        raise ImageError(f"{str(source)!r} has no channels R, G, B but {', '.join(planes)}.")
    return np.repeat(planes.pop(grey)[..., None], 3, axis=2)


def _layers(planes: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    layers = {}
    for name in list(planes):
        base = name.rpartition(".")[0]
        parts = [f"{base}.{channel}" for channel in "RGB"]
        if base and base not in layers and all(part in planes for part in parts):
            layers[base] = np.stack([planes.pop(part) for part in parts], axis=2)
    return {**layers, **planes}


def _write(path: str | os.PathLike[str], values: NDArray[Any], names: list[str], metadata: Mapping[str, Any]) -> None:
    oiio = require()
    target = _real(path)
    kind = oiio.UINT8 if values.dtype == np.uint8 else oiio.FLOAT
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    spec.channelnames = tuple(names)
    for name, value in metadata.items():
        spec.attribute(name, float(value) if isinstance(value, float) else str(value))
    partial = _beside(target)
    try:
        stream = oiio.ImageOutput.create(str(partial))
        if stream is None:
            raise ImageError(f"{str(target)!r} cannot be written: {oiio.geterror().strip()}.")
        done = stream.open(str(partial), spec) and stream.write_image(np.ascontiguousarray(values))
        closed = stream.close()
        if not (done and closed):
            raise ImageError(f"{str(target)!r} cannot be written: {stream.geterror().strip()}.")
        os.replace(partial, target)
    except OSError as error:
        raise ImageError(f"{str(target)!r} cannot be written: {error.strerror}.") from error
    finally:
        partial.unlink(missing_ok=True)


def _real(path: str | os.PathLike[str]) -> Path:
    # A link stays; what it leads to is replaced.
    return Path(os.path.realpath(path))


def _beside(target: Path) -> Path:
    # The suffix stays last: OpenImageIO picks the format by it.
    return target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
