"""Scenes read from Mitsuba's files hold what Mitsuba itself makes of them: rays, surfaces, textures, light."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmc_sampler import scenes

pytestmark = pytest.mark.needs("mitsuba")

LOOK = '<transform name="to_world"><lookat origin="1,2,5" target="0.2,0.1,0" up="0.1,1,0"/></transform>'
MIRRORED = (
    '<transform name="to_world"><scale x="-1"/><lookat origin="1,2,5" target="0.2,0.1,0" up="0,1,0"/></transform>'
)
SIZE = '<integer name="width" value="48"/><integer name="height" value="36"/>'
CROP = (
    '<integer name="crop_offset_x" value="10"/><integer name="crop_offset_y" value="4"/>'
    '<integer name="crop_width" value="21"/><integer name="crop_height" value="13"/>'
)
BOX = '<rfilter type="box"/>'


def sensor(inside: str = LOOK, film: str = SIZE + BOX, kind: str = "perspective") -> str:
    return f'<sensor type="{kind}">{inside}<film type="hdrfilm">{film}</film></sensor>'


class Files:
    """Writes scene files and reads them in both ways."""

    def __init__(self, folder: Path, mi: Any) -> None:
        self.folder, self.mi = folder, mi

    def write(self, *parts: str, camera: str | None = None) -> Path:
        file = self.folder / "scene.xml"
        body = "\n".join([sensor() if camera is None else camera, *parts])
        file.write_text(f'<scene version="3.0.0">\n{body}\n</scene>\n', encoding="utf-8")
        return file

    def read(self, *parts: str, camera: str | None = None, size: tuple[int, int] | None = None) -> Any:
        from pmc_sampler.adapters.opencl import mitsuba_scene

        return mitsuba_scene.read(self.write(*parts, camera=camera), size)

    @contextlib.contextmanager
    def loaded(self, *parts: str, camera: str | None = None) -> Iterator[Any]:
        from pmc_sampler.adapters.mitsuba import variants

        with variants.active("scalar_rgb"):
            yield self.mi.load_file(str(self.write(*parts, camera=camera)), optimize=False)

    def picture(self, name: str, *shape: int, bits: int = 8) -> Any:
        pixels = np.random.default_rng(5).random(shape)
        stored = pixels.astype(np.float32) if bits == 32 else (pixels * (2**bits - 1)).astype(f"uint{bits}")
        self.mi.Bitmap(stored).write(str(self.folder / name))
        return stored


@pytest.fixture
def files(tmp_path: Path, require: Callable[[str], Any]) -> Files:
    mi = require("mitsuba")
    mi.set_variant("scalar_rgb")
    return Files(tmp_path, mi)


@pytest.mark.parametrize("name", scenes.names())
def test_built_in_scenes(name: str, files: Files) -> None:
    from pmc_sampler.adapters.opencl.mitsuba_scene import read

    scene = read(scenes.path(name), (64, 48))
    assert (scene.camera.width, scene.camera.height, scene.max_depth) == (64, 48, 8 if name == "room" else 12)
    assert scene.filter == {"filter": "box", "filter_radius": 0.5}
    assert scene.meshes
    assert scene.spheres


def test_the_active_variant_stays(files: Files) -> None:
    files.mi.set_variant("llvm_ad_rgb")
    files.read()
    assert files.mi.variant() == "llvm_ad_rgb"


CAMERAS = {
    axis: sensor(f'{LOOK}<float name="fov" value="41"/><string name="fov_axis" value="{axis}"/>')
    for axis in ("x", "y", "diagonal", "smaller", "larger")
} | {
    "focal length": sensor(f'{LOOK}<string name="focal_length" value="35mm"/>'),
    "crop": sensor(film=SIZE + CROP + BOX),
    "mirrored": sensor(MIRRORED),
    "principal point": sensor(
        f'{LOOK}<float name="principal_point_offset_x" value="0.13"/>'
        '<float name="principal_point_offset_y" value="-0.2"/>',
        SIZE + CROP + BOX,
    ),
    "clipped": sensor(f'{LOOK}<float name="near_clip" value="0.5"/><float name="far_clip" value="9"/>'),
    "thin lens": sensor(
        f'{LOOK}<float name="aperture_radius" value="0.2"/><float name="focus_distance" value="4.5"/>', kind="thinlens"
    ),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_rays(name: str, files: Files) -> None:
    camera = files.read(camera=CAMERAS[name]).camera
    left, right, top, bottom = camera.window
    rng = np.random.default_rng(1)
    with files.loaded(camera=CAMERAS[name]) as loaded:
        film = loaded.sensors()[0].film()
        assert (camera.width, camera.height) == tuple(film.crop_size())
        for x, y, a, b in rng.random((50, 4)):
            if name != "thin lens":
                a = b = 0.5
            ray, _ = loaded.sensors()[0].sample_ray(0.0, 0.5, files.mi.Point2f(x, y), files.mi.Point2f(a, b))
            local = np.array([left + x * (right - left), top + y * (bottom - top), 1.0])
            lens = camera.axes @ (np.array(ray.o) - camera.origin)  # with its way to the near plane
            lens -= camera.axes @ np.array(ray.d) / (camera.axes[2] @ np.array(ray.d)) * camera.near
            assert lens[2] == pytest.approx(0.0, abs=1e-5)
            assert np.hypot(*lens[:2]) <= camera.aperture_radius + 1e-5
            focus = local * camera.focus_distance - [lens[0], lens[1], 0.0] if name == "thin lens" else local
            expected = focus / np.linalg.norm(focus) @ camera.axes
            np.testing.assert_allclose(np.array(ray.d), expected, atol=1e-5)
            view = camera.axes[2] @ np.array(ray.d)
            assert ray.maxt * view == pytest.approx(camera.far - camera.near, rel=1e-4)


def surface(mesh: Any, origin: Any, direction: Any) -> tuple[float, Any, Any, Any]:
    """Distance, geometric and shading normal and texture coordinates of the first triangle that a ray meets."""
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    best: tuple[float, Any, Any, Any] = (np.inf, None, None, None)
    for i in range(len(corners)):
        system = np.stack([one[i], two[i], -np.asarray(direction)], axis=1)
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        u, v, t = np.linalg.solve(system, origin - corners[i, 0])
        if min(u, v, 1 - u - v, t) < 0 or t > best[0]:
            continue
        weights = np.array([1 - u - v, u, v])
        normal = np.cross(one[i], two[i])
        normal /= np.linalg.norm(normal)
        shading = normal if mesh.normals is None else weights @ mesh.normals[mesh.triangles[i]]
        uv = None if mesh.uvs is None else weights @ mesh.uvs[mesh.triangles[i]]
        best = t, normal, shading / np.linalg.norm(shading), uv
    return best


TURNED = '<rotate x="0.6" y="0.8" angle="50"/><scale x="1" y="1.4" z="0.8"/>'
TEXTURED = (
    '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="t.png"/>{}</texture></bsdf>'
)
TO_UV = '<transform name="to_uv"><scale x="2" y="3"/><rotate z="1" angle="20"/><translate x="0.1" y="0.3"/></transform>'


@pytest.mark.parametrize("mirror", ["", '<scale x="-1"/>'])
@pytest.mark.parametrize("flip", ["", '<boolean name="flip_normals" value="true"/>'])
@pytest.mark.parametrize("kind", ["rectangle", "cube", "disk", "ply", "obj", "faceted", "sphere"])
def test_surfaces(kind: str, flip: str, mirror: str, files: Files) -> None:
    """The shading normal tells front from back in Mitsuba: the triangles' winding goes with it."""
    files.picture("t.png", 5, 7, 3)
    inside, plugin = "", kind
    if kind in ("ply", "obj", "faceted"):
        plugin = "ply" if kind != "obj" else "obj"
        inside = f'<string name="filename" value="m.{plugin}"/>'
        inside += '<boolean name="face_normals" value="true"/>' if kind == "faceted" else ""
        ball = files.mi.load_dict({"type": "cube"})
        if plugin == "ply":
            ball.write_ply(str(files.folder / "m.ply"))
        else:
            (files.folder / "m.obj").write_text(
                "v -1 -1 0\nv 1 -1 0.2\nv 1 1 0\nv -1 1 0.3\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
                "vn 0.1 0 1\nvn 0 0 1\nvn 0 0.2 1\nvn 0 0 1\nf 1/1/1 2/2/2 3/3/3\nf 1/1/1 3/3/3 4/4/4\n"
            )
    if kind not in ("disk", "sphere"):
        inside += TEXTURED.format(TO_UV)
    turned = TURNED if kind != "sphere" else '<rotate x="0.6" y="0.8" angle="50"/><scale value="1.3"/>'
    shape = f'<shape type="{plugin}">{inside}{flip}<transform name="to_world">{mirror}{turned}</transform></shape>'
    scene = files.read(shape)
    rng, hits = np.random.default_rng(3), 0
    with files.loaded(shape) as loaded:
        for _ in range(60):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            origin = rng.uniform(-0.5, 0.5, 3) - 6 * direction
            si = loaded.ray_intersect(files.mi.Ray3f(list(origin), list(direction)))
            if kind == "sphere":
                if si.is_valid():
                    hits += 1
                    normal = (np.array(si.p) - scene.spheres[0].center) / scene.spheres[0].radius
                    normal *= -1 if scene.spheres[0].flipped else 1
                    np.testing.assert_allclose(np.array(si.sh_frame.n), normal, atol=1e-4)
                continue
            t, normal, shading, uv = surface(scene.meshes[0], origin, direction)
            assert np.isfinite(t) == si.is_valid()
            if not si.is_valid():
                continue
            hits += 1
            assert t == pytest.approx(si.t, rel=1e-4)
            np.testing.assert_allclose(np.array(si.sh_frame.n), shading, atol=1e-4)
            assert normal @ shading > 0
            if uv is not None:
                color = np.array(si.bsdf().eval_diffuse_reflectance(si))
                np.testing.assert_allclose(lookup(scene.textures[0], uv)[:3], color, atol=2e-4)
    assert hits > 5


