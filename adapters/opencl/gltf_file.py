"""The parts of a glTF 2.0 file, each checked before anything is made of it: JSON, buffers, accessors, files beside it.

`pygltflib` reads the JSON into its classes. It takes sizes, offsets and indices as they come, and so they are checked
here: nothing larger than the data that is there gets allocated.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import re
import struct
import urllib.parse
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
from numpy.typing import NDArray

from .gltf_values import pick, whole

__all__ = ["Document"]

_SUPPORTED = (
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
)
_REMEDIES = {
    "KHR_draco_mesh_compression": "decompress its meshes, or export it without mesh compression",
    "EXT_meshopt_compression": "decompress its buffers, or export it without mesh compression",
    "KHR_texture_basisu": "export its textures as PNG or JPEG",
}
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}  # other matrices have padding, and no use here
_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")


class Document:
    """A glTF file: `model` is its `pygltflib.GLTF2`, `json` the same as plain dictionaries and lists.

    Raises FileNotFoundError for a missing file, OSError for one that cannot be read and ValueError for one that is no
    glTF 2.0 or requires an extension that is not supported; warns once for each other extension that is left out.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        text, self._binary = _split(file, _bytes_of(file, "the scene file"))
        self.json = _parsed(text)
        try:
            self.model: Any = pygltflib.GLTF2.from_json(text, infer_missing=True)
        except Exception as error:  # whatever the classes stumble over
            raise ValueError(f"its JSON does not follow the schema of glTF 2.0 ({error}); export it anew") from error
        self._buffers: dict[int, bytes] = {}
        self._said: set[str] = set()
        for name in self.model.extensionsRequired or []:
            if name not in _SUPPORTED:
                remedy = _REMEDIES.get(str(name), "export it without that")
                raise ValueError(
                    f"it requires the extension {name}, which is not supported; {remedy} "
                    f"(supported are {', '.join(_SUPPORTED)})"
                )
        for name in self.model.extensionsUsed or []:
            if name not in _SUPPORTED:
                self.warn(f"the extension {name} is not supported and left out")

    def warn(self, sentence: str) -> None:
        """Warns (UserWarning) of what is left out, once for each sentence."""
        if sentence not in self._said:
            self._said.add(sentence)
            warnings.warn(f"{self.file}: {sentence}", stacklevel=3)

    def accessor(self, index: Any, what: str, types: Sequence[str]) -> NDArray[Any]:
        """An accessor's elements (section 3.6.2), (count, width): as stored, or float32 where they are normalized.

        types: those that are expected, such as "VEC3". Raises ValueError where data are missing or of another type.
        """
        accessor = pick(self.model.accessors, index, f"the accessor of {what}")
        label = f"accessor {index} ({what})"
        if accessor.type not in types:
            raise ValueError(f"{label} is of the type {accessor.type!r}: expected {' or '.join(types)}")
        if accessor.componentType not in _COMPONENTS:
            raise ValueError(f"{label} has the component type {accessor.componentType!r}: expected {_either()}")
        width, component = _WIDTHS[accessor.type], _COMPONENTS[accessor.componentType]
        count = whole(accessor.count, f"the count of {label}")
        if accessor.bufferView is not None:
            values = self._view(accessor.bufferView, accessor.byteOffset, component, count, width, label)
        else:
            # Zeros, to be replaced in part: never more of them than the file has bytes, lest its numbers allocate.
            available = sum(len(self._buffer(i)) for i in range(len(self.model.buffers)))
            if count > available:
                raise ValueError(f"{label} has {count} elements and no data: expected a bufferView")
            values = np.zeros((count, width), component)
        if accessor.sparse is not None:
            values = self._replaced(values, accessor.sparse, label)
        if accessor.normalized and values.dtype.kind in "iu":
            values = values / np.float32(np.iinfo(values.dtype).max)
            values = np.maximum(values, np.float32(-1.0))  # the lowest of the signed integers is beyond it
        return values

    def indices(self, index: Any, what: str) -> NDArray[np.uint32]:
        """The vertex indices in an accessor, (count,)."""
        values = self.accessor(index, what, ["SCALAR"])
        if values.dtype.kind != "u":
            raise ValueError(f"accessor {index} ({what}) holds {values.dtype.name}: expected unsigned integers")
        return values[:, 0].astype(np.uint32)

    def content(self, view: Any, what: str) -> bytes:
        """The bytes of a buffer view."""
        data, start, length, _ = self._range(view, what)
        return data[start : start + length]

    def beside(self, uri: str, what: str) -> Path:
        """The file that a relative URI names (section 2.8).

        Raises ValueError for URIs that lead out of the file's folder, FileNotFoundError where there is no such file.
        """
        name = urllib.parse.unquote(uri)
        if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|//", uri) or "\0" in name:
            raise ValueError(
                f"{what} is at {uri[:80]!r}: expected a data: URI or a file beside the scene's; put it there"
            )
        relative = os.path.normpath(name)
        if os.path.isabs(name) or relative.split(os.sep)[0] == os.pardir:
            raise ValueError(
                f"{what} is at {uri[:80]!r}, outside the scene's folder: expected a file in there; move it there"
            )
        path = self.file.parent / relative
        if not path.is_file():
            raise FileNotFoundError(f"{self.file}: {what} is in {uri!r}, and there is no file {path}; put it there")
        return path

    def read(self, uri: Any, what: str) -> bytes:
        """The bytes that a URI names: data: or a file beside the scene's; raises as `beside` does, and OSError."""
        if not isinstance(uri, str):
            raise ValueError(f"{what} has the URI {uri!r}: expected text")
        if not uri.startswith("data:"):
            return _bytes_of(self.beside(uri, what), what)
        head, comma, body = uri.partition(",")
        if not comma:
            raise ValueError(f"{what} has a data: URI without data: expected 'data:<type>;base64,<data>'")
        plain = urllib.parse.unquote_to_bytes(body)
        if not head.endswith(";base64"):
            return plain
        try:
            return base64.b64decode(plain, validate=True)
        except binascii.Error as error:
            raise ValueError(f"{what} has a data: URI that is no base64 ({error}); export the file anew") from error

    def _buffer(self, index: Any) -> bytes:
        """A buffer's bytes, `byteLength` of them."""
        buffer = pick(self.model.buffers, index, "the buffer of a buffer view")
        if index not in self._buffers:
            label = f"buffer {index}"
            if buffer.uri is not None:
                data = self.read(buffer.uri, label)
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise ValueError(f"{label} has no uri, and the file no binary chunk for it: expected one of them")
            length = whole(buffer.byteLength, f"the byteLength of {label}")
            if len(data) < length:
                raise ValueError(f"{label} has {len(data)} bytes and should have {length}; get the whole of it")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _range(self, index: Any, what: str) -> tuple[bytes, int, int, int | None]:
        """The buffer, the start, the length and the stride of a buffer view."""
        view = pick(self.model.bufferViews, index, f"the buffer view of {what}")
        data = self._buffer(view.buffer)
        start = whole(view.byteOffset or 0, f"the byteOffset of buffer view {index}")
        length = whole(view.byteLength, f"the byteLength of buffer view {index}")
        if start + length > len(data):
            raise ValueError(
                f"buffer view {index} ({what}) ends at byte {start + length} of buffer {view.buffer}, "
                f"which has {len(data)}; export the file anew"
            )
        return data, start, length, view.byteStride

    def _view(self, view: Any, offset: Any, component: str, count: int, width: int, what: str) -> NDArray[Any]:
        """(count, width) elements in a buffer view, not copied."""
        data, start, length, stride = self._range(view, what)
        offset = whole(offset or 0, f"the byteOffset of {what}")
        dtype = np.dtype(component)
        size = width * dtype.itemsize
        if stride is not None and stride < size:
            raise ValueError(
                f"{what} has elements of {size} bytes and the byteStride {stride}: expected {size} or more"
            )
        step = size if stride is None else stride
        end = offset + step * (count - 1) + size if count else 0
        if end > length:
            raise ValueError(
                f"{what} with {count} elements needs {end} bytes of buffer view {view}, which has {length}; "
                "export the file anew"
            )
        return np.ndarray((count, width), dtype, data, start + offset, (step, dtype.itemsize))

    def _replaced(self, values: NDArray[Any], sparse: Any, what: str) -> NDArray[Any]:
        """`values` with those that a sparse accessor gives (section 3.6.2.3)."""
        count = whole(sparse.count, f"the sparse count of {what}")
        if sparse.indices is None or sparse.values is None or sparse.indices.componentType not in _UNSIGNED:
            raise ValueError(
                f"{what} is sparse without values or unsigned indices: expected both; export the file anew"
            )
        places, given = sparse.indices, sparse.values
        component = _COMPONENTS[places.componentType]
        at = self._view(places.bufferView, places.byteOffset, component, count, 1, f"the sparse indices of {what}")[
            :, 0
        ]
        new = self._view(
            given.bufferView, given.byteOffset, values.dtype.str, count, values.shape[1], f"the sparse values of {what}"
        )
        if count and int(at.max()) >= len(values):
            raise ValueError(f"{what} replaces element {int(at.max())} and has {len(values)}; export the file anew")
        values = values.copy()
        values[at] = new
        return values


