"""The scene that a peer is given: plain values and arrays, which any Python reads."""

from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

RINGS = 256
"""Rings of triangles that stand for a sphere, each of twice as many segments."""

RGB = tuple[float, float, float]


class Shape(TypedDict):
    """Triangles of one material.

    ``vertices`` (v, 3) float32; ``triangles`` (t, 3) int32, counter-clockwise from the front; ``normals`` (v, 3) for
    shading, or None for flat ones. ``kind`` is "diffuse", with the reflectance ``color``, or "dielectric", with the
    index of refraction ``eta`` of its inside over its outside. A diffuse surface is black from behind unless
    ``two_sided``. ``radiance`` is what the front emits, or None.
    """

    name: str
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    kind: str
    color: RGB
    eta: float
    two_sided: bool
    radiance: RGB | None


class Description(TypedDict):
    """A scene as every peer can render it.

    World space is right-handed; radiance is linear Rec. 709 RGB. ``origin`` (3,); ``axes`` (3, 3), rows the unit
    vectors of the image's x (right), its y (down) and the view; ``window`` is (left, right, top, bottom) of the image
    on the plane at distance 1 along the view. ``max_depth`` is the longest path in segments.
    """

    width: int
    height: int
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]
    window: tuple[float, float, float, float]
    shapes: list[Shape]
    max_depth: int


def describe(scene: Any) -> Description:
    """The description of a scene of the OpenCL tracer (its ``Scene``), which must limit the length of paths.

    Spheres become triangles with the sphere's own normals. Raises ValueError for what the peers are not told of:
    textures, vertex colours, materials that are neither diffuse nor smooth dielectrics, lights without area, lenses.
    """
    camera = scene.camera
    left, right, top, bottom = camera.window
    for found, what in (
        (scene.lights, "point or directional lights"),
        (scene.environment is not None, "light from infinity"),
        (camera.aperture_radius > 0.0, "a lens"),
        (not np.isclose((right - left) * camera.height, (bottom - top) * camera.width, rtol=1e-4), "oblong pixels"),
        (scene.textures, "textures"),
        (scene.max_depth < 1, "paths of any length (max_depth)"),
        (scene.hide_emitters, "hidden emitters"),
        (dict(scene.filter) != {"filter": "box", "filter_radius": 0.5}, "a pixel filter other than a box of one pixel"),
    ):
        if found:
            raise ValueError(f"the scene has {what}, which the peers are not told of; try 'cornell-box'.")
    parts = [(mesh, *_triangles(mesh)) for mesh in scene.meshes] + [(ball, *_sphere(ball)) for ball in scene.spheres]
    return Description(
        width=camera.width,
        height=camera.height,
        origin=np.asarray(camera.origin, dtype=np.float64),
        axes=np.asarray(camera.axes, dtype=np.float64),
        window=camera.window,
        shapes=[_shape(f"shape-{i}", scene.materials[part[0].material], *part) for i, part in enumerate(parts)],
        max_depth=scene.max_depth,
    )


_Arrays = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32] | None]


def _triangles(mesh: Any) -> _Arrays:
    if mesh.emits_both_sides or mesh.colors is not None:
        raise ValueError(f"{mesh.name} emits on both sides or has vertex colours, which the peers are not told of.")
    return mesh.vertices, mesh.triangles.astype(np.int32), mesh.normals


def _sphere(ball: Any) -> _Arrays:
    theta, phi = np.linspace(0.0, np.pi, RINGS + 1)[:, None], np.arange(2 * RINGS) * (np.pi / RINGS)
    directions = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi))
    normals = np.stack(directions, axis=-1).reshape(-1, 3)
    at = np.arange(len(normals), dtype=np.int32).reshape(RINGS + 1, 2 * RINGS)
    beside = np.roll(at, -1, axis=1)
    # At a pole a ring is a point, and one of each pair of triangles has no area.
    lower = np.stack([at[:-1], beside[1:], at[1:]], axis=-1)[:-1].reshape(-1, 3)
    upper = np.stack([at[:-1], beside[:-1], beside[1:]], axis=-1)[1:].reshape(-1, 3)
    triangles = np.concatenate([lower, upper])
    vertices = np.asarray(ball.center) + ball.radius * normals
    if ball.flipped:
        triangles, normals = np.ascontiguousarray(triangles[:, ::-1]), -normals
    return vertices.astype(np.float32), triangles, normals.astype(np.float32)


def _shape(name: str, material: Any, part: Any, vertices: Any, triangles: Any, normals: Any) -> Shape:
    plain = material.specular_reflectance == material.specular_transmittance == (1.0, 1.0, 1.0)
    if material.kind not in ("diffuse", "dielectric") or material.cut_out or not plain:
        raise ValueError(
            f"{part.name} is of a material ({material.kind}) that the peers are not told of; they are told of "
            "'diffuse' and of 'dielectric' without colour."
        )
    return Shape(
        name=name,
        vertices=vertices,
        triangles=triangles,
        normals=normals,
        kind=material.kind,
        color=material.color,
        eta=material.eta,
        two_sided=material.two_sided,
        radiance=part.radiance,
    )
