"""The scenes of Debian's povray-examples: uniform samples converge to POV-Ray's own image, and all can be driven."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from pmc_sampler import Budget, Config, render

pytestmark = [pytest.mark.long, pytest.mark.needs("povray", "OpenImageIO")]

EXAMPLES = Path("/usr/share/doc/povray/examples")
SIZE = (160, 120)
GRID = 16  # of POV-Ray's own samples, along each side of a pixel


@pytest.fixture(scope="module", autouse=True)
def examples() -> None:
    if not EXAMPLES.is_dir():
        pytest.fail(f"there is no folder {EXAMPLES}: apt install povray-examples", pytrace=False)


@pytest.fixture(scope="module")
def grid_average(povray: Any, program: Any) -> Callable[[Path], npt.NDArray[Any]]:
    """A function that gives POV-Ray's image of a scene by its own camera, of 16 x 16 samples in each pixel."""
    from pmc_sampler.adapters.povray import images

    def make(scene: Path) -> npt.NDArray[Any]:
        width, height = SIZE[0] * GRID, SIZE[1] * GRID
        with program.private_folder() as folder:
            switches = [f"+W{width}", f"+H{height}", "+FE", "+Oi.exr", "-A", "+WT2"]
            program.run(folder, scene, switches, 3600).check(str(scene))
            pixels = np.asarray(images.read(folder / "i.exr"), np.float64)
        return np.asarray(pixels.reshape(SIZE[1], GRID, SIZE[0], GRID, 3).mean(axis=(1, 3)))

    return make


@pytest.mark.parametrize(
    ("name", "limit"),
    [("lights/arealit1", 3e-4), ("lights/phot_met_glass", 8e-4), ("camera/focalblur", 2.5e-3)],
)
def test_uniform_samples_converge(name: str, limit: float, povray: Any, grid_average: Any) -> None:
    """The mean absolute difference falls as one over root n or faster, to at most `limit` at 256 samples a pixel.

    Positions are stratified, so it may fall faster; noise of POV-Ray's own image is left, so from 64 to 256 it may
    fall more slowly. The slope is fitted over 4 to 64. An image that is one step of the grid aside does not converge:
    the negative control.
    """
    scene = EXAMPLES / f"{name}.pov"
    own = grid_average(scene)
    renderer = povray.PovRayRenderer(scene, size=SIZE)
    counts = (4, 16, 64, 256)
    apart = []
    for count in counts:
        mean = render(renderer, *SIZE, Budget(spp=count), Config.uniform(), seed=count).film.mean
        apart.append(float(np.abs(mean - own).mean()))
    renderer.close()
    print(name, dict(zip(counts, apart, strict=True)), "mean", own.mean())  # seen with `pytest -s`
    slope = np.polyfit(np.log(counts[:3]), np.log(apart[:3]), 1)[0]
    assert slope < -0.4
    assert apart[-1] <= limit
    assert apart[-1] < apart[-2]
    aside = np.abs(mean - np.roll(own, 1, axis=1)).mean()
    assert aside > 2 * limit, "the negative control"


def test_every_example(checkout: Path, tmp_path: Path) -> None:
    """Of the scenes with a camera that POV-Ray can be given, all agree or differ by their noise; none fails silently.

    The rest are those that POV-Ray refuses itself, have no camera, or one that cannot be followed: each has a sentence.
    """
    path = checkout / "benchmarks" / "povray_examples.py"
    spec = importlib.util.spec_from_file_location("povray_examples", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.main(["-o", str(tmp_path)]) == 0
    rows = [json.loads(line) for line in (tmp_path / "povray_examples.jsonl").read_text().splitlines()]
    print(script.summary(rows))
    assert len(rows) == len(list(EXAMPLES.rglob("*.pov"))) >= 390
    driven = [row for row in rows if row["outcome"] != script.FAILS]
    assert sum(row["camera"] in ("perspective", "orthographic") for row in driven) >= 340
    for row in rows:
        if row["outcome"] == script.FAILS:
            assert len(row["sentence"]) > 20, row
        elif row["outcome"] == script.AGREES:
            assert row["same"] >= 0.97
        else:
            assert row["apart"] <= max(3 * row["noise"], 0.01) + 1e-4
