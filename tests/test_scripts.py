"""The demo and the benchmark scripts at sizes that take a second: they write what they say. Exact."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from pmc_sampler.eval import images

pytestmark = pytest.mark.needs("mitsuba", "pyopencl", "OpenImageIO", "skimage", "flip_evaluator", "matplotlib")


@pytest.fixture
def script(checkout: Path) -> Iterator[Callable[[str], ModuleType]]:
    """Import a script of the checkout by its path."""
    loaded = []

    def load(path: str) -> ModuleType:
        name = f"script_{Path(path).stem}"
        spec = importlib.util.spec_from_file_location(name, checkout / path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # where dataclasses look themselves up
        loaded.append(name)
        spec.loader.exec_module(module)
        return module

    yield load
    for name in loaded:
        del sys.modules[name]


@pytest.mark.parametrize("renderer", ["opencl", "mitsuba"])
def test_the_demo(
    renderer: str, script: Callable[[str], ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["-o", str(tmp_path / "out"), "--size", "64x48", "--spp", "8", "--reference-spp", "32"]
    words += ["--renderer", renderer]
    assert script("examples/demo.py").main(words) == 0
    out = capsys.readouterr().out
    written = set(os.listdir(tmp_path / "out"))
    pictures = {f"{prefix}{name}.png" for prefix in ("", "caustic-") for name in ("pt", "pmc", "reference")}
    assert written == pictures | {"demo.png", "strategy.png", "pt.exr", "pmc.exr", "reference.exr", "reference"}
    assert str(tmp_path / "out") in out
    lines = [line.split() for line in out.splitlines()]
    rows = {cells[0]: cells for cells in lines if cells[:1] in (["PT"], ["PMC"])}
    assert rows["PT"][1] == rows["PMC"][1] == "8"
    pt, pmc = (images.read(tmp_path / "out" / f"{name}.exr") for name in ("pt", "pmc"))
    assert pt.layers["samples"].sum() == pmc.layers["samples"].sum() == 8 * 64 * 48
    assert (pt.layers["samples"] == 8).all()
    reference = images.read(tmp_path / "out" / "reference.png").rgb
    # The crop is what the contact sheet shows: four times as large, and somewhere the brightest of the floor.
    crop = images.read(tmp_path / "out" / "caustic-reference.png").rgb
    assert crop.shape[0] % 4 == crop.shape[1] % 4 == 0
    lower = reference[30:]
    assert np.isclose(crop.max(), lower.max(), rtol=1e-3)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--spp 0", "demo: budget spp is 0: expected samples a pixel above 0"),
        ("--spp 1.5", "invalid int value: '1.5'"),
        ("--seed -1", "'-1' is no seed; give a whole number from 0"),
        ("--size 3x30", "demo: --size is 3x30: expected 11x11 at least, which SSIM needs"),
        ("--size 99999x30", "demo: the image is 99999x30: expected 1 to 65535 pixels on each side"),
        ("--reference-spp 3", "demo: --reference-spp is 3: expected a multiple of 16, and 16 at least"),
        ("--reference-spp 0", "demo: --reference-spp is 0: expected a multiple of 16"),
        ("--renderer foo", "demo: no renderer is called 'foo'"),
        ("-o file", "demo: the output 'file' is a file; name a folder"),
        ("-o file/below", "demo: the folder 'file/below' cannot be made: Not a directory"),
    ],
)
def test_a_demo_that_cannot_be_says_why_and_leaves_nothing(
    words: str,
    sentence: str,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("a file")
    monkeypatch.setattr("sys.argv", ["demo.py", *words.split()])
    try:
        status = script("examples/demo.py").command()
    except SystemExit as stop:
        status = int(stop.code or 0)
    *before, said = capsys.readouterr().err.splitlines()
    assert (status, sentence in said) == (2, True), said
    assert before in ([], ["loading cornell-box for foo"], ["loading cornell-box for opencl"])
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("kind", [ImportError, MemoryError, RuntimeError, TypeError, OSError])
def test_a_demo_whose_renderer_fails_says_so(
    kind: type[Exception],
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """As it is set up, which leaves nothing, and as it renders."""

    def sick(*words: object, **options: object) -> None:
        raise kind("no light\nhere")

    module = script("examples/demo.py")
    monkeypatch.setattr("sys.argv", ["demo.py", "-o", str(tmp_path / "out"), "--size", "16x16"])
    monkeypatch.setattr(module.adapters, "load", sick)
    assert module.command() == 2
    assert capsys.readouterr().err.splitlines()[-1] == "demo: no light here"
    assert os.listdir(tmp_path) == []
    monkeypatch.setattr(module.adapters, "load", lambda *words, **options: sick)
    assert module.command() == 1
    assert capsys.readouterr().err.splitlines()[-1] == "demo failed: no light here"


def test_a_demo_without_a_library_names_the_extra(
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["demo.py"])
    monkeypatch.setitem(sys.modules, "skimage", None)
    assert script("examples/demo.py").command() == 2
    assert "pip install 'pmc-sampler[eval]'" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_a_demo_without_llvm_says_so(checkout: Path, tmp_path: Path) -> None:
    """In a process of its own, for the library is looked for once."""
    done = subprocess.run(
        [sys.executable, checkout / "examples" / "demo.py", "--renderer", "mitsuba"],
        cwd=tmp_path,
        env={**os.environ, "DRJIT_LIBLLVM_PATH": "/none/x.so"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.splitlines()[-1].startswith("demo: ")
    assert "Traceback" not in done.stderr
    assert "DRJIT_LIBLLVM_PATH names /none/x.so, and there is no such file" in done.stderr
    assert os.listdir(tmp_path) == []


def test_the_benchmark_of_overhead(script: Callable[[str], ModuleType], tmp_path: Path) -> None:
    words = ["-o", str(tmp_path), "--sizes", "64x64", "--spp", "6", "--repeats", "2", "--renderer", ""]
    assert script("benchmarks/overhead.py").main(words) == 0
    assert os.listdir(tmp_path) == ["overhead.md"]
    page = (tmp_path / "overhead.md").read_text()
    assert "| 64x64 | 6 | default |" in page
    assert "| 64x64 | 6 | uniform |" in page
    assert "bytes a pixel" in page


def test_the_benchmark_of_the_mitsuba_adapter(script: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """The same samples a pixel in batches of each size, a row for each kind of numbers."""
    module = script("benchmarks/mitsuba_throughput.py")
    words = ["-o", str(tmp_path), "--sizes", "32x24", "--spp", "2", "--rounds", "1"]
    assert module.main(words) == 0
    page = (tmp_path / "mitsuba_throughput.md").read_text()
    for kind in ("sobol", "independent"):
        for batch in ("all", "1", "1/8"):
            assert page.count(f"| 32x24 | {kind} | {batch} | ") == 1
    sizes = {share: [len(batch) for batch in module.drawn(32, 24, 2, share)] for share in (None, 1.0, 0.125)}
    assert sizes == {None: [1536], 1.0: [768] * 2, 0.125: [96] * 16}


def test_the_benchmark_of_the_opencl_tracer(script: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """On the scene that it makes itself, which has the hundred thousand triangles that it says."""
    module = script("benchmarks/opencl.py")
    words = ["-o", str(tmp_path), "--scenes", "mesh", "--size", "32x24", "--spp", "1", "--rounds", "1"]
    assert module.main(words) == 0
    page = (tmp_path / "opencl.md").read_text()
    assert page.count("| `mesh` |") == 3
    assert "32x24 pixels, 1 samples a pixel, 1 rounds" in page
    from pmc_sampler.adapters.opencl.load import scene_of

    meshes = scene_of(module.mesh_scene(tmp_path)).meshes
    assert max(len(mesh.triangles) for mesh in meshes) == 131_072


def test_the_benchmark_of_peers(
    script: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without a peer it measures PMC, and nothing again; a missing peer is one sentence, and the runs stay."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    main = script("benchmarks/peers.py").main
    words = ["-o", str(tmp_path / "out"), "--size", "32x24", "--spp", "4", "--seeds", "2", "--reference-spp", "16"]
    words += ["--own-seeds", "3"]
    assert main([*words, "--peers"]) == 0
    page = (tmp_path / "out" / "peers.md").read_text()
    assert "| our OpenCL tracer | PMC | 4.0 |" in page
    assert images.read(tmp_path / "out" / "peers.png").rgb.std() > 0.0
    rows = (tmp_path / "out" / "peers.jsonl").read_text()
    made = [json.loads(line) for line in rows.splitlines()]
    assert {(row["renderer"], row["seed"], str(row["method"]), "ssim" in row) for row in made} == {
        (renderer, seed, method, seed < 3)
        for renderer in ("opencl", "recorded")
        for seed in (1, 2, 3)
        for method in ("{}", "{'sampler': 'PMC'}")
    }
    assert len(made) == 12
    assert main([*words, "--peers"]) == 0
    assert (tmp_path / "out" / "peers.jsonl").read_text() == rows
    # Runs of other code stay in the file and count for nothing.
    others = "".join(json.dumps({**row, "code": "other", "mse": 1e6}) + "\n" for row in made)
    (tmp_path / "out" / "peers.jsonl").write_text(rows + others)
    assert main([*words, "--peers"]) == 0
    assert (tmp_path / "out" / "peers.md").read_text() == page
    (tmp_path / "out" / "peers.jsonl").write_text(rows)
    capsys.readouterr()
    assert main([*words, "--peers", "cycles", "--python", "no/such/python"]) == 2
    assert "cannot be run" in capsys.readouterr().err.splitlines()[-1]
    assert (tmp_path / "out" / "peers.jsonl").read_text() == rows
