"""Scenes for POV-Ray made by hand, and a look at what its processes leave."""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]
SIZE = (48, 36)

# A ball before a plane, lit by a point: no random number is drawn. The tiles have no border at a pixel's centre.
PLAIN = """
#version 3.7;
global_settings { assumed_gamma 1.0 }
camera { location <0, 1, -5> direction z right x*4/3 up y }
light_source { <3, 4, -5> 1 }
sphere { <0, 1, 0>, 1 pigment { color rgb <0.8, 0.5, 0.2> } }
plane { y, 0 pigment { checker rgb 0.9 rgb 0.1 translate <0.31, 0.5, 0.37> } }
"""
# The same under a lamp of some size, whose shadow rays are random.
NOISY = PLAIN.replace("<3, 4, -5> 1", "<3, 4, -5> 1 area_light 4*x, 4*y, 2, 2 jitter")
# From within this ball, of radius 20, a pixel's colour is where its ray ends.
BALL = """#version 3.7;
global_settings { assumed_gamma 1 }
sphere { 0, 20 hollow pigment { average pigment_map {
  [1 function { 0.5 + x / 40 } color_map { [0 rgb 0] [1 rgb <3, 0, 0>] }]
  [1 function { 0.5 + y / 40 } color_map { [0 rgb 0] [1 rgb <0, 3, 0>] }]
  [1 function { 0.5 + z / 40 } color_map { [0 rgb 0] [1 rgb <0, 0, 3>] }] } }
  finish { ambient 0 diffuse 0 emission 1 } }
"""
CAMERA = {"location": (0, 1, -5), "right": (4 / 3, 0, 0), "up": (0, 1, 0), "direction": (0, 0, 1)}


@pytest.fixture(scope="session")
def povray(require: Callable[[str], Any]) -> Any:
    """The adapter."""
    require("OpenImageIO")
    import pmc_sampler.adapters.povray

    return pmc_sampler.adapters.povray


@pytest.fixture(scope="session")
def program(povray: Any) -> Any:
    """The module that runs POV-Ray."""
    from pmc_sampler.adapters.povray import program

    return program


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files, of this test alone, so that what is left there is seen."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


@pytest.fixture
def running(temporary: Path) -> Callable[[], list[str]]:
    """A function that lists the processes that work below `temporary`."""

    def find() -> list[str]:
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if os.readlink(process / "cwd").startswith(str(temporary)):
                    found.append((process / "cmdline").read_text().replace("\0", " "))
            except OSError:  # it has ended meanwhile, or is not ours
                continue
        return [line for line in found if line]

    return find


@pytest.fixture
def appears(running: Callable[[], list[str]]) -> Callable[[], bool]:
    """A function that says whether a process is there. While it becomes another program it has no command line."""

    def wait() -> bool:
        until = time.perf_counter() + 5
        while not running() and time.perf_counter() < until:
            time.sleep(0.01)
        return bool(running())

    return wait


@pytest.fixture
def clean(temporary: Path, running: Callable[[], list[str]]) -> Iterator[None]:
    """Fails a test after which a process or a file of POV-Ray's is left. What was killed needs some milliseconds."""
    yield
    until = time.perf_counter() + 5
    while (running() or list(temporary.iterdir())) and time.perf_counter() < until:
        time.sleep(0.01)
    assert running() == []
    assert list(temporary.iterdir()) == []


@pytest.fixture(scope="session")
def plain_text() -> str:
    return PLAIN


@pytest.fixture(scope="session")
def noisy_text() -> str:
    return NOISY


@pytest.fixture(scope="session")
def ball_text() -> str:
    return BALL


@pytest.fixture(scope="session")
def plain_camera() -> dict[str, Any]:
    """That of both scenes."""
    return dict(CAMERA)


@pytest.fixture
def make(povray: Any, tmp_path: Path, plain_camera: Any, clean: None) -> Iterator[Any]:
    """A function that gives a renderer of a scene's text, with the camera known; it is closed in the end."""
    made = []

    def renderer(text: str, **options: Any) -> Any:
        file = tmp_path / "scene.pov"
        file.write_text(text)
        made.append(povray.PovRayRenderer(file, **{"size": SIZE, "camera": plain_camera, "timeout": 60, **options}))
        return made[-1]

    yield renderer
    for one in made:
        one.close()


@pytest.fixture(scope="session")
def centres(batch_of: Any) -> Callable[..., Any]:
    """A function that gives a batch of `spp` samples at the centre of each pixel, with a number."""

    def make(size: tuple[int, int] = SIZE, spp: int = 1, number: int = 0, seed: int = 0) -> Any:
        batch = batch_of(*size, spp, seed)
        batch.positions = np.floor(batch.positions) + np.float32(0.5)
        return dataclasses.replace(batch, number=number)

    return make


@pytest.fixture(scope="session")
def own_image(program: Any) -> Callable[..., Array]:
    """A function that gives POV-Ray's image of a scene's text by its own camera, by default with one sample at the
    centre of each pixel."""
    from pmc_sampler.adapters.povray import images

    def render(text: str, size: tuple[int, int], *switches: str) -> Array:
        arguments = [f"+W{size[0]}", f"+H{size[1]}", "+FE", "+Oi.exr", *(switches or ["-A"])]
        with program.private_folder() as folder:
            program.run(folder, text, arguments, 60).check("it")
            return np.asarray(images.read(folder / "i.exr"))

    return render
