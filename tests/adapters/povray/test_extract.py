"""A scene's own camera, found by letting POV-Ray evaluate it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]
pytestmark = pytest.mark.needs("povray", "OpenImageIO")

W, H = 16, 12
RADIUS = 20.0
A = "#declare A = camera { location <1, 2, 3> look_at <4, 2, 5> angle 50 right 1.5*x translate x }\n"
CAMERAS = [
    # One order for all, since version 3.5.
    "camera { look_at <4, 2, 5> translate x rotate 30*y angle 50 sky <1, 3, 0> location <1, 2, 3> right 1.5*x }",
    "camera { direction <0, 0.2, 3> angle 60 right -1.5*x up <0.2, 1, 0> scale <1, 2, 1> }",
    "camera { location <1, 3, 2> up z look_at 0 }",  # up along direction: neither right- nor left-handed
    "camera { location 2*y look_at 4*y }",  # the sky tells no right
    "camera { location 2*z sky z look_at 0 right -1.5*x }",
    "camera { perspective right x*image_width/image_height angle 0 location 1 }",
    "camera { orthographic location -3*z direction 2*z look_at 2*x }",
    "camera { orthographic location -3*z right 3*x look_at 2*x }",
    "camera { orthographic location -3*z right 3*x angle 40 look_at 2*x rotate 10 }",
    "camera { spherical angle 90 60 location 1 }",
    "camera { spherical angle 200, 100 location 1 }",
    "camera { cylinder 2 angle 100 location 1 right 2*x look_at 0 scale 0.5 }",
    "camera { fisheye angle 200 location 1 look_at <3, 1, 1> right x*image_width/image_height }",
    # Identifiers and several statements.
    A + "camera { A }",
    A + "#declare B = camera { A rotate 20*z } #declare C = B; camera { C translate y }",
    "#declare L = array[2] #declare L[0] = camera { location 1 } #declare L[1] = camera { location 2 } camera { L[1] }",
    "camera { location 1 } camera { location 2 look_at z } #declare Later = camera { location 3 }",
    "#if (0) camera { location 1 } #else camera { location 2 } #end #if (0) camera { location 3 } #end",
    "#default { camera { location <1, 2, 3> } } camera { look_at <4, 2, 5> angle 50 }",
    # A default's transformations act once more on a camera made from it, and not on one that begins with another.
    "#default { camera { location <1, 2, 3> rotate 30*y translate x } } camera { look_at <4, 2, 5> scale 2 }",
    "#default { camera { location 1 angle 50 } } #default { camera { translate x } } camera { rotate 10*y }",
    "#default { finish { ambient 0 } camera { location <1, 2, 3> rotate 10*y } pigment { rgb 1 } } camera { angle 70 }",
    "#default { camera { rotate 10*y } } #declare B = camera { location 1 } camera { B translate x }",
    # Directives, macros, comments and random numbers within.
    "camera { location #if (1) <1, 2, 3> #else 2 #end // look_at 1\n /* angle 1 /* */ */ look_at 0 }",
    "camera { #declare P = <1, 2, 0>; location P #ifdef (P) angle 80 #else angle 20 #end look_at 0 }",
    "#macro Turn(A) rotate A*y #end camera { location 1 Turn(30) look_at <2, 3, 1> }",
    "#macro Cam(P) camera { location P look_at <P.z, 2, 1> } #end Cam(<1, 2, 3>)",
    "#declare S = seed(3); camera { location <rand(S), rand(S), 0> look_at <rand(S), 3, 1> }",
    "#declare T = transform { rotate 40*x } camera { transform T location 1 transform { T scale 2 } }",
    "camera { matrix <1, 0.2, 0, 0, 1, 0.3, 0, 0, 1, 1, 2, 3> location <1, 1, 0> }",
    '#declare camera_ = "camera { location 7 }"; camera { location 1 }',
    # One after the other, up to version 3.1.
    "#version 3.1; camera { angle 60 right 2*x look_at <1, 2, 3> location 1 }",
    "#version 3.1; camera { location 1 direction <0, 0.2, 1> angle 60 rotate 30*y look_at <1, 2, 3> right 2*x }",
    "#version 3.1; camera { location <1, 2, 3> angle 50 orthographic look_at 0 rotate 4*x }",
    "#version 3.1;" + A + "camera { A location 2 look_at 5*z angle 40 sky x }",
    "#version 1.0; camera { location <1, 2, 3> direction <0, 0, 1.5> look_at <0, 0, 1> }",
]


@pytest.fixture(scope="module")
def source_of(povray: Any, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """A scene of a text, in a folder of its own."""
    from pmc_sampler.adapters.povray.source import of_file

    def make(text: str, libraries: tuple[Path, ...] = (), switches: tuple[str, ...] = (), timeout: float = 30.0) -> Any:
        file = tmp_path_factory.mktemp("with a space é") / "scène.pov"
        file.write_text(text, encoding="utf-8")
        return of_file(file, libraries, switches, timeout)

    return make


@pytest.fixture(scope="module")
def extract(povray: Any) -> Any:
    from pmc_sampler.adapters.povray.extract import extracting

    def extract(source: Any, width: int, height: int) -> Any:
        with extracting(source, width, height) as camera:
            return camera()

    return extract


@pytest.fixture(scope="module")
def found(own_image: Any, source_of: Any, extract: Any, ball_text: str) -> Iterator[dict[str, tuple[Any, Any]]]:
    """POV-Ray's own image and the camera that is found, both under way; its processes mostly sleep, so several run."""
    with ThreadPoolExecutor(8) as pool:
        yield {
            words: (
                pool.submit(own_image, ball_text + words, (W, H)),
                pool.submit(extract, source_of(ball_text + words), W, H),
            )
            for words in CAMERAS
        }


