"""Scenes read from glTF files hold what the specification says: shapes, materials, textures, cameras, light.

Files are made here from plain dictionaries, so that what is expected does not come from the library that reads them.
"""

from __future__ import annotations

import base64
import json
import math
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pygltflib", "OpenImageIO")

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
QUAD = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]]
QUAD_UVS = [[0, 1], [1, 1], [1, 0], [0, 0]]  # v down
FACES = [[0, 1, 2], [0, 2, 3]]
UP = [[0, 0, 1]] * 4
LIGHT = {"type": "point"}


class File:
    """A glTF file in the making."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.data = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}

    def add(self, kind: str, item: dict[str, Any]) -> int:
        self.json.setdefault(kind, []).append(item)
        return len(self.json[kind]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        start, self.data = len(self.data), self.data + data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **more})

    def accessor(self, values: Any, dtype: str = "f4", **more: Any) -> int:
        array = np.array(values, f"<{dtype}")
        width = array.shape[1] if array.ndim > 1 else 1
        item = {"bufferView": self.view(array.tobytes()), "componentType": CODES[dtype], "count": len(array)}
        return self.add("accessors", {**item, "type": TYPES[width], **more})

    def primitive(self, faces: Any = FACES, dtype: str = "u2", **more: Any) -> dict[str, Any]:
        """The attributes are `more` in capitals, as values or numbers of accessors; the rest are the primitive's."""
        made = {key: value for key, value in more.items() if not key.isupper()}
        attributes = {"POSITION": QUAD} | {key: value for key, value in more.items() if key.isupper()}
        made["attributes"] = {k: v if isinstance(v, int) else self.accessor(v) for k, v in attributes.items()}
        if faces is not None:
            made["indices"] = faces if isinstance(faces, int) else self.accessor(np.ravel(faces), dtype)
        return made

    def mesh(self, *primitives: dict[str, Any], node: dict[str, Any] | None = None, **more: Any) -> int:
        """A mesh with these primitives, or a quad, at a node."""
        mesh = self.add("meshes", {"primitives": list(primitives) or [self.primitive()], **more})
        return self.add("nodes", {"mesh": mesh, **(node or {})})

    def textured(self, material: dict[str, Any], **more: Any) -> None:
        """A quad with coordinates and this material."""
        self.mesh(self.primitive(TEXCOORD_0=QUAD_UVS, material=self.add("materials", material), **more))

    def lit(self, light: dict[str, Any] | None = None, **node: Any) -> None:
        """A point light, or another one, so that nothing is lit by default."""
        name = "KHR_lights_punctual"
        lights = self.json.setdefault("extensions", {}).setdefault(name, {"lights": []})["lights"]
        lights.append(light or LIGHT)
        self.add("nodes", {"extensions": {name: {"light": len(lights) - 1}}, **node})

    def picture(self, pixels: Any, name: str = "picture.png", uri: str | None = None, **sampler: Any) -> int:
        """The number of a texture with an image file of these pixels, (h, w, 1 to 4) of 8 or 16 bits."""
        image = self.add("images", {"uri": uri or self.image(pixels, name)})
        texture = {"source": image, **({"sampler": self.add("samplers", sampler)} if sampler else {})}
        return self.add("textures", texture)

    def image(self, pixels: Any, name: str) -> str:
        import OpenImageIO

        array = np.array(pixels)
        spec = OpenImageIO.ImageSpec(array.shape[1], array.shape[0], array.shape[2], str(array.dtype))
        spec.attribute("oiio:UnassociatedAlpha", 1)
        output = OpenImageIO.ImageOutput.create(name)
        assert output.open(str(self.folder / name), spec)
        assert output.write_image(array)
        output.close()
        return name

    def write(self, how: str = "embedded") -> Path:
        """The file with its buffer "embedded", "outer" or in a "binary" one."""
        file = self.folder / ("scene.glb" if how == "binary" else "scene.gltf")
        made = dict(self.json)
        if self.data and "buffers" not in made:
            made["buffers"] = [{"byteLength": len(self.data)}]
            if how == "embedded":
                made["buffers"][0]["uri"] = data_uri(self.data)
            elif how == "outer":
                made["buffers"][0]["uri"] = "some%20data.bin"
                (self.folder / "some data.bin").write_bytes(self.data)
        text = json.dumps(made).encode()
        file.write_bytes(glb(text, self.data) if how == "binary" else text)
        return file

    def read(self, how: str = "embedded", **more: Any) -> Any:
        from pmc_sampler.adapters.opencl import gltf

        return gltf.read(self.write(how), **more)


def moved(*offset: float) -> Any:
    """The quad's corners."""
    return np.add(QUAD, offset)


def data_uri(data: bytes, kind: str = "application/octet-stream") -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def glb(text: bytes, data: bytes = b"", version: int = 2, extra: bytes = b"") -> bytes:
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if data:
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    chunks += extra
    return struct.pack("<4sII", b"glTF", version, 12 + len(chunks)) + chunks


def linear(code: float) -> float:
    """IEC 61966-2-1."""
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


@pytest.fixture
def file(tmp_path: Path) -> File:
    return File(tmp_path)


@pytest.fixture
def refuses(file: File) -> Callable[..., None]:
    """A function that checks that the file is refused with these words, and with its name."""

    def check(*words: str, error: type[Exception] = ValueError, how: str = "embedded") -> None:
        with pytest.raises(error) as caught:
            file.read(how)
        message = str(caught.value)
        assert "scene.gl" in message
        assert "\n" not in message
        for word in words:
            assert word in message

    return check


# The container


@pytest.mark.parametrize("how", ["embedded", "outer", "binary"])
def test_containers(how: str, file: File) -> None:
    file.mesh(file.primitive(NORMAL=UP, TEXCOORD_0=QUAD_UVS), name="Quad")
    file.lit()
    scene = file.read(how)
    (mesh,) = scene.meshes
    np.testing.assert_array_equal(mesh.vertices, np.array(QUAD, np.float32))
    np.testing.assert_array_equal(mesh.triangles, FACES)
    np.testing.assert_array_equal(mesh.normals, UP)
    assert mesh.vertices.dtype == mesh.normals.dtype == np.float32
    assert mesh.triangles.dtype == np.uint32
    assert mesh.uvs is None  # no texture asks for them
    assert mesh.name == "primitive 0 of mesh 0 ('Quad') in node 0"
    assert scene.alpha_shadows


def test_a_file_by_another_writer(file: File, require: Callable[[str], Any]) -> None:
    gltf = require("pygltflib")
    file.mesh()
    model = gltf.GLTF2.from_json(json.dumps({**file.json, "buffers": [{"byteLength": len(file.data)}]}))
    model.set_binary_blob(file.data)
    model.save_binary(str(file.folder / "other.glb"))
    from pmc_sampler.adapters.opencl.load import scene_of

    scene = scene_of(file.folder / "other.glb", (20, 10))
    np.testing.assert_array_equal(scene.meshes[0].triangles, FACES)
    assert (scene.camera.width, scene.camera.height) == (20, 10)


