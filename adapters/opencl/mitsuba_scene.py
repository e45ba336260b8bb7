"""Reads Mitsuba 3 scene files for the OpenCL tracer.

Mitsuba's own parser and loaders do the reading, in its variant `scalar_rgb`, which needs no LLVM. What is supported:

- shapes `rectangle`, `cube`, `sphere`, `disk` (as 512 triangles), `ply`, `obj`, `serialized`; textures on meshes only
- BSDFs `diffuse`, `dielectric`, `roughdielectric`, `conductor`, `roughconductor`, `plastic`, `twosided` around one,
  `mask` and `normalmap` (its flags off); rough ones with the distribution `ggx`
- textures `bitmap` and `checkerboard`, for diffuse reflectance, opacity, normals and an area light's radiance
- emitters `area`, `point`, `directional`, `constant`, `envmap`; sensors `perspective` and `thinlens`; film `hdrfilm`
- integrators `path`, and `pmc` around it

Anything else is refused, and so is what has no extent, or a size that is not finite. Of several sensors the first is
taken, as Mitsuba does; a sphere of a negative radius is one that is turned inside out, as it is to Mitsuba.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..inputs import check_size
from ..mitsuba import loading, variants
from .mitsuba_materials import Image, Materials, image
from .mitsuba_nodes import Node, matrix, rgb, value
from .scene import Camera, DirectionalLight, Environment, Mesh, PointLight, Scene, Sphere

__all__ = ["read"]

_VARIANT = "scalar_rgb"
_DISK = 512  # triangles: the area is that of the disk less 3e-5 of it
_MESHES = {
    "rectangle": ["to_world", "flip_normals"],
    "cube": ["to_world", "flip_normals"],
    "disk": ["to_world", "flip_normals"],
    "ply": ["to_world", "flip_normals", "filename", "face_normals", "flip_tex_coords"],
    "obj": ["to_world", "flip_normals", "filename", "face_normals", "flip_tex_coords"],
    "serialized": ["to_world", "flip_normals", "filename", "face_normals", "shape_index"],
}
_EMITTERS = {
    "point": ["position", "to_world", "intensity"],
    "directional": ["direction", "to_world", "irradiance"],
    "constant": ["radiance"],
    "envmap": ["filename", "scale", "to_world"],
}
_CAMERA = ["to_world", "fov", "fov_axis", "focal_length", "near_clip", "far_clip"]
_SENSORS = {
    "perspective": [*_CAMERA, "principal_point_offset_x", "principal_point_offset_y"],
    "thinlens": [*_CAMERA, "aperture_radius", "focus_distance"],
}
_FILM = ["width", "height", "crop_offset_x", "crop_offset_y", "crop_width", "crop_height"]
_STORAGE = ["file_format", "pixel_format", "component_format", "banner", "compensate"]  # of no effect on radiance
_SAMPLING = ["sampling_weight", "silhouette_sampling_weight"]  # of effect on noise alone


def read(file: Path, size: tuple[int, int] | None = None) -> Scene:
    """The scene in an `.xml` file; with `size`, (width, height) in pixels, its film gets that size first.

    Raises FileNotFoundError for a missing file, OSError for one that cannot be read, and ValueError for content that
    Mitsuba cannot load or that is not supported, which is named with its place in the file.
    """
    file = loading.scene_file(file)
    if size is not None:
        check_size(size)
    with variants.active(_VARIANT), loading.files_beside(file):
        config = mi.parser.ParserConfig(_VARIANT)
        config.merge_meshes = config.merge_equivalent = False  # shapes stay those of the file
        parsed = loading.guarded(str(file), mi.parser.parse_file, config, str(file))
        loading.guarded(str(file), mi.parser.transform_all, config, parsed)
        if size is not None:
            loading.resize(parsed, size)
        root = Node(parsed, 0)
        if root.type != mi.ObjectType.Scene:
            raise ValueError(f"{root.where} is no scene")
        loading.check_plugins(str(file), parsed)
        nodes = _checked(root)
        path = _path(root)
        made = mi.parser.ParserState(parsed)  # making objects empties the nodes
        for node in nodes:
            made.nodes[node.index].props.set_id(f"node {node.index}")
        for key, child in root.children().items():
            if child.type == mi.ObjectType.Integrator:  # it may be one that this variant lacks
                del made.nodes[root.index].props[key]
        with loading.log_as_warnings():
            loaded = loading.guarded(str(file), mi.parser.instantiate, config, made)
        return _scene(loaded, {f"node {node.index}": node for node in nodes}, path)


def _checked(root: Node) -> list[Node]:
    """The shapes and emitters of a scene whose parts, but for BSDFs and textures, are within the subset."""
    shapes, emitters = root.of(mi.ObjectType.Shape), root.of(mi.ObjectType.Emitter)
    for node in shapes:
        if node.kind not in ("sphere", *_MESHES):
            raise node.refuse(["sphere", *_MESHES])
        _check_extent(node)
        names = _MESHES.get(node.kind, ["center", "radius", "to_world", "flip_normals"])
        if any(child.type == mi.ObjectType.Medium for child in node.children().values()):
            raise ValueError(f"{node.where} bounds a medium, which is not supported; supported are surfaces alone")
        node.allow([*names, *_SAMPLING], [mi.ObjectType.BSDF, mi.ObjectType.Emitter])
        for emitter in node.of(mi.ObjectType.Emitter):
            if emitter.kind != "area":
                raise emitter.refuse(["area"])
            emitter.allow(["radiance", *_SAMPLING])
    for node in emitters:
        if node.kind not in _EMITTERS:
            raise node.refuse(["area", *_EMITTERS])
        node.allow([*_EMITTERS[node.kind], *_SAMPLING])
    for node in root.of(mi.ObjectType.Sensor):
        if node.kind not in _SENSORS:
            raise node.refuse(_SENSORS)
        _check_extent(node)
        node.allow(_SENSORS[node.kind], [mi.ObjectType.Film, mi.ObjectType.Sampler])
        for film in node.of(mi.ObjectType.Film):
            if film.kind != "hdrfilm":
                raise film.refuse(["hdrfilm"])
            film.allow([*_FILM, *_STORAGE], [mi.ObjectType.ReconstructionFilter])
    return [*shapes, *emitters]


def _check_extent(node: Node) -> None:
    """Raises ValueError where a `to_world` or a radius leaves nothing of a plugin, or is not finite."""
    to_world = node.get("to_world", None)
    if to_world is not None:
        linear = matrix(to_world)[:3, :3]
        if not np.isfinite(linear).all():
            raise ValueError(f"{node.where} has a to_world that is NaN or infinite in part: expected finite numbers")
        if np.linalg.det(linear) == 0.0:
            raise ValueError(f"{node.where} is scaled by 0 in its to_world: expected factors other than 0")
    radius = node.get("radius", 1.0)
    if not np.isfinite(radius) or radius == 0.0:
        raise ValueError(f"{node.where} has the radius {radius:g}: expected a finite one other than 0")


def _path(root: Node) -> dict[str, Any]:
    """The settings of the path tracer that a scene names; Mitsuba's defaults where it names none."""
    settings = {"max_depth": -1, "rr_depth": 5, "hide_emitters": False}
    integrators = root.of(mi.ObjectType.Integrator)
    if integrators and integrators[0].kind == "pmc":  # our own plugin, around a path tracer by default
        integrators = integrators[0].of(mi.ObjectType.Integrator)
    for node in integrators:
        if node.kind != "path":
            raise node.refuse(["path", "pmc around path"])
        node.allow(settings)
        settings = {name: type(default)(node.get(name, default)) for name, default in settings.items()}
    return settings


