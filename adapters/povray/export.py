"""A `Scene` as POV-Ray's scene description language.

The same geometry, camera, materials and lights, so that a scene renders in all renderers. POV-Ray is no path tracer,
and its image differs from the tracer's in these ways:

- Light that comes by way of diffuse surfaces is left out, or, with `radiosity`, gathered by POV-Ray's radiosity:
  cached, interpolated and so biased.
- Glass lets light through unbent, and mirrors send none on; with `photons`, both are traced by POV-Ray's photon maps.
- Light sources are those that `export_lights` makes, materials those of `export_materials`; both say what is near
  and what is exact.
- What is cut out lets shadow rays through, whatever `alpha_shadows` says.
- The near and far planes of the camera are ignored, and paths have at most `MOST_SEGMENTS` segments.
- Colours and textures are single precision, pixels of images half precision.

Not written, with a ValueError that says so: normal maps, metallic-roughness textures and vertex colours; cut-out
surfaces other than diffuse ones; lamps other than diffuse ones, and spheres that shine inwards; a hidden environment.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..inputs import check_whole
from ..opencl.scene import Camera, DirectionalLight, Environment, Mesh, Scene, Sphere
from .export_lights import lights
from .export_materials import Materials, Surface
from .export_text import number, rows, times, vector, write_image
from .export_textures import Textures
from .program import write_text

__all__ = ["export"]

MOST_SEGMENTS = 16
_SMALL, _LARGE, _USUAL = 1.0, 1e4, 20.0  # extents: POV-Ray's tolerances are lengths, of 1e-3
_SKY_ROWS = 1024
# Quality somewhere between speed and noise: what POV-Ray's own examples call "final".
_RADIOSITY = (
    "radiosity { pretrace_start 0.08 pretrace_end 0.01 count 200 nearest_count 10 error_bound 0.4 recursion_limit 3 "
    "low_error_factor 0.5 gray_threshold 0 minimum_reuse 0.01 brightness 1 normal off always_sample off }"
)


def export(
    scene: Scene,
    folder: Path,
    *,
    radiosity: bool = False,
    photons: int = 0,
    patches: int = 3,
    sky: int = 32,
    blur_samples: int = 64,
) -> Path:
    """Writes `scene` to `scene.pov` in `folder`, with its textures beside it, and returns that file.

    Parameters
    ----------
    scene
        What to write.
    folder
        Made if missing. Files of the same names are replaced.
    radiosity
        Whether light by way of diffuse surfaces is gathered; the sky lights by it alone then.
    photons
        How many photons are shot for glass and mirrors; 0 for none.
    patches
        A rectangular lamp is cut into about `patches`^2 area lights of four jittered points each, with a shadow ray
        for each; between 1 and 64.
    sky
        Into how many such lights the sky is cut, between 0 (it is seen and lights nothing) and 4096.
    blur_samples
        How many rays POV-Ray's own camera sends through each place in the image if it has a lens, 1 to 2^20. All of
        them always: where POV-Ray may stop early it misses small lights out of focus nearly everywhere.

    Raises
    ------
    ValueError
        For what POV-Ray cannot show, and for numbers out of range.
    OSError
        If a file cannot be written.
    """
    check_whole("patches", patches, 1, 64)
    check_whole("sky", sky, 0, 4096)
    check_whole("photons", photons, 0, 1 << 31)
    check_whole("blur_samples", blur_samples, 1, 1 << 20)
    if scene.hide_emitters and scene.environment is not None:
        raise ValueError("the scene hides its emitters from the camera, which POV-Ray cannot do for an environment")
    folder.mkdir(parents=True, exist_ok=True)
    extent = _extent(scene)
    if not _SMALL <= extent <= _LARGE:
        scene, extent = _scaled(scene, _USUAL / extent), _USUAL
    made = [] if scene.max_depth == 1 else lights(scene, extent, patches, 0 if radiosity else sky, photons > 0)
    only_points = bool(scene.lights) and len(made) == len(scene.lights)
    materials = Materials(scene, Textures(scene, folder), extent, only_points)
    parts = [_settings(scene, radiosity, photons), camera(scene.camera, blur_samples), *made]
    parts += [_environment(scene.environment, folder)] if scene.environment is not None else []
    for mesh in scene.meshes:
        if len(mesh.triangles):
            inside_out = _volume(mesh) < 0.0
            parts.append(_mesh(mesh, materials.surface(mesh, inside_out), scene.hide_emitters, photons > 0))
    for sphere in scene.spheres:
        parts.append(_sphere(sphere, materials.surface(sphere, sphere.flipped), scene.hide_emitters, photons > 0))
    file = folder / "scene.pov"
    write_text(file, "\n".join(parts) + "\n")
    return file


def camera(camera: Camera, blur_samples: int) -> str:
    """The `camera` statement; POV-Ray's lens is a disc of a quarter of its `aperture` in radius."""
    left, right, top, bottom = (float(x) for x in camera.window)
    x, y, view = camera.axes.astype(np.float64)
    direction = view + 0.5 * (left + right) * x + 0.5 * (top + bottom) * y
    text = (
        f"camera {{ perspective location {_exactly(camera.origin)} right {_exactly((right - left) * x)} "
        f"up {_exactly((top - bottom) * y)} direction {_exactly(direction)}"
    )
    if camera.aperture_radius > 0.0:
        focus = camera.origin.astype(np.float64) + direction * camera.focus_distance
        text += (
            f" aperture {number(4.0 * camera.aperture_radius)} focal_point {_exactly(focus)} "
            f"blur_samples {blur_samples} variance 0"
        )
    return text + " }"