def test_unknown_chunks_are_skipped(file: File) -> None:
    file.mesh()
    path = file.write("binary")
    path.write_bytes(glb(json.dumps({**file.json, "buffers": [{"byteLength": len(file.data)}]}).encode(), file.data,
                         extra=struct.pack("<I4s", 4, b"\xff\xfe\xfd\xfc") + b"abcd"))  # fmt: skip
    from pmc_sampler.adapters.opencl.gltf import read

    assert len(read(path).meshes) == 1


BROKEN = {
    "no JSON": ("scene.gltf", b"{", "no JSON"),
    "words": ("scene.gltf", b"hello", "it starts with 'hello' and is no JSON, nor glTF: expected a glTF 2.0 file"),
    "blank": ("scene.gltf", b" \n", "it is empty: expected a glTF 2.0 file"),
    "no text": ("scene.gltf", b"\xff\xfe{}", "no JSON in UTF-8"),
    "nested": ("scene.gltf", b"[" * 100000, "no JSON"),
    "a list": ("scene.gltf", b"[]", "no glTF"),
    "no asset": ("scene.gltf", b"{}", "no glTF"),
    "version 1": ("scene.gltf", b'{"asset": {"version": "1.0"}, "meshes": {}}', "glTF 1.0: expected 2.0"),
    "later readers": ("scene.gltf", b'{"asset": {"version": "2.1", "minVersion": "2.1"}}', "readers of 2.1"),
    "malformed": ("scene.gltf", b'{"asset": {"version": "2.0"}, "nodes": [5]}', "schema"),
    "bad magic": ("scene.glb", b'{"asset": {}}', "b'glTF'"),
    "empty": ("scene.glb", b"", "b'glTF'"),
    "header alone": ("scene.glb", b"glTF\2\0\0\0", "truncated"),
    "binary version 1": ("scene.glb", glb(b"{}", version=1), "version 1"),
    "truncated": ("scene.glb", glb(b'{"asset": {"version": "2.0"}}', b"1234" * 9)[:-4], "truncated"),
    "chunk too long": ("scene.glb", b"glTF" + struct.pack("<III4s", 2, 20, 99, b"JSON"), "truncated"),
    "nothing": ("scene.gltf", b'{"asset": {"version": "2.0"}}', "no triangles"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files(name: str, tmp_path: Path) -> None:
    from pmc_sampler.adapters.opencl.gltf import read

    file, data, words = BROKEN[name]
    (tmp_path / file).write_bytes(data)
    with pytest.raises(ValueError, match=r"scene\.gl") as caught:
        read(tmp_path / file)
    assert words in str(caught.value)


def test_missing_files(file: File, refuses: Callable[..., None]) -> None:
    from pmc_sampler.adapters.opencl.gltf import read

    with pytest.raises(FileNotFoundError, match="no scene file"):
        read(file.folder / "none.glb")
    with pytest.raises(OSError, match="cannot be read"):
        read(file.folder)
    file.mesh()
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": "none.bin"}]
    refuses("buffer 0", "none.bin", error=FileNotFoundError)


@pytest.mark.parametrize(
    "uri",
    ["http://example.org/a.bin", "https://example.org/a.bin", "file:///etc/passwd", "//host/a.bin", "/etc/passwd",
     "../a.bin", "a/../../a.bin", "%2e%2e/a.bin", "C:/a.bin", "a%00.bin"],
)  # fmt: skip
def test_uris_that_lead_elsewhere(uri: str, file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    (file.folder.parent / "a.bin").write_bytes(file.data)
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": uri}]
    refuses("buffer 0", "expected")


def test_bad_buffers(file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    file.json["buffers"] = [{"byteLength": len(file.data)}]
    refuses("no uri")
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": data_uri(file.data[:-1])}]
    refuses("buffer 0", f"has {len(file.data) - 1} bytes")
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": "data:;base64,?"}]
    refuses("base64")
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": "data:"}]
    refuses("without data")


def test_required_extensions(file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    for name, word in {
        "KHR_draco_mesh_compression": "decompress",
        "EXT_meshopt_compression": "decompress",
        "KHR_texture_basisu": "PNG or JPEG",
        "EXT_mesh_gpu_instancing": "without",
    }.items():
        file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["KHR_mesh_quantization", name]
        refuses(name, word)


def test_optional_extensions(file: File) -> None:
    file.mesh()
    file.json["extensionsUsed"] = ["KHR_materials_sheen", "KHR_materials_ior", "KHR_materials_clearcoat"]
    with pytest.warns(UserWarning, match="left out") as caught:
        file.read()
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == 2
    assert "KHR_materials_sheen" in messages[0]
    assert "KHR_materials_clearcoat" in messages[1]


# Accessors


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_index_types(dtype: str, file: File) -> None:
    file.mesh(file.primitive(dtype=dtype))
    np.testing.assert_array_equal(file.read().meshes[0].triangles, FACES)


def test_interleaved(file: File) -> None:
    rows = np.concatenate([np.array(QUAD, "<f4"), np.full((4, 1), np.nan, "<f4"), np.array(UP, "<f4")], axis=1)
    view = file.view(rows.tobytes(), byteStride=28)
    item = {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"}
    positions, normals = file.add("accessors", item), file.add("accessors", {**item, "byteOffset": 16})
    file.mesh(file.primitive(POSITION=positions, NORMAL=normals))
    (mesh,) = file.read().meshes
    np.testing.assert_array_equal(mesh.vertices, QUAD)
    np.testing.assert_array_equal(mesh.normals, UP)


def sparse(file: File, places: Any, values: Any, dtype: str = "u1") -> dict[str, Any]:
    at, new = np.array(places, f"<{dtype}"), np.array(values, "<f4")
    return {
        "count": len(at),
        "indices": {"bufferView": file.view(at.tobytes()), "componentType": CODES[dtype]},
        "values": {"bufferView": file.view(new.tobytes())},
    }


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_sparse(dtype: str, file: File) -> None:
    part = sparse(file, [1, 3], [[5, 6, 7], [8, 9, 1]], dtype)
    file.mesh(file.primitive(POSITION=file.accessor(QUAD, sparse=part)))
    item = {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": part}
    file.mesh(file.primitive(POSITION=file.add("accessors", item)))  # in place of zeros
    one, two = file.read().meshes
    np.testing.assert_array_equal(one.vertices, [QUAD[0], [5, 6, 7], QUAD[2], [8, 9, 1]])
    np.testing.assert_array_equal(two.vertices, [[0, 0, 0], [5, 6, 7], [0, 0, 0], [8, 9, 1]])


def test_normalized(file: File) -> None:
    colors = [[0, 51, 255, 255], [0, 0, 0, 102], [255] * 4, [0] * 4]
    normals = [[0, 0, 127], [0, -128, 0], [127, 0, 0], [0, 0, -127]]
    file.mesh(
        file.primitive(
            NORMAL=file.accessor(normals, "i1", normalized=True), COLOR_0=file.accessor(colors, "u1", normalized=True)
        )
    )
    file.mesh(file.primitive(COLOR_0=file.accessor([[0, 13107, 65535]] * 4, "u2", normalized=True)))
    one, two = file.read().meshes
    np.testing.assert_array_equal(one.normals, [[0, 0, 1], [0, -1, 0], [1, 0, 0], [0, 0, -1]])
    np.testing.assert_array_equal(one.colors, (np.array(colors) / np.float32(255)).astype(np.float32))
    np.testing.assert_array_equal(two.colors, np.array([[0, 13107 / 65535, 1, 1]] * 4, np.float32))


def test_quantized(file: File) -> None:
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    positions = file.accessor(np.array(QUAD) * 100 - 100, "i2")
    file.mesh(file.primitive(POSITION=positions), node={"scale": [0.01] * 3, "translation": [1, 1, 1]})
    np.testing.assert_allclose(file.read().meshes[0].vertices, QUAD, atol=1e-6)


def test_bad_accessors(file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    positions, _ = file.json["accessors"]
    views = file.json["bufferViews"]
    for change, words in [
        ({"count": 5}, ["POSITION", "needs 60 bytes", "has 48"]),
        ({"count": 10**15}, ["needs", "has 48"]),
        ({"count": 10**15, "bufferView": None}, ["no data"]),
        ({"count": -1}, ["count", "-1"]),
        ({"byteOffset": 4}, ["needs 52 bytes"]),
        ({"byteOffset": -4}, ["byteOffset", "-4"]),
        ({"bufferView": 7}, ["number 7", "there are 2"]),
        ({"type": "VEC2"}, ["'VEC2'", "expected VEC3"]),
        ({"componentType": 5130}, ["5130"]),
    ]:
        file.json["accessors"][0] = {**positions, **change}
        refuses(*words)
    file.json["accessors"][0] = positions
    for change, words in [
        ({"byteLength": 10**15}, ["buffer view 0", "ends at byte"]),
        ({"byteOffset": 10**15}, ["buffer view 0", "ends at byte"]),
        ({"byteStride": 8}, ["byteStride 8", "12 or more"]),
        ({"byteStride": 0}, ["byteStride 0"]),
        ({"buffer": 3}, ["number 3"]),
    ]:
        file.json["bufferViews"] = [{**views[0], **change}, *views[1:]]
        refuses(*words)


def test_bad_indices(file: File, refuses: Callable[..., None]) -> None:
    file.mesh(file.primitive([0, 1, 4]), name="Quad")
    refuses("primitive 0 of mesh 0 ('Quad')", "names vertex 4 and has 4")
    file.json["meshes"][0]["primitives"][0] = file.primitive(file.accessor([0, 1, 2], "f4"))
    refuses("unsigned integers")
    file.json["meshes"][0]["primitives"][0] = file.primitive(NORMAL=UP[:3])
    refuses("4 vertices", "3 elements of NORMAL")
    part = sparse(file, [4], [[0, 0, 0]])
    file.json["meshes"][0]["primitives"][0] = file.primitive(POSITION=file.accessor(QUAD, sparse=part))
    refuses("replaces element 4 and has 4")


def test_nan(file: File, refuses: Callable[..., None]) -> None:
    file.mesh(file.primitive(POSITION=[[0, 0, math.nan], *QUAD[1:]]))
    refuses("the vertices of primitive 0 of mesh 0", "NaN or infinite")


def test_nothing_to_see(file: File, refuses: Callable[..., None]) -> None:
    """Files that would give a blank picture."""
    file.mesh(file.primitive(POSITION=[[x, 0, 0] for x in range(4)]))
    refuses("none of the triangles in its scene has an area")
    for corners, words in [
        (np.multiply(QUAD, 1e-30), "radius 1.12e-30"),
        (np.multiply(QUAD, 1e20), "radius 1.12e+20"),
        (moved(2e7, 0, 0), "centre 2e+07 from the origin"),
    ]:
        file.json, file.data = {"asset": file.json["asset"]}, b""
        file.mesh(file.primitive(POSITION=corners))
        refuses(words, "scale it, or move it to the origin")
    file.json, file.data = {"asset": file.json["asset"]}, b""
    file.mesh(file.primitive(POSITION=np.multiply(QUAD, 1e20)))
    file.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}})
    file.add("nodes", {"camera": 0})
    refuses("primitive 0 of mesh 0 in node 0 has coordinates up to 2e+20: expected 1e+12 at most")


# Primitives


def test_modes(file: File) -> None:
    zigzag = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]]
    file.mesh(
        file.primitive(None, POSITION=zigzag, mode=5),
        file.primitive(None, POSITION=zigzag, mode=6),
        file.primitive(None, POSITION=zigzag),  # with vertices left over
        file.primitive([4, 3, 2, 1], POSITION=zigzag, mode=5),
        file.primitive([0, 1, 2, 2, 4, 4, 3, 1], POSITION=zigzag, mode=5),  # two strips in one
    )
    meshes = file.read().meshes
    assert [mesh.triangles.tolist() for mesh in meshes] == [
        [[0, 1, 2], [1, 3, 2], [2, 3, 4]],
        [[1, 2, 0], [2, 3, 0], [3, 4, 0]],
        [[0, 1, 2]],
        [[4, 3, 2], [3, 1, 2]],
        [[0, 1, 2], [4, 1, 3]],
    ]


def test_points_and_lines(file: File) -> None:
    file.mesh(file.primitive(mode=0), file.primitive(), file.primitive(mode=3), name="Mixed")
    file.mesh(file.primitive(None, POSITION=QUAD[:2]))
    with pytest.warns(UserWarning, match="no triangles") as caught:
        scene = file.read()
    assert len(scene.meshes) == len(caught) == 1
    for name in ("0 of mesh 0 ('Mixed') (POINTS)", "2 of mesh 0 ('Mixed') (LINE_STRIP)", "0 of mesh 1 (2 vertices)"):
        assert f"primitive {name}" in str(caught[0].message)


def test_bad_primitives(file: File, refuses: Callable[..., None]) -> None:
    file.mesh(file.primitive(mode=7))
    refuses("mode 7")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file.json["meshes"][0]["primitives"] = [file.primitive(mode=1)]
        refuses("no triangles")


def test_morph_targets(file: File) -> None:
    targets = [
        {"POSITION": file.accessor([[1, 0, 0]] * 4), "NORMAL": file.accessor([[1, 0, -1]] * 4)},
        {"POSITION": file.accessor([[0, 0, 4]] * 4)},
    ]
    file.mesh(file.primitive(NORMAL=UP, targets=targets), weights=[0.0, 0.5])
    file.add("nodes", {"mesh": 0, "weights": [1.0, 0.25]})
    file.mesh(file.primitive(targets=targets))
    one, two, three = file.read().meshes
    np.testing.assert_array_equal(one.vertices, moved(0, 0, 2))
    np.testing.assert_array_equal(one.normals, UP)
    np.testing.assert_array_equal(two.vertices, moved(1, 0, 1))
    np.testing.assert_array_equal(two.normals, [[1, 0, 0]] * 4)
    np.testing.assert_array_equal(three.vertices, QUAD)


# Nodes


def test_transforms(file: File) -> None:
    half = math.sqrt(0.5)
    turn = {"rotation": [0, 0, half, half], "scale": [2, 1, 4], "translation": [10, 0, 0]}  # z by 90 degrees
    file.mesh(file.primitive(NORMAL=[[0.6, 0.8, 0]] * 4), node=turn)
    columns = [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 5, 6, 7, 1]  # x by 90 degrees
    file.add("nodes", {"matrix": columns, "children": [0]})
    file.json["scenes"] = [{"nodes": []}, {"nodes": [1]}]
    file.json["scene"] = 1
    (mesh,) = file.read().meshes
    quad = np.array(QUAD, float)
    placed = np.stack([10 - quad[:, 1], 2 * quad[:, 0], 4 * quad[:, 2]], axis=1)
    placed = np.stack([placed[:, 0] + 5, 6 - placed[:, 2], placed[:, 1] + 7], axis=1)
    np.testing.assert_allclose(mesh.vertices, placed, atol=1e-6)
    # The normal is stretched by 1/2 and 1 before it is turned.
    expected = np.array([-0.8, 0.3, 0.0]) / math.hypot(0.8, 0.3)
    np.testing.assert_allclose(mesh.normals, [[expected[0], 0, expected[1]]] * 4, atol=1e-6)


@pytest.mark.parametrize("scale", [[-1, 1, 1], [1, 1, -2], [-1, -1, -1]])
def test_mirrored(scale: list[float], file: File) -> None:
    file.mesh(file.primitive(NORMAL=UP), node={"scale": scale})
    (mesh,) = file.read().meshes
    corners = mesh.vertices[mesh.triangles]
    front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (front[:, 2] * mesh.normals[0, 2] > 0).all()
    np.testing.assert_array_equal(mesh.normals, [[0, 0, np.sign(scale[2])]] * 4)
    np.testing.assert_array_equal(mesh.triangles[:, 0], [0, 0])


def test_instances_share_what_they_can(file: File) -> None:
    file.mesh(file.primitive(material=file.add("materials", {})), node={"translation": [1, 0, 0]})
    file.add("nodes", {"mesh": 0, "translation": [0, 2, 0]})
    scene = file.read()
    assert len(scene.materials) == 1
    np.testing.assert_array_equal(scene.meshes[0].vertices, moved(1, 0, 0))
    np.testing.assert_array_equal(scene.meshes[1].vertices, moved(0, 2, 0))


def test_hidden_nodes(file: File) -> None:
    file.mesh(node={"scale": [0, 0, 0]})
    file.mesh(file.primitive(NORMAL=UP), node={"scale": [1, 1, 0]})  # flat, but there
    (mesh,) = file.read().meshes
    np.testing.assert_array_equal(mesh.normals, UP)


def test_nodes_outside_the_scene(file: File) -> None:
    file.mesh()
    file.mesh(node={"translation": [9, 9, 9]})
    file.json["scenes"] = [{"nodes": [0]}]
    assert len(file.read().meshes) == 1


def test_deep_nesting(file: File) -> None:
    file.mesh()
    for i in range(1100):
        file.add("nodes", {"children": [i], "translation": [0, 0, 1]})
    np.testing.assert_array_equal(file.read().meshes[0].vertices, moved(0, 0, 1100))


def test_bad_nodes(file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    file.json["scenes"] = [{"nodes": [0]}]
    for change, words in [
        ({"children": [0]}, ["node 0", "tree"]),
        ({"children": [5]}, ["number 5"]),
        ({"mesh": 3}, ["the mesh of node 0", "number 3"]),
        ({"scale": [1, 2]}, ["the scale of node 0", "3 finite numbers"]),
        ({"matrix": [1] * 15}, ["the matrix of node 0", "16 finite numbers"]),
        ({"rotation": [0, 0, 0, 0]}, ["the rotation of node 0", "zero"]),
        ({"translation": [0, 0, math.inf]}, ["the translation of node 0"]),
    ]:
        file.json["nodes"] = [{"mesh": 0, **change}]
        refuses(*words)
    file.json["nodes"] = [{"mesh": 0, "scale": [1e200] * 3}]
    refuses("the vertices of", "NaN or infinite")
    file.json["scene"] = 4
    refuses("the default scene is number 4")


def test_skins(file: File) -> None:
    inverse = np.eye(4)
    inverse[:3, 3] = [-1, 0, 0]  # the joint was at x = 1 when it was bound
    skin = file.add(
        "skins",
        {"joints": [1, 2], "inverseBindMatrices": file.accessor(np.stack([np.eye(4), inverse.T]).reshape(2, 16))},
    )
    joints = file.accessor([[0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]], "u1")
    weights = file.accessor([[1, 0, 0, 0], [1, 0, 0, 0], [0.25, 0.25, 0, 0], [1, 0, 0, 0]])
    file.mesh(
        file.primitive(JOINTS_0=joints, WEIGHTS_0=weights, NORMAL=UP),
        node={"skin": skin, "translation": [100, 0, 0]},  # of no effect: joints place a skin
    )
    file.add("nodes", {"translation": [0, 5, 0]})
    file.add("nodes", {"translation": [1, 0, 3]})
    (mesh,) = file.read().meshes
    np.testing.assert_allclose(mesh.vertices, [[0, 5, 0], [2, 0, 3], [2, 1 + 2.5, 1.5], [0, 6, 0]], atol=1e-6)
    np.testing.assert_allclose(mesh.normals, UP, atol=1e-6)
    file.json["skins"][0]["joints"] = [1]
    with pytest.raises(ValueError, match="joints that are none of the 1"):
        file.read()
    file.json["skins"][0]["joints"] = [1, 9]
    with pytest.raises(ValueError, match="the joint 9"):
        file.read()


# Materials


def test_default_material(file: File) -> None:
    file.mesh()
    (material,) = file.read().materials
    assert (material.kind, material.color) == ("metallic-roughness", (1.0, 1.0, 1.0))
    assert (material.metallic, material.roughness, material.two_sided) == (1.0, 1.0, False)


def test_factors(file: File) -> None:
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.6}
    file.mesh(file.primitive(material=file.add("materials", {"pbrMetallicRoughness": pbr, "doubleSided": True})))
    (material,) = file.read().materials
    assert material.color == (0.1, 0.2, 0.3)
    assert (material.metallic, material.roughness, material.two_sided) == (0.5, 0.6, True)
    assert (material.opacity, material.cut_out) == (1.0, False)  # OPAQUE


@pytest.mark.parametrize(
    ("material", "words"),
    [
        ({"pbrMetallicRoughness": {"metallicFactor": 2.0}}, ["the metallic factor of material 0 ('M') is 2.0"]),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1]}}, ["the base colour", "4 finite numbers"]),
        ({"emissiveFactor": [0, 0, -1]}, ["the emission", "from 0 to 1"]),
        ({"alphaMode": "SOME"}, ["alphaMode", "'SOME'"]),
        ({"alphaMode": "MASK", "alphaCutoff": -1.0}, ["alphaCutoff"]),
        ({"extensions": {"KHR_materials_ior": {"ior": 0.5}}}, ["index of refraction", "1 or more"]),
        ({"extensions": {"KHR_materials_ior": 3}}, ["KHR_materials_ior", "an object"]),
        ({"extensions": {"KHR_materials_transmission": {"transmissionFactor": "x"}}}, ["transmission"]),
        ({"normalTexture": {"index": 8}}, ["the normal texture of material 0 ('M') is number 8"]),
    ],
)
def test_bad_materials(material: Any, words: list[str], file: File, refuses: Callable[..., None]) -> None:
    file.textured({"name": "M", **material})
    refuses(*words)