def _scene(loaded: Any, nodes: dict[str, Node], path: dict[str, Any]) -> Scene:
    if not loaded.sensors():
        raise ValueError("the scene has no sensor; supported are " + " and ".join(_SENSORS))
    materials = Materials()
    meshes: list[Mesh] = []
    spheres: list[Sphere] = []
    for shape in loaded.shapes():
        node = nodes[shape.id()]
        if node.kind == "sphere":
            spheres.append(_sphere(node, shape, materials))
        else:
            meshes.append(_mesh(node, shape, materials))
    lights: list[PointLight | DirectionalLight] = []
    environment = None
    for emitter in loaded.emitters():
        if emitter.id() not in nodes:
            continue  # an area light, of a shape
        node, params = nodes[emitter.id()], mi.traverse(emitter)
        if node.kind == "point":
            intensity = value(node, "intensity", params, "intensity", None)
            lights.append(PointLight(rgb(params["position"]), intensity))
        elif node.kind == "directional":
            irradiance = value(node, "irradiance", params, "irradiance", None)
            lights.append(DirectionalLight(rgb(matrix(params["to_world"])[:3, 2]), irradiance))
        elif node.kind == "constant":
            radiance = value(node, "radiance", params, "radiance", None)
            environment = Environment(np.array(radiance, np.float32).reshape(1, 1, 3))
        else:
            environment = _environment(params, node.where)
    sensor = loaded.sensors()[0]
    return Scene(
        camera=_camera(sensor),
        materials=tuple(materials.materials),
        meshes=tuple(meshes),
        spheres=tuple(spheres),
        lights=tuple(lights),
        environment=environment,
        textures=tuple(materials.textures),
        filter=loading.filter_of(sensor.film()),
        **path,
    )


