"""What rays hit: against arithmetic in double precision, by both ways to trace; none slips through a closed surface.
Exact but for the rays whose answer depends on rounding, which are counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pyopencl")

TRACE = """
kernel void probe(global const float* rays, PARAMETERS, global float* t, global int* prim, global int* shadow) {
    const int i = get_global_id(0);
    Geometry geometry;
    FILL
    Ray ray;
    ray.o = load3(rays, 2 * i);
    ray.d = load3(rays, 2 * i + 1);
    ray.tmax = INFINITY;
    const Hit hit = nearest(&geometry, &ray);
    t[i] = hit.t;
    prim[i] = hit.prim;
    shadow[i] = occluded(&geometry, &ray);
}
"""
POINTERS = {
    "triangle_packets": ("float8", "triangles"),
    "triangle_order": ("int", "triangle_order"),
    "triangle_bounds": ("float8", "triangle_bounds"),
    "triangle_children": ("int", "triangle_children"),
    "sphere_packets": ("float8", "spheres"),
    "sphere_order": ("int", "sphere_order"),
    "sphere_bounds": ("float8", "sphere_bounds"),
    "sphere_children": ("int", "sphere_children"),
}


@pytest.fixture(scope="module")
def trace(call: Any) -> Any:
    """A function from a scene and rays, (n, 2, 3), to distances, numbers of primitives and whether anything is hit."""

    def run(scene: Any, rays: Any, hierarchy: bool | None = None, **macros: str) -> Any:
        from pmc_sampler.adapters.opencl.tables import tables

        compiled = tables(scene, hierarchy=hierarchy)
        names = [name for name in compiled.arrays if name in POINTERS]
        parameters = ", ".join(f"global const {POINTERS[name][0]}* a{k}" for k, name in enumerate(names))
        fill = " ".join(f"geometry.{POINTERS[name][1]} = a{k};" for k, name in enumerate(names))
        text = TRACE.replace("PARAMETERS", parameters).replace("FILL", fill)
        inputs = [np.ascontiguousarray(rays, np.float32), *(compiled.arrays[name] for name in names)]
        outputs = [(np.float32, 1), (np.int32, 1), (np.int32, 1)]
        return call(scene, text, len(rays), inputs, outputs, **{**compiled.macros, **macros})

    return run


def rays_between(starts: Any, ends: Any) -> Any:
    directions = ends - starts
    return np.stack([starts, directions / np.linalg.norm(directions, axis=1, keepdims=True)], axis=1).astype(np.float32)


def distances(rays: Any, corners: Any) -> Any:
    """Of each ray to each triangle, (n, m), infinite where it misses (Moeller and Trumbore 1997, in double precision);
    and how far from the triangle's edges it passes, as a share."""
    o, d = rays[:, None, 0].astype(float), rays[:, None, 1].astype(float)
    v0, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d, e2)
    inverse = 1.0 / np.einsum("nmk,mk->nm", p, e1)
    s = o - v0
    u = np.einsum("nmk,nmk->nm", s, p) * inverse
    q = np.cross(s, np.broadcast_to(e1, s.shape))
    v = np.einsum("nmk,nmk->nm", np.broadcast_to(d, q.shape), q) * inverse
    t = np.einsum("nmk,mk->nm", q, e2) * inverse
    inside = np.minimum(np.minimum(u, v), 1.0 - u - v)
    return np.where((inside >= 0.0) & (t > 0.0), t, np.inf), inside


