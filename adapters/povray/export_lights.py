"""Lights of a scene as POV-Ray's.

POV-Ray lights a surface by light sources alone, not by what emits; so every lamp, and the sky, gets light sources
besides being seen. A lamp is cut into patches, each an area light of two by two jittered points, whose cosine at the
lamp is that of a spotlight of 90 degrees and whose distance and angles are those of the patch's middle: what comes from
a lamp is right where the patches are small against the distance. Triangles that are no half of a parallelogram become
squares of the same area; of more than `MOST` some are drawn, in equal steps of power, for all. Spheres are discs that
face what they light: right where the surface sees the whole sphere. The sky is cut by its light into patches far away
(Debevec 2005, "A Median Cut Algorithm for Light Probe Sampling", here in equal-area coordinates).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..opencl.scene import DirectionalLight, Environment, Mesh, PointLight, Scene, Sphere
from .export_text import number, vector
from .export_textures import lookup

__all__ = ["lights"]

MOST = 64
_FAR = 1e3  # of the extent: where the sky's lights are
_NEAR = 1e-5  # of the extent: where POV-Ray's fading begins, below which it is not by the square
_CLEAR = 2e-3  # POV-Ray ignores what is within 1e-3 of a light
Vectors = NDArray[np.float64]


@dataclass(frozen=True)
class _Patch:
    """A parallelogram that shines to the side of `normal`: radiance times area is `power`, RGB."""

    middle: Vectors
    axes: Vectors  # (2, 3): its sides
    normal: Vectors
    power: Vectors


def lights(scene: Scene, extent: float, patches: int, sky: int, photons: bool) -> list[str]:
    """A `light_source` for every light, `patches` by `patches` for a rectangle and `sky` for an environment.

    extent: the scene's diameter. photons: whether lights shoot them.
    """
    text = " photons { reflection on refraction on }" if photons else ""
    made = []
    for light in scene.lights:
        if isinstance(light, PointLight):
            color = np.array(light.intensity, float) / np.pi
            made.append(f"light_source {{ {vector(light.position)} {_fading(color, extent)}{text} }}")
        else:
            made.append(_directional(light, extent, text))
    for mesh in scene.meshes:
        if mesh.radiance is not None and max(mesh.radiance) > 0.0 and len(mesh.triangles):
            made += [_area(patch, extent, text) for patch in _mesh_patches(scene, mesh, patches)]
    for sphere in scene.spheres:
        if sphere.radiance is not None and max(sphere.radiance) > 0.0:
            made.append(_ball(sphere, extent, patches, text))
    if scene.environment is not None and sky:
        made += _sky(scene.environment, extent, sky)
    return made


def _fading(color: Vectors, extent: float) -> str:
    """`color` over the square of the distance: POV-Ray's factor is 2 / (1 + (distance / fade_distance)^fade_power)."""
    near = extent * _NEAR
    return f"rgb {vector(color / (2.0 * near**2))} fade_distance {number(near)} fade_power 2"


def _directional(light: DirectionalLight, extent: float, text: str) -> str:
    direction = np.array(light.direction, float)
    direction /= np.linalg.norm(direction)
    color = vector(x / np.pi for x in light.irradiance)
    at = -direction * extent * _FAR
    return f"light_source {{ {vector(at)} rgb {color} parallel point_at 0{text} }}"


def _grid(axes: Vectors, across: int) -> str:
    """Jittered points over the whole parallelogram.

    POV-Ray puts the outermost ones on the border that it is given, and jitters by half a step beyond.
    """
    share = (across - 1) / across
    sides = ", ".join(vector(axis * share) for axis in axes)
    return f"area_light {sides}, {across}, {across} jitter area_illumination on"


def _area(patch: _Patch, extent: float, text: str) -> str:
    # In front of the lamp by more than POV-Ray's tolerance: the lamp may else be in its own light's way, and stays so
    # for whole regions of the image once POV-Ray has cached it.
    middle = patch.middle + patch.normal * (_CLEAR + 1e-6 * extent)
    ahead = middle + patch.normal * extent
    cosine = f"spotlight radius 90 falloff 90 tightness 1 point_at {vector(ahead)}"
    fading = _fading(patch.power / np.pi, extent)
    return f"light_source {{ {vector(middle)} {fading} {cosine} {_grid(patch.axes, 2)}{text} }}"


def _ball(sphere: Sphere, extent: float, patches: int, text: str) -> str:
    if sphere.flipped:
        raise ValueError(f"{sphere.name} shines inwards, which POV-Ray has no light for; use an environment")
    intensity = np.array(sphere.radiance, float) * sphere.radius**2  # times pi, over pi
    disc = _grid(2.0 * sphere.radius * np.eye(3)[[0, 2]], 2 * patches)
    return f"light_source {{ {vector(sphere.center)} {_fading(intensity, extent)} {disc} circular orient{text} }}"