def lookup(texture: Any, uv: Any) -> Any:
    """The value of a texture, as the documentation of `Texture` has it."""
    height, width, _ = texture.pixels.shape
    place = np.array([uv[0] * width, (1.0 - uv[1]) * height])

    def texel(i: int, j: int) -> Any:
        index = []
        for at, count in ((i, height), (j, width)):
            if texture.wrap == "clamp":
                at = min(max(at, 0), count - 1)
            elif texture.wrap == "mirror":
                at = min(at % (2 * count), 2 * count - 1 - at % (2 * count))
            index.append(at % count)
        return texture.pixels[index[0], index[1]]

    if texture.nearest:
        return texel(int(np.floor(place[1])), int(np.floor(place[0])))
    (j, i), (x, y) = np.floor(place - 0.5).astype(int), (place - 0.5) % 1.0
    above = texel(i, j) * (1 - x) + texel(i, j + 1) * x
    return above * (1 - y) + (texel(i + 1, j) * (1 - x) + texel(i + 1, j + 1) * x) * y


BITMAPS = [
    ("t.png", (5, 7, 3), 8, ""),
    ("t.png", (5, 7, 1), 8, ""),
    ("t.png", (5, 7, 3), 16, ""),
    ("t.exr", (5, 7, 3), 32, ""),
    ("t.png", (5, 7, 3), 8, '<boolean name="raw" value="true"/>'),
    ("t.png", (5, 7, 3), 8, '<string name="wrap_mode" value="mirror"/>'),
    ("t.png", (5, 7, 3), 8, '<string name="wrap_mode" value="clamp"/>'),
    ("t.png", (5, 7, 3), 8, '<string name="filter_type" value="nearest"/>' + TO_UV),
    ("t.png", (5, 7, 4), 8, ""),
]


