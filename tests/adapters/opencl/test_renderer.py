"""The renderer as its users see it: one image however batches are cut, devices by name, sentences for what cannot be.
Exact but where rounding is named.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Budget, Config, adapters, render

pytestmark = pytest.mark.needs("pyopencl", "mitsuba", "OpenImageIO")

SIZE = (48, 32)


@pytest.fixture(scope="module")
def renderer(opencl: Any) -> Any:
    return opencl.OpenCLRenderer("materials", size=SIZE)


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_any_split_and_order_gives_the_same_bits(opencl: Any, batch_of: Any, sampler: str) -> None:
    renderer = opencl.OpenCLRenderer("cornell-box-mirrors", sampler, size=SIZE)
    batch = batch_of(*SIZE, 7, 3)
    whole = renderer(batch)
    assert whole.dtype == np.float32
    assert whole.shape == (len(batch), 3)
    assert whole.std() > 0.0
    order = np.random.default_rng(0).permutation(len(batch))
    assert renderer(batch[order]).tobytes() == whole[order].tobytes()
    for size in (1, 63, 64, 65, 1000):
        some = slice(100, 100 + size)
        assert renderer(batch[some]).tobytes() == whole[some].tobytes()
    for piece in (64, 777, 5000):
        renderer._piece = renderer._largest = piece
        assert renderer(batch).tobytes() == whole.tobytes()
    assert len(renderer(batch[:0])) == 0


def test_pieces_take_a_quarter_of_a_second(opencl: Any) -> None:
    from pmc_sampler.adapters.opencl.renderer import next_piece

    assert next_piece(10_000, 0.1, 10_000, 10**6) == 20_000  # 25,000 would take that long: not at once
    assert next_piece(20_000, 0.2, 20_000, 10**6) == 25_000
    assert next_piece(25_000, 2.5, 25_000, 10**6) == 2_500
    assert next_piece(900_000, 0.01, 900_000, 10**6) == 10**6
    assert next_piece(100, 0.01, 20_000, 10**6) == 2_500  # the rest of a batch
    assert next_piece(10, 100.0, 20_000, 10**6) == 64


def test_out_of_memory_makes_pieces_smaller(opencl: Any, batch_of: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """And where even small ones do not fit, it is said, and the renderer goes on when there is room."""
    renderer = opencl.OpenCLRenderer("diffuse", size=SIZE)
    batch = batch_of(*SIZE, 40, 3)
    whole = renderer(batch)
    renderer._piece, room, real = 50_000, 20_000, renderer._room

    def tight(count: int) -> Any:
        if count > room:
            raise MemoryError("full")
        return real(count)

    monkeypatch.setattr(renderer, "_room", tight)
    assert renderer(batch).tobytes() == whole.tobytes()
    assert renderer._largest < room * 2
    room = 0
    with pytest.raises(MemoryError, match="full"):
        renderer(batch)
    monkeypatch.undo()
    assert renderer(batch).tobytes() == whole.tobytes()


def test_other_samples_have_other_values(renderer: Any, batch_of: Any) -> None:
    """The negative control of the above."""
    assert renderer(batch_of(*SIZE, 2, 3)).tobytes() != renderer(batch_of(*SIZE, 2, 4)).tobytes()


def test_another_device_agrees_within_rounding(renderer: Any, batch_of: Any, tmp_path: Path) -> None:
    """Code without what is special about x86 stands for another device: where every path takes the same turns, values
    differ by rounding, and a path in a thousand may take another."""
    text = f"""
