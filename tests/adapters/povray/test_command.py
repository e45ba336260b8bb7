"""`pmc-sampler render` on POV-Ray scenes: what reaches POV-Ray of what was typed. Exact."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO")

# Every pixel has the same colour.
SCENE = """#version 3.7; global_settings { assumed_gamma 1.0 }
camera { orthographic location <0,0,-1> right <2,0,0> up <0,2,0> direction <0,0,1> }
#ifndef (SHADE) #declare SHADE = 1; #end
box { <-9,-9,0>, <9,9,1> pigment { rgb SHADE } finish { ambient 0 diffuse 0 emission clock + 1 } }
"""


@pytest.fixture
def run(povray: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """A function from words to the exit status, standard output and standard error."""
    from pmc_sampler.cli import main

    monkeypatch.chdir(tmp_path)
    Path("flat.pov").write_text(SCENE, encoding="utf-8")

    def command(words: str) -> tuple[int, str, str]:
        try:
            status = main(words.split())
        except SystemExit as stop:
            status = int(stop.code or 0)
        return status, *capsys.readouterr()

    return command


@pytest.fixture
def image(povray: Any) -> Any:
    from pmc_sampler.eval import images

    return lambda: images.read(Path("flat.exr"))


def test_options_of_povray_and_of_the_renderer(run: Any, image: Any) -> None:
    words = "render flat.pov --size 4x3 --spp 1 --set processes=1 --set timeout=60.5 -- Declare=SHADE=0.25 +K1"
    status, out, _ = run(words)
    assert status == 0, out
    np.testing.assert_array_equal(image().rgb, 0.5)
    options = json.loads(image().metadata["pmc:renderer_options"])
    assert options == {
        "device": None,
        "set": {"processes": 1, "timeout": 60.5},
        "own": ["Declare=SHADE=0.25", "+K1"],
    }


def test_a_section_of_an_ini_file(run: Any, image: Any) -> None:
    Path("flat.ini").write_text("Input_File_Name=flat.pov\nWidth=4\nHeight=3\n[dim]\nDeclare=SHADE=0.25\n[Other]\n")
    status, _, err = run("render ./flat.ini[dim] --spp 1 --seed 3")
    assert status == 0, err
    assert sorted(path.name for path in Path().iterdir()) == ["flat-dim.exr", "flat-dim.png", "flat.ini", "flat.pov"]
    Path("flat-dim.exr").rename("flat.exr")
    np.testing.assert_array_equal(image().rgb, 0.25)
    assert run("render flat.ini[bright] --spp 1")[0] == 2


def test_a_camera_given_by_hand(run: Any, image: Any) -> None:
    Path("none.pov").write_text(SCENE.replace("camera {", "#if (0) camera {").replace("1> }", "1> } #end", 1))
    camera = "{location=[0,0,-1],right=[2,0,0],up=[0,2,0],direction=[0,0,1]}"
    status, _, err = run(f"render none.pov --size 4x3 --spp 1 -o flat.exr --set camera={camera}")
    assert status == 0, err
    np.testing.assert_array_equal(image().rgb, 1.0)


def test_povray_s_own_anti_aliasing(run: Any, image: Any) -> None:
    status, out, _ = run(
        "render flat.pov --size 4x3 --method native --json --set antialiasing=1 --set depth=2 --set threshold=0 "
        "--set jitter=false -- Declare=SHADE=0.5"
    )
    assert status == 0
    summary = json.loads(out)
    assert summary["method"] == summary["done"] == "native"
    assert summary["samples"] >= 12 * 4, "threshold 0 gives each pixel depth x depth samples"
    assert summary["visible_noise"] is None
    assert summary["seconds"]["sampler"] == 0.0
    assert summary["seconds"]["setup"] > 0.0
    np.testing.assert_array_equal(image().rgb, 0.5)
    assert json.loads(image().metadata["pmc:native"]) == {
        "antialiasing": 1,
        "depth": 2,
        "threshold": 0,
        "jitter": False,
    }


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--method native --spp 4", "takes no --spp: povray chooses its samples by itself"),
        ("--method native --seed 1", "takes no --seed"),
        ("--method native --scheduler tcp://127.0.0.1:1", "takes no --scheduler"),
        ("--method native --config none.toml", "takes no --config"),
        ("--method native --set depth=12", "depth is 12: expected a whole number from 1 to 9"),
        ("--method native --set threshold=low", "threshold is 'low': expected a number"),
        ("--set depth=2", "has no option 'depth'"),
        ("--set timeout=soon", "timeout is 'soon': expected a number above 0"),
        ("--set timeout", "'timeout' is no setting"),
        ("--set 2=3", "'2=3' is no setting"),
        ("--set camera=3", "a camera is a Camera, or a mapping"),
        ("-- +A0.1", "'+A0.1' is no option of POV-Ray that can be given here"),
        ("--renderer opencl -- +K1", "the renderer 'opencl' takes no options after --: '+K1'"),
        ("--renderer opencl --method native", "'opencl' has no sampling of its own"),
    ],
)
def test_bad_input(run: Any, words: str, sentence: str) -> None:
    status, out, err = run(f"render flat.pov --size 4x3 {words}")
    assert status == 2, err
    assert out == ""
    assert sentence in err
    assert err.count("\n") == 1
    assert [file.name for file in Path().iterdir()] == ["flat.pov"]


def test_only_rendering_takes_options_of_a_renderer(run: Any) -> None:
    status, _, err = run("scenes -- +K1")
    assert status == 2
    assert "scenes takes no options of a renderer: '+K1'" in err


@pytest.mark.needs("pyopencl")
def test_an_exported_scene_without_radiosity_says_that_it_is_darker(run: Any) -> None:
    """In one sentence, once; a scene that is POV-Ray's own says nothing and takes no such option."""
    status, _, err = run("render cornell-box --renderer povray --size 8x6 --spp 1 -o flat.exr")
    assert status == 0, err
    assert err.count("note: exported to POV-Ray, the scene is lit directly") == 1
    status, _, err = run("render cornell-box --renderer povray --size 8x6 --spp 1 -o flat.exr --set photons=100")
    assert (status, err) == (0, "")
    status, _, err = run("render flat.pov --size 4x3 --spp 1")
    assert (status, err) == (0, "")
    for option in ("radiosity=true", "photons=100"):
        status, _, err = run(f"render flat.pov --size 4x3 --spp 1 --set {option}")
        assert status == 2
        assert "options for scenes that are exported to POV-Ray; flat.pov is POV-Ray's own" in err
