"""What a scene holds, as plain arrays: made by the readers of scene files, taken by the tracer.

World space is right-handed. Lengths are the scene's units, radiance is linear Rec. 709 RGB.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Camera",
    "DirectionalLight",
    "Environment",
    "Material",
    "Mesh",
    "PointLight",
    "Scene",
    "Sphere",
    "Texture",
]

RGB = tuple[float, float, float]
Floats = NDArray[np.float32]

KINDS = ("diffuse", "dielectric", "roughdielectric", "conductor", "roughconductor", "plastic", "metallic-roughness")
_SMOOTHEST = 1e-4  # alpha: below it the density overflows


@dataclass(frozen=True, eq=False)
class Texture:
    """An image that is looked up by (u, v), v up: (0, 0) is the lower left corner of the image.

    pixels: (height, width, 4) float32, linear RGB and alpha, the top row first.
    wrap: "repeat", "mirror" or "clamp".
    nearest: the nearest texel instead of bilinear interpolation.
    """

    pixels: Floats
    wrap: str = "repeat"
    nearest: bool = False


@dataclass(frozen=True)
class Material:
    """How a surface scatters. Textures are indices into `Scene.textures` and multiply what they are named after.

    kind: one of `KINDS`; those before the last are Mitsuba's plugins of that name (rough ones are GGX, with visible
        normals sampled), the last is glTF 2.0's, with KHR_materials_transmission and KHR_materials_ior.
    color: diffuse reflectance, plastic's diffuse reflectance, or glTF's base colour; color_texture its texture.
    cut_out: whether alpha counts: opacity, the texture's alpha and the vertices' multiplied. A surface is not there
        where alpha is below alpha_cutoff; where that is None it lets the share 1 - alpha of all paths straight through.
    vertex_colors: whether the mesh's vertex colours multiply color.
    specular_reflectance, specular_transmittance: factors, 1 for physical interfaces.
    eta: index of refraction inside over outside (dielectrics, plastic, metallic-roughness), of which a side is told by
        the surface's normal.
    conductor_eta, conductor_k: complex index of refraction of conductors over that outside, RGB.
    alpha: GGX roughness of the rough kinds.
    nonlinear: plastic's colour shift by internal scattering.
    metallic, roughness: glTF's factors (alpha is roughness squared); metallic_roughness_texture: in its blue
        and green.
    transmission: glTF's transmission factor; thin: the surface is a thin sheet that does not refract (glTF without
        KHR_materials_volume).
    normal_texture: tangent-space normals, coded as (n + 1) / 2; normal_scale multiplies x and y.
    two_sided: scatters on both sides; else black from behind (but for dielectrics, which have an inside).
    """

    kind: str
    color: RGB = (0.5, 0.5, 0.5)
    color_texture: int | None = None
    opacity: float = 1.0
    alpha_cutoff: float | None = None
    cut_out: bool = False
    vertex_colors: bool = False
    specular_reflectance: RGB = (1.0, 1.0, 1.0)
    specular_transmittance: RGB = (1.0, 1.0, 1.0)
    eta: float = 1.5
    conductor_eta: RGB = (0.0, 0.0, 0.0)
    conductor_k: RGB = (1.0, 1.0, 1.0)
    alpha: float = 0.1
    nonlinear: bool = False
    metallic: float = 1.0
    roughness: float = 1.0
    metallic_roughness_texture: int | None = None
    transmission: float = 0.0
    thin: bool = True
    normal_texture: int | None = None
    normal_scale: float = 1.0
    two_sided: bool = False


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles that share a material.

    vertices: (v, 3) float32, world space; triangles: (t, 3) uint32, counter-clockwise from the front.
    normals: (v, 3) shading normals, or None for flat ones; uvs: (v, 2); colors: (v, 4) linear RGB and alpha.
    material: index into `Scene.materials`.
    radiance: what the front emits, RGB, or None; radiance_texture multiplies it. emits_both_sides: the back too.
    name: for messages.
    """

    vertices: Floats
    triangles: NDArray[np.uint32]
    material: int
    normals: Floats | None = None
    uvs: Floats | None = None
    colors: Floats | None = None
    radiance: RGB | None = None
    radiance_texture: int | None = None
    emits_both_sides: bool = False
    name: str = "mesh"


@dataclass(frozen=True)
class Sphere:
    """A sphere; its front is the outside, or the inside where flipped. It has no texture coordinates."""

    center: RGB
    radius: float
    material: int
    flipped: bool = False
    radiance: RGB | None = None
    name: str = "sphere"


