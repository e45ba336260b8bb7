"""Cameras: rays in double precision against POV-Ray's own, and the triangles that stand for them."""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]
pytestmark = pytest.mark.needs("povray", "OpenImageIO")

W, H = 16, 12
RADIUS = 20.0
PLACE = "location <1, 2, 3> right <1.5, 0.2, 0> up <0, 0.3, 1.1> direction <0.1, 1.1, -0.1>"
LEFT = "location <1, 2, 3> right <-1.5, 0, 0> up <0, 0.3, 1.1> direction <0, 1.1, -0.3>"
VECTORS = {"location": (1, 2, 3), "right": (1.5, 0.2, 0), "up": (0, 0.3, 1.1), "direction": (0.1, 1.1, -0.1)}
LEFT_VECTORS = {"location": (1, 2, 3), "right": (-1.5, 0, 0), "up": (0, 0.3, 1.1), "direction": (0, 1.1, -0.3)}
KINDS: dict[str, dict[str, Any]] = {
    "perspective": {"kind": "perspective"},
    "orthographic": {"kind": "orthographic"},
    "fisheye": {"kind": "fisheye"},
    "fisheye angle 300": {"kind": "fisheye", "angle": 300},
    "ultra_wide_angle angle 250": {"kind": "ultra_wide_angle", "angle": 250},
    "omnimax": {"kind": "omnimax"},
    "panoramic": {"kind": "panoramic"},
    "spherical": {"kind": "spherical"},
    "spherical angle 300 170": {"kind": "spherical", "angle": 300, "vertical_angle": 170},
    "cylinder 1 angle 250": {"kind": "cylinder", "cylinder": 1, "angle": 250},
    "cylinder 2": {"kind": "cylinder", "cylinder": 2},
    "cylinder 3 angle 250": {"kind": "cylinder", "cylinder": 3, "angle": 250},
    "cylinder 4 angle 250": {"kind": "cylinder", "cylinder": 4, "angle": 250},
}
CASES = [(words, left) for words in KINDS for left in (False, True)]


def pixel_centres(width: int, height: int) -> Array:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 2)


def ends(origins: Array, directions: Array) -> Array:
    """Where rays from within the ball meet it, as its colours."""
    b, c = (origins * directions).sum(1), (origins**2).sum(1) - RADIUS**2
    reached = origins + (np.sqrt(b * b - c) - b)[:, None] * directions
    return np.asarray(0.5 + reached / (2 * RADIUS))


@pytest.fixture(scope="module")
def camera_of(povray: Any) -> Callable[..., Any]:
    """Camera, with the vectors above if there are none."""
    from pmc_sampler.adapters.povray.camera import Camera

    def make(left: bool = False, **given: Any) -> Any:
        return Camera(**{"kind": "perspective", **(LEFT_VECTORS if left else VECTORS), **given})

    return make


@pytest.fixture(scope="module")
def mesh_camera(povray: Any) -> Any:
    from pmc_sampler.adapters.povray.ray_mesh import mesh_camera

    return mesh_camera


@pytest.fixture(scope="module")
def own(own_image: Callable[..., Array], ball_text: str) -> dict[tuple[str, bool], Array]:
    """POV-Ray's images of the ball by each camera; its processes mostly sleep, so all run at once."""
    with ThreadPoolExecutor(8) as pool:
        texts = [f"{ball_text}camera {{ {words} {LEFT if left else PLACE} }}" for words, left in CASES]
        images = pool.map(lambda text: own_image(text, (W, H)), texts)
        return {case: image[..., :3].reshape(-1, 3) for case, image in zip(CASES, images, strict=True)}


@pytest.mark.parametrize(("words", "left"), CASES)
def test_rays_are_those_of_povray(words: str, left: bool, own: Any, camera_of: Any) -> None:
    """Exact within the rounding of half floats (2^-12 at 0.5 to 1), and so is which pixels have rays."""
    camera = camera_of(left, **KINDS[words])
    positions = pixel_centres(W, H)
    seen = camera.sees(W, H, positions)
    image = own[words, left]
    np.testing.assert_array_equal(seen, image.any(axis=1))
    np.testing.assert_allclose(ends(*camera.rays(W, H, positions[seen])), image[seen], atol=2.6e-4)
    if words in ("fisheye", "omnimax"):
        assert 0 < seen.sum() < len(seen)