def _exactly(values: NDArray[Any]) -> str:
    return "<" + ",".join(f"{x:.17g}" for x in np.asarray(values, np.float64)) + ">"


def _settings(scene: Scene, radiosity: bool, photons: int) -> str:
    levels = MOST_SEGMENTS if scene.max_depth < 0 else min(max(scene.max_depth, 1), MOST_SEGMENTS)
    more = f" {_RADIOSITY}" if radiosity else ""
    if photons:
        more += f" photons {{ count {photons} autostop 0 jitter 1 }}"
    return (
        "#version 3.7;\n"
        f"global_settings {{ assumed_gamma 1.0 ambient_light 0 max_trace_level {levels} adc_bailout 0.001{more} }}\n"
        "#default { texture { pigment { rgb 0 } finish { ambient 0 diffuse 0 specular 0 phong 0 } } }\n"
        "background { rgb 0 }"
    )


def _environment(environment: Environment, folder: Path) -> str:
    radiance = environment.radiance
    if radiance.shape[:2] == (1, 1):
        return f"sky_sphere {{ pigment {{ rgb {vector(radiance[0, 0])} }} }}"
    # The map's rows are nodes from pole to pole, those of POV-Ray's images lie between: finer rows than the map's.
    intervals = len(radiance) - 1
    count = intervals * max(2, -(-_SKY_ROWS // intervals))
    place = (np.arange(count) + 0.5) / count * intervals
    upper = np.minimum(place.astype(int), intervals - 1)
    share = (place - upper)[:, None, None].astype(np.float32)
    pixels = radiance[upper] * (1.0 - share) + radiance[upper + 1] * share
    scale = max(1.0, float(pixels.max()) / 6e4)
    write_image(folder / "sky.exr", pixels / np.float32(scale))
    # Azimuth 0 is -z in the map's frame and +x in POV-Ray's; both go round the same way.
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    matrix = turn @ environment.to_world.astype(np.float64).T
    place_text = ",".join(f"{x:.17g}" for x in [*matrix.ravel(), 0.0, 0.0, 0.0])
    return (
        f'sky_sphere {{ pigment {{ image_map {{ exr "sky.exr" map_type 1 interpolate 2 }} matrix <{place_text}> }} '
        f"emission {number(scale)} }}"
    )


def _mesh(mesh: Mesh, surface: Surface, hide: bool, photons: bool) -> str:
    # POV-Ray's front is where corners go round clockwise.
    faces = mesh.triangles[:, ::-1]
    text = "mesh2 {\n" + rows("vertex_vectors", mesh.vertices)
    if mesh.normals is not None:
        text += rows("normal_vectors", mesh.normals)
    if mesh.uvs is not None:
        text += rows("uv_vectors", mesh.uvs)
    text += rows("face_indices", faces)
    if mesh.uvs is not None:
        text += rows("uv_indices", faces)
    lamp = mesh.radiance is not None and max(mesh.radiance) > 0.0
    return text + _dress(surface, lamp, hide, photons)


def _sphere(sphere: Sphere, surface: Surface, hide: bool, photons: bool) -> str:
    if sphere.flipped:
        front, back = surface.back or surface.front, surface.front
        surface = Surface(front, "" if front == back else back, surface.interior, surface.shines_through)
    lamp = sphere.radiance is not None and max(sphere.radiance) > 0.0
    # Its light is inside it.
    shadow = " no_shadow" if lamp else ""
    text = f"sphere {{ {vector(sphere.center)}, {number(sphere.radius)}{shadow}\n"
    return text + _dress(surface, lamp, hide, photons)


def _dress(surface: Surface, lamp: bool, hide: bool, photons: bool) -> str:
    text = surface.front + "\n"
    if surface.back:
        text += surface.back.replace("texture {", "interior_texture {", 1) + "\n"
    text += surface.interior + "\n"
    if lamp:
        text += "no_radiosity" + (" no_image" if hide else "") + "\n"
    if photons and surface.shines_through:
        text += "photons { target reflection on refraction on }\n"
    return text + "}"


def _volume(mesh: Mesh) -> float:
    """Six times the volume inside a closed mesh, below 0 where its fronts are inside."""
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)))


def _extent(scene: Scene) -> float:
    """The diagonal of the box around what is there."""
    points = [scene.camera.origin[None].astype(np.float64)]
    points += [mesh.vertices.astype(np.float64) for mesh in scene.meshes if len(mesh.vertices)]
    for sphere in scene.spheres:
        points.append(np.array(sphere.center) + sphere.radius * np.array([[-1.0], [1.0]]))
    everything = np.concatenate(points)
    return float(np.linalg.norm(np.ptp(everything, axis=0))) or 1.0


def _scaled(scene: Scene, factor: float) -> Scene:
    """The scene with all lengths times `factor`, which looks the same."""
    small = np.float32(factor)
    camera = replace(
        scene.camera,
        origin=scene.camera.origin * small,
        aperture_radius=scene.camera.aperture_radius * factor,
        focus_distance=scene.camera.focus_distance * factor,
        near=scene.camera.near * factor,
        far=scene.camera.far * factor,
    )
    lights = tuple(
        light
        if isinstance(light, DirectionalLight)
        else replace(
            light,
            position=times(light.position, factor),
            intensity=times(light.intensity, factor**2),
        )
        for light in scene.lights
    )
    spheres = tuple(
        replace(sphere, center=times(sphere.center, factor), radius=sphere.radius * factor) for sphere in scene.spheres
    )
    meshes = tuple(replace(mesh, vertices=mesh.vertices * small) for mesh in scene.meshes)
    return replace(scene, camera=camera, lights=lights, spheres=spheres, meshes=meshes)