@pytest.mark.parametrize("hierarchy", [False, True])
@pytest.mark.parametrize("portable", [False, True])
def test_triangles(parts: Any, camera: Any, trace: Any, hierarchy: bool, portable: bool) -> None:
    rng = np.random.default_rng(1)
    count = 200
    vertices = (rng.normal(size=(count, 1, 3)) + 0.4 * rng.normal(size=(count, 3, 3))).astype(np.float32)
    faces = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
    scene = parts.Scene(camera(), (parts.Material("diffuse"),), (parts.Mesh(vertices.reshape(-1, 3), faces, 0),))
    rays = rays_between(rng.normal(size=(5000, 3)) * 2, rng.normal(size=(5000, 3)))
    rays[:300, 1] = np.eye(3, dtype=np.float32)[rng.integers(0, 3, 300)] * rng.choice([-1.0, 1.0], (300, 1))
    t, prim, shadow = trace(scene, rays, hierarchy, **({"PORTABLE": "1"} if portable else {}))
    expected, inside = distances(rays, vertices.astype(float))
    best = expected.min(axis=1)
    clear = np.abs(inside).min(axis=1) > 1e-5  # passes no triangle's edge within rounding
    assert clear.mean() > 0.97
    hit = np.isfinite(best)
    assert 0.3 < hit.mean() < 0.9
    assert ((prim >= 0) == hit)[clear].all()
    assert ((shadow != 0) == hit)[clear].all()
    assert (prim == expected.argmin(axis=1))[clear & hit].mean() > 0.999
    np.testing.assert_allclose(t[clear & hit], best[clear & hit], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("hierarchy", [False, True])
def test_spheres(parts: Any, camera: Any, trace: Any, hierarchy: bool) -> None:
    rng = np.random.default_rng(2)
    balls = [(*rng.normal(size=3), 0.05 + 0.4 * rng.random()) for _ in range(90)]
    scene = parts.Scene(
        camera(), (parts.Material("diffuse"),), spheres=tuple(parts.Sphere(ball[:3], ball[3], 0) for ball in balls)
    )
    rays = rays_between(rng.normal(size=(5000, 3)) * 2, rng.normal(size=(5000, 3)))
    t, prim, shadow = trace(scene, rays, hierarchy)
    o, d = rays[:, None, 0].astype(float), rays[:, None, 1].astype(float)
    centers, radii = np.array(balls, np.float32).astype(float)[:, :3], np.array(balls, np.float32).astype(float)[:, 3]
    b = np.einsum("nmk,nmk->nm", centers - o, np.broadcast_to(d, (5000, 90, 3)))
    rest = radii**2 - (np.square(centers - o).sum(axis=2) - b**2)
    root = np.sqrt(np.maximum(rest, 0.0))
    each = np.where(rest < 0, np.inf, np.where(b - root > 0, b - root, np.where(b + root > 0, b + root, np.inf)))
    best = each.min(axis=1)
    clear = (np.abs(rest) > 1e-5).all(axis=1)
    assert clear.mean() > 0.97
    hit = np.isfinite(best)
    assert ((prim >= 0) == hit)[clear].all()
    assert ((shadow != 0) == hit)[clear].all()
    assert (prim == each.argmin(axis=1))[clear & hit].mean() > 0.999
    np.testing.assert_allclose(t[clear & hit], best[clear & hit], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("offset", [0.0, 1e3])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e6])
@pytest.mark.parametrize("hierarchy", [False, True])
def test_no_ray_slips_through_a_closed_surface(
    parts: Any, camera: Any, trace: Any, hierarchy: bool, size: float, offset: float
) -> None:
    """Rays from inside a ball of triangles at its edges and corners, and along the axes. No exception is allowed."""
    n = 24
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n, endpoint=False), np.linspace(0, np.pi, n + 1)[1:-1])
    ring = np.stack([np.sin(v) * np.cos(u), np.cos(v), np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    points = np.concatenate([[[0, 1, 0]], ring, [[0, -1, 0]]])
    faces = []
    for j in range(n):
        k, last = (j + 1) % n, len(points) - 1
        faces += [(0, 1 + j, 1 + k), (last, last - n + k, last - n + j)]
        for i in range(n - 2):
            a, b, c, d = (1 + i * n + j, 1 + i * n + k, 1 + (i + 1) * n + j, 1 + (i + 1) * n + k)
            faces += [(a, c, b), (b, c, d)]
    vertices = ((points + offset) * size).astype(np.float32)
    mesh = parts.Mesh(vertices, np.array(faces, np.uint32), 0)
    scene = parts.Scene(camera(), (parts.Material("diffuse"),), (mesh,))
    rng = np.random.default_rng(3)
    starts = (rng.uniform(-0.4, 0.4, (20000, 3)) + offset) * size
    face = mesh.triangles[rng.integers(0, len(faces), 20000)]
    corner, other = vertices[face[:, 0]].astype(float), vertices[face[:, 1]].astype(float)
    along = rng.random((20000, 1)) * (rng.random((20000, 1)) > 0.3)  # three tenths at the corners themselves
    rays = rays_between(starts, corner + along * (other - corner))
    rays[:3000, 1] = np.eye(3, dtype=np.float32)[rng.integers(0, 3, 3000)] * rng.choice([-1.0, 1.0], (3000, 1))
    _, prim, shadow = trace(scene, rays, hierarchy)
    assert (prim >= 0).all()
    assert shadow.all()
