"""From a scene to what the kernel is compiled with, macros that leave out what it lacks, and is called with, arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _bvh
from .checks import WRAPS
from .lights import Lights, light_table
from .scene import Camera, Material, Mesh, Scene, has_area

__all__ = ["SAMPLERS", "Tables", "tables"]

SAMPLERS = ("sobol", "independent")
PACKET = 8
BRUTE_FORCE_PACKETS = 8  # up to so many, testing all is faster than a hierarchy (benchmarks/opencl.md)

_KIND_MACROS = {
    "diffuse": "DIFFUSE",
    "dielectric": "DIELECTRIC",
    "roughdielectric": "ROUGHDIELECTRIC",
    "conductor": "CONDUCTOR",
    "roughconductor": "ROUGHCONDUCTOR",
    "plastic": "PLASTIC_KIND",
    "metallic-roughness": "METALLIC_ROUGHNESS",
}
_TWO_SIDED, _CUT_OUT, _VERTEX_COLORS, _NONLINEAR, _THIN = 1, 2, 4, 8, 16
_SEGMENTS = 1 << 16  # of a path without a limit: where nothing absorbs, Russian roulette ends it long before
_LAYERS = 64  # of cut-out surfaces that a ray passes beyond those


@dataclass(frozen=True)
class Tables:
    """macros: name to value, as text; arrays: the kernel's arguments by name, in its order."""

    macros: dict[str, str] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)


def tables(scene: Scene, sampler: str = "sobol", hierarchy: bool | None = None) -> Tables:
    """What the kernel needs for `scene`.

    sampler: "sobol" or "independent". hierarchy: whether to trace through a hierarchy of boxes; None: where there are
    more than `BRUTE_FORCE_PACKETS` packets of eight triangles, or of eight spheres.

    Raises ValueError for a scene without geometry and light, or with more than the tables can number.
    """
    lights = light_table(scene)
    macros: dict[str, Any] = {"INDEPENDENT": int(sampler == "independent")}
    arrays: dict[str, NDArray[Any]] = {}
    arrays["camera"] = _camera(scene.camera)
    macros["THIN_LENS"] = int(scene.camera.aperture_radius > 0.0)
    macros["MAX_DEPTH"] = scene.max_depth if scene.max_depth >= 0 else _SEGMENTS
    macros["MAX_SEGMENTS"] = min(macros["MAX_DEPTH"], _SEGMENTS) + _LAYERS
    macros["RR_DEPTH"] = scene.rr_depth
    macros["HIDE_EMITTERS"] = int(scene.hide_emitters)
    _materials(scene, macros, arrays)
    _triangles(scene, lights, hierarchy, macros, arrays)
    _spheres(scene, lights, hierarchy, macros, arrays)
    if not (macros["TRIANGLES"] or macros["SPHERES"] or scene.environment):
        raise ValueError("the scene has no triangle, no sphere and no environment: there is nothing to see")
    _textures(scene, macros, arrays)
    macros.update(lights.macros)
    arrays.update(lights.arrays)
    stack = max((7 * depth + 2 for depth in (macros.pop("_depths"))), default=0)
    macros["STACK"] = stack
    return Tables({name: _text(value) for name, value in macros.items()}, arrays)


def _text(value: Any) -> str:
    """A macro's text; floats keep all their bits."""
    if isinstance(value, tuple | list | np.ndarray):
        return ",".join(_text(float(v)) for v in value)
    if isinstance(value, float | np.floating):
        if math.isinf(value):
            return "INFINITY"
        return f"{float(np.float32(value))!r}f".replace("e-0", "e-").replace("inff", "INFINITY")
    return str(value)


def _camera(camera: Camera) -> NDArray[np.float32]:
    """The kernel's table of the camera, (6, 4); it is no macro, so that a film's size needs no other program."""
    left, right, top, bottom = camera.window
    rows = np.zeros((6, 4), np.float32)
    rows[0, :3] = camera.origin
    rows[1:4, :3] = camera.axes
    rows[4] = left, top, (right - left) / camera.width, (bottom - top) / camera.height
    rows[5] = camera.near, camera.far - camera.near, camera.aperture_radius, camera.focus_distance
    return rows