def test_statements_are_those_of_the_cameras(own: Any, own_image: Any, camera_of: Any, ball_text: str) -> None:
    """Exact: POV-Ray makes the same image of a camera's statement as of the words that it came from."""
    cases = CASES[1::4]
    with ThreadPoolExecutor(8) as pool:
        texts = [ball_text + camera_of(left, **KINDS[words]).statement for words, left in cases]
        for case, image in zip(cases, pool.map(lambda text: own_image(text, (W, H)), texts), strict=True):
            np.testing.assert_array_equal(image[..., :3].reshape(-1, 3), own[case])


def test_another_angle_is_noticed(own: Any, camera_of: Any) -> None:
    """The comparison above fails for an angle that is 1 % too wide: its negative control."""
    camera = camera_of(kind="cylinder", cylinder=1, angle=252.5)
    apart = ends(*camera.rays(W, H, pixel_centres(W, H))) - own["cylinder 1 angle 250", False]
    assert np.abs(apart).max() > 10 * 2.6e-4


def rays_of(text: str) -> tuple[Array, Array]:
    """The rays that POV-Ray makes of a mesh camera: from its triangles' centroids along their normals."""
    number = r"([-+]\.\d+(?:e-?\d+)?)"
    text = re.sub(rf"{{y{number}\*z,x{number}\*z,0}}", r"{<0,1,\1>,<1,0,\2>,<0,0,0>}", text)
    numbers = re.findall(r"<([^<>]*)>", text)
    triangles = np.array([n.split(",") for n in numbers if n.count(",") == 2], np.float32).astype(np.float64)
    corners = triangles.reshape(-1, 3, 3)
    place = np.array(next(n.split(",") for n in numbers if n.count(",") == 11), np.float64)
    matrix, location = place[:9].reshape(3, 3), place[9:]
    normals = -np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    world = normals @ np.linalg.inv(matrix).T
    return corners.mean(1) @ matrix + location, world / np.linalg.norm(world, axis=1, keepdims=True)


@pytest.mark.parametrize(("words", "left"), CASES)
def test_triangles_stand_for_the_rays(words: str, left: bool, camera_of: Any, mesh_camera: Any) -> None:
    """Exact within 32 bits, for one position more than fits in four meshes, some of them far behind the camera."""
    camera = camera_of(left, **KINDS[words])
    positions = np.random.default_rng(1).random((12000, 2)) * (640, 480)
    positions = positions[camera.sees(640, 480, positions)][:4001]
    assert len(positions) == 4001
    text = mesh_camera(camera, 640, 480, positions)
    origins, directions = rays_of(text)
    expected = camera.rays(640, 480, positions)
    np.testing.assert_allclose(origins, expected[0], atol=2e-7)
    np.testing.assert_allclose(directions, expected[1], atol=1e-5 if camera.kind == "cylinder" else 1e-6)
    assert [part.count("triangle") for part in text.split("mesh{")] == [0, 1000, 1000, 1000, 1000, 1]


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("words", ["perspective", "spherical", "panoramic", "ultra_wide_angle angle 250"])
@pytest.mark.parametrize("aperture", [0.2, 400.0])
def test_triangles_on_the_lens(words: str, left: bool, aperture: float, camera_of: Any, mesh_camera: Any) -> None:
    """Exact within 32 bits, for small and huge lenses."""
    camera = camera_of(left, **KINDS[words], aperture=aperture, focal_distance=7.0)
    rng = np.random.default_rng(2)
    positions, lens = rng.random((1000, 2)) * (640, 480), rng.random((1000, 2))
    expected = camera.rays(640, 480, positions, lens)
    origins, directions = rays_of(mesh_camera(camera, 640, 480, positions, lens))
    np.testing.assert_allclose(origins, expected[0], atol=1e-6 * max(aperture, 1))
    np.testing.assert_allclose(directions, expected[1], atol=3e-5)


def test_rays_of_a_position_meet_in_focus(camera_of: Any) -> None:
    """Exact: where the ray through the lens's centre meets the plane at the focal distance."""
    camera = camera_of(True, aperture=2.0, focal_distance=7.0)
    ahead = camera.direction / np.linalg.norm(camera.direction)
    rng = np.random.default_rng(2)
    positions, lens = rng.random((1000, 2)) * (640, 480), rng.random((1000, 2))
    reached = []
    for origins, directions in (camera.rays(640, 480, positions), camera.rays(640, 480, positions, lens)):
        along = (7 - (origins - camera.location) @ ahead) / (directions @ ahead)
        reached.append(origins + along[:, None] * directions)
    np.testing.assert_allclose(reached[1], reached[0], atol=1e-9)
    assert np.linalg.norm(origins - camera.location, axis=1).max() > 0.49