def _mesh_patches(scene: Scene, mesh: Mesh, across: int) -> list[_Patch]:
    corners = mesh.vertices[mesh.triangles].astype(np.float64)  # (t, 3, 3)
    textured = mesh.radiance_texture is not None and mesh.uvs is not None
    uvs = mesh.uvs[mesh.triangles].astype(np.float64) if textured and mesh.uvs is not None else None
    found: list[_Patch] = []
    single = []
    i = 0
    while i < len(corners):
        order = _parallelogram(corners[i], corners[i + 1]) if i + 1 < len(corners) else None
        if order is None:
            single.append(i)
            i += 1
        else:
            found += _cut(scene, mesh, corners[i][order], None if uvs is None else uvs[i][order], across)
            i += 2
    found += [_square(scene, mesh, corners[i], None if uvs is None else uvs[i]) for i in single]
    found = _fewer([patch for patch in found if patch.power.max() > 0.0], max(MOST, across * across))
    if mesh.emits_both_sides:
        found += [_Patch(patch.middle, patch.axes, -patch.normal, patch.power) for patch in found]
    return found


def _parallelogram(one: Vectors, two: Vectors) -> list[int] | None:
    """The corners of triangle `one` from its own one to those it shares, if `two` makes a parallelogram of it."""
    size = np.ptp(one, axis=0).max()
    for k in range(3):
        order = [k, (k + 1) % 3, (k + 2) % 3]
        own, a, b = one[order]
        distances = np.linalg.norm(two[:, None] - np.stack([a, b, a + b - own]), axis=2)
        if (distances.min(axis=0) < 1e-4 * size).all():
            return order
    return None


def _cut(scene: Scene, mesh: Mesh, corners: Vectors, uvs: Vectors | None, across: int) -> list[_Patch]:
    """`across`^2 patches, as square as their number allows, of the parallelogram of a corner and its neighbours."""
    sides = corners[1:] - corners[0]
    normal = np.cross(*sides)
    area = float(np.linalg.norm(normal))
    if area == 0.0:
        return []
    lengths = np.linalg.norm(sides, axis=1)
    columns = int(np.clip(round(across * np.sqrt(lengths[0] / lengths[1])), 1, across * across))
    counts = np.array([columns, max(round(across * across / columns), 1)])
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    places = (cells + 0.5) / counts
    inside = (np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2) + 0.5) / 8
    made = []
    for cell, place in zip(cells, places, strict=True):
        colors = _radiance(scene, mesh, uvs, (cell + inside) / counts)
        middle = corners[0] + place @ sides
        made.append(_Patch(middle, sides / counts[:, None], normal / area, colors * area / len(cells)))
    return made


def _square(scene: Scene, mesh: Mesh, corners: Vectors, uvs: Vectors | None) -> _Patch:
    """A square with the place, the area and the plane of a triangle."""
    sides = corners[1:] - corners[0]
    normal = np.cross(*sides)
    length = max(float(np.linalg.norm(normal)), 1e-300)
    normal = normal / length
    first = sides[0] / max(float(np.linalg.norm(sides[0])), 1e-300)
    axes = np.stack([first, np.cross(normal, first)]) * np.sqrt(0.5 * length)
    a = (np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2) + 0.5) / 8
    folded = np.where(a.sum(axis=1, keepdims=True) > 1.0, 1.0 - a, a)
    return _Patch(corners.mean(axis=0), axes, normal, _radiance(scene, mesh, uvs, folded) * 0.5 * length)


def _radiance(scene: Scene, mesh: Mesh, uvs: Vectors | None, places: Vectors) -> Vectors:
    """The mean of what a mesh emits at places along the sides of a triangle, RGB."""
    factor = np.array(mesh.radiance, float)
    if uvs is None or mesh.radiance_texture is None:
        return factor
    texture = scene.textures[mesh.radiance_texture]
    mean: Vectors = factor * lookup(texture, uvs[0] + places @ (uvs[1:] - uvs[0])).mean(axis=0)
    return mean


def _fewer(patches: list[_Patch], most: int) -> list[_Patch]:
    """At most `most` patches with the power of all, in equal steps of their power."""
    if len(patches) <= most:
        return patches
    powers = np.array([patch.power for patch in patches])
    upto = np.cumsum(powers.sum(axis=1))
    steps = (np.arange(most) + 0.5) * (upto[-1] / most)
    total = powers.sum(axis=0) / most
    chosen = np.searchsorted(upto, steps)
    share = np.sqrt(len(patches) / most)  # as soft as the whole
    return [_Patch(patches[k].middle, patches[k].axes * share, patches[k].normal, total) for k in chosen]


