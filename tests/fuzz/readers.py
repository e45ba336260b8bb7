"""The readers of files that others may have made, as functions of bytes: what fuzz.py feeds and test_found.py replays.

Each reads the bytes from a file in a folder of its own. It may return, or raise what the reader documents for bad
files; it may not raise anything else, leave a file outside of that folder, take memory that the bytes do not pay for,
or run code.
"""

from __future__ import annotations

import io
import json
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmc_sampler import Budget, Config, Sampler, scenes, toml

HERE = Path(__file__).parent
REFUSED = (ValueError, TypeError, OSError)
"""What a reader says of a bad file; the errors of evaluation are ValueErrors."""


def radiance(batch: Any) -> np.ndarray:
    """A renderer that costs nothing."""
    return np.repeat(((batch.pixel % 7) / np.float32(7.0))[:, None], 3, axis=1).astype(np.float32)


def state() -> bytes:
    """A checkpoint with batches open, told in turn and out of turn."""
    sampler = Sampler(20, 15, Budget(spp=20), Config(initial_spp=2.0, batch=200, lookahead=2), seed=3, threads=1)
    while sampler.samples < 1500:
        batch = sampler.ask()
        sampler.tell(batch, radiance(batch))
    sampler.ask()
    later = sampler.ask()
    sampler.tell(later, radiance(later))
    with tempfile.TemporaryDirectory() as folder:
        sampler.save(Path(folder, "state"))
        return Path(folder, "state").read_bytes()


def checkpoint(path: Path) -> None:
    """Loads, goes on for three batches and reads the film."""
    sampler = Sampler.load(path, threads=1)
    for _ in range(3):
        if sampler.done or sampler.width * sampler.height > 10**5 or (sampler.config.batch or 0) > 10**5:
            break
        try:
            batch = sampler.ask()
        except RuntimeError:  # the budget is drawn
            break
        sampler.tell(batch, np.zeros((len(batch), 3 + sampler.aovs), np.float32))
    assert sampler.film.mean.shape == (sampler.height, sampler.width, 3)
    assert 0.0 <= sampler.visible_noise <= 1.0


def edited_checkpoint(path: Path) -> None:
    """A checkpoint that is whole but for bytes that the file's edits put over its blocks: raw mutations of an archive
    end at its checksums. An edit is 8 bytes: the block, where, how many times over, and 4 bytes to put there.
    """
    data = path.read_bytes()
    with np.load(io.BytesIO(state_once())) as archive:
        blocks = {name: archive[name].copy() for name in archive.files if name != "header"}
        header = archive["header"]
    names = sorted(blocks)
    for at in range(0, min(len(data), 80) - 7, 8):
        which, where, times, value = struct.unpack_from("<BHB4s", data, at)
        block = blocks[names[which % len(names)]]
        if len(block):
            new = np.frombuffer(value * (1 + times % 8), np.uint8)
            start = where * 4 % len(block)
            block[start : start + len(new)] = new[: len(block) - start]
    with path.open("wb") as file:
        np.savez(file, header=header, **blocks)
    checkpoint(path)


_state: list[bytes] = []


def state_once() -> bytes:
    """`state()`, made the first time."""
    if not _state:
        _state.append(state())
    return _state[0]


def reference(path: Path) -> None:
    """A reference in the cache."""
    from pmc_sampler.eval import references

    references.load(path)


def suite(path: Path) -> None:
    """A suite of the benchmark: nothing that its names lead to lies outside of the results."""
    from pmc_sampler.eval import results
    from pmc_sampler.eval import suite as suites

    made = suites.read(path)
    top = path.parent / "images"
    for scene in made.scenes:
        for run, _ in zip(made.runs(scene), range(1000), strict=False):
            for name in (
                results.image_name(scene.name, run.method.name, str(run.budget)),
                results.reference_name(scene.name),
            ):
                assert top.resolve() in (top / name).resolve().parents, name


def config(path: Path) -> None:
    """A file of settings."""
    Config.from_dict(toml.read(path))


def recording(path: Path) -> None:
    """A recording, whole."""
    from pmc_sampler.eval import recorded

    recorded.Recording(path)


def row(path: Path) -> None:
    """A row of a folder of results."""
    from pmc_sampler.eval import results

    folder = path.parent / "folder"
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    path.replace(folder / "runs" / "a.parquet")
    results.Folder(folder).row("a")


def plan(path: Path) -> None:
    """The plan of a folder of results, beside a suite that is in order."""
    from pmc_sampler.eval import results

    folder = path.parent / "folder"
    folder.mkdir(exist_ok=True)
    path.replace(folder / "plan.json")
    (folder / "suite.toml").write_bytes(suite_seed())
    results.load(folder)


def image(path: Path) -> None:
    """An image, of the kind that its first byte says."""
    from pmc_sampler.eval import images

    data = path.read_bytes()
    other = path.with_suffix(images.READABLE[data[0] % len(images.READABLE)] if data else ".png")
    other.write_bytes(data[1:])
    images.read(other)


def gltf(path: Path) -> None:
    """A glTF file, text or binary."""
    from pmc_sampler.adapters.opencl import gltf as reader

    reader.read(path, (16, 12))


def mitsuba_xml(path: Path) -> None:
    """A scene of Mitsuba for the OpenCL tracer."""
    from pmc_sampler.adapters.opencl import mitsuba_scene

    mitsuba_scene.read(path, (16, 12))


