"""Makes the meshes of the scene `room` from nothing: `python -m pmc_sampler.scenes.furniture` writes them to `room/`.

Needs trimesh and SciPy (the extra `dev`). Lengths are in metres, y is up, and a thing stands on y = 0 in its middle,
its front towards +z. What is solid is made of closed parts, which may run into each other. Coordinates are rounded
to 10 micrometres, so that the last bits of a machine's sines do not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator
from trimesh import Trimesh, transformations

__all__ = ["FOLDER", "MESHES", "OPEN", "made", "write"]

FOLDER = Path(__file__).resolve().parent / "room"
"""Where the meshes lie that come with the scene."""

_Y_UP = transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
_GOLDEN_ANGLE = 137.508  # degrees, as leaves grow


def curve(points: ArrayLike, along: int) -> NDArray[Any]:
    """A curve through `points` (n, d), sampled (along (n - 1) + 1, d), that does not overshoot (SciPy's PCHIP)."""
    knots = np.asarray(points, float)
    last = len(knots) - 1
    return np.asarray(PchipInterpolator(np.arange(last + 1), knots)(np.linspace(0, last, along * last + 1)))


def turned(profile: ArrayLike, sections: int = 48, along: int = 3) -> Trimesh:
    """The curve through `profile`, (radius, height) up the outside and down inside, turned about the axis y."""
    return trimesh.creation.revolve(curve(profile, along), sections=sections, transform=_Y_UP)


def sheet(points: NDArray[Any], closed: bool = False) -> Trimesh:
    """Triangles over a grid (u, v, 3) of points, u x v outward; `closed` joins the ends of v."""
    nu, nv = points.shape[:2]
    u, v = np.meshgrid(np.arange(nu - 1), np.arange(nv if closed else nv - 1), indexing="ij")
    a, b, c, d = (((u + i) * nv + (v + j) % nv).ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    mesh = Trimesh(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    mesh.update_faces(mesh.nondegenerate_faces())
    return mesh


def cushion(size: ArrayLike, edge: float = 0.3, rows: int = 24) -> Trimesh:
    """A superellipsoid in the middle of the origin (Barr 1981, doi:10.1109/MCG.1981.1673799) that fills the box `size`.

    The smaller `edge`, the more it is like the box; 1 is an ellipsoid.
    """
    u = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[:, None]
    v = np.arange(2 * rows) * (np.pi / rows)

    def power(x: NDArray[Any]) -> NDArray[Any]:
        x = np.where(np.abs(x) < 1e-9, 0.0, x)
        return np.asarray(np.sign(x) * np.abs(x) ** edge)

    across = power(np.cos(u))
    points = np.stack(np.broadcast_arrays(across * power(np.cos(v)), power(np.sin(u)), across * power(np.sin(v))), -1)
    return sheet(0.5 * points * np.asarray(size), closed=True)


def tube(
    path: ArrayLike, radius: ArrayLike, across: ArrayLike = (0, 0, 1), along: int = 8, around: int = 12
) -> Trimesh:
    """A tube about the curve through `path` (n, 3), nowhere parallel to `across`; `radius` may be one a point."""
    knots = np.asarray(path, float)
    middle = curve(knots, along)
    radii = curve(np.broadcast_to(np.asarray(radius, float), len(knots))[:, None], along)
    forward = np.gradient(middle, axis=0)
    right = np.cross(forward, np.asarray(across, float))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(right, forward)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    # The ends shrink to points, which closes them.
    ends = [0, *range(len(middle)), -1]
    middle, right, up, radii = middle[ends], right[ends], up[ends], radii[ends]
    radii[[0, -1]] = 0.0
    angle = np.arange(around)[:, None] * (2 * np.pi / around)
    ring = np.cos(angle) * right[:, None] + np.sin(angle) * up[:, None]
    return sheet(middle[:, None] + radii[:, None] * ring, closed=True)


def placed(
    mesh: Trimesh, at: ArrayLike = (0, 0, 0), turn: float = 0.0, tilt: float = 0.0, lean: float = 0.0
) -> Trimesh:
    """Rolled about z by `lean`, then tilted about x, then turned about y (degrees), then moved."""
    about_z, about_x, about_y = np.radians([lean, tilt, turn])
    matrix = transformations.euler_matrix(about_z, about_x, about_y, "szxy")
    matrix[:3, 3] = at
    return mesh.copy().apply_transform(matrix)


def joined(*meshes: Trimesh) -> Trimesh:
    """All of them in one mesh."""
    return cast(Trimesh, trimesh.util.concatenate(meshes))


def sofa() -> Trimesh:
    """Base, back and feet; on each half a seat and a back cushion; arms."""
    parts = [
        placed(cushion((2.0, 0.2, 0.85), 0.15), (0, 0.23, 0)),
        placed(cushion((2.0, 0.6, 0.2), 0.2), (0, 0.48, -0.36), tilt=-5),
    ]
    for side in (-1, 1):
        parts += [
            placed(cushion((0.18, 0.52, 0.88), 0.25), (1.05 * side, 0.38, 0)),
            placed(cushion((0.96, 0.2, 0.72), 0.3), (0.48 * side, 0.4, 0.07)),
            placed(cushion((0.92, 0.44, 0.2), 0.4), (0.47 * side, 0.68, -0.2), tilt=-12),
        ]
        for z in (-0.33, 0.33):
            parts.append(placed(turned([(0, 0), (0.018, 0), (0.03, 0.16), (0, 0.16)], 16, 2), (0.92 * side, 0, z)))
    return joined(*parts)


def pillow() -> Trimesh:
    """A square pillow on its edge, thin at its seams."""
    mesh = cushion((0.46, 0.46, 0.16), 0.45)
    x, y = mesh.vertices[:, 0] / 0.23, mesh.vertices[:, 1] / 0.23
    mesh.vertices *= np.stack([1 - 0.12 * (1 - y**2), 1 - 0.12 * (1 - x**2), np.ones_like(x)], 1)
    mesh.apply_translation((0, 0.23, 0))
    return mesh


def chair() -> Trimesh:
    """A bent tube for each side, from the front foot back under the seat and up; cross tubes, seat and back."""
    parts = []
    for side in (-0.24, 0.24):
        path = [(0.2, 0.013), (0.22, 0.22), (0.2, 0.41), (0.12, 0.44), (-0.16, 0.43), (-0.22, 0.46), (-0.27, 0.85)]
        parts.append(tube([(side, y, z) for z, y in path], 0.013, across=(1, 0, 0)))
        foot = [(-0.14, 0.42), (-0.24, 0.2), (-0.28, 0.013)]
        parts.append(tube([(side, y, z) for z, y in foot], 0.013, across=(1, 0, 0)))
    for y, z in ((0.43, 0.13), (0.43, -0.15), (0.84, -0.27)):
        parts.append(tube([(-0.24, y, z), (0, y, z - 0.015 * (y > 0.5)), (0.24, y, z)], 0.011, across=(0, 1, 0)))
    return joined(*parts)


def upholstery() -> Trimesh:
    """Seat and back of the chair."""
    return joined(
        placed(cushion((0.46, 0.06, 0.44), 0.35), (0, 0.47, 0.0)),
        placed(cushion((0.44, 0.26, 0.05), 0.35), (0, 0.69, -0.235), tilt=-8),
    )


def table() -> Trimesh:
    """An oval top on four splayed legs."""
    top = turned([(0, 0.385), (0.4, 0.385), (0.46, 0.395), (0.47, 0.405), (0.462, 0.417), (0.45, 0.42), (0, 0.42)], 128)
    top.apply_scale((1.45, 1, 1))
    leg = turned([(0, 0), (0.012, 0), (0.028, 0.38), (0, 0.39)], 24, 3)
    corners = [(x, z) for x in (-1, 1) for z in (-1, 1)]
    return joined(top, *(placed(leg, (0.46 * x, 0.005, 0.27 * z), tilt=-9 * z, lean=9 * x) for x, z in corners))


def vase() -> Trimesh:
    """Outside up, over the rim and down inside."""
    outside = [(0, 0), (0.05, 0), (0.058, 0.008), (0.095, 0.11), (0.06, 0.22), (0.036, 0.27), (0.055, 0.33)]
    inside = [(0.051, 0.331), (0.031, 0.27), (0.052, 0.22), (0.083, 0.11), (0.045, 0.025), (0, 0.02)]
    return turned(outside + inside, 64, 4)


def bowl() -> Trimesh:
    """A shallow bowl on a foot."""
    outside = [(0, 0), (0.06, 0), (0.065, 0.012), (0.12, 0.035), (0.165, 0.085)]
    return turned([*outside, (0.16, 0.087), (0.115, 0.042), (0.06, 0.022), (0, 0.02)], 64)


def apples() -> Trimesh:
    """Five in the bowl, each with a dent and a stalk."""
    flesh = turned(
        [(0, 0.006), (0.014, 0), (0.036, 0.017), (0.041, 0.046), (0.026, 0.069), (0.01, 0.066), (0, 0.058)], 32
    )
    apple = joined(flesh, tube([(0, 0.055, 0), (0.002, 0.075, 0), (0.008, 0.09, 0)], 0.0016, around=6, along=4))
    apple.apply_translation((0, -0.036, 0))
    places = [
        (0.065, 0.066, 0.02),
        (-0.03, 0.064, 0.062),
        (-0.045, 0.064, -0.035),
        (0.03, 0.066, -0.065),
        (0.0, 0.118, 0.0),
    ]
    return joined(*(placed(apple, place, 70 * i, 25 * i - 40) for i, place in enumerate(places)))


def teapot() -> Trimesh:
    """Body, lid and knob in one; spout and handle are tubes."""
    body = [(0, 0), (0.05, 0), (0.055, 0.006), (0.085, 0.055), (0.075, 0.1), (0.045, 0.122)]
    lid = [(0.044, 0.126), (0.02, 0.137), (0.008, 0.142), (0.014, 0.155), (0, 0.163)]
    spout = [(0.06, 0.04, 0), (0.1, 0.055, 0), (0.115, 0.09, 0), (0.145, 0.118, 0)]
    handle = [(-0.062, 0.11, 0), (-0.1, 0.115, 0), (-0.13, 0.085, 0), (-0.115, 0.045, 0), (-0.075, 0.03, 0)]
    return joined(turned(body + lid, 64, 4), tube(spout, [0.022, 0.016, 0.011, 0.008]), tube(handle, 0.007))


def cup() -> Trimesh:
    """A cup with a handle, on its saucer."""
    saucer = [(0, 0), (0.035, 0), (0.07, 0.012), (0.069, 0.015), (0.035, 0.005), (0, 0.005)]
    outside = [(0, 0.006), (0.02, 0.006), (0.022, 0.012), (0.036, 0.03), (0.041, 0.062)]
    inside = [(0.0385, 0.0625), (0.033, 0.031), (0.018, 0.016), (0, 0.015)]
    handle = [(0.037, 0.053, 0), (0.058, 0.054, 0), (0.056, 0.03, 0), (0.034, 0.026, 0)]
    return joined(turned(saucer, 40), turned(outside + inside, 40), tube(handle, 0.0035, along=5, around=8))


def pot() -> Trimesh:
    """A plant's pot, filled to below its rim."""
    outside = [(0, 0), (0.11, 0), (0.12, 0.01), (0.165, 0.28), (0.175, 0.29), (0.175, 0.32)]
    return turned([*outside, (0.155, 0.32), (0.15, 0.28), (0, 0.285)])


def plant() -> Trimesh:
    """Arching leaves, folded along their middle, from one root."""
    s, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(-1, 1, 5), indexing="ij")
    leaves = []
    for i in range(40):
        length, lean = 0.6 + 0.5 * (0.618 * i % 1), 0.15 + 0.9 * (0.382 * i % 1)
        bend = lean * (0.3 + 1.3 * s)
        out, up = (length / 21 * np.cumsum(f(bend), axis=0) for f in (np.sin, np.cos))
        width = 0.05 * np.sin(np.pi * s**0.7) * t
        leaves.append(placed(sheet(np.stack([width, up + 0.35 * np.abs(width), out], -1)), turn=_GOLDEN_ANGLE * i))
    return joined(*leaves)


def curtain() -> Trimesh:
    """Folds that widen towards the hem, 0.9 wide and 2.4 high."""
    x, y = np.meshgrid(np.linspace(-0.45, 0.45, 181), np.linspace(0, 1, 11), indexing="ij")
    fold = (0.025 + 0.03 * (1 - y)) * np.sin(45 * x + 0.7 * np.sin(3 * y) + np.sin(9 * x))
    return sheet(np.stack([x, 2.4 * y, fold], -1))


def lamp_stand() -> Trimesh:
    """Foot and pole of the standing lamp."""
    return turned([(0, 0), (0.15, 0), (0.15, 0.015), (0.03, 0.03), (0.012, 0.06), (0.012, 1.4), (0, 1.4)], 32)


def lamp_shade() -> Trimesh:
    """The shade of the standing lamp, pleated, open above and below."""
    s, angle = np.meshgrid(np.linspace(0, 1, 9), np.arange(160) * (np.pi / 80), indexing="ij")
    radius = (0.24 - 0.1 * s) * (1 + 0.02 * np.cos(40 * angle))
    return sheet(np.stack([radius * np.sin(angle), 1.22 + 0.3 * s, radius * np.cos(angle)], -1), closed=True)


def books(colour: int, colours: int = 3) -> Trimesh:
    """Every third of a row of books 0.9 long; some lean."""
    rng = np.random.Generator(np.random.PCG64(7))
    parts, x = [], -0.45
    for i in range(28):
        thick, high, deep = rng.uniform((0.02, 0.17, 0.13), (0.042, 0.26, 0.18))
        x += thick
        if i % colours == colour:
            leaning = -6.0 if i % 9 == 5 else 0.0
            box = trimesh.creation.box((thick - 0.002, high, deep))
            parts.append(placed(box, (x - 0.5 * thick, 0.5 * high, 0.5 * deep), lean=leaning))
        x += 0.012 * (i % 9 == 5)
    return joined(*parts)


OPEN = ("plant", "curtain", "lamp-shade")
"""Meshes that are sheets, seen from both sides; all others are closed and face outward."""

MESHES: dict[str, Callable[[], Trimesh]] = {
    "sofa": sofa,
    "pillow": pillow,
    "chair": chair,
    "upholstery": upholstery,
    "table": table,
    "vase": vase,
    "bowl": bowl,
    "apples": apples,
    "teapot": teapot,
    "cup": cup,
    "pot": pot,
    "plant": plant,
    "curtain": curtain,
    "lamp-stand": lamp_stand,
    "lamp-shade": lamp_shade,
    **{f"books-{colour}": partial(books, colour) for colour in range(3)},
}


def made(name: str) -> Trimesh:
    """The mesh called `name`, rounded as it is written."""
    mesh = MESHES[name]()
    return Trimesh(np.round(mesh.vertices, 5).astype(np.float32), mesh.faces, process=False)


def write(folder: Path = FOLDER) -> None:
    """Write all meshes into `folder`, which is made if it is not there, as binary PLY files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in MESHES:
        made(name).export(folder / f"{name}.ply", vertex_normal=False)


if __name__ == "__main__":
    write()