@pytest.mark.parametrize(("name", "shape", "bits", "inside"), BITMAPS)
def test_textures(name: str, shape: Any, bits: int, inside: str, files: Files) -> None:
    files.picture(name, *shape, bits=bits)
    part = f'<shape type="rectangle">{TEXTURED.format(inside).replace("t.png", name)}</shape>'
    scene = files.read(part)
    corner = scene.meshes[0].uvs[[int(np.argmin(np.abs(scene.meshes[0].vertices - [x, y, 0]).sum(1))) for x, y in
                                  ((-1, -1), (1, -1), (-1, 1))]].astype(np.float64)  # fmt: skip
    with files.loaded(part) as loaded:
        si = loaded.ray_intersect(files.mi.Ray3f([0.1, 0.2, 2.0], [0.0, 0.0, -1.0]))
        for u, v in np.random.default_rng(2).uniform(-1.7, 2.7, (80, 2)):
            si.uv = files.mi.Point2f(u, v)
            mapped = corner[0] + u * (corner[1] - corner[0]) + v * (corner[2] - corner[0])
            expected = np.array(si.bsdf().eval_diffuse_reflectance(si))
            np.testing.assert_allclose(lookup(scene.textures[0], mapped)[:3], expected, atol=2e-4)


def test_checkerboard(files: Files) -> None:
    part = (
        '<shape type="rectangle"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">'
        f'<rgb name="color0" value="0.1,0.2,0.3"/>{TO_UV}</texture></bsdf></shape>'
    )
    scene = files.read(part)
    with files.loaded(part) as loaded:
        for x, y in np.random.default_rng(2).uniform(-0.99, 0.99, (60, 2)):
            si = loaded.ray_intersect(files.mi.Ray3f([x, y, 2.0], [0.0, 0.0, -1.0]))
            uv = surface(scene.meshes[0], np.array([x, y, 2.0]), np.array([0.0, 0.0, -1.0]))[3]
            expected = np.array(si.bsdf().eval_diffuse_reflectance(si))
            np.testing.assert_allclose(lookup(scene.textures[0], uv)[:3], expected, atol=1e-6)