def test_alpha_modes(file: File) -> None:
    clear = {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4]}}
    for more in [
        {"alphaMode": "MASK"},
        {"alphaMode": "MASK", "alphaCutoff": 0.7},
        {"alphaMode": "BLEND", **clear},
        {"alphaMode": "BLEND"},
    ]:
        file.textured(more)
    made = file.read().materials
    assert [(m.cut_out, m.alpha_cutoff, m.opacity) for m in made] == [
        (True, 0.5, 1.0),
        (True, 0.7, 1.0),
        (True, None, 0.4),
        (False, None, 1.0),  # alpha is 1 all over
    ]


@pytest.mark.parametrize("alpha", [255, 100])
def test_alpha_of_textures(alpha: int, file: File) -> None:
    picture = file.picture(np.full((1, 1, 4), alpha, np.uint8))
    file.textured({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorTexture": {"index": picture}}})
    scene = file.read()
    assert scene.materials[0].cut_out == (alpha < 255)
    assert scene.textures[0].pixels[0, 0, 3] == np.float32(alpha / 255)


def test_vertex_colors(file: File) -> None:
    material = file.add("materials", {"alphaMode": "BLEND"})
    colors = [[0.1, 0.2, 0.3]] * 4
    file.mesh(file.primitive(material=material, COLOR_0=colors), file.primitive(material=material))
    scene = file.read()
    one, two = scene.meshes
    np.testing.assert_array_equal(one.colors, np.array([[0.1, 0.2, 0.3, 1]] * 4, np.float32))
    assert two.colors is None
    assert [scene.materials[mesh.material].vertex_colors for mesh in (one, two)] == [True, False]


def test_emission(file: File) -> None:
    strong = {"KHR_materials_emissive_strength": {"emissiveStrength": 20.0}}
    picture = file.picture(np.full((1, 1, 3), 128, np.uint8))
    file.textured({"emissiveFactor": [0.5, 1, 0], "extensions": strong, "emissiveTexture": {"index": picture}})
    file.textured({"emissiveFactor": [0.5, 1, 0], "doubleSided": True})
    file.textured({"emissiveTexture": {"index": picture}})  # times a factor of 0
    scene = file.read()
    assert [mesh.radiance for mesh in scene.meshes] == [(10.0, 20.0, 0.0), (0.5, 1.0, 0.0), None]
    assert [mesh.radiance_texture for mesh in scene.meshes] == [0, None, None]
    assert [mesh.emits_both_sides for mesh in scene.meshes] == [False, True, False]
    assert scene.textures[0].pixels[0, 0, 1] == np.float32(linear(128 / 255))
    assert scene.environment is None
    assert scene.lights == ()


def test_transmission(file: File) -> None:
    glass = {
        "KHR_materials_transmission": {"transmissionFactor": 0.9, "transmissionTexture": {"index": 0}},
        "KHR_materials_ior": {"ior": 1.33},
    }
    attenuation = {"attenuationColor": [1, 0, 0], "attenuationDistance": 2.0}
    volume = {"KHR_materials_volume": {"thicknessFactor": 0.5, **attenuation}}
    file.textured({"extensions": glass, "doubleSided": True})
    file.textured({"extensions": {**glass, **volume}, "doubleSided": True})
    file.textured({"extensions": {"KHR_materials_volume": {}, "KHR_materials_ior": {"ior": 0}}})
    with pytest.warns(UserWarning, match="left out") as caught:
        pane, solid, other = file.read().materials
    assert (pane.transmission, pane.eta, pane.thin, pane.two_sided) == (0.9, 1.33, True, True)
    assert (solid.transmission, solid.eta, solid.thin, solid.two_sided) == (0.9, 1.33, False, False)
    assert (other.transmission, other.eta, other.thin) == (0.0, 1.5, True)
    messages = [str(warning.message).partition("scene.gltf: ")[2] for warning in caught]
    assert messages == [
        "the transmission texture of material 0 is left out",
        "the transmission texture of material 1 is left out",
        "the attenuation in the volume of material 1 is left out",
        "the index of refraction of material 2 is 0, which is left out",
    ]


def test_unlit(file: File) -> None:
    picture = file.picture(np.array([[[255, 0, 0, 128]]], np.uint8))
    unlit = {"extensions": {"KHR_materials_unlit": {}}, "emissiveFactor": [1, 1, 1], "doubleSided": True}
    pbr = {"baseColorFactor": [0.5, 1, 1, 1], "baseColorTexture": {"index": picture}}
    file.textured({**unlit, "pbrMetallicRoughness": pbr, "alphaMode": "BLEND"})
    file.textured({**unlit, "pbrMetallicRoughness": pbr}, COLOR_0=[[1, 1, 1]] * 4)
    with pytest.warns(UserWarning, match="vertex colours on material 1, which is unlit"):
        scene = file.read()
    for mesh in scene.meshes:
        assert (mesh.radiance, mesh.radiance_texture, mesh.emits_both_sides) == ((0.5, 1.0, 1.0), 0, True)
    blended, opaque = scene.materials
    assert (blended.kind, blended.color, blended.color_texture) == ("diffuse", (0.0, 0.0, 0.0), 0)
    assert blended.cut_out
    assert (opaque.kind, opaque.color, opaque.color_texture) == ("diffuse", (0.0, 0.0, 0.0), None)
    assert scene.environment is not None  # nothing else lights the scene


# Textures


def test_textures(file: File) -> None:
    rows = np.array([[[255, 0, 0, 255], [0, 255, 0, 128]], [[10, 128, 0, 0], [1, 2, 3, 4]]], np.uint8)
    picture = {"index": file.picture(rows)}
    file.textured(
        {
            "pbrMetallicRoughness": {"baseColorTexture": picture, "metallicRoughnessTexture": picture},
            "normalTexture": {**picture, "scale": 0.7},
            "emissiveTexture": picture,
            "emissiveFactor": [1, 1, 1],
            "occlusionTexture": picture,
        }
    )
    scene = file.read()
    (material,), (mesh,) = scene.materials, scene.meshes
    assert (material.color_texture, mesh.radiance_texture) == (0, 0)
    assert material.metallic_roughness_texture == material.normal_texture == 1
    assert material.normal_scale == 0.7
    coded = rows / 255
    expected = np.array([[[*map(linear, texel[:3]), texel[3]] for texel in row] for row in coded])
    np.testing.assert_allclose(scene.textures[0].pixels, expected, rtol=1e-6)
    np.testing.assert_allclose(scene.textures[1].pixels, coded, rtol=1e-6)
    np.testing.assert_array_equal(mesh.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])  # v up
    assert (scene.textures[0].wrap, scene.textures[0].nearest) == ("repeat", False)


@pytest.mark.parametrize(
    ("channels", "dtype"), [(1, np.uint8), (2, np.uint8), (3, np.uint8), (3, np.uint16), (4, np.uint16)]
)
def test_channels(channels: int, dtype: Any, file: File) -> None:
    most = np.iinfo(dtype).max
    pixels = (np.arange(1, 2 * channels + 1).reshape(1, 2, channels) * (most // 10)).astype(dtype)
    file.textured({"normalTexture": {"index": file.picture(pixels)}})
    (texture,) = file.read().textures
    share = pixels / most
    np.testing.assert_allclose(texture.pixels[..., :3], share[..., :3] if channels > 2 else share[..., [0, 0, 0]])
    np.testing.assert_allclose(texture.pixels[..., 3], share[..., -1] if channels in (2, 4) else 1.0)


@pytest.mark.parametrize("how", ["data", "view", "jpeg", "webp"])
def test_where_images_are(how: str, file: File) -> None:
    name = {"jpeg": "a.jpg", "webp": "a.webp"}.get(how, "a b.png")
    file.image(np.full((8, 8, 3), 200, np.uint8), name)
    stored = (file.folder / name).read_bytes()
    image = {"bufferView": file.view(stored)} if how == "view" else {"uri": data_uri(stored, "image/png")}
    if how == "jpeg":
        image = {"uri": name}
    source = {"source": file.add("images", image)}
    texture = {"extensions": {"EXT_texture_webp": source}} if how == "webp" else source
    file.textured({"normalTexture": {"index": file.add("textures", texture)}})
    np.testing.assert_allclose(file.read().textures[0].pixels[..., :3], 200 / 255, atol=0.01)


def test_samplers(file: File) -> None:
    pixels = np.zeros((1, 1, 3), np.uint8)
    one = file.picture(pixels, wrapS=33071, wrapT=33071, magFilter=9728)
    two = file.picture(pixels, wrapS=33648, wrapT=33648, magFilter=9729)
    three = file.picture(pixels, wrapS=33648, wrapT=10497)
    file.textured({"normalTexture": {"index": one}, "emissiveTexture": {"index": two}, "emissiveFactor": [1, 1, 1]})
    file.textured({"normalTexture": {"index": three}})
    with pytest.warns(UserWarning, match="sampler 2 wraps u and v in two ways") as caught:
        textures = file.read().textures
    assert [(t.wrap, t.nearest) for t in textures] == [("clamp", True), ("mirror", False), ("mirror", False)]
    assert len(caught) == 1
    file.json["samplers"][0]["wrapS"] = 5
    with pytest.raises(ValueError, match="sampler 0 wraps as 5"):
        file.read()


def test_second_coordinates(file: File) -> None:
    picture = file.picture(np.zeros((1, 1, 3), np.uint8))
    second = {"index": picture, "texCoord": 1}
    other = (np.array(QUAD_UVS) * 0.5).tolist()
    file.textured({"normalTexture": second, "emissiveTexture": second, "emissiveFactor": [1, 1, 1]}, TEXCOORD_1=other)
    file.textured({"normalTexture": {"index": picture}, "emissiveTexture": second, "emissiveFactor": [1, 1, 1]},
                  TEXCOORD_1=other)  # fmt: skip
    file.textured({"normalTexture": second})
    with pytest.warns(UserWarning, match="left out") as caught:
        one, two, three = file.read().meshes
    np.testing.assert_array_equal(one.uvs, [[0, 0.5], [0.5, 0.5], [0.5, 1], [0, 1]])
    np.testing.assert_array_equal(two.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])
    assert (one.radiance_texture, two.radiance_texture, three.uvs) == (1, None, None)
    assert [str(warning.message).partition("scene.gltf: ")[2] for warning in caught] == [
        "the emission texture of material 1 is left out: its coordinates are not those of the normal texture of "
        "material 1",
        "the normal texture of material 2 is left out on meshes without TEXCOORD_1",
    ]


def test_texture_transforms(file: File) -> None:
    angle = 0.3
    transform = {"offset": [0.1, 0.2], "rotation": angle, "scale": [2, 3]}
    moved = {
        "index": file.picture(np.zeros((1, 1, 3), np.uint8)),
        "extensions": {"KHR_texture_transform": transform},
    }
    file.textured({"normalTexture": moved, "emissiveTexture": moved, "emissiveFactor": [1, 1, 1]})
    file.textured({"normalTexture": moved, "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]})
    with pytest.warns(UserWarning, match="the emission texture of material 1 is left out"):
        one, two = file.read().meshes
    u, v = (np.array(QUAD_UVS) * [2, 3]).T
    cos, sin = math.cos(angle), math.sin(angle)
    expected = np.stack([cos * u + sin * v + 0.1, 1 - (-sin * u + cos * v + 0.2)], axis=1)
    np.testing.assert_allclose(one.uvs, expected, atol=1e-6)
    np.testing.assert_allclose(two.uvs, expected, atol=1e-6)
    assert (one.radiance_texture, two.radiance_texture) == (1, None)


def test_bad_images(file: File, refuses: Callable[..., None], capfd: pytest.CaptureFixture[str]) -> None:
    file.picture(None, uri="none.png")
    file.textured({"normalTexture": {"index": 0}})
    refuses("image 0", "none.png", error=FileNotFoundError)
    (file.folder / "none.png").write_bytes(b"GIF89a")
    refuses("image 0 in 'none.png'", "expected a PNG, JPEG or WebP")
    (file.folder / "none.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    refuses("image 0 in 'none.png'", "the PNG is truncated")
    rng = np.random.default_rng(1)
    file.image(rng.integers(0, 255, (64, 64, 3), np.uint8), "whole.png")
    (file.folder / "none.png").write_bytes((file.folder / "whole.png").read_bytes()[:-4000])
    refuses("image 0 in 'none.png'", "the PNG is truncated")
    file.image(rng.integers(0, 255, (64, 64, 3), np.uint8), "whole.jpg")
    (file.folder / "none.png").write_bytes((file.folder / "whole.jpg").read_bytes()[:300])
    refuses("image 0 in 'none.png'", "cannot be decoded")
    assert capfd.readouterr() == ("", "")
    file.json["images"][0]["uri"] = "https://example.org/a.png"
    refuses("image 0", "expected a data: URI or a file")
    file.json["images"][0] = {"bufferView": 77}
    refuses("the buffer view of image 0 is number 77")
    file.json["images"] = []
    refuses("the image of", "number 0, and there are 0")
    file.json["textures"] = [{}]
    refuses("texture 0, has no image")


@pytest.mark.parametrize("side", [16385, 60000])
def test_huge_images_are_not_decoded(side: int, file: File, refuses: Callable[..., None]) -> None:
    name = file.image(np.zeros((1, 1, 3), np.uint8), "huge.png")
    data = bytearray((file.folder / name).read_bytes())
    data[16:24] = struct.pack(">II", side, side)
    import zlib

    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (file.folder / name).write_bytes(data)
    file.picture(None, uri=name)
    file.textured({"normalTexture": {"index": 0}})
    refuses(f"image 0 in 'huge.png' has {side}x{side} texels", "16384 a side")


# Cameras and light


def corner_rays(camera: Any) -> Any:
    """Directions through the image's upper left and lower right corners."""
    left, right, top, bottom = camera.window
    return np.array([[left, top, 1], [right, bottom, 1]]) @ camera.axes


def test_camera(file: File) -> None:
    file.mesh()
    file.add("cameras", {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "zfar": 1, "znear": 0}})
    lens = {"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1, "zfar": 50.0}
    file.add("cameras", {"type": "perspective", "perspective": lens})
    file.add("nodes", {"camera": 0})
    file.add("nodes", {"camera": 1, "translation": [1, 2, 3], "rotation": [0, math.sqrt(0.5), 0, math.sqrt(0.5)],
                       "scale": [2, 2, 2]})  # fmt: skip
    with pytest.warns(UserWarning, match="camera 0 is orthographic and left out"):
        camera = file.read().camera
    assert (camera.width, camera.height) == (720, 480)
    np.testing.assert_array_equal(camera.origin, [1, 2, 3])
    assert (camera.near, camera.far) == (0.1, 50.0)
    y = math.tan(0.4)
    # It looks along -x; its right is -z.
    np.testing.assert_allclose(corner_rays(camera), [[-1, y, 1.5 * y], [-1, -y, -1.5 * y]], atol=1e-6)
    del file.json["nodes"][1], lens["aspectRatio"], lens["zfar"]
    camera = file.read().camera
    assert (camera.width, camera.height, camera.far) == (640, 480, math.inf)
    camera = file.read(size=(100, 200)).camera
    assert (camera.width, camera.height) == (100, 200)
    np.testing.assert_allclose(camera.window, [-y / 2, y / 2, -y, y])


def test_bad_cameras(file: File, refuses: Callable[..., None]) -> None:
    file.mesh()
    file.add("cameras", {"type": "perspective"})
    file.add("nodes", {"camera": 0})
    refuses("camera 0", "yfov")
    for change, words in [
        ({"yfov": 4.0}, ["yfov"]),
        ({"yfov": math.pi}, ["the yfov of camera 0", "from 0 to 3.14059"]),
        ({"znear": None}, ["znear"]),
        ({"aspectRatio": 0}, ["aspectRatio"]),
    ]:
        file.json["cameras"][0]["perspective"] = {"yfov": 1.0, "znear": 0.1, **change}
        refuses(*words)
    file.json["cameras"][0]["perspective"] = {"yfov": 1.0, "znear": 0.1}
    file.json["nodes"][1]["scale"] = [0, 0, 0]
    refuses("camera 0 has no direction: node 1, or one above it, is scaled by 0")
    file.lit({"type": "directional"}, scale=[0, 0, 0])
    file.json["nodes"][1] = {}
    refuses("light 0 has no direction: node 2, or one above it, is scaled by 0")
    file.json["nodes"][1]["camera"] = 5
    refuses("the camera of node 1 is number 5")


@pytest.mark.parametrize("size", [None, (300, 100), (100, 300)])
def test_default_camera_sees_all(size: Any, file: File) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(60, 3)) * [3, 1, 5] + [100, -50, 20]
    file.mesh(file.primitive(None, POSITION=points))
    camera = file.read(size=size).camera
    assert (camera.width, camera.height) == (size or (640, 480))
    # The sphere around all points about their box's centre is within the frame's nearer edges, by a twentieth.
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = np.linalg.norm(points - center, axis=1).max()
    local = camera.axes.astype(float) @ (center - camera.origin)
    np.testing.assert_allclose(local[:2], 0, atol=1e-4)
    narrow = math.atan(min(camera.window[1::2]))
    assert local[2] * math.sin(narrow) == pytest.approx(1.05 * radius, rel=1e-5)
    assert camera.window[3] == pytest.approx(math.tan(math.radians(22.5)))
    away = -camera.axes[2]
    assert (away > 0.1).all()  # from the right, above and the front
    np.testing.assert_allclose(np.cross(camera.axes[0], camera.axes[1]), camera.axes[2], atol=1e-6)
    assert camera.axes[1, 1] < 0


def test_sizes(file: File) -> None:
    file.mesh()
    for size in [(0, 10), (10,), (1.5, 2), "ab", 5]:
        with pytest.raises(ValueError, match="whole pixels"):
            file.read(size=size)


def test_lights(file: File) -> None:
    from pmc_sampler.adapters.opencl.scene import DirectionalLight, PointLight

    file.mesh()
    file.lit({"type": "point", "color": [1, 0.5, 0], "intensity": 10}, translation=[1, 2, 3])
    file.lit({"type": "directional", "intensity": 3}, rotation=[-math.sqrt(0.5), 0, 0, math.sqrt(0.5)])
    file.lit({"type": "spot", "name": "Lamp"})
    with pytest.warns(UserWarning, match=r"light 2 \('Lamp'\) is a spot and left out"):
        scene = file.read()
    point, sun = scene.lights
    assert isinstance(point, PointLight)
    assert (point.position, point.intensity) == ((1.0, 2.0, 3.0), (10.0, 5.0, 0.0))
    assert isinstance(sun, DirectionalLight)
    np.testing.assert_allclose(sun.direction, [0, -1, 0], atol=1e-6)
    assert sun.irradiance == (3.0, 3.0, 3.0)
    assert scene.environment is None
    file.json["extensions"]["KHR_lights_punctual"]["lights"][0] = {"type": "moon"}
    with pytest.raises(ValueError, match="'moon'"):
        file.read()
    del file.json["extensions"]
    with pytest.raises(ValueError, match="the light of node 1 is number 0, and there are 0"):
        file.read()


def test_default_light(file: File) -> None:
    file.mesh()
    scene = file.read()
    np.testing.assert_array_equal(scene.environment.radiance, np.full((1, 1, 3), 0.5))
    (key,) = scene.lights
    assert key.irradiance == (2.0, 2.0, 2.0)
    right, down, along = scene.camera.axes @ np.array(key.direction)
    assert min(right, down, along) > 0.1  # from the left, above and behind the camera


def test_damaged_values(file: File) -> None:
    """Values of a file replaced at random: it is read, or refused with a sentence, and nothing else happens."""
    picture = file.picture(np.zeros((1, 1, 3), np.uint8), wrapS=10497)
    info = {"index": picture, "extensions": {"KHR_texture_transform": {"offset": [0, 0], "rotation": 0.0}}}
    extensions = {"KHR_materials_ior": {"ior": 1.5}, "KHR_materials_volume": {"thicknessFactor": 1.0}}
    pbr = {"baseColorTexture": info, "baseColorFactor": [1, 1, 1, 1], "metallicFactor": 1.0}
    material = {"pbrMetallicRoughness": pbr, "normalTexture": info, "alphaMode": "MASK", "extensions": extensions}
    targets = [{"POSITION": file.accessor(QUAD)}]
    part = sparse(file, [1], [[5, 6, 7]])
    skin = file.add("skins", {"joints": [1], "inverseBindMatrices": file.accessor(np.eye(4).reshape(1, 16))})
    file.textured(
        material, COLOR_0=[[1, 1, 1]] * 4, NORMAL=UP, targets=targets, POSITION=file.accessor(QUAD, sparse=part),
        JOINTS_0=file.accessor(np.zeros((4, 4)), "u1"), WEIGHTS_0=[[1, 0, 0, 0]] * 4, mode=4,
    )  # fmt: skip
    file.json["nodes"][0].update(skin=skin, weights=[0.5], rotation=[0, 0, 0, 1], scale=[1, 1, 1])
    file.lit({"type": "point", "color": [1, 1, 1], "intensity": 1.0}, children=[])
    file.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1, "aspectRatio": 1.0}})
    file.add("nodes", {"camera": 0, "matrix": np.eye(4).ravel().tolist()})
    file.json.update(scene=0, scenes=[{"nodes": [0, 1, 2]}], extensionsUsed=["KHR_lights_punctual"])
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": data_uri(file.data)}]
    text = json.dumps(file.json)
    places: list[list[Any]] = []

    def visit(value: Any, place: list[Any]) -> None:
        if place:
            places.append(place)
        for key, child in (
            value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else [])
        ):
            visit(child, [*place, key])

    visit(file.json, [])
    others: list[Any] = [None, "x", "", [], [1], {}, {"a": 1}, True]
    numbers: list[Any] = [-1, 0, 1, 2, 3, 7, 10**12, -0.5, 0.5, 1e9, 1e300, math.nan]
    rng = np.random.default_rng(3)
    read = refused = 0
    for _ in range(80):
        place = places[rng.integers(len(places))]
        file.json = json.loads(text)
        holder = file.json
        for key in place[:-1]:
            holder = holder[key]
        # Most are of the right type: the others do not get far.
        of_numbers = isinstance(holder[place[-1]], int | float) and rng.random() < 0.8
        values = numbers if of_numbers else others
        holder[place[-1]] = value = values[rng.integers(len(values))]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                file.read()
                read += 1
            except Exception as error:
                if not isinstance(error, ValueError | FileNotFoundError) or "scene.gltf" not in str(error):
                    pytest.fail(f"{place} = {value!r} raised {error!r}")
                refused += 1
    assert min(read, refused) > 10


