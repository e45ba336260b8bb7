"""What a scene holds, as plain arrays: made by the readers of scene files, taken by the tracer.

World space is right-handed. Lengths are the scene's units, radiance is linear Rec. 709 RGB.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import checks

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
    "has_area",
]

RGB = tuple[float, float, float]
Floats = NDArray[np.float32]


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

    kind: one of `checks.KINDS`; those before the last are Mitsuba's plugins of that name (rough ones are GGX, with
        visible normals sampled), the last is glTF 2.0's, with KHR_materials_transmission and KHR_materials_ior.
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
        checks.check(self)


def has_area(mesh: Mesh) -> NDArray[np.bool_]:
    """Which triangles of a mesh have a normal in single precision, (t,): the others are neither hit nor shine."""
    corners = mesh.vertices.astype(np.float32)[mesh.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = np.maximum(np.abs(first).max(axis=1), np.abs(second).max(axis=1))[:, None]
    scale = np.float32(1.0) / np.maximum(size, np.float32(1e-37))
    normal = np.cross(first * scale, second * scale)
    return np.asarray(np.square(normal).sum(axis=1) > 1e-30)