def povray_ini(path: Path) -> None:
    """Options of POV-Ray."""
    from pmc_sampler.adapters.povray import options

    options.read([str(path)])


def suite_seed() -> bytes:
    """A suite with all that one can have."""
    return b"""name = "a"
about = "b."
seeds = 2
baseline = "PT"
size = [32, 24]
spp = [4, 8]
renderer = "opencl"
reference_spp = 64
[[scene]]
name = "cornell-box"
[[scene]]
name = "x"
file = "../x.xml"
seconds = [1.5]
options = {a = [1, 2]}
[[method]]
name = "PT"
sampler = "uniform"
[[method]]
name = "P {moves} {eliminate}"
sampler = "pmc"
scenes = ["x"]
sweep = {moves = [1, 2], eliminate = [0.1, 0.5]}
on = {x = {moves = 1}}
"""


def _images() -> Iterator[bytes]:
    from pmc_sampler.eval import images

    with tempfile.TemporaryDirectory() as folder:
        for kind, suffix in enumerate(images.READABLE):
            values = np.linspace(0.0, 1.0, 5 * 7 * 3, dtype=np.float32).reshape(5, 7, 3)
            path = Path(folder, f"a{suffix}")
            if suffix == ".exr":
                images.write_exr(path, values, {"samples": values[..., 0], "error": values}, {"pmc:seed": 3})
            elif suffix == ".pfm":
                path.write_bytes(b"PF\n7 5\n-1.0\n" + values.tobytes())
            else:
                _write(path, values)
            yield bytes([kind]) + path.read_bytes()


def _write(path: Path, values: np.ndarray) -> None:
    import OpenImageIO as oiio  # noqa: N813

    out = oiio.ImageOutput.create(str(path))
    kind = oiio.FLOAT if path.suffix == ".hdr" else oiio.UINT8
    out.open(str(path), oiio.ImageSpec(values.shape[1], values.shape[0], 3, kind))
    out.write_image(values)
    out.close()


def _gltf_seeds() -> Iterator[bytes]:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    binary = corners + np.array([0, 1, 2, 0], "<u2").tobytes()
    model: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "scale": [2, 2, 2], "children": [2]}, {"camera": 0, "translation": [0, 0, 3]}, {}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.2, 1]}, "emissiveFactor": [1, 1, 1]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 8},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(model).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    yield struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
    import base64

    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    yield json.dumps({**model, "buffers": [{"byteLength": len(binary), "uri": uri}]}).encode()


def _row_seed() -> bytes:
    from pmc_sampler.eval import results

    with tempfile.TemporaryDirectory() as folder:
        results.Folder(folder).store({"id": "a", "scene": "b", "seed": 1, "mse": 0.5, "error": None, "tiles": [[1.0]]})
        return Path(folder, "runs", "a.parquet").read_bytes()


def _reference_seed() -> bytes:
    stream = io.BytesIO()
    plane = np.ones((3, 4), np.float32)
    color = np.ones((3, 4, 3), np.float32)
    names = {"spp": 64, "replicates": 4, "rejected": 0, "seconds": 1.5, "key": "abc"}
    np.savez(stream, mean=color, variance=color, luminance_variance=plane, **names)
    return stream.getvalue()


@dataclass(frozen=True)
class Reader:
    """A reader, the suffix of its files and files to begin with."""

    read: Callable[[Path], None]
    suffix: str
    seeds: Callable[[], list[bytes]]


READERS = {
    "checkpoint": Reader(checkpoint, "", lambda: [state_once()]),
    "edited-checkpoint": Reader(edited_checkpoint, "", lambda: [b"", bytes(range(64))]),
    "reference": Reader(reference, ".npz", lambda: [_reference_seed()]),
    "suite": Reader(suite, ".toml", lambda: [suite_seed()]),
    "config": Reader(config, ".toml", lambda: [b'preset = "uniform"\nradii = [0.5, 2]\nbatch = 50\nfilter = "tent"\n']),
    "recording": Reader(recording, ".h5", lambda: [(HERE.parent / "eval" / "cornell-box.h5").read_bytes()]),
    "row": Reader(row, ".parquet", lambda: [_row_seed()]),
    "plan": Reader(plan, ".json", lambda: [b'{"ids": ["a", "b"]}']),
    "image": Reader(image, "", lambda: list(_images())),
    "gltf": Reader(gltf, ".gltf", lambda: list(_gltf_seeds())),
    "mitsuba-xml": Reader(
        mitsuba_xml, ".xml", lambda: [scenes.path(name).read_bytes() for name in ("cornell-box", "thin-lens")]
    ),
    "povray-ini": Reader(
        povray_ini,
        ".ini",
        lambda: [b'Input_File_Name="a.pov"\n+W64 +H48 ; x\n[s]\nDeclare=A=1\nInclude_Ini="b.ini"\nLibrary_Path=.\n'],
    ),
}


def try_bytes(name: str, data: bytes) -> str:
    """Feeds a reader: what it said, or nothing where it took the file. Raises what it may not raise."""
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder, f"file{reader.suffix}")
        path.write_bytes(data)
        try:
            reader.read(path)
        except REFUSED as error:
            return str(error) or type(error).__name__
    return ""