def test_environment(files: Files) -> None:
    """Texel (i, j) lies at u = (j + 1/2) / width, v = i / (height - 1): rows from pole to pole, columns all round."""
    files.picture("e.exr", 5, 8, 3, bits=32)
    part = (
        '<emitter type="envmap"><string name="filename" value="e.exr"/><float name="scale" value="2.5"/>'
        '<transform name="to_world"><rotate x="0.6" z="-0.8" angle="70"/></transform></emitter>'
    )
    environment = files.read(part).environment
    height, width, _ = environment.radiance.shape
    assert (height, width) == (5, 8)
    with files.loaded(part) as loaded:
        for direction in np.random.default_rng(4).normal(size=(80, 3)):
            direction /= np.linalg.norm(direction)
            x, y, z = environment.to_world.T @ direction
            column = np.arctan2(x, -z) / (2 * np.pi) * width - 0.5
            row = np.arccos(y) / np.pi * (height - 1)
            i, j, a, b = int(row), int(np.floor(column)), row % 1, column % 1
            texels = environment.radiance[[[i], [min(i + 1, height - 1)]], [[j % width, (j + 1) % width]]]
            expected = np.einsum("i,j,ijc->c", [1 - a, a], [1 - b, b], texels)
            si = files.mi.SurfaceInteraction3f()
            si.wi = files.mi.Vector3f(list(-direction))
            np.testing.assert_allclose(np.array(loaded.environment().eval(si)), expected, atol=1e-4)


def test_lights(files: Files) -> None:
    scene = files.read(
        '<emitter type="point"><point name="position" x="1" y="2" z="3"/>'
        '<rgb name="intensity" value="1,2,3"/></emitter>',
        '<emitter type="directional"><vector name="direction" x="0" y="-3" z="4"/>'
        '<rgb name="irradiance" value="4,5,6"/></emitter>',
        '<emitter type="constant"><rgb name="radiance" value="0.1,0.2,0.3"/></emitter>',
        '<shape type="sphere"><emitter type="area"><rgb name="radiance" value="7,8,9"/></emitter></shape>',
    )
    point, directional = scene.lights
    assert (point.position, point.intensity) == ((1, 2, 3), (1, 2, 3))
    assert directional.direction == pytest.approx((0, -0.6, 0.8))
    assert directional.irradiance == (4, 5, 6)
    assert scene.environment.radiance.shape == (1, 1, 3)
    assert scene.spheres[0].radiance == (7, 8, 9)
    assert scene.materials[scene.spheres[0].material].color == (0, 0, 0)  # Mitsuba's default for emitters


def test_materials(files: Files) -> None:
    def material(bsdf: str) -> Any:
        scene = files.read(f'<shape type="sphere">{bsdf}</shape>')
        return scene.materials[scene.spheres[0].material]

    ggx = '<string name="distribution" value="ggx"/><float name="alpha" value="0.3"/>'
    with files.loaded():
        gold = files.mi.traverse(files.mi.load_dict({"type": "conductor", "material": "Au"}))
    got = material(f'<bsdf type="roughconductor"><string name="material" value="Au"/>{ggx}</bsdf>')
    assert got.conductor_eta == pytest.approx(tuple(gold["eta.value"]))
    assert got.conductor_k == pytest.approx(tuple(gold["k.value"]))
    assert got.alpha == pytest.approx(0.3)
    mirror = material('<bsdf type="conductor"><string name="material" value="none"/></bsdf>')
    assert (mirror.conductor_eta, mirror.conductor_k) == ((0, 0, 0), (1, 1, 1))
    assert material('<bsdf type="dielectric"/>').eta == pytest.approx(1.5046 / 1.000277)
    assert (
        material(f'<bsdf type="roughdielectric"><float name="int_ior" value="2"/>{ggx}</bsdf>').kind
        == "roughdielectric"
    )
    plastic = material('<bsdf type="plastic"><boolean name="nonlinear" value="true"/></bsdf>')
    assert (plastic.kind, plastic.nonlinear, plastic.color) == ("plastic", True, (0.5, 0.5, 0.5))
    nested = material(
        '<bsdf type="mask"><float name="opacity" value="0.25"/>'
        '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>'
    )
    assert (nested.kind, nested.two_sided, nested.cut_out, nested.alpha_cutoff) == ("diffuse", True, True, None)
    assert nested.opacity == pytest.approx(0.25)