import numpy as np, sys
from pmc_sampler.adapters.opencl import OpenCLRenderer, program
build = program.build
options = ("-cl-std=CL1.2", "-cl-opt-disable")
program.build = lambda context, macros: build(context, {{**macros, "PORTABLE": "1"}}, options=options)
values = np.load({str(tmp_path / "batch.npz")!r})
class Batch: positions, scramble, index = (values[name] for name in ("positions", "scramble", "index"))
np.save({str(tmp_path / "out.npy")!r}, OpenCLRenderer("materials", size={SIZE})(Batch))
"""
    batch = batch_of(*SIZE, 2, 3)
    np.savez(tmp_path / "batch.npz", positions=batch.positions, scramble=batch.scramble, index=batch.index)
    subprocess.run([sys.executable, "-c", text], check=True, env={**os.environ, "POCL_DEVICES": "basic"})
    other, ours = np.load(tmp_path / "out.npy"), renderer(batch)
    assert np.isclose(other, ours, rtol=1e-3, atol=1e-4).all(axis=1).mean() > 0.999
    np.testing.assert_allclose(other.mean(axis=0), ours.mean(axis=0), rtol=1e-2)


def test_the_sampler_drives_it() -> None:
    radiance = adapters.load("opencl", "cornell-box", size=SIZE)
    assert (radiance.width, radiance.height) == SIZE
    results = [
        render(radiance, *SIZE, Budget(spp=16), config, seed=2) for config in (Config(), Config.uniform(), Config())
    ]
    assert [result.samples for result in results] == [16 * 48 * 32] * 3
    assert results[0].film.mean.tobytes() == results[2].film.mean.tobytes()
    np.testing.assert_allclose(results[0].film.mean.mean(), results[1].film.mean.mean(), rtol=0.1)


def test_a_scene_without_shapes_or_without_light(opencl: Any, parts: Any, camera: Any, batch_of: Any) -> None:
    sky = parts.Environment(np.full((1, 1, 3), 0.25, np.float32))
    assert (opencl.OpenCLRenderer(parts.Scene(camera(), (), environment=sky))(batch_of(16, 16, 1, 0)) == 0.25).all()
    ball = parts.Sphere((0.0, 0.0, 0.0), 1.0, 0)
    dark = parts.Scene(camera(), (parts.Material("diffuse"),), spheres=(ball,))
    assert (opencl.OpenCLRenderer(dark)(batch_of(16, 16, 1, 0)) == 0.0).all()
    with pytest.raises(ValueError, match="there is nothing to see"):
        opencl.OpenCLRenderer(parts.Scene(camera(), ()))


def test_devices_are_chosen_by_name(opencl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.opencl import devices

    found = devices.devices()
    name = devices.label(found[0])
    monkeypatch.delenv(devices.VARIABLE, raising=False)
    assert devices.choose() == found[0]
    assert devices.choose("0") == devices.choose(name[2:12].upper()) == found[0]
    assert name in opencl.OpenCLRenderer.probe()
    with pytest.raises(ValueError, match=r"no OpenCL device is called 'teapot'; give .* 0: "):
        devices.choose("teapot")
    monkeypatch.setenv(devices.VARIABLE, "17")
    with pytest.raises(ValueError, match=r"no OpenCL device is called '17' \(from PMC_SAMPLER_DEVICE\)"):
        devices.choose()
    assert devices.choose("0") == found[0]  # what is asked for goes before the variable


def test_devices_are_chosen_by_kind_and_never_by_an_ambiguous_name(
    opencl: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import types

    import pyopencl as cl
    from pmc_sampler.adapters.opencl import devices

    def device(name: str, kind: int, version: str) -> Any:
        platform = types.SimpleNamespace(name="Portable")
        return types.SimpleNamespace(name=name, type=kind, platform=platform, driver_version=version)

    gpu, twin = (device("Big GPU", cl.device_type.GPU, "1") for _ in range(2))
    new, old = (device("pthread", cl.device_type.CPU, version) for version in ("6.1", "3.0"))
    monkeypatch.setattr(devices, "devices", lambda: [gpu, twin, new, old])
    monkeypatch.setenv(devices.VARIABLE, "")
    assert devices.choose() is gpu
    assert devices.choose("CPU") is new
    assert devices.choose("gpu") is gpu
    assert devices.choose("1") is twin
    assert devices.choose("PTHREAD (Portable, 3.0)") is old
    with pytest.raises(ValueError, match=r"2 OpenCL devices are called 'pthread'; .* 2: pthread .*; 3: pthread"):
        devices.choose("pthread")
    for name in ("", " ", "accelerator"):
        with pytest.raises(ValueError, match=rf"no OpenCL device is called '{name}'; give the number, the kind \(cpu"):
            devices.choose(name)
    monkeypatch.setenv(devices.VARIABLE, "big")
    with pytest.raises(ValueError, match=r"2 OpenCL devices are called 'big' \(from PMC_SAMPLER_DEVICE\)"):
        devices.choose()


def test_gpus_come_before_cpus_and_new_pocl_before_old(opencl: Any) -> None:
    import pyopencl as cl
    from pmc_sampler.adapters.opencl import devices

    class Device:
        def __init__(self, kind: int, version: str, units: int = 1, unified: bool = False) -> None:
            self.type, self.version, self.max_compute_units, self.host_unified_memory = kind, version, units, unified
            self.platform = self

    old, new = (Device(cl.device_type.CPU, f"OpenCL 3.0 PoCL {v}") for v in ("3.0-rc2", "6.1"))
    gpu, vendor = Device(cl.device_type.GPU, "OpenCL 3.0 CUDA"), Device(cl.device_type.CPU, "OpenCL 3.0 (Build 0)")
    shared = Device(cl.device_type.GPU, "OpenCL 3.0", 96, unified=True)
    larger = Device(cl.device_type.GPU, "OpenCL 3.0", 80)
    assert sorted([old, shared, vendor, new, gpu, larger], key=devices._rank) == [larger, gpu, shared, vendor, new, old]


def test_no_device(opencl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.opencl import devices

    monkeypatch.setattr(devices.cl, "get_platforms", lambda: [])
    with pytest.raises(RuntimeError, match=r"no OpenCL device on this machine.*pip install pocl-binary-distribution"):
        opencl.OpenCLRenderer("cornell-box")
    entry = next(entry for entry in adapters.available() if entry.name == "opencl")
    assert not entry.runs
    assert "pocl-binary-distribution" in str(entry.trouble)


def test_a_pocl_that_does_not_know_the_processor(opencl: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """On an AMD of family 26 pip's PoCL 3.0 says "error: unknown target CPU 'generic'" of every kernel."""
    import pyopencl as cl
    from pmc_sampler.adapters.opencl import devices

    class Device:
        name, driver_version, type = "pthread-AMD EPYC", "3.0-rc2", cl.device_type.CPU
        available = compiler_available = True

        def __init__(self, version: str) -> None:
            self.version, self.platform = f"OpenCL 3.0 PoCL HSTR: pthread-{version}", self

        def get_devices(self) -> list[Any]:
            return [self]

    old = Device("x86_64-unknown-linux-gnu-generic")
    monkeypatch.setattr(devices.cl, "get_platforms", lambda: [old])
    with pytest.raises(RuntimeError, match=r"pthread-AMD EPYC .*3\.0-rc2\) is older .* apt install pocl-opencl-icd"):
        devices.choose()
    others = [Device(name) for name in ("x86_64-pc-linux-gnu-znver3", "aarch64-unknown-linux-gnu-generic")]
    monkeypatch.setattr(devices.cl, "get_platforms", lambda: [old, *others])
    assert devices.devices() == others


