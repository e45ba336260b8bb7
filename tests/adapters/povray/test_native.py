"""POV-Ray's own anti-aliasing. Exact: POV-Ray with one thread makes the same image every time."""

from __future__ import annotations

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
def native() -> Any:
    from pmc_sampler.adapters.povray import native

    return native


@pytest.mark.parametrize(("method", "depth"), [(None, 3), (1, 4), (2, 3)])
def test_edges_are_smoothed(native: Any, scene: Path, method: int | None, depth: int) -> None:
    """The edge is met to one step of the grid, and not at all without anti-aliasing."""
    image, seconds = native.render(scene, (10, 4), method=method, depth=depth, jitter=False, threads=1)
    assert image.shape == (4, 10, 3)
    assert image.dtype == np.float32
    assert (image[:, :6] == 1.0).all()
    assert (image[:, 7:] == 0.0).all()
    if method is None:
        assert set(np.unique(image[:, 6])) <= {0.0, 1.0}
    else:
        assert np.abs(image[:, 6] - 0.5).max() <= 0.26
        assert (image[:, 6] % 1.0 != 0.0).all()
    assert 0.05 < seconds < 60.0


def test_options_and_values_above_one(native: Any, scene: Path) -> None:
    image, _ = native.render(scene, (10, 4), method=None, options=["Declare=SHADE=7.5"])
    assert image.max() == 7.5
    image, _ = native.render(scene, (10, 4), method=None, options=["Declare=SHADE=1e6"])
    assert image.max() == 65504.0


def test_nothing_is_left_behind(native: Any, scene: Path) -> None:
    native.render(scene, (4, 4), method=None)
    assert [file.name for file in scene.parent.iterdir()] == [scene.name]


def test_bad_input(native: Any, scene: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no scene file"):
        native.render(scene.with_name("none.pov"), (4, 4))
    for settings, words in [
        ({"method": 3}, "method is 3: expected 1, 2 or None"),
        ({"depth": 0}, "depth of anti-aliasing is 0"),
        ({"threshold": -1.0}, "threshold of anti-aliasing is -1"),
        ({"threshold": float("nan")}, "threshold of anti-aliasing is nan"),
        ({"threads": 0}, "threads is 0"),
    ]:
        with pytest.raises(ValueError, match=words):
            native.render(scene, (4, 4), **settings)
    with pytest.raises(ValueError, match="image is 0x4"):
        native.render(scene, (0, 4))
    scene.write_text("sphere { 0, }", encoding="utf-8")
    with pytest.raises(ValueError, match=r"edge\.pov.*line 1.*Parse Error"):
        native.render(scene, (4, 4))
    scene.write_text("#while (1) #end", encoding="utf-8")
    with pytest.raises(TimeoutError, match="did not finish within 1 seconds"):
        native.render(scene, (4, 4), timeout=1.0)
    scene.write_text(EDGE, encoding="utf-8")
    with pytest.raises(ValueError, match="is 5x4, not 4x4"):
        native.render(scene, (4, 4), method=None, options=["+W5"])
