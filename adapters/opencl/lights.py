"""The table of lights: one row for each emitting triangle and sphere, each point and direction, and the environment."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .distributions import alias_table
from .scene import Environment, Mesh, PointLight, Scene, has_area

__all__ = ["Lights", "light_table"]

_TRIANGLE, _SPHERE, _POINT, _DIRECTIONAL, _ENVIRONMENT = range(5)
_GRID = 6  # points along each side of a triangle, at which its emission texture is looked up
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Lights:
    """of_triangle, of_sphere: the row of each triangle (of the scene's meshes in turn) and sphere, -1 for none; macros
    and arrays as in `tables.Tables`."""

    of_triangle: NDArray[np.int32]
    of_sphere: NDArray[np.int32]
    macros: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def light_table(scene: Scene) -> Lights:
    """All lights of a scene, each with the probability of being chosen.

    Lights at infinity, whose power depends on how far a scene reaches, are as probable each as all others together
    (as in pbrt-v4, section 12.6.3); those are chosen in proportion to their power.

    Raises ValueError for light from infinity where there is nothing that it could fall on.
    """
    rows: list[tuple[tuple[float, ...], tuple[float, ...]]] = []  # (k, 2, 4)
    ints: list[tuple[int, int, int, int]] = []
    powers: list[float] = []
    counts = [len(mesh.triangles) for mesh in scene.meshes]
    of_triangle = np.full(sum(counts), -1, np.int32)
    start = number = 0
    for mesh, count in zip(scene.meshes, counts, strict=True):
        if count and mesh.radiance is not None and max(mesh.radiance) > 0.0:
            corners = mesh.vertices.astype(np.float64)[mesh.triangles]
            areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            kept = np.flatnonzero(has_area(mesh))  # a light without area sends out nothing
            texture = -1 if mesh.radiance_texture is None else mesh.radiance_texture
            of_triangle[start + kept] = number + np.arange(len(kept))
            number += len(kept)
            rows += [((*mesh.radiance, 0.0), (0.0, 0.0, 0.0, float(mesh.emits_both_sides)))] * len(kept)
            ints += [(_TRIANGLE, triangle, 0, texture) for triangle in (start + kept).tolist()]
            power = math.pi * (1 + mesh.emits_both_sides) * areas[kept] * _luminance(mesh.radiance)
            powers.extend(power * _brightness(scene, mesh, kept))
        start += count
    of_sphere = np.full(len(scene.spheres), -1, np.int32)
    for i, sphere in enumerate(scene.spheres):
        if sphere.radiance is not None and max(sphere.radiance) > 0.0:
            of_sphere[i] = len(rows)
            rows.append(
                ((*sphere.radiance, 0.0), (*sphere.center, -sphere.radius if sphere.flipped else sphere.radius))
            )
            ints.append((_SPHERE, i, 0, -1))
            powers.append(4.0 * math.pi**2 * sphere.radius**2 * _luminance(sphere.radiance))
    for light in scene.lights:
        if isinstance(light, PointLight):
            rows.append(((*light.intensity, 0.0), (*light.position, 0.0)))
            ints.append((_POINT, 0, 0, -1))
            powers.append(4.0 * math.pi * _luminance(light.intensity))
        else:
            direction = -np.array(light.direction) / np.linalg.norm(light.direction)
            rows.append(((*light.irradiance, 0.0), (*direction, 0.0)))
            ints.append((_DIRECTIONAL, 0, 0, -1))
            powers.append(-1.0)
    kinds = [row[0] for row in ints]
    macros: dict[str, Any] = {
        "TRIANGLE_LIGHTS": kinds.count(_TRIANGLE),
        "SPHERE_LIGHTS": kinds.count(_SPHERE),
        "POINT_LIGHTS": kinds.count(_POINT),
        "DIRECTIONAL_LIGHTS": kinds.count(_DIRECTIONAL),
        "ENVIRONMENT": 0,
        "EMISSION_TEXTURES": int(any(row[3] >= 0 for row in ints)),
    }
    environment: dict[str, NDArray[Any]] = {}
    if scene.environment is not None and float(scene.environment.radiance.max()) > 0.0:
        _environment(scene.environment, macros, environment)
        rows.append(((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)))  # the last row, which the kernel counts on
        ints.append((_ENVIRONMENT, 0, 0, -1))
        powers.append(-1.0)
    macros["LIGHTS"] = len(rows)
    arrays: dict[str, NDArray[Any]] = {}
    if rows:
        weights = _probabilities(np.array(powers, np.float64))
        thresholds, aliases = alias_table(weights)
        table = np.array(rows, np.float32)
        table[:, 0, 3] = weights
        numbers = np.array(ints, np.int32)
        numbers[:, 2] = aliases
        arrays = {"light_rows": table, "light_ints": numbers, "light_thresholds": thresholds}
    return Lights(of_triangle, of_sphere, macros, {**arrays, **environment})


def _brightness(scene: Scene, mesh: Mesh, triangles: NDArray[np.intp]) -> NDArray[np.float64]:
    """Mean luminance of the emission texture on each of the triangles, from some points of them; 1 without one."""
    if mesh.radiance_texture is None or mesh.uvs is None:
        return np.ones(len(triangles))
    pixels = scene.textures[mesh.radiance_texture].pixels
    height, width = pixels.shape[:2]
    total = np.zeros(len(triangles))
    corners = mesh.uvs.astype(np.float64)[mesh.triangles[triangles]]
    steps = [(i, j) for i in range(_GRID) for j in range(_GRID - i)]
    for i, j in steps:
        b1, b2 = (i + 1 / 3) / _GRID, (j + 1 / 3) / _GRID
        uv = (1 - b1 - b2) * corners[:, 0] + b1 * corners[:, 1] + b2 * corners[:, 2]
        x, y = (uv * (width, height)).astype(np.int64).T % np.array([[width], [height]])
        total += pixels[height - 1 - y, x, :3].astype(np.float64) @ _LUMINANCE
    # Points between the samples may be brighter: none is left out.
    return total / len(steps) + 0.05 * float((pixels[..., :3] @ _LUMINANCE).mean())


def _luminance(rgb: Any) -> float:
    return float(np.dot(_LUMINANCE, rgb))


def _probabilities(powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of lights with these powers, -1 for those at infinity; none is impossible to choose."""
    infinite = powers < 0.0
    weights = np.where(infinite, 0.0, powers)
    if not weights.sum() > 0.0:  # only light that no luminance tells of
        weights = np.where(infinite, 0.0, 1.0)
    weights = np.where(infinite, 0.0, np.maximum(weights, 1e-6 * weights.max()))
    weights[infinite] = weights.sum() or 1.0
    return np.asarray(weights / weights.sum())


def _environment(environment: Environment, macros: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Macros and arrays of the environment."""
    radiance = environment.radiance
    for axis, name in enumerate("XYZ"):
        macros[f"ENVIRONMENT_{name}"] = environment.to_world[:, axis]
    if radiance.shape[:2] == (1, 1):
        macros["ENVIRONMENT"] = 1
        macros["ENVIRONMENT_RADIANCE"] = radiance[0, 0]
        return
    height, width = radiance.shape[:2]
    macros.update(ENVIRONMENT=2, ENVIRONMENT_WIDTH=width, ENVIRONMENT_HEIGHT=height)
    nodes = np.zeros((height, width + 1, 4), np.float32)
    nodes[:, :width, :3] = radiance
    nodes[:, width, :3] = radiance[:, 0]
    luminance = nodes[..., :3].astype(np.float64) @ _LUMINANCE
    cells = 0.25 * (luminance[:-1, :-1] + luminance[1:, :-1] + luminance[:-1, 1:] + luminance[1:, 1:])
    edges = np.cos(math.pi * np.arange(height) / (height - 1))
    solid = (edges[:-1] - edges[1:])[:, None] * (2.0 * math.pi / width)
    mean = float((cells * solid).sum() / (4.0 * math.pi))
    weights = (cells + 1e-3 * mean) * solid  # no cell that interpolation lights may be left out
    tables = [alias_table(row) for row in weights]
    bands = alias_table(weights.sum(axis=1))
    thresholds = np.concatenate([table[0] for table in tables])
    arrays["environment_map"] = nodes
    arrays["environment_cells"] = np.column_stack([(weights / weights.sum()).ravel(), thresholds]).astype(np.float32)
    arrays["environment_aliases"] = np.concatenate([table[1] for table in tables])
    arrays["environment_bands"], arrays["environment_band_aliases"] = bands
