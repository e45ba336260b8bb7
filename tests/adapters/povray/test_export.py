"""Whether a scene that is written for POV-Ray looks there as in the OpenCL tracer.

Where light is not random in either (point and directional lights on diffuse surfaces, emission, the sky), the images of
the pixels' middles are compared, exactly but for half floats and the stated share of pixels at edges. Where it is, the
bounds are some five standard errors of the noise or more (fixed seeds, POV-Ray with one thread: the images are always
the same, so that there are no false alarms), and negative controls show that the bounds see what they should.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO", "pyopencl")

Array = npt.NDArray[Any]
GREY = (0.6, 0.4, 0.2)


@pytest.fixture(scope="module")
def parts(require: Callable[[str], Any]) -> Any:
    """The module that defines what a scene holds."""
    require("pyopencl")
    from pmc_sampler.adapters.opencl import scene

    return scene


@pytest.fixture
def povray(tmp_path: Path) -> Callable[..., Array]:
    """A function from a scene to POV-Ray's image; settings are those of `export` and of `native.render`."""
    from pmc_sampler.adapters.povray import native, source
    from pmc_sampler.adapters.povray.export import export

    def render(scene: Any, method: int = 0, depth: int = 3, **settings: Any) -> Array:
        file = export(scene, tmp_path / "exported", **settings)
        size = (scene.camera.width, scene.camera.height)
        made = source.of_file(file, (), (), 600.0)
        return native.render(made, size, antialiasing=method, depth=depth, threshold=0.0, jitter=False, threads=1).mean

    return render


def traced(scene: Any, spp: int = 1, batch_of: Any = None) -> Array:
    """The tracer's image: of the pixels' middles, or of places all over them by `batch_of`."""
    from pmc_sampler.adapters.opencl import OpenCLRenderer

    width, height = scene.camera.width, scene.camera.height
    if batch_of is not None:
        batch = batch_of(width, height, spp, 1)
    else:
        batch = type("Middles", (), {})()
        pixel = np.repeat(np.arange(width * height), spp)
        batch.positions = np.stack([pixel % width, pixel // width], axis=1).astype(np.float32) + np.float32(0.5)
        batch.scramble = np.random.default_rng(1).integers(0, 1 << 32, len(pixel), np.uint32)
        batch.index = np.arange(len(pixel), dtype=np.uint32)
    radiance: Array = OpenCLRenderer(scene, "independent")(batch)
    return radiance.reshape(height, width, spp, 3).mean(axis=2)


def camera(parts: Any, width: int = 48, height: int = 36, origin: Any = (0.4, 1.6, 4.0), **more: Any) -> Any:
    """Looks at (0, 0.4, 0), y up, a little turned about its view, its window off the middle."""
    origin = np.array(origin)
    view = np.array([0.0, 0.4, 0.0]) - origin
    view /= np.linalg.norm(view)
    right = np.cross(view, [0.1, 1.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view, right), view]).astype(np.float32)
    window = (-0.45, 0.5, -0.32, 0.4)
    return parts.Camera(width, height, origin.astype(np.float32), axes, window, **more)


def rectangle(parts: Any, at: Any, u: Any, v: Any, material: int = 0, uvs: Any = None, **more: Any) -> Any:
    """From corner `at` by `u` and `v`; the front is towards their cross product."""
    at, u, v = (np.array(x, float) for x in (at, u, v))
    vertices = np.stack([at, at + u, at + u + v, at + v]).astype(np.float32)
    if uvs is not None:
        uvs = np.array(uvs, np.float32)
    return parts.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), material, uvs=uvs, **more)


def floor(parts: Any, material: int = 0, **more: Any) -> Any:
    return rectangle(parts, (-5, 0, 5), (10, 0, 0), (0, 0, -10), material, **more)


def blocks(parts: Any, **more: Any) -> Any:
    """A floor, a ball and a slanting card, all diffuse."""
    materials = (
        parts.Material("diffuse", GREY),
        parts.Material("diffuse", (0.1, 0.7, 0.9), two_sided=True),
        parts.Material("diffuse", (0.0, 0.0, 0.0)),
    )
    card = rectangle(parts, (-1.2, 0.1, 0.0), (0.9, 0, 0.3), (0.1, 0.9, -0.2), 1)
    ball = parts.Sphere((0.5, 0.5, 0.0), 0.5, 0)
    meshes = (floor(parts), card, *more.pop("meshes", ()))
    return parts.Scene(camera(parts), materials, meshes, (ball, *more.pop("spheres", ())), max_depth=2, **more)