def _materials(scene: Scene, macros: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    used = sorted({mesh.material for mesh in scene.meshes} | {sphere.material for sphere in scene.spheres})
    kinds = sorted({scene.materials[i].kind for i in used}, key=list(_KIND_MACROS).index)
    for code, (kind, macro) in enumerate(_KIND_MACROS.items()):
        macros[macro] = code
        macros[f"HAS_{kind.upper().replace('-', '_')}"] = int(kind in kinds)
    macros["HAS_DELTA"] = int("dielectric" in kinds or "conductor" in kinds)
    macros["HAS_CUT_OUT"] = int(any(scene.materials[i].cut_out for i in used))
    if len(kinds) == 1:
        macros["ONLY_KIND"] = _KIND_MACROS[kinds[0]]
    macros.update(ALPHA_SHADOWS=int(bool(macros["HAS_CUT_OUT"]) and scene.alpha_shadows), MAX_LAYERS=_LAYERS)
    rows = np.zeros((max(len(scene.materials), 1), 7, 4), np.float32)
    ints = np.full((len(rows), 5), -1, np.int32)
    codes = list(_KIND_MACROS)
    for i, m in enumerate(scene.materials):
        rows[i, 0] = *m.color, m.opacity
        rows[i, 1] = *m.specular_reflectance, m.eta
        rows[i, 2] = *m.specular_transmittance, m.alpha
        rows[i, 3, :3] = m.conductor_eta
        rows[i, 4, :3] = m.conductor_k
        rows[i, 5, :2] = _plastic(m) if m.kind == "plastic" else (0.0, 0.0)
        rows[i, 5, 2] = -1.0 if m.alpha_cutoff is None else m.alpha_cutoff
        rows[i, 6] = m.metallic, m.roughness, m.transmission, m.normal_scale
        ints[i, 0] = codes.index(m.kind)
        ints[i, 1] = sum(
            flag
            for flag, is_set in (
                (_TWO_SIDED, m.two_sided),
                (_CUT_OUT, m.cut_out),
                (_VERTEX_COLORS, m.vertex_colors),
                (_NONLINEAR, m.nonlinear),
                (_THIN, m.thin),
            )
            if is_set
        )
        textures = (m.color_texture, m.normal_texture, m.metallic_roughness_texture)
        ints[i, 2:] = [-1 if texture is None else texture for texture in textures]
    arrays["materials"], arrays["material_ints"] = rows, ints


def _plastic(material: Material) -> tuple[float, float]:
    """Share of diffuse light that the interface reflects back inside, and the weight of the specular lobe in sampling.

    The share is d'Eon and Irving's fit for eta below 1 seen from inside (2011, doi:10.1145/1964921.1964951), that of
    Egan and Hilgeman (1979) otherwise, as in Mitsuba.
    """
    eta = 1.0 / material.eta
    if eta < 1.0:
        share = -1.4399 * eta**2 + 0.7099 * eta + 0.6681 + 0.0636 / eta
    else:
        share = float(np.polyval([-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317], 1.0 / eta))
    specular, diffuse = (float(np.mean(c)) for c in (material.specular_reflectance, material.color))
    return share, specular / (specular + diffuse) if specular + diffuse > 0.0 else 0.0


def _triangles(
    scene: Scene, lights: Lights, hierarchy: bool | None, macros: dict[str, Any], arrays: dict[str, NDArray[Any]]
) -> None:
    meshes = [mesh for mesh in scene.meshes if len(mesh.triangles)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    count = sum(len(mesh.triangles) for mesh in meshes)
    macros.update(TRIANGLES=count, NORMALS=0, UVS=0, COLORS=0, TRIANGLE_NODES=0, TRIANGLE_PACKETS=0, _depths=[])
    if count == 0:
        return
    if count >= 2**31 // 72 * PACKET or starts[-1] >= 2**31 // 3:
        raise ValueError(f"the scene has {count} triangles and {starts[-1]} vertices: more than this tracer numbers")
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)
    ints = np.empty((count, 5), np.int32)
    ints[:, :3] = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)])
    ints[:, 3] = np.repeat([mesh.material for mesh in meshes], [len(mesh.triangles) for mesh in meshes])
    ints[:, 4] = lights.of_triangle
    # Rays hit a triangle without area by rounding, and find no normal there.
    kept = np.flatnonzero(np.concatenate([has_area(mesh) for mesh in meshes])).astype(np.int32)
    corners = vertices[ints[kept, :3]]
    if len(kept):
        order, nodes = _arranged(corners.min(axis=1), corners.max(axis=1), hierarchy)
    else:
        order, nodes = np.full(PACKET, -1, np.int32), None
    packets = np.zeros((len(order), 3, 3), np.float32)
    packets[order >= 0] = corners[order[order >= 0]]
    order[order >= 0] = kept[order[order >= 0]]
    arrays["triangle_packets"] = np.ascontiguousarray(packets.reshape(-1, PACKET, 9).transpose(0, 2, 1))
    arrays["triangle_order"] = order
    arrays["vertices"] = vertices
    arrays["triangles"] = ints
    macros["TRIANGLE_PACKETS"] = len(order) // PACKET
    if nodes is not None:
        macros["TRIANGLE_NODES"] = len(nodes[1])
        arrays["triangle_bounds"], arrays["triangle_children"], depth = nodes
        macros["_depths"].append(depth)
    if any(mesh.normals is not None for mesh in meshes):
        macros["NORMALS"] = 1
        arrays["normals"] = np.concatenate([_or_zero(mesh.normals, len(mesh.vertices), 3) for mesh in meshes])
    if any(_textures_of(scene, mesh) for mesh in meshes):
        macros["UVS"] = 1
        arrays["uvs"] = np.concatenate([_or_zero(mesh.uvs, len(mesh.vertices), 2) for mesh in meshes])
    if any(mesh.colors is not None and scene.materials[mesh.material].vertex_colors for mesh in meshes):
        macros["COLORS"] = 1
        arrays["colors"] = np.concatenate(
            [
                np.ones((len(mesh.vertices), 4), np.float32) if mesh.colors is None else mesh.colors.astype(np.float32)
                for mesh in meshes
            ]
        )