def test_a_kernel_that_does_not_build(opencl: Any, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    from pmc_sampler.adapters.opencl import devices, program

    source = program.source
    monkeypatch.setattr(program, "source", lambda macros: source(macros) + "\nnonsense here;")
    with pytest.raises(RuntimeError) as caught:
        opencl.OpenCLRenderer("cornell-box")
    sentence = str(caught.value)
    assert devices.label(devices.choose()) in sentence
    assert "-cl-std=CL1.2" in sentence
    assert "nonsense" in sentence


def test_kernels_compile_without_a_warning(opencl: Any) -> None:
    """A compiler may print "1 warning generated." past Python, on the user's terminal."""
    import pyopencl as cl
    from pmc_sampler.adapters.opencl import devices, program
    from pmc_sampler.adapters.opencl.load import scene_of
    from pmc_sampler.adapters.opencl.tables import tables

    macros = tables(scene_of("materials")).macros
    context = cl.Context([devices.choose()])
    options = (*program.OPTIONS, "-Werror")
    program.build(context, macros, options=options)
    with pytest.raises(RuntimeError, match="constant"):
        program.build(context, macros, more="int wrong(int a) { return a && 7; }", options=options)


def test_all_is_compiled_before_the_first_sample(opencl: Any, batch_of: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL finishes compiling when it first starts a kernel, once for small calls and once for large ones."""
    started: list[tuple[int, int]] = []
    monkeypatch.setattr(
        opencl.OpenCLRenderer, "_enqueue", lambda self, count, buffers, items: started.append((count, items))
    )
    opencl.OpenCLRenderer("diffuse", size=(400, 300))
    assert sorted(started) == [(0, 1 << 14), (0, 400 * 300)]
    started.clear()
    opencl.OpenCLRenderer("diffuse", size=SIZE)
    assert started == [(0, SIZE[0] * SIZE[1])]


def test_scenes_that_do_not_fit(opencl: Any, parts: Any, camera: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.opencl import memory

    class Device:
        name, driver_version = "Tiny", "1"
        max_mem_alloc_size, global_mem_size = 1000, 1500

        @property
        def platform(self) -> Any:
            return self

    with pytest.raises(MemoryError, match=r"triangle packets take 1004 bytes.* Tiny .*at most 1000 bytes in one piece"):
        memory.check(Device(), {"triangle_packets": np.zeros(251, np.float32)})
    arrays = {"texels": np.zeros(200, np.float32), "vertices": np.zeros(201, np.float32)}
    with pytest.raises(MemoryError, match=r"1604 bytes, most of it its vertices, .* has 1500 bytes"):
        memory.check(Device(), arrays)
    import pyopencl as cl

    with pytest.raises(MemoryError, match=r"out of memory: 2 MiB were asked for"), memory.guarded(Device(), 2 << 20):
        raise cl.MemoryError("clCreateBuffer", cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE, "none left")


@pytest.mark.parametrize(
    ("scene", "options", "error", "message"),
    [
        ("cornell-bax", {}, ValueError, "did you mean 'cornell-box'"),
        ("no.xml", {}, FileNotFoundError, "no.xml"),
        ("no.glb", {}, FileNotFoundError, "no.glb"),
        ("no.obj", {}, ValueError, r"no\.obj .*\.xml, \.gltf and \.glb"),
        (7, {}, TypeError, "a scene is .*, not int"),
        ("cornell-box", {"sampler": "halton"}, ValueError, "a sampler is 'sobol' or 'independent', not 'halton'"),
        ("cornell-box", {"size": (0, 4)}, ValueError, "a size is"),
        ("cornell-box", {"device": "teapot"}, ValueError, "teapot"),
    ],
)
def test_bad_input(opencl: Any, scene: Any, options: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        opencl.OpenCLRenderer(scene, **options)


def test_positions_alone_are_no_batch(renderer: Any) -> None:
    with pytest.raises(TypeError, match=r"called with a Batch .*, not with ndarray"):
        renderer(np.zeros((4, 2), np.float32))


def test_programs_come_from_the_cache(tmp_path: Path) -> None:
    """A second process builds nothing: PoCL's cache has not a file more."""
    from pmc_sampler.adapters.opencl import devices

    text = "from pmc_sampler.adapters.opencl import OpenCLRenderer as R; import numpy as np\n" + (
        "class B: positions=np.ones((4,2),np.float32); scramble=index=np.zeros(4,np.uint32)\n"
        "r = R('diffuse', size=(16, 12)); r(B); print(r.device)"
    )
    pocl = next(str(i) for i, device in enumerate(devices.devices()) if "Portable" in devices.label(device))
    counts = []
    for _ in range(2):
        environment = {**os.environ, "POCL_CACHE_DIR": str(tmp_path), "PMC_SAMPLER_DEVICE": pocl}
        subprocess.run([sys.executable, "-c", text], check=True, env=environment)
        counts.append(len(list(tmp_path.rglob("*.so"))))
    assert counts[0] == counts[1] > 0


def test_without_a_folder_for_caches(tmp_path: Path) -> None:
    """PoCL has no device then, unless it is given a folder; that is gone afterwards."""
    environment = {**os.environ, "HOME": "/proc/none", "TMPDIR": str(tmp_path), "XDG_CACHE_HOME": ""}
    environment.pop("POCL_CACHE_DIR", None)
    program = (
        "from pmc_sampler import Budget, adapters, render\n"
        "radiance = adapters.load('opencl', 'cornell-box', size=(8, 6))\n"
        "print(render(radiance, 8, 6, Budget(spp=1)).samples)"
    )
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, cwd=tmp_path, check=False
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout == "48\n"
    assert list(tmp_path.iterdir()) == []