def agreeing(ours: Array, theirs: Array, tolerance: float) -> float:
    """The share of pixels that agree, relative to their brightest channel."""
    scale = np.maximum(theirs.max(axis=2, keepdims=True), 1e-3)
    return float((np.abs(ours - theirs) / scale < tolerance).all(axis=2).mean())


def test_point_and_directional_lights(parts: Any, povray: Any) -> None:
    """Exact: 1 % everywhere but in the pixels whose middle is on an edge of a shadow."""
    lights = (
        parts.PointLight((1.5, 2.5, 2.0), (9.0, 6.0, 4.0)),
        parts.PointLight((-0.5, 0.3, 1.5), (1.0, 1.5, 2.0)),
        parts.DirectionalLight((1.0, -2.0, -0.5), (0.5, 0.6, 0.7)),
    )
    # The tracer draws one of the lights; alone each is certain.
    scenes = [blocks(parts, lights=(light,)) for light in lights]
    theirs = sum(traced(scene) for scene in scenes)
    ours = povray(replace(scenes[0], lights=lights))
    assert theirs.mean() > 0.1
    assert agreeing(ours, theirs, 0.01) > 0.99
    assert agreeing(ours, np.roll(theirs, 1, axis=1), 0.01) < 0.9
    assert agreeing(ours, 1.02 * theirs, 0.01) < 0.5


def test_small_scenes_are_written_larger(parts: Any, povray: Any) -> None:
    """Exact, as above, for a scene of some millimetres, which POV-Ray's tolerances would swallow."""
    from pmc_sampler.adapters.povray.export import _scaled

    scene = blocks(parts, lights=(parts.PointLight((1.5, 2.5, 2.0), (9.0, 6.0, 4.0)),))
    assert agreeing(povray(_scaled(scene, 1e-3)), traced(scene), 0.01) > 0.99


@pytest.mark.parametrize(("wrap", "nearest"), [("repeat", False), ("mirror", True), ("clamp", False)])
def test_textures(parts: Any, povray: Any, wrap: str, nearest: bool) -> None:
    """Exact: orientation, wrapping and interpolation of a texture that shines and is seen from the front."""
    rng = np.random.default_rng(3)
    pixels = np.concatenate([rng.random((3, 5, 3)), np.ones((3, 5, 1))], axis=2).astype(np.float32)
    uvs = [(-0.6, -0.3), (1.7, -0.2), (1.5, 1.4), (-0.5, 1.2)]
    lamp = rectangle(
        parts, (-1, -0.4, 0), (2, 0, 0), (0, 1.6, 0), uvs=uvs, radiance=(1.0, 0.5, 2.0), radiance_texture=0
    )
    black = parts.Material("diffuse", (0.0, 0.0, 0.0))
    texture = parts.Texture(pixels, wrap, nearest)
    scene = parts.Scene(camera(parts, origin=(0.3, 0.6, 3.0)), (black,), (lamp,), textures=(texture,), max_depth=1)
    ours, theirs = povray(scene), traced(scene)
    assert theirs.max() > 1.0
    # Half floats in the texture and in the image; where nearest, edges of texels are met to rounding.
    assert agreeing(ours, theirs, 3e-3) > 0.995
    assert agreeing(ours, theirs[::-1], 3e-3) < 0.6
    assert agreeing(ours, theirs[:, ::-1], 3e-3) < 0.6


def test_textured_diffuse_surfaces(parts: Any, povray: Any) -> None:
    """Exact: reflectance by texture, and black from behind where a surface has one side."""
    pixels = np.random.default_rng(4).random((4, 4, 4)).astype(np.float32)
    material = parts.Material("diffuse", (0.9, 0.8, 0.7), color_texture=0)
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    meshes = (
        floor(parts, uvs=np.array(square) * 4),
        rectangle(parts, (-1, 0.2, 0.5), (0.8, 0, 0), (0, 0.8, 0), 0, square),
        rectangle(parts, (1, 0.2, 0.5), (-0.8, 0, 0), (0, 0.8, 0), 0, square),
    )
    sun = parts.DirectionalLight((0.2, -1.0, -0.5), (2.0, 2.0, 2.0))
    scene = parts.Scene(
        camera(parts), (material,), meshes, lights=(sun,), textures=(parts.Texture(pixels),), max_depth=2
    )
    ours, theirs = povray(scene), traced(scene)
    assert agreeing(ours, theirs, 0.01) > 0.98
    two_sided = replace(scene, materials=(replace(material, two_sided=True),))
    assert agreeing(ours, traced(two_sided), 0.01) < 0.95


