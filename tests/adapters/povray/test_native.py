"""POV-Ray's own anti-aliasing. Exact: POV-Ray with one thread makes the same image every time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO")

# A white half plane x < 0.3 of an image that reaches from -1 to 1: of 10 pixels the seventh is half white.
EDGE = """#version 3.7; global_settings { assumed_gamma 1.0 }
camera { orthographic location <0,0,-1> right <2,0,0> up <0,2,0> direction <0,0,1> }
#ifndef (SHADE) #declare SHADE = 1; #end
box { <-9,-9,0>, <0.3,9,1> pigment { rgb SHADE } finish { ambient 0 diffuse 0 emission 1 } }
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "a folder of scènes"
    folder.mkdir()
    file = folder / "edge.pov"
    file.write_text(EDGE, encoding="utf-8")
    return file


@pytest.fixture
def native(povray: Any) -> Callable[..., Any]:
    """A function that renders a scene file by POV-Ray's own anti-aliasing."""
    from pmc_sampler.adapters.povray import native, source

    def render(file: Path, size: tuple[int, int], switches: tuple[str, ...] = (), **settings: Any) -> Any:
        timeout = settings.pop("timeout", 60.0)
        return native.render(source.of_file(file, (), switches, timeout), size, **settings)

    return render


@pytest.mark.parametrize(("method", "depth"), [(0, 3), (1, 4), (2, 3)])
def test_edges_are_smoothed(native: Any, scene: Path, method: int, depth: int) -> None:
    """The edge is met to one step of the grid, and not at all without anti-aliasing; the rays are counted."""
    made = native(scene, (10, 4), antialiasing=method, depth=depth, jitter=False, threads=1)
    image = made.mean
    assert image.shape == (4, 10, 3)
    assert image.dtype == np.float32
    assert (image[:, :6] == 1.0).all()
    assert (image[:, 7:] == 0.0).all()
    assert made.samples == 40 if method == 0 else 40 < made.samples <= 40 * (2**depth + 1) ** 2
    if method == 0:
        assert set(np.unique(image[:, 6])) <= {0.0, 1.0}
    else:
        assert np.abs(image[:, 6] - 0.5).max() <= 0.26
        assert (image[:, 6] % 1.0 != 0.0).all()
    assert 0.05 < made.seconds < 60.0


def test_options_and_values_above_one(native: Any, scene: Path) -> None:
    assert native(scene, (10, 4), ("Declare=SHADE=7.5",), antialiasing=0).mean.max() == 7.5
    assert native(scene, (10, 4), ("Declare=SHADE=1e6",), antialiasing=0).mean.max() == 65504.0


def test_nothing_is_left_behind(native: Any, scene: Path) -> None:
    native(scene, (4, 4), antialiasing=0)
    assert [file.name for file in scene.parent.iterdir()] == [scene.name]


def test_bad_input(native: Any, scene: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no scene file"):
        native(scene.with_name("none.pov"), (4, 4))
    for settings, words in [
        ({"antialiasing": 3}, "antialiasing is 3: expected a whole number from 0 to 2"),
        ({"depth": 0}, "depth is 0"),
        ({"depth": "3"}, "depth is '3'"),
        ({"threshold": -1.0}, "threshold is -1"),
        ({"threshold": float("nan")}, "threshold is nan"),
        ({"threshold": "small"}, "threshold is 'small'"),
        ({"threads": 0}, "threads is 0"),
    ]:
        with pytest.raises(ValueError, match=words):
            native(scene, (4, 4), **settings)
    with pytest.raises(ValueError, match="image is 0x4"):
        native(scene, (0, 4))
    scene.write_text("sphere { 0, }", encoding="utf-8")
    with pytest.raises(ValueError, match=r"edge\.pov.*line 1.*Parse Error"):
        native(scene, (4, 4))
    scene.write_text("#while (1) #end", encoding="utf-8")
    with pytest.raises(TimeoutError, match="did not finish within 1 seconds"):
        native(scene, (4, 4), timeout=1.0)


def test_the_renderer_s_camera_is_used(povray: Any, scene: Path) -> None:
    """Exact: the scene's own, or the one that is given, as the rays that the renderer traces have it."""
    place = {"right": (2, 0, 0), "up": (0, 2, 0), "direction": (0, 0, 1)}

    def renderer(**options: Any) -> Any:
        return povray.PovRayRenderer(scene, size=(10, 4), processes=1, **options)

    own = renderer()
    given = renderer(camera={"kind": "orthographic", "location": (0.5, 0, -1), **place})
    blurred = renderer(camera={"location": (0, 0, -1), "aperture": 0.1, **place})
    # Pixels are 0.2 wide; the white ends at 0.3, and the image begins at -1 and at -0.5.
    assert (own.native(antialiasing=0).mean[0, :, 0] > 0).sum() == 6
    assert (given.native(antialiasing=0).mean[0, :, 0] > 0).sum() == 4
    with pytest.raises(ValueError, match="blur_samples"):
        blurred.native()
    for one in (own, given, blurred):
        one.close()
