"""What belongs to a scene beside its text: options, INI files and included ones, photons, and the check of its camera.

Exact, but where a test gives its false-alarm rate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO")

SIZE = (48, 36)
HALF = 2.0**-10  # relative rounding of half floats, truncated


def test_options_reach_the_scene(povray: Any, make: Any, tmp_path: Path, plain_text: str, centres: Any) -> None:
    """Declare, Clock, Library_Path and an INI file with a section; `image_width` is the picture's, not the batch's."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "blue.inc").write_text("#declare Blue = clock * image_width / 480;\n")
    text = plain_text.replace(
        "rgb <0.8, 0.5, 0.2> }", "rgb <Red, Green, Blue> } finish { emission 1 diffuse 0 ambient 0 }"
    )
    text = '#include "blue.inc"\n' + text
    ini = tmp_path / "scene.ini"
    ini.write_text(
        "; a comment\nInput_File_Name=scene.pov\nWidth=48\n+H36 +A0.1\nOutput_File_Name=/nowhere.png\nDisplay=On\n"
        "Library_Path=parts\n[bright]\nDeclare=Red=0.75 ; more\nClock=5\n[dark]\nDeclare=Red=0.25\n"
    )
    (tmp_path / "scene.pov").write_text(text)
    camera = {"location": (0, 1, -5), "right": (4 / 3, 0, 0), "up": (0, 1, 0), "direction": (0, 0, 1)}
    renderer = povray.PovRayRenderer(f"{ini}[bright]", camera=camera, options=["Declare=Green=0.125"])
    try:
        assert (renderer.width, renderer.height) == SIZE
        middle = centres()[SIZE[0] * 18 + 24 :][:1]
        np.testing.assert_allclose(renderer(middle), [[0.75, 0.125, 0.5]], rtol=2 * HALF)
    finally:
        renderer.close()


# Brightness says the frame and the clock.
FRAMES = """#version 3.7; global_settings { assumed_gamma 1.0 }
camera { orthographic location <0,0,-1> right <2,0,0> up <0,2,0> direction <0,0,1> }
box { <-9,-9,0>, <9,9,1> pigment { rgb <frame_number, final_frame, 8 * clock> / 16 }
  finish { ambient 0 diffuse 0 emission 1 } }
"""


@pytest.mark.parametrize(
    ("lines", "options", "expected"),
    [
        ("Final_Frame=9", ["+SF3"], (3, 9, 2)),
        ("Initial_Frame=2\nFinal_Frame=6\nFinal_Clock=2", ["Subset_Start_Frame=5"], (5, 6, 12)),
        ("Final_Frame=8\nCyclic_Animation=on", ["+SF5"], (5, 9, 4)),
        ("Final_Frame=8\nCyclic_Animation=off\nSubset_Start_Frame=2\nSubset_End_Frame=4", ["+SF8"], (8, 8, 8)),
        ("", ["+KFI0", "+KFF8", "+KI0.5", "+KF1.5", "+SF8"], (8, 8, 12)),
        ('Final_Frame="9"\nFinal_Clock=2.5e-1\n', ["+SF5"], (5, 9, 1)),
        ("Subset_End_Frame=7\nFinal_Frame=9\nSubset_Start_Frame=3\n+KF.4e1 +KI+0", ["+SF5"], (5, 9, 16)),
        ("Clock=0.25", [], (0, 0, 2)),
    ],
)
def test_a_frame_of_an_animation(
    povray: Any, tmp_path: Path, clean: None, centres: Any, lines: str, options: list[str], expected: tuple[int, ...]
) -> None:
    """Its number and its clock, also in the picture by POV-Ray alone."""
    (tmp_path / "scene.pov").write_text(FRAMES)
    (tmp_path / "scene.ini").write_text("Input_File_Name=scene.pov\n" + lines)
    renderer = povray.PovRayRenderer(tmp_path / "scene.ini", size=(8, 6), options=options, processes=1)
    try:
        np.testing.assert_allclose(renderer(centres((8, 6)))[7], np.array(expected) / 16, rtol=2 * HALF)
        np.testing.assert_allclose(renderer.native().mean[3, 3], np.array(expected) / 16, rtol=2 * HALF)
    finally:
        renderer.close()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["+KFF20"], r"animation of frames 1 to 20, and one is rendered at a time: choose it by Subset_Start_Frame=1"),
        (["+KFF20", "+SF3", "+EF5"], r"one is rendered at a time"),
        (["+SF3"], r"frame 3 of no animation: give its last frame, too \(Final_Frame=N or \+KFFN\)"),
        (["+KFI2", "+KFF20", "+SF21"], r"frame 21 is not one of the animation's, 2 to 20"),
        (["+KFF20", "+SF0.5"], r"'\+SF0.5': expected a whole number from 0 \(Subset_Start_Frame or \+SF\)"),
        (["Final_Frame=", "+SF1"], r"'Final_Frame=': expected a whole number from 0"),
        (["+KFF20", "+SF3", "+KF2x"], r"'\+KF2x': expected a number \(Final_Clock or \+KF\)"),
        (["+EF5", "+KFF20", "+SF3", "+EF5"], r"one is rendered at a time"),
    ],
)
def test_animations_of_no_single_frame(
    povray: Any, tmp_path: Path, clean: None, options: list[str], sentence: str
) -> None:
    (tmp_path / "scene.pov").write_text(FRAMES)
    with pytest.raises(ValueError, match=sentence):
        povray.PovRayRenderer(tmp_path / "scene.pov", options=options)