@pytest.mark.parametrize("cutoff", [None, 0.5])
def test_cut_out_surfaces(parts: Any, povray: Any, cutoff: float | None) -> None:
    """Exact in the mean of the tracer's paths: a black card, partly there, before a shining wall."""
    pixels = np.random.default_rng(6).random((3, 3, 4)).astype(np.float32)
    materials = (
        parts.Material("diffuse", (0.0, 0.0, 0.0)),
        parts.Material(
            "diffuse", (0.0, 0.0, 0.0), color_texture=0, cut_out=True, opacity=0.9, alpha_cutoff=cutoff, two_sided=True
        ),
    )
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    card = rectangle(parts, (-0.8, 0.1, 0.5), (1.5, 0, 0), (0, 1.2, 0), 1, square)
    wall = rectangle(parts, (-3, -3, -2), (6, 0, 0), (0, 6, 0), 0, radiance=(0.9, 0.6, 0.3))
    textures = (parts.Texture(pixels, nearest=True),)
    scene = parts.Scene(camera(parts), materials, (card, wall), textures=textures, max_depth=2)
    ours, theirs = povray(scene), traced(scene, 256)
    # Five standard errors of a share of 256 paths.
    assert agreeing(ours, theirs, 1e-3) > 0.8
    assert (np.abs(ours - theirs).max(axis=2) < 0.9 * 5 * 0.5 / 16).mean() > 0.99
    assert (np.abs(ours - traced(replace(scene, meshes=(wall,)))).max(axis=2) < 0.14).mean() < 0.95