def test_mask_and_normal_textures(files: Files) -> None:
    stored = files.picture("t.png", 5, 7, 1)
    raw = '<string name="filename" value="t.png"/><boolean name="raw" value="true"/>'
    scene = files.read(
        f'<shape type="rectangle"><bsdf type="mask"><texture type="bitmap" name="opacity">{raw}</texture>'
        '<bsdf type="diffuse"><rgb name="reflectance" value="0.1,0.2,0.3"/></bsdf></bsdf></shape>'
    )
    material = scene.materials[scene.meshes[0].material]
    assert material.color == pytest.approx((0.1, 0.2, 0.3))
    texture = scene.textures[material.color_texture]
    np.testing.assert_allclose(texture.pixels[..., 3], stored[..., 0] / 255, atol=1e-6)
    assert (texture.pixels[..., :3] == 1).all()

    stored = files.picture("t.png", 5, 7, 3)
    part = (
        f'<shape type="rectangle"><bsdf type="normalmap"><texture type="bitmap" name="normalmap">{raw}</texture>'
        '<boolean name="flip_invalid_normals" value="false"/><boolean name="use_shadowing_function" value="false"/>'
        '<bsdf type="diffuse"/></bsdf></shape>'
    )
    with pytest.raises(ValueError, match="'flip_invalid_normals' on, as by default, which is not supported: set it to"):
        files.read(part.replace('<boolean name="flip_invalid_normals" value="false"/>', ""))
    scene = files.read(part)
    pixels = scene.textures[scene.materials[scene.meshes[0].material].normal_texture].pixels
    np.testing.assert_allclose(pixels[..., 0], stored[..., 0] / 255, atol=1e-6)
    # a rectangle shows images upside down in Mitsuba, so that its y, up the rectangle, goes down the image
    np.testing.assert_allclose(pixels[..., 1], 1 - stored[..., 1] / 255, atol=1e-6)


def test_integrators_and_filters(files: Files) -> None:
    path = (
        '<integrator type="path"><integer name="rr_depth" value="3"/>'
        '<boolean name="hide_emitters" value="true"/></integrator>'
    )
    for integrator in (path, f'<integrator type="pmc">{path}</integrator>'):
        scene = files.read(integrator, camera=sensor(film=SIZE))
        assert (scene.max_depth, scene.rr_depth, scene.hide_emitters) == (-1, 3, True)
        assert scene.filter == {"filter": "gaussian", "filter_radius": 2.0}


def shape(inside: str, kind: str = "sphere") -> str:
    return f'<shape type="{kind}" id="thing">{inside}</shape>'


REFUSED = [
    (shape("", "cylinder"), r"cylinder 'thing' at .*scene\.xml \(line 3, col \d+\) is not supported; .* sphere,"),
    (shape('<bsdf type="thindielectric"/>'), "thindielectric at .* is not supported; supported are diffuse,"),
    (shape('<bsdf type="roughconductor"/>'), "'beckmann', Mitsuba's default; supported is 'ggx'"),
    (
        shape('<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha_u" value="0.1"/>'
              '<float name="alpha_v" value="0.2"/></bsdf>'),
        "'alpha_u', which is not supported",
    ),
    (shape('<medium name="interior" type="homogeneous"/>'), "bounds a medium"),
    (shape('<emitter type="directionalarea"/>', "rectangle"), "directionalarea"),
    (shape(TEXTURED.format("")), "supported are textures on meshes"),
    (
        shape('<bsdf type="roughconductor"><string name="distribution" value="ggx"/>'
              '<texture name="alpha" type="bitmap">'
              '<string name="filename" value="t.png"/></texture></bsdf>', "cube"),
        "bitmap at .* is not supported as 'alpha'",
    ),
    ('<emitter type="spot"/>', "spot at .* is not supported"),
    ('<integrator type="direct"/>', "direct at .* is not supported; supported are path"),
    (shape('<string name="filename" value="none.ply"/>', "ply"), "Mitsuba cannot load .*none.ply"),
    (shape('<string name="colour" value="red"/>'), "'colour', which is not supported"),
    ("<shape", "Mitsuba cannot load"),
    (shape('<transform name="to_world"><scale value="0"/></transform>', "cube"), r"cube 'thing' at .* is scaled by 0"),
    (shape('<transform name="to_world"><scale x="nan"/></transform>'), r"sphere 'thing' at .* NaN or infinite in part"),
    (shape('<float name="radius" value="nan"/>'), r"sphere 'thing' at .* has the radius nan: expected a finite one"),
    (shape('<float name="radius" value="0"/>'), "has the radius 0: expected"),
]  # fmt: skip