def _either() -> str:
    return "one of " + ", ".join(str(code) for code in _COMPONENTS)


def _bytes_of(path: Path, what: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no scene file {path}") from None
    except OSError as error:
        raise OSError(f"{what} {path} cannot be read: {error.strerror}") from error


def _split(file: Path, data: bytes) -> tuple[str, bytes | None]:
    """The JSON and the binary chunk of a file; ones that start with the magic are GLB (section 4.4)."""
    binary = None
    if data[:4] == b"glTF" or file.suffix.lower() == ".glb":
        chunks = dict(reversed(list(_chunks(data))))  # of several the first counts
        data, binary = chunks.get(b"JSON", b""), chunks.get(b"BIN\0")
    try:
        return data.decode("utf-8-sig"), binary
    except UnicodeDecodeError as error:
        raise ValueError(f"it is no JSON in UTF-8 (byte {error.start}): expected a glTF 2.0 file") from error


def _chunks(data: bytes) -> Iterable[tuple[bytes, bytes]]:
    """The types and contents of a GLB's chunks."""
    if data[:4] != b"glTF":
        raise ValueError(f"it starts with {data[:4]!r}: expected b'glTF', as binary glTF does; is it a .gltf?")
    if len(data) < _HEADER.size:
        raise ValueError(f"it is truncated, to {len(data)} bytes; get the whole of it")
    _, version, length = _HEADER.unpack_from(data)
    if version != 2:
        raise ValueError(f"it is version {version} of binary glTF: expected 2; convert it to glTF 2.0")
    if length > len(data):
        raise ValueError(f"it is truncated: it has {len(data)} bytes and should have {length}; get the whole of it")
    at = _HEADER.size
    while at + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        if at + size > length:
            raise ValueError(f"its chunk {kind!r} is truncated: it should end at byte {at + size} of {length}")
        yield kind, data[at : at + size]
        at += size


def _parsed(text: str) -> dict[str, Any]:
    """The JSON of a file whose version is 2."""
    try:
        parsed = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        start = text.strip()[:20]
        if not start:
            raise ValueError("it is empty: expected a glTF 2.0 file; get the whole of it") from error
        if start[0] != "{":
            raise ValueError(f"it starts with {start!r} and is no JSON, nor glTF: expected a glTF 2.0 file") from error
        raise ValueError(f"it is no JSON ({error}): expected a glTF 2.0 file; export it anew") from error
    asset = parsed.get("asset") if isinstance(parsed, dict) else None
    if not isinstance(parsed, dict) or not isinstance(asset, dict):
        raise ValueError("it is JSON, but no glTF: expected an object with an 'asset'")
    least = asset.get("minVersion", "2.0")
    if not re.fullmatch(r"2\.\d+", str(asset.get("version"))) or least != "2.0":
        came = asset.get("version") if least == "2.0" else f"for readers of {least}"
        raise ValueError(f"it is glTF {came}: expected 2.0; convert it, or export it anew")
    return parsed
