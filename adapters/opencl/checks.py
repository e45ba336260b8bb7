"""What a scene must be to be rendered, each fault with a sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .scene import RGB, Camera, Material, Mesh, Scene

__all__ = ["KINDS", "WRAPS", "check"]

KINDS = ("diffuse", "dielectric", "roughdielectric", "conductor", "roughconductor", "plastic", "metallic-roughness")
_SMOOTHEST = 1e-4  # alpha: below it the density overflows
# Radii and coordinates in world units; a thousand times less or more, and products of them leave single precision.
SMALLEST, LARGEST = 1e-12, 1e12
WRAPS = ("repeat", "mirror", "clamp")


def check(scene: Scene) -> None:
    """Raises ValueError for what cannot be rendered."""
    from . import scene as scenes  # which imports this module

    _check_camera(scene.camera)
    if not (scene.max_depth == -1 or scene.max_depth >= 0) or scene.rr_depth < 1:
        raise ValueError(
            f"max_depth is {scene.max_depth} and rr_depth {scene.rr_depth}: expected -1 or 0 and more, and 1 or more"
        )
    for i, texture in enumerate(scene.textures):
        if texture.wrap not in WRAPS:
            raise ValueError(f"texture {i} has the wrap {texture.wrap!r}: expected one of {', '.join(WRAPS)}")
        if texture.pixels.ndim != 3 or texture.pixels.shape[2] != 4 or texture.pixels.size == 0:
            raise ValueError(f"texture {i} has the shape {texture.pixels.shape}: expected (height, width, 4)")
        _finite(texture.pixels, f"texture {i}")
    for i, material in enumerate(scene.materials):
        _check_material(material, f"material {i}", len(scene.textures))
    for mesh in scene.meshes:
        _check_mesh(mesh, len(scene.materials), len(scene.textures))
        if mesh.uvs is None and (mesh.radiance_texture is not None or _textured(scene.materials[mesh.material])):
            raise ValueError(f"{mesh.name} has a texture and no texture coordinates")
    for sphere in scene.spheres:
        _check_reach(_finite(np.array([*sphere.center, sphere.radius]), sphere.name), sphere.name)
        if not sphere.radius > 0.0:
            raise ValueError(f"{sphere.name} has the radius {sphere.radius:g}: expected one above 0")
        _index(sphere.material, len(scene.materials), f"the material of {sphere.name}")
        if _textured(scene.materials[sphere.material]):
            raise ValueError(f"{sphere.name} has a texture, and spheres have no texture coordinates: make it a mesh")
        _radiance(sphere.radiance, sphere.name)
    for light in scene.lights:
        if isinstance(light, scenes.PointLight):
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
        turn = _finite(scene.environment.to_world, "the environment's rotation").astype(np.float64)
        if turn.shape != (3, 3) or np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3:
            raise ValueError("the environment's to_world is no rotation: expected a (3, 3) matrix of unit columns")
        if _finite(radiance, "the environment map").min() < 0.0:
            raise ValueError("the environment map holds negative radiance")


def _check_camera(camera: Camera) -> None:
    if not (1 <= camera.width <= 65535 and 1 <= camera.height <= 65535):
        raise ValueError(f"the image is {camera.width}x{camera.height}: expected 1 to 65535 pixels a side")
    _finite(camera.origin, "the camera's origin")
    _finite(camera.axes, "the camera's axes")
    if abs(abs(np.linalg.det(camera.axes.astype(np.float64))) - 1.0) > 1e-3:
        raise ValueError(
            "the camera is degenerate: its axes are not perpendicular unit vectors (is its up along its view, or is it "
            "scaled?)"
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
    for key in ("color", "specular_reflectance", "specular_transmittance"):
        if max(getattr(material, key)) > 1.0:
            raise ValueError(
                f"{key} of {name} is {getattr(material, key)}: expected 1 at most, or light grows for ever"
            )
    if not np.isfinite(material.normal_scale):
        raise ValueError(f"the normal scale of {name} is {material.normal_scale:g}: expected a finite one")
    if material.two_sided and material.kind in ("dielectric", "roughdielectric"):
        raise ValueError(f"{name} is a two-sided {material.kind}: its inside is told by its normal; expected one side")
    for key, low, high in (("opacity", 0, 1), ("metallic", 0, 1), ("roughness", 0, 1), ("transmission", 0, 1)):
        if not low <= getattr(material, key) <= high:
            raise ValueError(f"{key} of {name} is {getattr(material, key):g}: expected {low} to {high}")
    if (
        material.kind in ("dielectric", "roughdielectric", "plastic", "metallic-roughness")
        and not 0.0 < material.eta < 100.0
    ):
        raise ValueError(f"the index of refraction of {name} is {material.eta:g}: expected one above 0 and below 100")
    if material.kind in ("roughdielectric", "roughconductor") and not _SMOOTHEST <= material.alpha <= 10.0:
        raise ValueError(f"alpha of {name} is {material.alpha:g}: expected {_SMOOTHEST:g} to 10, or the smooth kind")


def _check_mesh(mesh: Mesh, materials: int, textures: int) -> None:
    count = len(mesh.vertices)
    if mesh.vertices.shape != (count, 3) or mesh.triangles.ndim != 2 or mesh.triangles.shape[1] != 3:
        raise ValueError(
            f"{mesh.name} has vertices {mesh.vertices.shape} and triangles {mesh.triangles.shape}: "
            "expected (v, 3) and (t, 3)"
        )
    if len(mesh.triangles) and not (int(mesh.triangles.min()) >= 0 and int(mesh.triangles.max()) < count):
        raise ValueError(
            f"{mesh.name} names the vertices {int(mesh.triangles.min())} to {int(mesh.triangles.max())} and has {count}"
        )
    _finite(mesh.vertices, f"the vertices of {mesh.name}")
    _check_reach(mesh.vertices, mesh.name)
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


def _check_reach(lengths: Any, name: str) -> None:
    farthest = float(np.abs(lengths).max(initial=0.0))
    if farthest > LARGEST:
        raise ValueError(
            f"{name} has coordinates up to {farthest:.3g}: expected {LARGEST:g} at most, for single precision; scale "
            "the scene, or move it to the origin"
        )


def _textured(material: Material) -> bool:
    found = (material.color_texture, material.normal_texture, material.metallic_roughness_texture)
    return any(texture is not None for texture in found)


def _finite(values: Any, name: str) -> Any:
    # In single precision, in which it is rendered: 1e39 is infinite there.
    with np.errstate(over="ignore"):
        finite = np.isfinite(np.asarray(values).astype(np.float32))
    if not finite.all():
        bad = int(np.size(values) - np.count_nonzero(finite))
        raise ValueError(f"{name}: {bad} of {np.size(values)} numbers are NaN or infinite")
    return values


def _radiance(values: RGB | None, name: str) -> None:
    if values is not None and not (np.isfinite(values).all() and min(values) >= 0.0):
        raise ValueError(f"{name}: {tuple(values)} are no three finite numbers of 0 or more")


def _index(index: int, count: int, name: str) -> None:
    if not 0 <= index < count:
        raise ValueError(f"{name} is number {index} and there are {count}")