def test_photons_are_shot_once(make: Any, own_image: Any, centres: Any, tmp_path: Path) -> None:
    """Those that are loaded give the image that those that are shot give; they are found in an included file, too."""
    settings = "global_settings { assumed_gamma 1.0 /* photons { } */ photons { count 3000 } }\n"
    rest = """#version 3.7;
camera { location <0, 1, -5> direction z right x*4/3 up y }
light_source { <3, 6, 2> 1 }
sphere { <0, 1, 0>, 1 pigment { rgbf 1 } interior { ior 1.5 } photons { target refraction on reflection off } }
plane { y, 0 pigment { rgb 0.8 } }
"""
    (tmp_path / "settings.inc").write_text(settings)
    (tmp_path.parent / "above.inc").write_text(settings)
    above = make('#include "../above.inc"\n' + rest)
    renderer = make('#include "settings.inc"\n' + rest)
    assert [name for name, _ in renderer._pool.source.files] == ["settings.inc", "pmc_photons.ph"]
    for one in (renderer, above):
        text = one._pool.source.files[0][1].read_text()
        assert 'photons { load_file "pmc_photons.ph"' in " ".join(text.split())
    values = renderer(centres()).reshape(SIZE[1], SIZE[0], 3)
    np.testing.assert_array_equal(above(centres()).reshape(SIZE[1], SIZE[0], 3), values)
    np.testing.assert_allclose(values, own_image(settings + rest, SIZE), rtol=2 * HALF, atol=1e-6)
    without = own_image(rest.replace("#version 3.7;", "#version 3.7;global_settings{assumed_gamma 1}"), SIZE)
    assert np.abs(without - values).max() > 0.1  # the negative control: photons make a difference
    assert make(rest)._pool.source.files == ()


@pytest.mark.parametrize("frame", [(), ("+KFF12", "+SF2")])
def test_radiosity_is_computed_once(
    make: Any, own_image: Any, plain_text: str, centres: Any, tmp_path: Path, frame: tuple[str, ...]
) -> None:
    """What is loaded gives POV-Ray's own image within 2 % of its mean; without radiosity it is another by far.

    Asked for in an included file, too, and in an animation.
    """
    lit = plain_text.replace("assumed_gamma 1.0", "assumed_gamma 1.0 radiosity { count 60 error_bound 0.5 }")
    lit = lit.replace("<3, 4, -5> 1 }", "<3, 4, -5> 1 } sky_sphere { pigment { rgb 1 } }")
    settings, rest = lit.partition("camera")[::2]
    (tmp_path / "settings.inc").write_text(settings.replace("#version 3.7;", ""))
    renderer = make('#version 3.7; #include "settings.inc"\ncamera' + rest if frame else lit, options=frame)
    assert "+RFI" in renderer._pool.source.switches
    values = renderer(centres()).reshape(SIZE[1], SIZE[0], 3)
    own = own_image(lit, SIZE)
    assert np.abs(values - own).mean() < 0.02 * own.mean()
    plain = make(lit.replace("radiosity { count 60 error_bound 0.5 }", ""))
    assert plain._pool.source.switches == ()
    assert np.abs(plain(centres()).reshape(own.shape) - own).mean() > 0.1 * own.mean()


