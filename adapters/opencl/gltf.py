"""Reads glTF 2.0 files, `.gltf` and `.glb`, for the OpenCL tracer (Khronos Group, glTF 2.0 specification).

What is supported:

- all nodes of the default scene; meshes of triangles, strips and fans, with normals, two sets of texture coordinates,
  vertex colours, morph targets by their weights and skins by their joints: in the pose that the nodes have, unanimated
- the metallic-roughness material with its textures, except occlusion, which is what a path tracer finds itself;
  tangents come from texture coordinates; what is single-sided is black from behind, not left out
- images in PNG, JPEG and WebP
- the first perspective camera; orthographic ones are left out with a warning
- the extensions KHR_lights_punctual (point and directional; spots are left out with a warning; range has no effect),
  KHR_materials_emissive_strength, KHR_materials_ior, KHR_materials_transmission and KHR_materials_volume (without
  their textures and without attenuation), KHR_materials_unlit (as emission, which lights up what is around),
  KHR_mesh_quantization, KHR_texture_transform, EXT_texture_webp

Photometric units are taken as radiometric ones: a candela as 1 W/sr, a lux as 1 W/m^2, a nit as 1 W/(sr m^2).

A file without a camera is seen whole, with a margin, from the front, the right and above. One without light is lit by
an environment of radiance 0.5 and a directional light of irradiance 2 from the upper left of the camera.

What else a file has is refused where it says that it cannot be read without, and left out with a warning otherwise.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..inputs import check_size
from .checks import LARGEST, SMALLEST
from .gltf_file import Document
from .gltf_materials import Materials
from .gltf_meshes import Meshes
from .gltf_nodes import Placed, placed_nodes
from .gltf_values import extension, numbers, pick, title
from .scene import RGB, Camera, DirectionalLight, Environment, Mesh, PointLight, Scene, has_area

__all__ = ["read"]

_HEIGHT, _ASPECT = 480, 4.0 / 3.0
_WIDEST = math.pi - 1e-3  # the largest vertical field of view: half a turn sees nothing of a size
_MARGIN = 1.05  # how much farther away than touching the frame
_FRAMED = math.radians(45.0)  # vertical field of view of the camera that a file lacks
_FROM = np.array([0.5, 0.4, 1.0])  # where it is, from what it looks at: the front of a glTF faces +z (section 3.4)
_KEY = np.array([0.5, 0.7, 0.5])  # the way of the light that a file lacks: right, down and along the view

Lights = tuple[PointLight | DirectionalLight, ...]


def read(file: Path, size: tuple[int, int] | None = None) -> Scene:
    """The scene in a glTF file.

    size: (width, height) in pixels; by default 480 rows, and columns by the camera's aspect ratio, or 4:3 where it has
    none. The vertical field of view is the camera's in any case.

    Raises FileNotFoundError for a missing file, image or buffer, OSError for one that cannot be read, and ValueError
    for content that breaks the specification or is not supported; warns (UserWarning) of what is left out.
    """
    file = Path(file)
    if size is not None:
        check_size(size)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused when all is there
            return _scene(Document(file), size)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def _scene(document: Document, size: tuple[int, int] | None) -> Scene:
    nodes = placed_nodes(document)
    world = {placed.index: placed.matrix for placed in nodes}
    materials = Materials(document)
    found = Meshes(document, materials)
    for placed in nodes:
        if placed.node.mesh is not None:
            found.add(placed, world)
    found.finish()
    if not found.meshes:
        raise ValueError("it has no triangles in its scene: expected a node with a mesh of them")
    if not any(has_area(mesh).any() for mesh in found.meshes):
        raise ValueError("none of the triangles in its scene has an area: expected some that can be seen")
    camera = _camera(document, nodes, found.meshes, size)
    lights, environment = _lights(document, nodes), None
    if not lights and not found.lit:
        environment = Environment(np.full((1, 1, 3), 0.5, np.float32))
        right, down, view = (float(v) for v in _KEY @ camera.axes.astype(np.float64))
        lights = (DirectionalLight((right, down, view), (2.0, 2.0, 2.0)),)
    return Scene(
        camera=camera,
        materials=tuple(materials.materials),
        meshes=tuple(found.meshes),
        lights=lights,
        environment=environment,
        textures=tuple(materials.textures),
        alpha_shadows=True,
    )


def _camera(document: Document, nodes: list[Placed], meshes: list[Mesh], size: tuple[int, int] | None) -> Camera:
    """The first perspective camera (section 3.10), or one that sees all."""
    for placed in nodes:
        if placed.node.camera is None:
            continue
        camera = pick(document.model.cameras, placed.node.camera, f"the camera of {placed.name}")
        label = title("camera", placed.node.camera, camera.name)
        if camera.type != "perspective":
            document.warn(f"{label} is {camera.type} and left out; supported are perspective ones")
            continue
        if camera.perspective is None:
            raise ValueError(f"{label} has no 'perspective': expected its yfov and znear")
        return _perspective(camera.perspective, label, placed, size)
    lower = np.min([mesh.vertices[mesh.triangles].min(axis=(0, 1)) for mesh in meshes], axis=0).astype(np.float64)
    upper = np.max([mesh.vertices[mesh.triangles].max(axis=(0, 1)) for mesh in meshes], axis=0).astype(np.float64)
    width, height = size or (round(_HEIGHT * _ASPECT), _HEIGHT)
    tangent = math.tan(_FRAMED / 2.0)
    narrow = math.atan(tangent * min(1.0, width / height))
    center = (lower + upper) / 2.0
    radius = math.sqrt(max(float(_farthest(mesh, center)) for mesh in meshes))
    towards = _FROM / np.linalg.norm(_FROM)
    if not max(1e-7 * np.abs(center).max(), SMALLEST) < radius < LARGEST:
        raise ValueError(
            f"its scene has the radius {radius:.3g} about a centre {np.linalg.norm(center):.3g} from the origin: "
            f"expected a radius of {SMALLEST:g} to {LARGEST:g}, and of 1e-7 of that distance or more, for single "
            "precision; scale it, or move it to the origin"
        )
    origin = center + towards * _MARGIN * radius / math.sin(narrow)
    return _pinhole(width, height, origin, -towards, np.array([0.0, 1.0, 0.0]), tangent)


def _farthest(mesh: Mesh, center: NDArray[np.float64]) -> Any:
    """The square of the largest distance of a mesh from a point."""
    return ((mesh.vertices[np.unique(mesh.triangles)] - center) ** 2).sum(axis=1).max()


def _perspective(perspective: Any, label: str, placed: Placed, size: tuple[int, int] | None) -> Camera:
    (yfov,) = numbers(perspective.yfov, 1, f"the yfov of {label}", 0.0, _WIDEST)
    (near,) = numbers(perspective.znear, 1, f"the znear of {label}", 0.0)
    far = math.inf
    if perspective.zfar is not None:
        (far,) = numbers(perspective.zfar, 1, f"the zfar of {label}", 0.0)
    aspect = _ASPECT
    if perspective.aspectRatio is not None:
        (aspect,) = numbers(perspective.aspectRatio, 1, f"the aspectRatio of {label}", 1e-6, 1e6)
    width, height = size or (max(1, round(_HEIGHT * aspect)), _HEIGHT)
    matrix = placed.matrix  # scale is not the camera's (section 3.10.1): only directions count
    if not np.linalg.norm(np.cross(matrix[:3, 2], matrix[:3, 1])) > 0.0:
        raise _scaled_away(label, placed)
    camera = _pinhole(width, height, matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1], math.tan(yfov / 2.0), near, far)
    return camera


def _scaled_away(label: str, placed: Placed) -> ValueError:
    return ValueError(
        f"{label} has no direction: {placed.name}, or one above it, is scaled by 0; expected scales other than 0"
    )


def _pinhole(
    width: int,
    height: int,
    origin: NDArray[np.float64],
    view: NDArray[np.float64],
    up: NDArray[np.float64],
    tangent: float,
    near: float = 0.0,
    far: float = math.inf,
) -> Camera:
    """tangent: of half the vertical field of view."""
    view = view / np.linalg.norm(view)
    right = np.cross(view, up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view, right), view])
    across = tangent * width / height
    return Camera(
        int(width),
        int(height),
        origin.astype(np.float32),
        axes.astype(np.float32),
        (-across, across, -tangent, tangent),
        near=near,
        far=far,
    )


def _lights(document: Document, nodes: list[Placed]) -> Lights:
    """The lights of KHR_lights_punctual."""
    given = (extension(document.model, "KHR_lights_punctual") or {}).get("lights", [])
    found: list[PointLight | DirectionalLight] = []
    for placed in nodes:
        index = (extension(placed.node, "KHR_lights_punctual") or {}).get("light")
        if index is None:
            continue
        light = pick(given, index, f"the light of {placed.name}")
        if not isinstance(light, dict):
            raise ValueError(f"light {index} is {light!r}: expected an object")
        label = title("light", index, light.get("name"))
        color = numbers(light.get("color", [1.0, 1.0, 1.0]), 3, f"the colour of {label}", 0.0)
        (intensity,) = numbers(light.get("intensity", 1.0), 1, f"the intensity of {label}", 0.0)
        red, green, blue = (intensity * c for c in color)
        power: RGB = (red, green, blue)
        kind = light.get("type")
        x, y, z = (float(v) for v in (placed.matrix[:3, 3] if kind == "point" else -placed.matrix[:3, 2]))
        if kind == "directional" and (x, y, z) == (0.0, 0.0, 0.0):
            raise _scaled_away(label, placed)
        if kind == "point":
            found.append(PointLight((x, y, z), power))
        elif kind == "directional":
            found.append(DirectionalLight((x, y, z), power))
        elif kind == "spot":
            document.warn(f"{label} is a spot and left out; supported are point and directional lights")
        else:
            raise ValueError(f"{label} is of the type {kind!r}: expected point, directional or spot")
    return tuple(found)