def test_lens_is_filled_evenly(camera_of: Any) -> None:
    """Exact but for the grid: the moments of a uniform disc of radius aperture / 4."""
    grid = (np.stack(np.meshgrid(np.arange(200), np.arange(200)), -1).reshape(-1, 2) + 0.5) / 200
    given = {"location": (0, 0, 0), "right": (2, 0, 0), "up": (0, 1, 0), "direction": (0, 0, 3)}
    camera = camera_of(**given, aperture=8.0, focal_distance=1.0)
    origins, _ = camera.rays(4, 4, np.full((len(grid), 2), 2.0), grid)
    radius = np.hypot(*origins[:, :2].T)
    assert radius.max() <= 2 + 1e-5
    np.testing.assert_allclose((radius**2).mean(), 2, rtol=1e-3)
    np.testing.assert_allclose((radius**4).mean(), 16 / 3, rtol=1e-3)
    np.testing.assert_allclose(origins.mean(0), 0, atol=1e-5)
    np.testing.assert_allclose(np.cov(origins[:, :2].T), np.eye(2), atol=2e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "wide"}, "kind is one of perspective"),
        ({"right": (1, 2)}, "right is three finite numbers"),
        ({"location": (0, np.nan, 0)}, "location is three finite numbers"),
        ({"up": "y"}, "up is three finite numbers"),
        ({"up": (1.5, 0.2, 0)}, "three different ways"),
        ({"direction": (0, 0, 0)}, "three different ways"),
        ({"kind": "fisheye", "angle": 0.0}, "positive number of degrees"),
        ({"kind": "cylinder", "cylinder": 5}, "1, 2, 3 or 4, not 5"),
        ({"aperture": -1.0}, "aperture is 0 or a positive length"),
        ({"aperture": 1.0, "focal_distance": 0.0}, "focal distance is a positive length"),
        ({"kind": "orthographic", "aperture": 1.0}, "leave out the aperture"),
    ],
)
def test_no_camera(given: dict[str, Any], message: str, camera_of: Any) -> None:
    with pytest.raises(ValueError, match=message):
        camera_of(**given)


def test_shapes_are_checked(camera_of: Any, mesh_camera: Any) -> None:
    with pytest.raises(ValueError, match=r"shape \(n, 2\), not \(3,\)"):
        mesh_camera(camera_of(), 4, 4, np.zeros(3))
    with pytest.raises(ValueError, match=r"points of the lens in the shape \(3, 2\) of the positions, not None"):
        mesh_camera(camera_of(aperture=1.0), 4, 4, np.zeros((3, 2)))


def exact_text(value: float) -> str:
    return f"{value:.17g}"


# Colours that repeat some 20 times in each pixel of a picture of 4096 by 512, and so tell where in it a ray passes.
RULER = """#version 3.7;
global_settings {{ assumed_gamma 1 }}
plane {{ z, 10 pigment {{ average pigment_map {{
  [1 function {{ {k} * x - floor({k} * x) }} color_map {{ [0 rgb 0] [1 rgb <2, 0, 0>] }}]
  [1 function {{ {k} * y - floor({k} * y) }} color_map {{ [0 rgb 0] [1 rgb <0, 2, 0>] }}] }} }}
  finish {{ ambient 0 diffuse 0 emission 1 }}
  matrix <0.6, 0.48, 0.64, -0.8, 0.36, 0.48, 0, -0.8, 0.6, 100, 200, 300> }}
"""


