"""Lights where tables are large, and cut-outs: against quadrature or a scene that must look the same.

Within four standard errors of both (false alarms of 1e-4), which are at most half a percent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pyopencl")

GREY = {"kind": "diffuse", "color": (0.5, 0.5, 0.5), "two_sided": True}


def quad(parts: Any, size: float, z: float, material: int = 0, **more: Any) -> Any:
    """A square that faces +z."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(size)
    corners[:, 2] = z
    return parts.Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), material, **more)


@pytest.fixture(scope="module")
def mean_of(opencl: Any, batch_of: Any) -> Any:
    """A function from a scene to the mean of green over its image, and its standard error."""

    def measure(scene: Any, spp: int = 2000, seed: int = 1) -> tuple[float, float]:
        renderer = opencl.OpenCLRenderer(scene, "independent")
        green = renderer(batch_of(renderer.width, renderer.height, spp, seed))[:, 1].astype(float)
        assert np.isfinite(green).all()
        return float(green.mean()), float(green.std() / np.sqrt(len(green)))

    return measure


def assert_alike(found: tuple[float, float], expected: tuple[float, float]) -> None:
    error = np.hypot(found[1], expected[1])
    assert error < 5e-3 * expected[0]
    assert abs(found[0] - expected[0]) <= 4.0 * error


@pytest.mark.parametrize("height", [64, 512, 2048])
def test_a_small_sun_in_a_map(parts: Any, camera: Any, mean_of: Any, height: int) -> None:
    """Of a floor below a dim sky with one bright texel, whose share of the light is the integral of its tent."""
    width = 2 * height
    sky = np.full((height, width, 3), 0.2, np.float32)
    row, column = height // 5, width // 3
    theta = np.pi * row / (height - 1)
    cell = np.pi / (height - 1) * 2.0 * np.pi / width * np.sin(theta)
    sky[row, column] += np.float32(0.4 * np.pi / (cell * np.cos(theta)))  # half of it all
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float32)  # the map's y is the world's z
    scene = parts.Scene(
        camera(8, 8, reach=0.1),
        (parts.Material(**GREY),),
        (quad(parts, 1.0, 0.0),),
        environment=parts.Environment(sky, up),
        max_depth=2,
    )
    assert_alike(mean_of(scene, 8000), (0.5 * (0.2 + 0.4), 0.0))


def test_many_lights(parts: Any, camera: Any, mean_of: Any) -> None:
    """A lamp beside 300,000 others that are too weak to be seen."""
    lamp = quad(parts, 0.5, 2.0, radiance=(5.0, 5.0, 5.0))
    lamp.vertices[:, 0] += np.float32(2.5)
    lamp = parts.Mesh(lamp.vertices, lamp.triangles[:, ::-1].copy(), 0, radiance=(5.0, 5.0, 5.0))
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (300_000, 1, 3)) + 1e-3 * rng.normal(size=(300_000, 3, 3)) + [0.0, 0.0, -5.0]
    faces = np.arange(900_000, dtype=np.uint32).reshape(-1, 3)
    weak = parts.Mesh(corners.reshape(-1, 3).astype(np.float32), faces, 0, radiance=(1e-9, 1e-9, 1e-9))
    floor = quad(parts, 1.0, 0.0)
    material = (parts.Material(**GREY),)
    few, many = (
        mean_of(parts.Scene(camera(8, 8, reach=0.1), material, meshes, max_depth=2), 8000)
        for meshes in ((floor, lamp), (floor, lamp, weak))
    )
    assert_alike(many, few)


def test_flat_triangles_are_not_there(parts: Any, camera: Any, mean_of: Any) -> None:
    """Triangles without area, under a mapped sky: what they would scatter has no direction."""
    rng = np.random.default_rng(1)
    start, along = rng.uniform(-1, 1, (2, 200, 1, 3))
    corners = (start + along * np.array([0.0, 0.37, 1.0])[:, None]).astype(np.float32)  # collinear but for rounding
    corners[::2, 2] = corners[::2, 1]
    slivers = parts.Mesh(
        corners.reshape(-1, 3), np.arange(600, dtype=np.uint32).reshape(-1, 3), 0, radiance=(9.0, 9.0, 9.0)
    )
    sky = parts.Environment(np.full((4, 8, 3), 0.7, np.float32))
    mean, _ = mean_of(parts.Scene(camera(64, 64), (parts.Material(**GREY),), (slivers,), environment=sky), 250)
    assert mean == pytest.approx(0.7, abs=2e-3)


def test_a_cut_out_emits_where_it_is(parts: Any, camera: Any, mean_of: Any) -> None:
    """Half of a lamp's texture has alpha 0, and only the other half lights the floor and is seen."""
    pixels = np.ones((1, 2, 4), np.float32)
    pixels[0, 1, 3] = 0.0
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    paper = parts.Material("diffuse", color=(0.0, 0.0, 0.0), two_sided=True)
    cut = parts.Material("diffuse", color=(0.0, 0.0, 0.0), two_sided=True, cut_out=True, color_texture=0)
    shine = {"radiance": (3.0, 3.0, 3.0), "emits_both_sides": True}
    whole = quad(parts, 1.0, 1.0, 1, uvs=uvs, **shine)
    half = quad(parts, 1.0, 1.0, 1, **shine)
    half.vertices[[1, 2], 0] = 0.0  # the left half of it
    views = []
    for lamp, material in ((whole, cut), (half, paper)):
        scene = parts.Scene(
            camera(8, 8),
            (parts.Material(**GREY), material),
            (quad(parts, 3.0, 0.0), lamp),
            textures=(parts.Texture(pixels, nearest=True),),
            alpha_shadows=True,
        )
        views.append(mean_of(scene, 20_000))
    assert_alike(views[0], views[1])


@pytest.mark.parametrize("max_depth", [2, 3, -1])
def test_light_through_layers(parts: Any, camera: Any, mean_of: Any, max_depth: int) -> None:
    """Three half-transparent black layers before a lamp: an eighth of its light, however short paths may be."""
    veil = parts.Material("diffuse", color=(0.0, 0.0, 0.0), two_sided=True, cut_out=True, opacity=0.5)
    material = (parts.Material(**GREY), veil)
    floor = quad(parts, 1.0, 0.0)
    lamp = quad(parts, 8.0, 3.0)
    lamp = parts.Mesh(lamp.vertices, lamp.triangles[:, ::-1].copy(), 0, radiance=(1.0, 1.0, 1.0))
    layers = tuple(quad(parts, 9.0, z, 1) for z in (1.0, 1.5, 2.0))
    above = camera(8, 8, origin=(0.0, 0.0, 0.5), reach=0.1)
    found, bare = (
        mean_of(parts.Scene(above, material, meshes, max_depth=max_depth, alpha_shadows=True), 10_000)
        for meshes in ((floor, lamp, *layers), (floor, lamp))
    )
    if max_depth == 2:  # beyond that, the bare floor and the grey lamp light each other
        assert_alike(found, (bare[0] / 8.0, bare[1] / 8.0))
    assert_alike(found, (direct() / 8.0, 0.0))


def direct() -> float:
    """The floor of the test above by the lamp's light alone: half the form factor of a square of side 16 at 3."""
    share = 8.0 / np.hypot(8.0, 3.0)
    return float(2.0 / np.pi * share * np.arctan(share))