def _or_zero(values: NDArray[np.float32] | None, count: int, width: int) -> NDArray[np.float32]:
    return np.zeros((count, width), np.float32) if values is None else values.astype(np.float32)


def _textures_of(scene: Scene, mesh: Mesh) -> list[int]:
    """The textures that are looked up on a mesh."""
    m = scene.materials[mesh.material]
    found = (m.color_texture, m.normal_texture, m.metallic_roughness_texture, mesh.radiance_texture)
    return [texture for texture in found if texture is not None]


def _spheres(
    scene: Scene, lights: Lights, hierarchy: bool | None, macros: dict[str, Any], arrays: dict[str, NDArray[Any]]
) -> None:
    count = len(scene.spheres)
    macros.update(SPHERES=count, SPHERE_NODES=0, SPHERE_PACKETS=0)
    if count == 0:
        return
    centers = np.array([sphere.center for sphere in scene.spheres], np.float32)
    radii = np.array([sphere.radius for sphere in scene.spheres], np.float32)
    reach = np.nextafter(radii, np.float32(np.inf))[:, None]
    order, nodes = _arranged(
        np.nextafter(centers - reach, np.float32(-np.inf)), np.nextafter(centers + reach, np.float32(np.inf)), hierarchy
    )
    packets = np.zeros((len(order), 4), np.float32)
    packets[order >= 0] = np.column_stack([centers, radii])[order[order >= 0]]
    arrays["sphere_packets"] = np.ascontiguousarray(packets.reshape(-1, PACKET, 4).transpose(0, 2, 1))
    arrays["sphere_order"] = order
    sign = np.array([-1.0 if sphere.flipped else 1.0 for sphere in scene.spheres], np.float32)
    arrays["balls"] = np.column_stack([centers, radii * sign]).astype(np.float32)
    arrays["ball_ints"] = np.column_stack([[s.material for s in scene.spheres], lights.of_sphere]).astype(np.int32)
    macros["SPHERE_PACKETS"] = len(order) // PACKET
    if nodes is not None:
        macros["SPHERE_NODES"] = len(nodes[1])
        arrays["sphere_bounds"], arrays["sphere_children"], depth = nodes
        macros["_depths"].append(depth)


def _arranged(
    lower: NDArray[np.float32], upper: NDArray[np.float32], hierarchy: bool | None
) -> tuple[NDArray[np.int32], tuple[NDArray[np.float32], NDArray[np.int32], int] | None]:
    """Primitives in the order of their packets, -1 for padding, and the hierarchy over them if one is wanted."""
    count = len(lower)
    if hierarchy is False or (hierarchy is None and count <= PACKET * BRUTE_FORCE_PACKETS):
        order = np.full(-(-count // PACKET) * PACKET, -1, np.int32)
        order[:count] = np.arange(count)
        return order, None
    bounds, children, order, depth = _bvh.build(np.ascontiguousarray(lower), np.ascontiguousarray(upper), PACKET)
    return order, (bounds, children, depth)


def _textures(scene: Scene, macros: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    used = {texture for mesh in scene.meshes for texture in _textures_of(scene, mesh)}
    macros["TEXTURES"] = len(used)
    macros["NORMAL_MAPS"] = int(any(scene.materials[mesh.material].normal_texture is not None for mesh in scene.meshes))
    if not used:
        return
    # Those that nothing uses keep their number and get no texels.
    parts = [
        t.pixels.reshape(-1, 4) if i in used else t.pixels.reshape(-1, 4)[:0] for i, t in enumerate(scene.textures)
    ]
    starts = np.cumsum([0, *(len(part) for part in parts)])
    if starts[-1] >= 2**31:
        raise ValueError(f"the textures have {starts[-1]} texels together: expected fewer than {2**31}")
    arrays["texels"] = np.concatenate(parts).astype(np.float32, copy=False)
    arrays["textures"] = np.array(
        [
            (start, t.pixels.shape[1], t.pixels.shape[0], WRAPS.index(t.wrap) + 4 * t.nearest)
            for t, start in zip(scene.textures, starts, strict=False)
        ],
        np.int32,
    )