def test_damaged_bytes(file: File) -> None:
    """Bytes of a binary file replaced, and its end cut off, at random: the same."""
    file.image(np.zeros((2, 2, 3), np.uint8), "a.png")
    image = file.add("images", {"bufferView": file.view((file.folder / "a.png").read_bytes())})
    file.textured({"normalTexture": {"index": file.add("textures", {"source": image})}}, NORMAL=UP)
    file.lit()
    path = file.write("binary")
    whole = path.read_bytes()
    from pmc_sampler.adapters.opencl.gltf import read

    read(path)
    rng = np.random.default_rng(4)
    for i in range(100):
        data = bytearray(whole[: rng.integers(len(whole))] if i % 4 == 0 else whole)
        for _ in range(rng.integers(4)):
            data[rng.integers(max(len(data), 1))] = rng.integers(256)
        path.write_bytes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                read(path)
            except Exception as error:
                if not isinstance(error, ValueError | FileNotFoundError) or "scene.glb" not in str(error):
                    pytest.fail(f"file {i} raised {error!r}")


# --- Rendered: from the file to the picture --------------------------------------------------------------------------
def seen(file: File) -> Any:
    """The file's picture, (h, w, 3), through the tracer."""
    from pmc_sampler import Budget, Config, adapters, render

    radiance = adapters.load("opencl", file.write("binary"), size=(32, 24))
    return render(radiance, 32, 24, Budget(spp=64), Config.uniform()).film.mean


