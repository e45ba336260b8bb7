"""What fuzzing found (fuzz.py) and what was thought of besides: every file is read or refused in a sentence. Exact."""

from __future__ import annotations

import importlib.util
import resource
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
pytestmark = pytest.mark.needs("OpenImageIO", "pyopencl", "mitsuba", "h5py", "pyarrow", "tomli_w")


@pytest.fixture(scope="module")
def readers() -> Any:
    """The module beside this one."""
    spec = importlib.util.spec_from_file_location("readers", HERE / "readers.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["readers"] = module
    spec.loader.exec_module(module)
    return module


def test_seeds_are_read(readers: Any) -> None:
    """Fuzzing that began with files which are refused would not get far."""
    for name, reader in readers.READERS.items():
        if name != "edited-checkpoint":
            assert [readers.try_bytes(name, seed) for seed in reader.seeds()] == [""] * len(reader.seeds()), name


@pytest.mark.parametrize("file", sorted(HERE.glob("found/*/*")), ids=lambda file: f"{file.parent.name}-{file.name}")
def test_findings(file: Path, readers: Any) -> None:
    readers.try_bytes(file.parent.name, file.read_bytes())


def png(width: int, height: int, rows: bytes = b"") -> bytes:
    """A PNG of RGB that says what it likes of its size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def suite_with(readers: Any, old: bytes, new: bytes) -> bytes:
    seed: bytes = readers.suite_seed()
    assert old in seed
    return seed.replace(old, new)


LONG_LIST = b"[" + b", ".join(b"%d" % k for k in range(100)) + b"]"

SIZE = "cannot be read as an image|promises"

CASES: dict[str, tuple[str, Callable[[Any], bytes], str]] = {
    "png": ("image", lambda r: b"\3" + png(60000, 60000), SIZE),
    "png within limits": ("image", lambda r: b"\3" + png(12000, 12000), SIZE),
    "pfm": ("image", lambda r: b"\2PF\n30000 30000\n-1.0\nxxxx", SIZE),
    "hdr": (
        "image",
        lambda r: b"\1#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\nxxxx",
        SIZE,
    ),
    "sweep": (
        "suite",
        lambda r: suite_with(
            r,
            b"sweep = {moves = [1, 2], eliminate = [0.1, 0.5]}",
            b"[method.sweep]\nmoves = %s\neliminate = %s\na = %s\nb = %s\nc = %s\n" % ((LONG_LIST,) * 5),
        ).replace(b"on = {x = {moves = 1}}", b""),
        "its sweep has more than 100000 combinations",
    ),
    "seeds": ("suite", lambda r: suite_with(r, b"seeds = 2", b"seeds = 1000000000000"), "has more than 100000 runs"),
    "wide name": ("suite", lambda r: suite_with(r, b"P {moves}", b"P {moves:>3000000000}"), "the name may hold"),
    "attribute": ("suite", lambda r: suite_with(r, b"P {moves}", b"P {moves.__class__}"), "the name may hold"),
    "deep suite": ("suite", lambda r: b"a = " + b"[" * 100_000, "no TOML"),
    "deep settings": ("config", lambda r: b"a = " + b"[" * 100_000, "no TOML"),
    "deep plan": ("plan", lambda r: b"[" * 100_000, "holds no results"),
    "plan outside": ("plan", lambda r: b'{"ids": ["../a"]}', "its plan names other files than its own"),
    "plan of no list": ("plan", lambda r: b'{"ids": 5}', "its plan names other files than its own"),
    "deep gltf": ("gltf", lambda r: b'{"asset": ' + b"[" * 100_000, "it is no JSON"),
    "entities": (
        "mitsuba-xml",
        lambda r: (
            b'<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;"><!ENTITY d SYSTEM "/etc/hostname">]>'
            b'<scene version="3.0.0"><shape type="&d;"/></scene>'
        ),
        "Mitsuba cannot load",
    ),
    "film": (
        "mitsuba-xml",
        lambda r: (
            b'<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm">'
            b'<integer name="crop_width" value="1000000000"/></film></sensor></scene>'
        ),
        "crop",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_files_that_promise_too_much(case: str, readers: Any) -> None:
    """Refused, in a process that may not take 1 GiB more than it has."""
    import re

    name, data, sentence = CASES[case]
    made = data(readers)
    readers.try_bytes(name, readers.READERS[name].seeds()[0])  # what is read with is there
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, before[1]))
    try:
        said = readers.try_bytes(name, made)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert re.search(sentence, said), said


def test_ini_files_that_include_each_other_many_times(tmp_path: Path) -> None:
    """Nine files of 1 kB, of which each names the next thirty times: 30^8 lines."""
    from pmc_sampler.adapters.povray import options

    for k in range(9):
        (tmp_path / f"{k}.ini").write_text(f'Include_Ini="{k + 1}.ini"\n' * 30 if k < 8 else "+W9\n")
    with pytest.raises(ValueError, match="include each other without end"):
        options.read([str(tmp_path / "0.ini")])


@pytest.mark.needs("c++")
@pytest.mark.parametrize("renderer", ["opencl", "mitsuba"])
@pytest.mark.parametrize("name", ["ours", "roughplastic", "../outside"])
def test_a_scene_brings_no_code(name: str, renderer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mitsuba loads `plugins/NAME.so` beside a scene, even in place of its own; this one writes a file when loaded."""
    (tmp_path / "plugins").mkdir()
    source = tmp_path / "a.cpp"
    source.write_text(
        "#include <fstream>\nnamespace { struct A { A() { std::ofstream(" + f'"{tmp_path}/loaded"' + "); } } a; }\n"
    )
    library = tmp_path / "plugins" / f"{name}.so"
    subprocess.run([str(shutil.which("c++")), "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"/><emitter type="constant"/>'
        f'<shape type="sphere"><bsdf type="{name}"/></shape></scene>'
    )
    monkeypatch.chdir(tmp_path)
    from pmc_sampler import adapters

    with pytest.raises(ValueError, match="is no plugin of Mitsuba's own, and a scene file may bring no code along"):
        adapters.load(renderer, str(scene), size=(16, 12))
    assert not (tmp_path / "loaded").exists()


def test_the_library_would_write_the_file(tmp_path: Path) -> None:
    """The control: loaded, such a library does what the test above looks for."""
    import ctypes

    source, library = tmp_path / "a.cpp", tmp_path / "a.so"
    source.write_text(
        "#include <fstream>\nnamespace { struct A { A() { std::ofstream(" + f'"{tmp_path}/loaded"' + "); } } a; }\n"
    )
    subprocess.run([str(shutil.which("c++")), "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    ctypes.CDLL(str(library))
    assert (tmp_path / "loaded").exists()