@dataclass(frozen=True)
class PointLight:
    """intensity: W/sr, RGB."""

    position: RGB
    intensity: RGB


@dataclass(frozen=True)
class DirectionalLight:
    """direction: in which the light travels; irradiance: on a surface that faces it, RGB."""

    direction: RGB
    irradiance: RGB


@dataclass(frozen=True, eq=False)
class Environment:
    """Radiance from infinity, in Mitsuba's latitude-longitude map (plugin `envmap`).

    radiance: (height, width, 3) float32, at least 2x2, top row towards +y of the map's own frame; a map that is
        constant may be given once, as (1, 1, 3).
    to_world: (3, 3), rotation from the map's frame to the world's.
    """

    radiance: Floats
    to_world: Floats = field(default_factory=lambda: np.eye(3, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole, or a thin lens where aperture_radius is above 0.

    width, height: of the image in pixels.
    origin: (3,); axes: (3, 3), rows the unit vectors of the image's x (right), its y (down) and the view.
    window: (left, right, top, bottom) of the image on the plane at distance 1 along the view, x right and y down:
        position (px, py) looks along (left + px / width * (right - left), top + py / height * (bottom - top), 1).
    aperture_radius, focus_distance: world units; focus_distance is measured along the view.
    near, far: clipping planes, along the view.
    """

    width: int
    height: int
    origin: Floats
    axes: Floats
    window: tuple[float, float, float, float]
    aperture_radius: float = 0.0
    focus_distance: float = 1.0
    near: float = 0.0
    far: float = float("inf")


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything the tracer needs, checked on construction.

    max_depth: longest path in segments (1: emitters seen directly alone), -1 for no limit; rr_depth: segments from
    which Russian roulette may end a path; hide_emitters: whether emitters that the camera sees directly are left out.
    alpha_shadows: whether light comes through surfaces that are cut out to what lies behind them; shadow rays end there
    otherwise, as they do in Mitsuba.
    filter: settings of a `Config` for the film's pixel filter.

    Raises ValueError with a sentence that names what is wrong, where and what was expected.
    """

    camera: Camera
    materials: tuple[Material, ...]
    meshes: tuple[Mesh, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    lights: tuple[PointLight | DirectionalLight, ...] = ()
    environment: Environment | None = None
    textures: tuple[Texture, ...] = ()
    max_depth: int = -1
    rr_depth: int = 5
    hide_emitters: bool = False
    alpha_shadows: bool = False
    filter: dict[str, Any] = field(default_factory=lambda: {"filter": "box", "filter_radius": 0.5})

    def __post_init__(self) -> None:
        check(self)


def check(scene: Scene) -> None:
    """Raises ValueError for what cannot be rendered."""
    _check_camera(scene.camera)
    for i, texture in enumerate(scene.textures):
        if texture.pixels.ndim != 3 or texture.pixels.shape[2] != 4 or texture.pixels.size == 0:
            raise ValueError(f"texture {i} has the shape {texture.pixels.shape}: expected (height, width, 4)")
        _finite(texture.pixels, f"texture {i}")
    for i, material in enumerate(scene.materials):
        _check_material(material, f"material {i}", len(scene.textures))
    for mesh in scene.meshes:
        _check_mesh(mesh, len(scene.materials), len(scene.textures))
    for sphere in scene.spheres:
        _finite(np.array([*sphere.center, sphere.radius]), sphere.name)
        if not sphere.radius > 0.0:
            raise ValueError(f"{sphere.name} has the radius {sphere.radius:g}: expected one above 0")
        _index(sphere.material, len(scene.materials), f"the material of {sphere.name}")
        _radiance(sphere.radiance, sphere.name)
    for light in scene.lights:
        if isinstance(light, PointLight):
            _finite(np.array(light.position), "a point light's position")
            _radiance(light.intensity, "a point light")
        else:
            if not np.linalg.norm(_finite(np.array(light.direction), "a directional light's direction")) > 0.0:
                raise ValueError("a directional light's direction is zero")
            _radiance(light.irradiance, "a directional light")
    if scene.environment is not None:
        radiance = scene.environment.radiance
        if (
            radiance.ndim != 3
            or radiance.shape[2] != 3
            or (min(radiance.shape[:2]) < 2 and radiance.shape[:2] != (1, 1))
        ):
            raise ValueError(
                f"the environment map has the shape {radiance.shape}: expected (height, width, 3), 2x2 or more"
            )
        if _finite(radiance, "the environment map").min() < 0.0:
            raise ValueError("the environment map holds negative radiance")


def _check_camera(camera: Camera) -> None:
    if not (1 <= camera.width <= 65535 and 1 <= camera.height <= 65535):
        raise ValueError(f"the image is {camera.width}x{camera.height}: expected 1 to 65535 pixels a side")
    _finite(camera.origin, "the camera's origin")
    _finite(camera.axes, "the camera's axes")
    if abs(abs(np.linalg.det(camera.axes.astype(np.float64))) - 1.0) > 1e-3:
        raise ValueError(
            "the camera is degenerate: its axes are not perpendicular unit vectors (is its up along its view?)"
        )
    left, right, top, bottom = _finite(np.array(camera.window), "the camera's field of view")
    if left == right or top == bottom:
        raise ValueError("the camera is degenerate: its field of view is empty")
    if not (camera.aperture_radius >= 0.0 and np.isfinite(camera.aperture_radius)):
        raise ValueError(f"the camera's aperture radius is {camera.aperture_radius:g}: expected 0 or more")
    if not (camera.focus_distance > 0.0 and np.isfinite(camera.focus_distance)):
        raise ValueError(f"the camera's focus distance is {camera.focus_distance:g}: expected a finite one above 0")
    if not 0.0 <= camera.near < camera.far:
        raise ValueError(f"the camera clips from {camera.near:g} to {camera.far:g}: expected a range in front of it")


def _check_material(material: Material, name: str, textures: int) -> None:
    if material.kind not in KINDS:
        raise ValueError(f"{name} is {material.kind!r}: expected one of {', '.join(KINDS)}")
    for key in ("color_texture", "metallic_roughness_texture", "normal_texture"):
        if (texture := getattr(material, key)) is not None:
            _index(texture, textures, f"the {key.replace('_', ' ')} of {name}")
    for key in ("color", "specular_reflectance", "specular_transmittance", "conductor_eta", "conductor_k"):
        _radiance(getattr(material, key), f"{key} of {name}")
    for key, low, high in (("opacity", 0, 1), ("metallic", 0, 1), ("roughness", 0, 1), ("transmission", 0, 1)):
        if not low <= getattr(material, key) <= high:
            raise ValueError(f"{key} of {name} is {getattr(material, key):g}: expected {low} to {high}")
    if (
        material.kind in ("dielectric", "roughdielectric", "plastic", "metallic-roughness")
        and not 0.0 < material.eta < 100.0
    ):
        raise ValueError(f"the index of refraction of {name} is {material.eta:g}: expected one above 0")
    if material.kind in ("roughdielectric", "roughconductor") and not _SMOOTHEST <= material.alpha <= 10.0:
        raise ValueError(f"alpha of {name} is {material.alpha:g}: expected {_SMOOTHEST:g} to 10, or the smooth kind")


def _check_mesh(mesh: Mesh, materials: int, textures: int) -> None:
    count = len(mesh.vertices)
    if mesh.vertices.shape != (count, 3) or mesh.triangles.ndim != 2 or mesh.triangles.shape[1] != 3:
        raise ValueError(
            f"{mesh.name} has vertices {mesh.vertices.shape} and triangles {mesh.triangles.shape}: "
            "expected (v, 3) and (t, 3)"
        )
    if len(mesh.triangles) and int(mesh.triangles.max()) >= count:
        raise ValueError(f"{mesh.name} names vertex {int(mesh.triangles.max())} and has {count}")
    _finite(mesh.vertices, f"the vertices of {mesh.name}")
    for key, width in (("normals", 3), ("uvs", 2), ("colors", 4)):
        values = getattr(mesh, key)
        if values is not None:
            if values.shape != (count, width):
                raise ValueError(f"{key} of {mesh.name} have the shape {values.shape}: expected ({count}, {width})")
            _finite(values, f"the {key} of {mesh.name}")
    _index(mesh.material, materials, f"the material of {mesh.name}")
    _radiance(mesh.radiance, mesh.name)
    if mesh.radiance_texture is not None:
        _index(mesh.radiance_texture, textures, f"the radiance texture of {mesh.name}")


def _finite(values: Any, name: str) -> Any:
    if not np.isfinite(values).all():
        bad = int(np.size(values) - np.count_nonzero(np.isfinite(values)))
        raise ValueError(f"{name}: {bad} of {np.size(values)} numbers are NaN or infinite")
    return values


def _radiance(values: RGB | None, name: str) -> None:
    if values is not None and not (np.isfinite(values).all() and min(values) >= 0.0):
        raise ValueError(f"{name}: {tuple(values)} are no three finite numbers of 0 or more")


def _index(index: int, count: int, name: str) -> None:
    if not 0 <= index < count:
        raise ValueError(f"{name} is number {index} and there are {count}")