def test_lamps_are_seen(parts: Any, povray: Any) -> None:
    """Exact: what shines, on which side, and whether the camera sees it."""
    black = parts.Material("diffuse", (0.0, 0.0, 0.0))
    meshes = (
        rectangle(parts, (-1.3, 0, 0), (0.6, 0, 0), (0, 1, 0), radiance=(1.0, 2.0, 3.0)),
        rectangle(parts, (0.1, 0, 0), (-0.6, 0, 0), (0, 1, 0), radiance=(1.0, 2.0, 3.0)),
        rectangle(parts, (0.9, 0, 0), (-0.6, 0, 0), (0, 1, 0), radiance=(3.0, 2.0, 1.0), emits_both_sides=True),
    )
    ball = parts.Sphere((1.2, 0.4, 0.0), 0.25, 0, radiance=(0.5, 0.5, 0.5))
    scene = parts.Scene(camera(parts), (black,), meshes, (ball,), max_depth=1)
    ours, theirs = povray(scene), traced(scene)
    assert sorted({tuple(np.round(x, 2)) for x in theirs.reshape(-1, 3).tolist()}) == [
        (0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (1.0, 2.0, 3.0), (3.0, 2.0, 1.0),
    ]  # fmt: skip
    assert agreeing(ours, theirs, 1e-3) > 0.998
    assert povray(replace(scene, hide_emitters=True)).max() == 0.0


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_rectangular_lamps_light(parts: Any, povray: Any, tilt: float) -> None:
    """2 % of the mean in each of 12 tiles; the tracer's noise there is below 0.3 %."""
    lamp = rectangle(parts, (-0.8, 2.5, -0.3), (1.2, tilt, 0), (0, 0, 1.0), 2, radiance=(8.0, 7.0, 6.0))
    scene = blocks(parts, meshes=(lamp,))
    ours, theirs = povray(scene), traced(scene, 256)
    tiles = [x.reshape(3, 12, 4, 12, 3).mean(axis=(1, 3, 4)) for x in (ours, theirs)]
    assert theirs.mean() > 0.04
    assert (np.abs(tiles[0] - tiles[1]) < 0.02 * tiles[1] + 2e-4).all()
    assert not (np.abs(0.97 * tiles[0] - tiles[1]) < 0.02 * tiles[1] + 2e-4).any(axis=1).all()
    dark = povray(replace(scene, max_depth=1))
    assert dark.mean() < 0.1 * theirs.mean()


@pytest.mark.long
def test_lamps_of_other_shapes_light(parts: Any, povray: Any) -> None:
    """3 % of the image's mean: a ball, and a fan of triangles that are no parallelograms, with a texture on one."""
    fan = np.concatenate([[[0, 0, 0]], [[np.cos(a), 0, np.sin(a)] for a in np.arange(7) * (2 * np.pi / 7)]])
    vertices = (fan * 0.5 + np.array([-0.8, 2.2, 0.5])).astype(np.float32)
    triangles = np.array([[0, 1 + k, 1 + (k + 1) % 7] for k in range(7)], np.uint32)
    pixels = np.ones((2, 2, 4), np.float32)
    pixels[0, :, :3] = 0.25
    uvs = (fan[:, [0, 2]] * 0.5 + 0.5).astype(np.float32)
    disc = parts.Mesh(vertices, triangles, 2, uvs=uvs, radiance=(9.0, 9.0, 9.0), radiance_texture=0)
    for more in (
        {"meshes": (disc,)},
        {"spheres": (parts.Sphere((1.0, 1.8, 1.2), 0.2, 2, radiance=(20.0, 20.0, 9.0)),)},
    ):
        scene = blocks(parts, textures=(parts.Texture(pixels),), **more)
        ours, theirs = povray(scene), traced(scene, 64)
        assert theirs.mean() > 0.03
        assert abs(ours.mean() / theirs.mean() - 1.0) < 0.03


def sky_map(parts: Any) -> Any:
    """Bright on one side, turned about two axes."""
    rng = np.random.default_rng(5)
    radiance = rng.random((6, 12, 3)).astype(np.float32)
    radiance[1:3, 2:5] += 3.0
    a, b = 0.5, 1.1
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return parts.Environment(radiance, (x @ y).astype(np.float32))


def test_the_sky_is_seen(parts: Any, povray: Any) -> None:
    """Near exact: 1 % in all pixels, for rows of the map lie otherwise in POV-Ray's. Mirrored it is another."""
    scene = parts.Scene(camera(parts), (), environment=sky_map(parts), max_depth=1)
    # Wider than the hemisphere's middle: the map's poles and its seam are in the picture.
    scene = replace(scene, camera=replace(scene.camera, window=(-4.0, 4.0, -3.0, 3.0)))
    ours, theirs = povray(scene), traced(scene)
    assert agreeing(ours, theirs, 0.01) == 1.0
    assert agreeing(ours, theirs[:, ::-1], 0.01) < 0.1


@pytest.mark.long
@pytest.mark.parametrize("mapped", [False, True])
def test_the_sky_lights(parts: Any, povray: Any, mapped: bool) -> None:
    """3 % of the image's mean; without its lights nothing is lit."""
    white = parts.Environment(np.full((1, 1, 3), 0.7, np.float32))
    scene = blocks(parts, environment=sky_map(parts) if mapped else white)
    scene = replace(scene, camera=replace(scene.camera, window=(-0.4, 0.4, 0.0, 0.4)))  # no sky in the picture
    ours, theirs = povray(scene), traced(scene, 256)
    assert np.abs(ours.mean(axis=(0, 1)) / theirs.mean(axis=(0, 1)) - 1.0).max() < 0.03
    if mapped:
        assert povray(scene, sky=0).max() == 0.0


@pytest.mark.long
def test_materials_under_a_white_sky(parts: Any, povray: Any) -> None:
    """In the mean over each ball, the tracer's within the bound of each kind, and glass gone.

    The tracer's noise is below 0.003. Its frosted glass and rough metals lose what would scatter twice on their
    micro-facets, POV-Ray's do not.
    """
    kinds = {
        "dielectric": {},
        "roughdielectric": {"alpha": 0.2},
        "conductor": {"conductor_eta": (0.2, 0.4, 1.4), "conductor_k": (3.9, 2.4, 1.6)},
        "roughconductor": {"conductor_eta": (0.2, 0.4, 1.4), "conductor_k": (3.9, 2.4, 1.6), "alpha": 0.2},
        "plastic": {"color": GREY, "nonlinear": True},
        "metallic-roughness": {"color": (0.9, 0.6, 0.3), "metallic": 0.5, "roughness": 0.4},
    }
    materials = tuple(parts.Material(kind, **more) for kind, more in kinds.items())
    spheres = tuple(parts.Sphere((float(k), 0.0, 0.0), 0.45, k) for k in range(len(kinds)))
    axes = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32)
    middle = 0.5 * (len(kinds) - 1)
    reach = 0.5 * len(kinds) / 40.0
    lens = parts.Camera(6 * 16, 16, np.array([middle, 0, 40], np.float32), axes, (-reach, reach, -0.5 / 40, 0.5 / 40))
    white = parts.Environment(np.ones((1, 1, 3), np.float32))
    scene = parts.Scene(lens, materials, (), spheres, environment=white)
    ours, theirs = povray(scene, sky=128), traced(scene, 256)
    ball = np.hypot(*(np.mgrid[:16, :16] - 7.5)) < 6.5
    means = np.array([[x[:, 16 * k : 16 * k + 16][ball].mean(axis=0) for k in range(6)] for x in (ours, theirs)])
    bounds = np.array([0.003, 0.08, 0.015, 0.09, 0.02, 0.04])
    assert (np.abs(means[0] - means[1]) < bounds[:, None]).all()
    assert not (np.abs(0.95 * means[0] - means[1]) < bounds[:, None]).all(axis=1)[[0, 2, 4]].any()
    assert np.abs(means[0, 0] - 1.0).max() < 0.003