def _camera(sensor: Any) -> Camera:
    """A camera from Mitsuba's own rays through the image's corners."""
    params, film = mi.traverse(sensor), sensor.film()
    to_world = matrix(params["to_world"])
    axes = np.stack([-to_world[:3, 0], -to_world[:3, 1], to_world[:3, 2]])  # Mitsuba's x is left, its y is up
    corners = []
    for corner in (0.0, 1.0):
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(corner), mi.Point2f(0.5))  # through the lens's centre
        x, y, z = axes @ np.array(ray.d, dtype=np.float64)
        corners.append((x / z, y / z))
    (left, top), (right, bottom) = corners
    width, height = (int(side) for side in film.crop_size())
    lens = "aperture_radius" in params
    return Camera(
        width,
        height,
        to_world[:3, 3].astype(np.float32),
        axes.astype(np.float32),
        (float(left), float(right), float(top), float(bottom)),
        aperture_radius=float(params["aperture_radius"]) if lens else 0.0,
        focus_distance=float(params["focus_distance"]) if lens else 1.0,
        near=float(params["near_clip"]),
        far=float(params["far_clip"]),
    )


def _environment(params: Any, label: str) -> Environment:
    to_world = matrix(params["to_world"])[:3, :3]
    if not np.allclose(to_world @ to_world.T, np.eye(3), atol=1e-4):
        raise ValueError(f"{label} is scaled by its to_world; supported are rotations")
    data = np.array(params["data"], dtype=np.float32)  # with a column repeated on either side, for interpolation
    radiance = data[:, 1:-1, :3] * np.float32(params["scale"])
    return Environment(np.ascontiguousarray(radiance), to_world.astype(np.float32))


def _sphere(node: Node, shape: Any, materials: Materials) -> Sphere:
    label = node.where
    material, images = materials.add(_bsdf(node), shape.bsdf())
    radiance, light = _radiance(node, shape)
    for found in [*images.values(), *([light] if light else [])]:
        raise ValueError(f"{found.node.where} is on {label}; supported are textures on meshes")
    to_world = matrix(mi.traverse(shape)["to_world"])
    radii = np.linalg.norm(to_world[:3, :3], axis=0)
    if np.ptp(radii) > 1e-4 * radii.max():
        raise ValueError(f"{label} is stretched by its to_world; supported are spheres")
    # Mitsuba turns a mirrored sphere's normals inwards
    flipped = bool(node.get("flip_normals", False)) != bool(np.linalg.det(to_world[:3, :3]) < 0.0)
    return Sphere(rgb(to_world[:3, 3]), float(radii.mean()), material, flipped, radiance, name=label)


def _mesh(node: Node, shape: Any, materials: Materials) -> Mesh:
    vertices, triangles, normals, uvs = _disk(shape) if node.kind == "disk" else _triangles(shape)
    if normals is not None:
        # Mitsuba tells the sides by shading normals: a mirrored mesh's winding disagrees with them
        corners = vertices[triangles].astype(np.float64)
        front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        known: NDArray[np.bool_] = np.asarray(np.isfinite(normals).all(axis=1))
        around: NDArray[Any] = np.where(known[:, None], normals, 0.0)
        back = np.einsum("ti,ti->t", front, around[triangles].sum(axis=1)) < 0.0
        triangles[back] = triangles[back][:, ::-1]
        front[back] *= -1.0
        normals[~known] = _mean_normals(vertices, triangles, front)[~known]
    if node.get("flip_normals", False) and node.kind != "disk":  # a disk's to_world holds it already
        triangles = triangles[:, ::-1]
        normals = None if normals is None else -normals
    if node.kind in ("rectangle", "disk"):
        normals = None  # flat
    bsdf, label = _bsdf(node), node.where
    material, images = materials.add(bsdf, shape.bsdf())
    radiance, light = _radiance(node, shape)
    found = [*images.values(), *([light] if light else [])]
    if not found:
        uvs = None
    elif uvs is None:
        raise ValueError(
            f"{label} has a texture and no texture coordinates; supported are textures on meshes with them"
        )
    else:
        if not all(np.allclose(other.to_uv, found[0].to_uv) for other in found):
            raise ValueError(f"{label} has textures with different 'to_uv'; supported is one for all of them")
        mapped = uvs.astype(np.float64) @ found[0].to_uv[:2, :2].T + found[0].to_uv[:2, 2]
        uvs = mapped.astype(np.float32)
        if "normal_texture" in images and _green_is_down(images["normal_texture"], vertices, triangles, uvs, label):
            material, _ = materials.add(bsdf, shape.bsdf(), flip_green=True)
    return Mesh(
        vertices,
        np.ascontiguousarray(triangles, dtype=np.uint32),
        material,
        normals=normals,
        uvs=uvs,
        radiance=radiance,
        radiance_texture=materials.texture(light.texture) if light else None,
        name=label,
    )


