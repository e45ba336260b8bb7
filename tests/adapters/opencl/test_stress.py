"""No path is lost to rounding: NaN, infinity and negative radiance do not occur. Exact, over the paths traced."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pyopencl")

QUICK, LONG = 1_000_000, 1_000_000_000  # paths


@pytest.fixture(scope="module")
def scene(parts: Any, camera: Any, cube: Any) -> Any:
    """Glass along its surface, needles, sizes from 1e-4 to 1e6, lights without area, black and white, in one room."""
    rng = np.random.default_rng(0)
    white, black = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    mirror = {"conductor_eta": black, "conductor_k": white}
    materials = (
        parts.Material("diffuse", color=white),
        parts.Material("diffuse", color=black, two_sided=True),
        parts.Material("dielectric", eta=1.5),
        parts.Material("dielectric", eta=1.0001),
        parts.Material("roughdielectric", alpha=1e-4),
        parts.Material("roughdielectric", alpha=2.0, eta=2.5),
        parts.Material("conductor", **mirror),
        parts.Material("roughconductor", alpha=1e-4, **mirror),
        parts.Material("plastic", color=white, nonlinear=True),
        parts.Material("plastic", color=black, specular_reflectance=black),
        parts.Material("metallic-roughness", color=white, roughness=0.0, metallic=0.0, transmission=1.0, thin=False),
        parts.Material("metallic-roughness", color=white, roughness=1.0, metallic=0.5, transmission=0.5),
        parts.Material("metallic-roughness", color=black, roughness=0.0, eta=1.0001, metallic=0.0),
        parts.Material("metallic-roughness", color=black, roughness=0.3, metallic=1.0),
        parts.Material("diffuse", color=white, cut_out=True, opacity=0.3, two_sided=True),
    )
    meshes, spheres = [], []
    for i in range(len(materials)):
        # Needles: one side 1e-4 to 1, the other a millionth of it, or nothing at all.
        start = rng.uniform(-2, 2, (40, 3))
        along = rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-4, 0, (40, 1))
        aside = along * rng.choice([1e-6, 0.3], (40, 1)) + rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(
            -9, -1, (40, 1)
        ) * (rng.random((40, 1)) > 0.1)
        corners = np.stack([start, start + along, start + aside], axis=1).astype(np.float32).reshape(-1, 3)
        lit = {"radiance": (1.0, 0.5, 0.2), "emits_both_sides": True} if i % 3 == 0 else {}
        faces = np.arange(120, dtype=np.uint32).reshape(-1, 3)
        meshes.append(parts.Mesh(corners, faces, i, **lit))
        for size in (1e-4, 1e-2, 0.3):
            spheres.append(parts.Sphere(tuple(rng.uniform(-2, 2, 3)), size, i, flipped=bool(i % 2)))
        slab = cube(1.0, material=i)  # as thin as 1e-4, and seen nearly along its faces
        slab.vertices[:] *= np.array([3.0, 10.0 ** rng.uniform(-4, -1), 3.0], np.float32)
        slab.vertices[:] += np.array([0.0, 0.002 + rng.uniform(-1.5, 1.5), 0.0], np.float32)
        meshes.append(slab)
    flat = np.array([[0, 1, 0], [1, 1, 0], [2, 1, 0]], np.float32)
    meshes.append(parts.Mesh(flat, np.array([[0, 1, 2], [0, 0, 0]], np.uint32), 0, radiance=(1e6, 1e6, 1e6)))
    room = cube(1e6, material=0, inside=True, radiance=(0.3, 0.3, 0.3))
    meshes.append(parts.Mesh(room.vertices, room.triangles[2:].copy(), 0, radiance=(0.3, 0.3, 0.3)))  # open to the sky
    spheres.append(parts.Sphere((0.5, 1.8, 0.5), 1e-4, 0, radiance=(1e5, 1e5, 1e5)))
    lights = (parts.PointLight((0.1, 0.2, 3.0), (1.0, 1.0, 1.0)), parts.DirectionalLight((0.0, 0.0, -1.0), white))
    sky = parts.Environment(np.abs(rng.normal(size=(8, 16, 3))).astype(np.float32) ** 4)
    return parts.Scene(
        camera(64, 64, origin=(0.01, 0.003, 4.0)), materials, tuple(meshes), tuple(spheres), lights, sky, max_depth=8
    )


def trace(opencl: Any, scene: Any, sampler: str, paths: int) -> None:
    renderer = opencl.OpenCLRenderer(scene, sampler)
    step = min(paths, 10_000_000)
    bright = 0.0
    for number in range(paths // step):
        rng = np.random.default_rng(number)
        batch = SimpleNamespace(
            positions=rng.random((step, 2), np.float32) * 64,
            scramble=rng.integers(0, 1 << 32, step, np.uint32),
            index=rng.integers(0, 1 << 32, step, np.uint32),
        )
        radiance = renderer(batch)
        assert np.isfinite(radiance).all(), np.flatnonzero(~np.isfinite(radiance).all(axis=1))[:5]
        assert (radiance >= 0.0).all()
        bright += float(radiance.mean(dtype=np.float64))
        print(f"{(number + 1) * step:.2g} paths", flush=True)  # seen with `pytest -s`
    assert bright > 0.0


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_some_paths(opencl: Any, scene: Any, sampler: str) -> None:
    trace(opencl, scene, sampler, QUICK)


@pytest.mark.long
def test_very_many_paths(opencl: Any, scene: Any) -> None:
    trace(opencl, scene, "sobol", LONG)