@pytest.mark.parametrize("length", [0.6, 12.0])  # angles of 96 and 6 degrees
def test_error_in_pixels(length: float, own_image: Any, camera_of: Any, mesh_camera: Any) -> None:
    """At most 2e-4 pixels at 4096 pixels width, at the corner, against POV-Ray's own camera: the largest of 288 errors,
    no chance involved. Written with 6 digits, positions are off by more: the negative control."""
    width, height, side, repeats = 4096, 512, 12, 20.37
    axes = np.array([[0.6, 0.48, 0.64], [-0.8, 0.36, 0.48], [0, -0.8, 0.6]])
    right, up, direction = axes * [[4 / 3], [1 / 6], [length]]
    camera = camera_of(location=(100, 200, 300), right=right, up=up, direction=direction)
    ruler = RULER.format(k=exact_text(repeats * width * length / (10 * 4 / 3)))
    vectors = zip(("location", "right", "up", "direction"), ((100, 200, 300), right, up, direction), strict=True)
    words = " ".join(f"{name} <{','.join(map(exact_text, vector))}>" for name, vector in vectors)
    window = ("-A", f"+SC{width - side + 1}", f"+EC{width}", f"+SR{height - side + 1}", f"+ER{height}")
    positions = pixel_centres(side, side) + np.array([width - side, height - side])
    text = mesh_camera(camera, width, height, positions)
    rough = re.sub(r"[-+]\.\d{10}(e-?\d+)?", lambda n: f"{float(n[0]):+.6g}", text)
    assert rough != text
    with ThreadPoolExecutor(3) as pool:
        theirs = pool.submit(own_image, f"{ruler}camera {{ {words} }}", (width, height), *window)
        ours = [pool.submit(own_image, ruler + one, (side * side, 1)) for one in (text, rough)]
        image = theirs.result()[..., :2]
        corner = image[-side:, -side:].reshape(-1, 2)
        assert len(np.unique(corner)) > side  # the window that was asked for
        exact, off = (np.abs((other.result()[0, :, :2] - corner + 0.5) % 1 - 0.5).max() / repeats for other in ours)
    assert exact <= 2e-4
    assert off > 2e-4


# A pattern before what is in focus; the blur makes it paler.
WAVES = """#version 3.7;
global_settings { assumed_gamma 1 }
plane { z, 2 pigment { function { 0.5 + 0.5 * sin(4 * x) * sin(4 * y) } color_map { [0 rgb 0] [1 rgb 1] } }
  finish { ambient 0 diffuse 0 emission 1 } }
"""


@pytest.mark.parametrize("words", ["right 3*x up 2*y direction 2*z", "fisheye right x"])
def test_blur_is_that_of_povray(words: str, own_image: Any, camera_of: Any, mesh_camera: Any) -> None:
    """Means of 400 rays in each of 80 blocks of 4 by 4 pixels against POV-Ray's own focal blur with as many.

    The sum of the squared differences in standard errors is then at most chi-square with 80 degrees of freedom, since
    POV-Ray's samples are no noisier than independent ones: a false alarm for less than 1e-4 of seeds; this one is
    fixed. Blocks, since POV-Ray's places within a pixel are some 0.04 pixels off the middle. A lens half as
    wide fails: the negative control.
    """
    from scipy.stats import chi2

    width, height, rays = 40, 32, 25
    blur = f"aperture 1.2 focal_point 5*z blur_samples {rays} variance 0 confidence 0.99999"
    vectors = {"location": (0, 0, 0), "right": (3, 0, 0), "up": (0, 2, 0), "direction": (0, 0, 2)}
    if "fisheye" in words:
        vectors |= {"right": (1, 0, 0), "up": (0, 1, 0)}
    rng = np.random.default_rng(3)
    positions = np.repeat(pixel_centres(width, height), rays, axis=0)
    positions += rng.random(positions.shape) - 0.5
    lens = rng.random(positions.shape)
    texts = [f"{WAVES}camera {{ {words} {blur} }}"]
    for aperture in (1.2, 0.6):
        kind = "fisheye" if "fisheye" in words else "perspective"
        camera = camera_of(kind=kind, **vectors, aperture=aperture, focal_distance=5.0)
        seen = camera.sees(width, height, positions)
        texts.append(WAVES + mesh_camera(camera, width, height, positions[seen], lens[seen]))
    sizes = [(width, height), (int(seen.sum()), 1), (int(seen.sum()), 1)]
    with ThreadPoolExecutor(3) as pool:
        theirs, *ours = pool.map(own_image, texts, sizes)

    def blocks(values: Array) -> Array:
        """(80, 16 * n) of (pixels, n)"""
        values = values.reshape(height // 4, 4, width // 4, 4, -1)
        return np.asarray(values.swapaxes(1, 2).reshape(80, -1))

    whole = blocks(seen).all(axis=1)
    expected = blocks(theirs[..., 0])[whole].mean(1)
    statistics = []
    for image in ours:
        values = np.zeros(len(positions))
        values[seen] = image[0, :, 0]
        values = blocks(values)[whole]
        statistics.append(((values.mean(1) - expected) ** 2 / (2 * values.var(1) / (16 * rays))).sum())
    limit = chi2.isf(1e-4, int(whole.sum()))
    assert statistics[0] < limit < statistics[1]