@pytest.mark.parametrize(("part", "message"), REFUSED)
def test_refusals(part: str, message: str, files: Files) -> None:
    files.picture("t.png", 5, 7, 3)
    with pytest.raises(ValueError, match=message):
        files.read(part)


@pytest.mark.parametrize("flip", [False, True])
def test_normals_that_mitsuba_does_not_find(flip: bool, files: Files, capfd: pytest.CaptureFixture[str]) -> None:
    """A sphere of latitudes and longitudes, triangles without area at its poles, and no normals in the file."""
    from pmc_sampler.adapters.opencl.scene import has_area

    rows, columns = 8, 16
    latitude, longitude = (np.pi / rows * np.arange(rows + 1), 2 * np.pi / columns * np.arange(columns + 1))
    ring = np.stack([np.cos(longitude), 0 * longitude, np.sin(longitude)], axis=1)
    points = [np.sin(a) * p + [0, np.cos(a), 0] for a in latitude for p in ring]
    corners = [i * (columns + 1) + k + 1 for i in range(rows) for k in range(columns)]
    below = columns + 1
    faces = [(a, a + 1, a + below + 1) for a in corners] + [(a, a + below + 1, a + below) for a in corners]
    lines = ["v {:f} {:f} {:f}".format(*p) for p in points] + ["f {} {} {}".format(*face) for face in faces]
    (files.folder / "ball.obj").write_text("\n".join(lines))
    inside = '<string name="filename" value="ball.obj"/>' + ('<boolean name="flip_normals" value="true"/>' * flip)
    with files.loaded(shape(inside, "obj")) as scene:
        assert not np.isfinite(np.array(scene.shapes()[0].vertex_normals_buffer())).all()
    capfd.readouterr()
    with pytest.warns(UserWarning, match=r'^Mitsuba: "ball.obj": computed vertex normals \(1 invalid vert'):
        (mesh,) = files.read(shape(inside, "obj")).meshes
    assert capfd.readouterr() == ("", "")
    seen = np.unique(mesh.triangles[has_area(mesh)])
    along = (mesh.normals * mesh.vertices)[seen].sum(axis=1) * (-1 if flip else 1)
    assert (along > 0.9).all()
    assert (along[mesh.vertices[seen, 1] == -1.0] > 1 - 1e-5).all()  # the pole where Mitsuba finds none
    (files.folder / "ball.obj").write_text("\n".join(lines).replace("1.000000", "nan", 1))
    with pytest.raises(ValueError, match="invalid vertex position"):
        files.read(shape(inside, "obj"))


def test_negative_radius_and_no_up_are_mitsuba_s(files: Files) -> None:
    """A sphere of a negative radius is inside out, and a view without an up gets one."""
    look = '<transform name="to_world"><lookat origin="0,2,6" target="0,0,0" up="0,0,0"/></transform>'
    scene = files.read(shape('<float name="radius" value="-2"/>'), camera=sensor(look))
    (ball,) = scene.spheres
    assert (ball.radius, ball.flipped) == (2.0, True)
    np.testing.assert_allclose(scene.camera.axes @ scene.camera.axes.T, np.eye(3), atol=1e-6)


def test_other_refusals(files: Files, tmp_path: Path) -> None:
    from pmc_sampler.adapters.opencl.mitsuba_scene import read

    with pytest.raises(FileNotFoundError, match="there is no scene file"):
        read(tmp_path / "none.xml")
    with pytest.raises(ValueError, match="crop window"):
        files.read(camera=sensor(film=SIZE + CROP), size=(10, 10))
    with pytest.raises(ValueError, match="negative lobes"):
        files.read(camera=sensor(film=SIZE + '<rfilter type="lanczos"/>'))
    with pytest.raises(ValueError, match=r"orthographic at .* is not supported"):
        files.read(camera=sensor(kind="orthographic"))
    with pytest.raises(ValueError, match="the scene has no sensor"):
        files.read(camera="")