@pytest.mark.needs("pyopencl")
def test_rendered_cards_show_what_is_behind_where_they_are_cut_out(file: File) -> None:
    """Unlit cards show their colour, exactly, and the sky where alpha is 0; light falls through them alike."""
    pixels = np.array([[[255, 255, 255, 255], [255, 255, 255, 0]]], np.uint8)
    card = {
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": file.picture(pixels, magFilter=9728, minFilter=9728)},
            "baseColorFactor": [0.2, 0.4, 0.6, 1.0],
        },
        "alphaMode": "MASK",
        "doubleSided": True,
        "extensions": {"KHR_materials_unlit": {}},
    }
    file.textured(card)
    file.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.01, "aspectRatio": 2.0}})
    file.add("nodes", {"camera": 0, "translation": [1.0, 0.5, 1.0]})
    image = seen(file)
    np.testing.assert_allclose(image[10:14, 10:14], np.broadcast_to([0.2, 0.4, 0.6], (4, 4, 3)), rtol=1e-5)
    np.testing.assert_allclose(image[10:14, 18:22], 0.5, rtol=1e-5)  # the sky of a file without light


@pytest.mark.needs("pyopencl")
@pytest.mark.parametrize("double_sided", [False, True])
def test_rendered_from_behind(file: File, double_sided: bool) -> None:
    white = {"pbrMetallicRoughness": {"metallicFactor": 0.0}, "doubleSided": double_sided}
    file.mesh(file.primitive(material=file.add("materials", white), NORMAL=UP))
    file.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.01}})
    file.add("nodes", {"camera": 0, "translation": [1.0, 0.5, -1.0], "rotation": [0.0, 1.0, 0.0, 0.0]})
    middle = seen(file)[10:14, 12:20]
    assert middle.mean() > 0.3 if double_sided else middle.max() == 0.0