def _sky(environment: Environment, extent: float, count: int) -> list[str]:
    """Area lights on a sphere far away, with equal shares of the sky's light."""
    flux, columns, heights = _equal_area(environment.radiance.astype(np.float64))
    regions = [(0, len(flux), 0, flux.shape[1])]
    brightness = flux.sum(axis=2)
    while len(regions) < count:
        powers = [brightness[a:b, c:d].sum() if (b - a) * (d - c) > 1 else -1.0 for a, b, c, d in regions]
        most = int(np.argmax(powers))
        if powers[most] <= 0.0:
            break
        regions += _halves(brightness, heights, columns, regions.pop(most))
    made = []
    for a, b, c, d in regions:
        part = flux[a:b, c:d]
        color = part.sum(axis=(0, 1)) / np.pi
        if not color.max() > 0.0:
            continue
        middle, axes = _tangent(part.sum(axis=2), heights[a : b + 1], columns[c : d + 1])
        at, sides = (environment.to_world.astype(float) @ v.T for v in (middle, axes))
        far = extent * _FAR
        made.append(f"light_source {{ {vector(at * far)} rgb {vector(color)} {_grid(sides.T * far, 2)} }}")
    return made


def _equal_area(radiance: Vectors) -> tuple[Vectors, Vectors, Vectors]:
    """Radiance times solid angle, (rows, columns, 3), in equal cells of the sphere; their azimuths and heights.

    The first row is up.
    """
    rows, columns = (
        (64, 128) if radiance.shape[:2] == (1, 1) else (max(radiance.shape[0], 64), max(radiance.shape[1], 128))
    )
    heights = np.linspace(1.0, -1.0, rows + 1)
    azimuths = np.linspace(0.0, 2.0 * np.pi, columns + 1)
    # Means over the cells, by 2 x 2 points in each.
    v = np.arccos(1.0 - (np.arange(2 * rows) + 0.5) / rows) / np.pi * (radiance.shape[0] - 1)
    u = (np.arange(2 * columns) + 0.5) / (2 * columns) * radiance.shape[1] - 0.5
    i = np.minimum(v.astype(int), max(radiance.shape[0] - 2, 0))
    j = np.floor(u).astype(int)
    down, right = (v - i)[:, None, None], (u - j)[None, :, None]
    below = np.minimum(i + 1, radiance.shape[0] - 1)
    left, after = radiance[:, j % radiance.shape[1]], radiance[:, (j + 1) % radiance.shape[1]]
    across = left * (1.0 - right) + after * right
    fine = across[i] * (1.0 - down) + across[below] * down
    cells = fine.reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))
    return cells * (4.0 * np.pi / (rows * columns)), azimuths, heights


def _halves(
    brightness: Vectors, heights: Vectors, azimuths: Vectors, region: tuple[int, int, int, int]
) -> list[tuple[int, int, int, int]]:
    """A region cut across its longer side, with equal light on both sides."""
    a, b, c, d = region
    sine = np.sqrt(max(1.0 - (0.5 * (heights[a] + heights[b])) ** 2, 1e-4))
    tall = np.arccos(heights[b]) - np.arccos(heights[a]) > (azimuths[d] - azimuths[c]) * sine
    by_rows = (tall and b - a > 1) or d - c == 1
    upto = np.cumsum(brightness[a:b, c:d].sum(axis=1 if by_rows else 0))
    cut = int(np.clip(np.searchsorted(upto, 0.5 * upto[-1]) + 1, 1, len(upto) - 1))
    if by_rows:
        return [(a, a + cut, c, d), (a + cut, b, c, d)]
    return [(a, b, c, c + cut), (a, b, c + cut, d)]


def _tangent(brightness: Vectors, heights: Vectors, azimuths: Vectors) -> tuple[Vectors, Vectors]:
    """The middle of a region's light on the unit sphere, (3,), and its sides there, (2, 3), in the map's frame.

    With the mean direction a plane under a white sky gets what it should within 0.5 % from 32 lights; with the middle
    of heights and azimuths it is 5 %.
    """
    height = (0.5 * (heights[1:] + heights[:-1]))[:, None]
    azimuth = 0.5 * (azimuths[1:] + azimuths[:-1])
    sine = np.sqrt(1.0 - height**2)
    directions = np.stack(np.broadcast_arrays(sine * np.sin(azimuth), height, -sine * np.cos(azimuth)), axis=-1)
    middle = (directions * brightness[..., None]).sum(axis=(0, 1))
    middle /= np.linalg.norm(middle)
    halfway, sine_there = 0.5 * (azimuths[0] + azimuths[-1]), np.sqrt(1.0 - (0.5 * (heights[0] + heights[-1])) ** 2)
    along = np.array([np.cos(halfway), 0.0, np.sin(halfway)]) * (azimuths[-1] - azimuths[0]) * sine_there
    up = np.cross(along, middle)
    up *= (np.arccos(heights[-1]) - np.arccos(heights[0])) / max(float(np.linalg.norm(up)), 1e-300)
    return middle, np.stack([along, up])