def test_the_check_knows_a_wrong_camera(povray: Any, clean: None, tmp_path: Path, noisy_text: str) -> None:
    """It passes with the right one, and not with one that is turned by six degrees, on a scene with noise."""
    from pmc_sampler.adapters.povray import check, source

    file = tmp_path / "scene.pov"
    file.write_text(noisy_text)
    scene = source.of_file(file, (), (), 60)
    right = {"location": (0, 1, -5), "right": (4 / 3, 0, 0), "up": (0, 1, 0)}
    check.check(scene, povray.Camera("perspective", **right, direction=(0, 0, 1)), 64, 48)
    with pytest.raises(ValueError, match=r"the camera found in .*scene.pov is not the one that POV-Ray uses"):
        check.check(scene, povray.Camera("perspective", **right, direction=(0.1, 0, 1)), 64, 48)


def test_the_check_with_radiosity(povray: Any, clean: None, tmp_path: Path) -> None:
    """Its interpolation differs from one shape of image to another by more than noise does. So where there is other
    light the check is without it, exact; where there is none a limit of its own knows a camera two degrees off.
    """
    from pmc_sampler.adapters.povray import check, prepare, source

    file = tmp_path / "scene.pov"
    for number, light in enumerate(("light_source { <3, 6, -5> 1 }", "")):
        (saved := tmp_path / str(number)).mkdir()
        # All else is lit by the sky's light that radiosity brings; the camera looks down on it.
        text = """#version 3.7;
global_settings { assumed_gamma 1 radiosity { pretrace_start 0.08 pretrace_end 0.02 count 30 recursion_limit 1 } }
#default { finish { ambient 0 } }
plane { y, 0 pigment { checker rgb 0.9 rgb <0.5, 0.2, 0.1> translate <0.31, 0.5, 0.37> } }
sky_sphere { pigment { rgb <0.6, 0.8, 1> } }
#local I = -4; #while (I < 5) sphere { <I, 0.7, 2 * sin(I)>, 0.7 pigment { rgb 0.8 } } #local I = I + 1; #end
camera { location <0, 9, 0> direction -y right x*4/3 up z }
"""
        file.write_text(text + light)
        scene = prepare.with_radiosity_saved(source.of_file(file, (), (), 60), 64, 48, saved)
        look = {"location": (0, 9, 0), "right": (4 / 3, 0, 0), "up": (0, 0, 1)}
        agreement = check.check(scene, povray.Camera("perspective", **look, direction=(0, -1, 0)), 64, 48)
        assert agreement.radiosity == (not light)
        with pytest.raises(ValueError, match=r"is not the one that POV-Ray uses"):
            check.check(scene, povray.Camera("perspective", **look, direction=(0.03, -1, 0)), 64, 48)


def test_the_check_knows_a_wrong_camera_by_few_pixels(povray: Any, clean: None, tmp_path: Path) -> None:
    """A small ball on black, without noise: 97 % of the pixels are the same wherever the camera looks."""
    from pmc_sampler.adapters.povray import check, source

    file = tmp_path / "scene.pov"
    file.write_text("sphere { 0, 0.3 pigment { rgb 1 } finish { ambient 1 } } camera { location -5*z }")
    scene = source.of_file(file, (), (), 60)
    right = {"location": (0, 0, -5), "right": (1.33, 0, 0), "up": (0, 1, 0)}
    assert check.check(scene, povray.Camera("perspective", **right, direction=(0, 0, 1)), 64, 48).noise is None
    with pytest.raises(ValueError, match=r"is not the one that POV-Ray uses"):
        check.check(scene, povray.Camera("perspective", **right, direction=(0.1, 0, 1)), 64, 48)