@pytest.mark.needs("pyopencl")
def test_rendered_by_the_command(
    file: File, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`pmc-sampler render scene.glb`, framed and lit: the quad is all in the picture, its texture the right way up."""
    from pmc_sampler.eval import images

    from pmc_sampler.cli import main

    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0] = [255, 0, 0]  # the upper left
    pixels[1, 1] = [0, 0, 255]
    file.textured({
        "pbrMetallicRoughness": {
            "metallicFactor": 0.0,
            "baseColorTexture": {"index": file.picture(pixels, magFilter=9728, minFilter=9728)},
        }
    })  # fmt: skip
    path = file.write("binary")
    monkeypatch.chdir(file.folder)
    assert main(["render", path.name, "--size", "64x48", "--spp", "16", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["output"] == "scene.exr"
    rgb = images.read("scene.exr").rgb
    redder, bluer = rgb[..., 0] - rgb[..., 2] > 0.1, rgb[..., 2] - rgb[..., 0] > 0.1
    assert redder.sum() > 50
    assert bluer.sum() > 50
    (upper, left), (lower, right) = (np.argwhere(mask).mean(axis=0) for mask in (redder, bluer))
    assert upper < lower
    assert left < right
    border = np.concatenate([rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]])
    np.testing.assert_allclose(border, 0.5, atol=0.02)