@pytest.mark.parametrize("words", CAMERAS)
def test_camera_is_that_of_povray(words: str, found: Any) -> None:
    """Exact within the rounding of half floats (2^-12 at 0.5 to 1); another camera is off by more than ten times that,
    as the first line of the list is compared with the second for a negative control."""
    image, camera = (future.result() for future in found[words])
    apart = difference(camera, image)
    assert apart <= 2.6e-4
    if words == CAMERAS[0]:
        assert difference(found[CAMERAS[1]][1].result(), image) > 2.6e-3


def difference(camera: Any, image: Array) -> float:
    positions = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), axis=-1).reshape(-1, 2)
    seen = camera.sees(W, H, positions)
    origins, directions = camera.rays(W, H, positions[seen])
    b, c = (origins * directions).sum(1), (origins**2).sum(1) - RADIUS**2
    ends = np.zeros((len(positions), 3))
    ends[seen] = 0.5 + (origins + (np.sqrt(b * b - c) - b)[:, None] * directions) / (2 * RADIUS)
    return float(np.abs(ends - image[..., :3].reshape(-1, 3)).max())


def test_lens(source_of: Any, extract: Any) -> None:
    """The focal distance is that before transformations; without samples there is no blur."""
    words = "camera { location 1 look_at 5*z aperture 0.5 focal_point <4, 1, 5> confidence 0.9 scale 3"
    blurred = extract(source_of(f"{words} blur_samples 3, 7 variance 0 }}"), W, H)
    assert blurred.has_lens
    assert (blurred.aperture, blurred.focal_distance) == (0.5, 5.0)
    assert not extract(source_of(words + "}"), W, H).has_lens


def test_size_and_switches(source_of: Any, extract: Any) -> None:
    source = source_of("camera { right x*image_width/image_height location Place }", switches=("Declare=Place=4",))
    camera = extract(source, 300, 100)
    np.testing.assert_array_equal(camera.right, [3, 0, 0])
    np.testing.assert_array_equal(camera.location, [4, 4, 4])