_Arrays = tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32] | None, NDArray[np.float32] | None]


def _triangles(shape: Any) -> _Arrays:
    """Vertices, triangles, normals and texture coordinates of a Mitsuba mesh, without `flip_normals`."""
    vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float32).reshape(-1, 3)
    triangles = np.array(shape.faces_buffer(), dtype=np.uint32).reshape(-1, 3)
    normals = uvs = None
    if shape.has_vertex_normals() and not shape.has_face_normals():
        normals = np.array(shape.vertex_normals_buffer(), dtype=np.float32).reshape(-1, 3)
    if shape.has_vertex_texcoords():
        uvs = np.array(shape.vertex_texcoords_buffer(), dtype=np.float32).reshape(-1, 2)
    return vertices, triangles, normals, uvs


def _mean_normals(vertices: NDArray[Any], triangles: NDArray[Any], front: NDArray[np.float64]) -> NDArray[Any]:
    """For each vertex, (v, 3), the mean normal by area of the triangles that meet at its position.

    front: (t, 3), normals of the triangles, as long as twice their areas. In files without normals Mitsuba finds none
    where a triangle has no area, such as at a sphere's poles; vertices of such triangles alone get an arbitrary one.
    """
    _, place = np.unique(vertices + np.float32(0.0), axis=0, return_inverse=True)  # -0 is 0
    place = place.ravel()
    total = np.zeros((len(vertices), 3))
    for corner in triangles.T:
        np.add.at(total, place[corner], front)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return np.asarray(unit[place])


def _disk(shape: Any) -> _Arrays:
    """The same of a disk; its coordinates are polar, which triangles cannot follow, so that it has none."""
    to_world = matrix(mi.traverse(shape)["to_world"])
    angle = np.arange(_DISK) * (2.0 * np.pi / _DISK)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(_DISK)], axis=1)
    vertices = np.concatenate([np.zeros((1, 3)), rim]) @ to_world[:3, :3].T + to_world[:3, 3]
    at = np.arange(_DISK)
    triangles = np.stack([np.zeros(_DISK, int), 1 + at, 1 + (at + 1) % _DISK], axis=1)
    normal = np.linalg.inv(to_world[:3, :3]).T[:, 2]
    normals = np.broadcast_to(normal, vertices.shape).astype(np.float32)
    return vertices.astype(np.float32), triangles.astype(np.uint32), normals, None


def _green_is_down(
    normal_map: Image, vertices: NDArray[Any], triangles: NDArray[Any], uvs: NDArray[Any], label: str
) -> bool:
    """Whether y of Mitsuba's normal map, across u and the normal, goes down the image, seen from the front.

    Raises ValueError where it goes down in parts, and where `to_uv` turns u, which Mitsuba's tangents do not follow.
    """
    if normal_map.to_uv[0, 0] <= 0.0 or abs(normal_map.to_uv[0, 1]) > 1e-6 or abs(normal_map.to_uv[1, 0]) > 1e-6:
        raise ValueError(f"{normal_map.node.where} has a 'to_uv' that turns or mirrors u; supported are others")
    corners = uvs[triangles].astype(np.float64)
    (ux, uy), (vx, vy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area = ux * vy - uy * vx  # below 0: the image is seen mirrored
    if (area < 0.0).any() and (area > 0.0).any():
        raise ValueError(f"{label} has a normal map on mirrored and other coordinates; supported is one of them")
    return bool((area < 0.0).any())


def _bsdf(node: Node) -> Node | None:
    found = node.of(mi.ObjectType.BSDF)
    return found[0] if found else None


def _radiance(node: Node, shape: Any) -> tuple[tuple[float, float, float] | None, Image | None]:
    """What a shape emits: the factor and the texture."""
    found = node.of(mi.ObjectType.Emitter)
    if not found:
        return None, None
    params = mi.traverse(shape.emitter())
    if "radiance" in found[0].children():
        return (1.0, 1.0, 1.0), image(found[0].children()["radiance"], params, "radiance")
    return value(found[0], "radiance", params, "radiance", None), None