@pytest.mark.long
@pytest.mark.parametrize("name", ["cornell-box", "cornell-box-mirrors", "materials", "room", "thin-lens"])
@pytest.mark.needs("mitsuba")
def test_built_in_scenes_are_rendered(povray: Any, name: str) -> None:
    """With photons and radiosity too: brighter than without, by what only these bring."""
    from pmc_sampler.adapters.opencl.load import scene_of

    scene = scene_of(name, (16, 12))
    scene = replace(scene, camera=replace(scene.camera, aperture_radius=0.0))
    direct = povray(scene, patches=1, sky=8)
    assert 0.01 < direct.mean() < 2.0
    if name == "cornell-box":
        assert povray(scene, patches=1, radiosity=True, photons=1000).mean() > 1.2 * direct.mean()


def test_the_lens(parts: Any, povray: Any) -> None:
    """A small lamp out of focus: its spot is as wide and as bright as the tracer's, and in the same place."""
    black = parts.Material("diffuse", (0.0, 0.0, 0.0))
    lamp = parts.Sphere((0.3, 0.6, 1.5), 0.03, 0, radiance=(100.0, 100.0, 100.0))
    thin = replace(camera(parts, aperture_radius=0.4, focus_distance=5.0), window=(-0.48, 0.48, -0.36, 0.36))
    scene = parts.Scene(thin, (black,), (), (lamp,), max_depth=1)

    def moments(image: Array) -> Array:
        weight = image.sum(axis=2) / image.sum()
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        mean = np.array([(weight * x).sum(), (weight * y).sum()])
        spread = np.sqrt((weight * ((x - mean[0]) ** 2 + (y - mean[1]) ** 2)).sum())
        return np.array([*mean, spread, image.mean() * 1e3])

    ours, theirs = moments(povray(scene, blur_samples=1000)), moments(traced(scene, 1600))
    assert theirs[2] > 2.0
    assert np.abs(ours[:2] - theirs[:2]).max() < 0.15
    assert np.abs(ours[2:] / theirs[2:] - 1.0).max() < 0.08


def test_what_cannot_be_written_is_refused(parts: Any, tmp_path: Path) -> None:
    from pmc_sampler.adapters.povray.export import export

    texture = parts.Texture(np.ones((2, 2, 4), np.float32))
    white = parts.Environment(np.ones((1, 1, 3), np.float32))
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]

    def scene(material: dict[str, Any], mesh: dict[str, Any] | None = None, **more: Any) -> Any:
        meshes = (floor(parts, **{"uvs": square, **(mesh or {})}),)
        return parts.Scene(camera(parts), (parts.Material(**material),), meshes, textures=(texture,), **more)

    diffuse = {"kind": "diffuse"}
    shining = parts.Sphere((0.0, 0.0, 0.0), 9.0, 0, flipped=True, radiance=(1.0, 1.0, 1.0))
    bright = parts.Texture(np.full((1, 1, 4), 1e6, np.float32))
    cases = [
        (scene({**diffuse, "normal_texture": 0}), "normal map"),
        (scene({"kind": "metallic-roughness", "metallic_roughness_texture": 0}), "metallic-roughness texture"),
        (scene({**diffuse, "vertex_colors": True}, {"colors": np.ones((4, 4), np.float32)}), "vertex colours"),
        (scene({"kind": "conductor", "cut_out": True}), "cut out"),
        (scene({"kind": "plastic"}, {"radiance": (1.0, 1.0, 1.0)}), "lamp of plastic"),
        (scene({"kind": "metallic-roughness", "color_texture": 0, "metallic": 0.5}), "0.5 metallic"),
        (scene(diffuse, environment=white, hide_emitters=True), "hides its emitters"),
        (replace(scene(diffuse), spheres=(shining,)), "shines inwards"),
        (replace(scene({**diffuse, "color_texture": 0}), textures=(bright,)), "65504"),
    ]
    for case, words in cases:
        with pytest.raises(ValueError, match=words):
            export(case, tmp_path)
    for setting in ({"patches": 0}, {"sky": -1}, {"photons": -5}, {"blur_samples": 0}):
        with pytest.raises(ValueError, match=f"{next(iter(setting))} is .* expected"):
            export(scene(diffuse), tmp_path, **setting)