def test_included_cameras(source_of: Any, extract: Any, tmp_path: Path) -> None:
    """Beside the scene, in a folder there, in a library and by a name that is put together; files stay as they are."""
    library = tmp_path / "library"
    library.mkdir()
    (library / "third.inc").write_text("camera { location 3 }")
    source = source_of('#include "sub/first.inc"\n')
    folder = source.file.parent
    (folder / "sub").mkdir()
    first = '#declare One = 1; camera { location 1 }\n#include "second.inc"'
    (folder / "sub" / "first.inc").write_text(first)
    (folder / "second.inc").write_text("#macro Second() camera { location 2 } #end")
    source = dataclasses.replace(source, libraries=(*source.libraries, library))
    for more, place in (("", 1), ("Second()", 2), ('#include "third"', 3), ('#include concat("thi", "rd.inc")', 3)):
        camera = extract(dataclasses.replace(source, text=source.text + more), W, H)
        np.testing.assert_array_equal(camera.location, place)
    assert (folder / "sub" / "first.inc").read_text() == first
    assert sorted(path.name for path in folder.rglob("*")) == ["first.inc", "scène.pov", "second.inc", "sub"]


def test_a_camera_that_is_called_done(source_of: Any, extract: Any) -> None:
    """The end of what the scene writes down is no name of a variable, however slowly the rest is read."""
    slow = "#local I = 0; #while (I < 300000) #local I = I + 1; #end"
    text = f"#declare my_done = camera {{ location 7 }} #declare C = my_done; {slow} camera {{ C }}"
    np.testing.assert_array_equal(extract(source_of(text), W, H).location, 7)


def test_an_error_names_the_file_that_is_included(source_of: Any) -> None:
    source = source_of("")
    (source.file.parent.parent / "bad.inc").write_text("\n#local W = image_width;\nsphere { Nothing }")
    from pmc_sampler.adapters.povray import prepare, program

    source = dataclasses.replace(source, text='#include "../bad.inc"')
    with program.private_folder() as place, program.private_folder() as folder:
        sized = prepare.sized(dataclasses.replace(source, text=source.text), 64, 48, place)
        assert sized.text != source.text
        with pytest.raises(ValueError, match=r"File '\.\./bad\.inc' line 3: Parse Error"):
            sized.run(folder, ("+W8", "+H6"))


def test_cameras_included_from_outside(source_of: Any, extract: Any, tmp_path: Path) -> None:
    """By a path upwards, from another file there, and by an absolute one; one that has no camera stays where it is."""
    source = source_of("")
    above = source.file.parent.parent
    (above / "a.b.inc").write_text('#declare There = 4; #include "../plain.inc"\ncamera { location There }')
    (above / "plain.inc").write_text("#declare There = There + Here;")
    (above / "cam.inc").write_text('#include "../a.b"\n#declare Not = "../a.b";')
    for more in ('#include "../a.b.inc"', '#include "../a.b"', f'#include "{above}/a.b.inc"', '#include "../cam.inc"'):
        camera = extract(dataclasses.replace(source, text="#declare Here = 1;\n" + more), W, H)
        np.testing.assert_array_equal(camera.location, 5)
    folder = tmp_path / "changes"
    folder.mkdir()
    from pmc_sampler.adapters.povray.sdl import changed

    text = '#include "../plain.inc" "../plain.inc"'
    same = changed(dataclasses.replace(source, text=text), lambda text: text, folder)
    assert same.text == text
    assert same.files == ()


ERRORS = {
    "sphere { 0, 1 }": "has no camera that could be found; add one",
    "camera { normal { bumps 1 } }": "has a normal, which only POV-Ray itself can follow",
    "camera { aperture 1 blur_samples 4 bokeh { pigment { rgb 1 } } }": "has a bokeh, which only POV-Ray itself can",
    "camera { mesh_camera { 1 1 mesh { triangle { 0, x, y } } } }": "has the type mesh_camera",
    "\n\ncamera { location 1\n angle 400 }": r"scène\.pov' line 4: Parse Error: Viewing angle has to be smaller",
    "camera { location 1\n look_at 2 } camera {\n location Nowhere }": r"scène\.pov' line 3.*'Nowhere'",
    "camera { location 1 look_at 1 }": "Camera location and look_at point must be different",
    "camera { location 1 } #if (0)": r"scène\.pov' .*#end expected",
    "camera { location 1 } /*": r"scène\.pov' .*omment",
    "#macro Rest() location 1 angle 40 #end camera { Rest() }": "is written in a way that cannot be followed",
    "camera { orthographic aperture 1 blur_samples 4 }": "leave out the aperture",
}


@pytest.fixture(scope="module")
def refused(source_of: Any, extract: Any) -> Iterator[dict[str, Any]]:
    """The cameras of scenes that have none, under way, several at once."""
    with ThreadPoolExecutor(8) as pool:
        yield {text: pool.submit(extract, source_of(text), W, H) for text in ERRORS}


@pytest.mark.parametrize("text", ERRORS)
def test_errors_are_sentences(text: str, refused: Any) -> None:
    with pytest.raises(ValueError, match=ERRORS[text]):
        refused[text].result()


def test_endless_scene(source_of: Any, extract: Any) -> None:
    with pytest.raises(TimeoutError, match=r"within 0\.5 seconds"):
        extract(source_of("#while (1) #end camera { location 1 }", timeout=0.5), W, H)


def test_nothing_is_left(source_of: Any, extract: Any, clean: None) -> None:
    extract(source_of("camera { location 1 }"), W, H)


def test_lines_stay_where_they_are(povray: Any) -> None:
    """Exact: POV-Ray's messages name the lines that the user has."""
    from pmc_sampler.adapters.povray.camera_log import with_log

    text = 'a "camera {"\n' + "".join(f"{words}\n// camera {{\n" for words in CAMERAS) + "end"
    changed = with_log(text)
    assert changed != text
    assert changed.count("\n") == text.count("\n")
    for words in ("sphere { 0, 1 }", "", "// camera { location 1 }", '"camera { location 1 }"', "camera {"):
        assert with_log(words) == words


def test_tokens(povray: Any) -> None:
    """Exact: comments nest, strings hide them, and directives may have spaces."""
    from pmc_sampler.adapters.povray.sdl import tokens

    found = tokens('#  declare A=1.5e3; /* b /* c */ d */ "/* \\" //" // e\n<-.5,x>/*')
    assert [token.text for token in found] == [
        *("#declare", "A", "=", "1.5e3", ";", '"/* \\" //"', "<", "-", ".5", ",", "x", ">"),
    ]
    assert [token.kind for token in found[:4]] == ["directive", "word", "mark", "number"]


def test_size_in_a_text(povray: Any) -> None:
    """Exact: words are replaced, comments, strings and longer words are not."""
    from pmc_sampler.adapters.povray.sdl import with_size

    text = 'x*image_width/image_height // image_width\n"image_width" my_image_width /* image_height */'
    assert with_size(text, 640, 480) == text.replace("image_width/image_height", "640/480", 1)


def test_changed_twice(source_of: Any, tmp_path: Path) -> None:
    """A second change is made to what the first has written, and to no file of the user's."""
    from pmc_sampler.adapters.povray.sdl import changed

    source = source_of('#include "a.inc" #include "b.inc"')
    for name, text in (("a.inc", "one"), ("b.inc", "two")):
        (source.file.parent / name).write_text(text)
    for number, (old, new) in enumerate((("one", "two"), ("two", "three"))):
        folder = tmp_path / str(number)
        folder.mkdir()
        source = changed(source, lambda text, old=old, new=new: text.replace(old, new), folder)
    assert {name: place.read_text() for name, place in source.files} == {"a.inc": "three", "b.inc": "three"}
    assert (source.file.parent / "a.inc").read_text() == "one"
