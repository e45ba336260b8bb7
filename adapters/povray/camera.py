"""`Camera`: what POV-Ray's cameras see, as rays in double precision.

The vectors and formulas are those of the manual of POV-Ray 3.7 (section Camera); what the manual leaves open (lengths,
the aspect of "omnimax", the disc of the focal blur) was measured with POV-Ray, and the tests measure it again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "Camera"]

KINDS = (
    "perspective",
    "orthographic",
    "fisheye",
    "ultra_wide_angle",
    "omnimax",
    "panoramic",
    "spherical",
    "cylinder",
)
_ANGLES = {"fisheye": 90.0, "ultra_wide_angle": 90.0, "spherical": 360.0, "cylinder": 90.0}  # degrees, where none given
# The angle from the axis is an odd polynomial of the distance from the centre.
_OMNIMAX = (1.411269, -0.09439, 0.25674)
_OMNIMAX_ASPECT = 1.283458  # of the screen; wider images show nothing at their sides

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera as POV-Ray has it in the end: after `angle`, `look_at`, `sky` and all transformations.

    Attributes
    ----------
    kind
        One of `KINDS`, POV-Ray's words.
    location, right, up, direction
        Shape (3,), float64, in the scene's units. Their lengths matter: `right` spans the image's width at the
        distance of the length of `direction` for "perspective", and so on as in the manual.
    angle
        Degrees from the left to the right edge, for "fisheye" (across the circle), "ultra_wide_angle", "spherical" and
        "cylinder"; None for POV-Ray's default.
    vertical_angle
        Degrees from the upper to the lower edge, for "spherical"; None for half of `angle`.
    cylinder
        1 to 4, for "cylinder".
    aperture
        As in SDL: the lens is a disc of radius aperture / 4, in the scene's units; 0 for a pinhole.
    focal_distance
        Of what is sharp, along `direction`, in the scene's units.

    Raises ValueError for what is no camera: an unknown kind, vectors that are not three finite numbers or span no
    image, an angle or a lens out of range.
    """

    kind: str
    location: Array
    right: Array
    up: Array
    direction: Array
    angle: float | None = None
    vertical_angle: float | None = None
    cylinder: int = 1
    aperture: float = 0.0
    focal_distance: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"a camera's kind is one of {', '.join(KINDS)}, not {self.kind!r}")
        for name in ("location", "right", "up", "direction"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        if np.linalg.matrix_rank(self._units) < 3:
            raise ValueError(
                "a camera's right, up and direction must point three different ways, not "
                f"{self.right.tolist()}, {self.up.tolist()} and {self.direction.tolist()}"
            )
        for name in ("angle", "vertical_angle"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"a camera's {name} is a positive number of degrees, not {value!r}")
        if self.kind == "cylinder" and self.cylinder not in (1, 2, 3, 4):
            raise ValueError(f"a cylinder camera's type is 1, 2, 3 or 4, not {self.cylinder!r}")
        if self.aperture and self._spread:
            raise ValueError(
                f"a camera of the kind {self.kind} has no focal blur: POV-Ray then lets all rays leave its one lens "
                "and shows a point; leave out the aperture"
            )
        if not (np.isfinite(self.aperture) and self.aperture >= 0):
            raise ValueError(f"a camera's aperture is 0 or a positive length, not {self.aperture!r}")
        if self.aperture and not (np.isfinite(self.focal_distance) and self.focal_distance > 0):
            raise ValueError(f"a camera's focal distance is a positive length, not {self.focal_distance!r}")

    @property
    def has_lens(self) -> bool:
        """Whether a ray depends on a point of the lens."""
        return self.aperture > 0

    @property
    def statement(self) -> str:
        """The `camera` statement, in SDL. Raises ValueError for a lens, whose number of samples it does not know."""
        if self.has_lens:
            raise ValueError(
                "a camera given with an aperture is for the sampler alone: POV-Ray's own focal blur needs blur_samples "
                "in the scene's camera"
            )
        kind = f"cylinder {self.cylinder}" if self.kind == "cylinder" else self.kind
        angles = [angle for angle in (self.angle, self.vertical_angle) if angle is not None]
        if angles and self.kind in _ANGLES:
            kind += " angle " + " ".join(f"{angle:.17g}" for angle in angles)
        vectors = (
            f"{name} <{', '.join(f'{x:.17g}' for x in getattr(self, name))}>"
            for name in ("location", "right", "up", "direction")
        )
        return f"\ncamera {{ {kind} {' '.join(vectors)} }}\n"

    @property
    def _spread(self) -> bool:
        """Whether rays begin in different places."""
        return self.kind == "orthographic" or (self.kind == "cylinder" and self.cylinder > 2)

    @property
    def _units(self) -> Array:
        """Rows right, up and direction, each of length 1 (0 if it is 0)."""
        rows = np.stack([self.right, self.up, self.direction])
        lengths = np.linalg.norm(rows, axis=1, keepdims=True)
        units: Array = rows / np.where(lengths > 0, lengths, 1)
        return units

    @property
    def _stretch(self) -> float:
        """What the frame's third row is, in lengths of `direction`.

        For "perspective" such that a normal in the frame has a first coordinate of at most 1/4: just below a power of
        two, 32-bit floats are most precise relative to their size, and errors of positions are largest at the edge.
        """
        if self.kind != "perspective":
            return 1.0
        return float(2 * (self.right @ self.right) / (self.direction @ self.direction))

    @property
    def frame(self) -> Array:
        """(3, 3): its rows are the vectors in which `local_rays` counts."""
        if self.kind in ("perspective", "orthographic", "panoramic"):
            return np.stack([self.right, self.up, self.direction * self._stretch])
        if self.kind == "spherical":
            _, up, ahead = self._units
            up = up - (up @ ahead) * ahead
            up /= np.linalg.norm(up)
            return np.stack([np.cross(up, ahead), up, ahead])
        return self._units

    def sees(self, width: int, height: int, positions: NDArray[Any]) -> NDArray[np.bool_]:
        """Which positions have a ray, shape (n,): "fisheye" and "omnimax" show nothing, black, outside a round area.

        positions: (n, 2), pixels from the upper left corner of an image of `width` by `height` pixels.
        """
        x, y = _image_plane(width, height, positions)
        if self.kind == "fisheye":
            inside: NDArray[np.bool_] = self._fisheye(x, y)[2] <= 1
            return inside
        if self.kind == "omnimax":
            x, y = self._omnimax(x, y)
            r = np.hypot(x, y)
            rays = _polar(x, y, r, _odd(r))
            seen: NDArray[np.bool_] = (r <= 1) & (rays[:, 1] + rays[:, 2] >= 0)
            return seen
        return np.ones(len(x), bool)

    def local_rays(
        self, width: int, height: int, positions: NDArray[Any], lens: NDArray[Any] | None = None
    ) -> tuple[Array | None, Array]:
        """Origins relative to `location` and directions, as multiples of the rows of `frame`.

        Both of shape (n, 3), float64; directions are of no particular length, origins None if all are 0. On a lens,
        origins are multiples of a power of two, 2^-18 to 2^-19 of its radius, so that 32-bit floats hold them.
        positions: see `sees`; positions that it denies get some ray. lens: (n, 2) in [0, 1), without which the ray goes
        through the lens's centre.
        """
        x, y = _image_plane(width, height, positions)
        origins, directions = self._pinhole(x, y)
        if not self.has_lens or lens is None:
            return origins, directions
        on_lens = self._on_lens(np.asarray(lens, np.float64))
        # The plane in focus is perpendicular to the direction for "perspective"; d reaches it at t d.
        length = np.linalg.norm(self.direction) if self.kind in ("perspective", "panoramic") else 1
        directions = directions * (self.focal_distance / length) - on_lens
        return (on_lens if origins is None else origins + on_lens), directions

    def rays(
        self, width: int, height: int, positions: NDArray[Any], lens: NDArray[Any] | None = None
    ) -> tuple[Array, Array]:
        """Origins and directions of length 1 in the scene, each (n, 3), float64; see `local_rays`."""
        origins, directions = self.local_rays(width, height, positions, lens)
        world = directions @ self.frame
        world /= np.linalg.norm(world, axis=1, keepdims=True)
        if origins is None:
            return np.tile(self.location, (len(world), 1)), world
        return self.location + origins @ self.frame, world

    def _pinhole(self, x: Array, y: Array) -> tuple[Array | None, Array]:
        """`local_rays` through the centre of the lens, for points of the image plane, -0.5 to 0.5."""
        zero, one = np.zeros_like(x), np.ones_like(x)
        if self.kind == "perspective":
            return None, _columns(x, y, one / self._stretch)
        if self.kind == "orthographic":
            return _columns(x, y, zero), _columns(zero, zero, one)
        if self.kind == "panoramic":
            around, above = np.pi * x, np.pi * y
            return None, _columns(np.sin(around) * np.cos(above), np.sin(above), np.cos(around) * np.cos(above))
        right, up = float(np.linalg.norm(self.right)), float(np.linalg.norm(self.up))
        if self.kind == "omnimax":
            x, y = self._omnimax(x, y)
            r = np.hypot(x, y)
            return None, _polar(x, y, r, _odd(r))
        angle = np.radians(_ANGLES[self.kind] if self.angle is None else self.angle)
        if self.kind == "fisheye":
            x, y, r = self._fisheye(x, y)
            return None, _polar(x, y, r, r * angle / 2)
        if self.kind == "spherical":
            vertical = angle / 2 if self.vertical_angle is None else np.radians(self.vertical_angle)
            # Turned about right, then about up, the same way for right vectors to the left: the image is turned round.
            axis_right, axis_up, ahead = self._units @ self.frame.T
            return None, _turned(_turned(np.tile(ahead, (len(x), 1)), axis_right, -y * vertical), axis_up, x * angle)
        if self.kind == "ultra_wide_angle":
            around, above = x * angle, y * angle * up / right
            return None, _columns(np.sin(around), np.sin(above), np.cos(around) * np.cos(above))
        if self.cylinder == 1:
            return None, _columns(np.sin(x * angle), y * up, np.cos(x * angle))
        if self.cylinder == 2:
            return None, _columns(x * right, np.sin(y * angle), np.cos(y * angle))
        if self.cylinder == 3:
            return _columns(zero, y * up, zero), _columns(np.sin(x * angle), zero, np.cos(x * angle))
        return _columns(x * right, zero, zero), _columns(zero, np.sin(y * angle), np.cos(y * angle))

    def _on_lens(self, lens: Array) -> Array:
        """(n, 3) points of the lens, by Shirley and Chiu's concentric map (Journal of Graphics Tools 2(3), 1997)."""
        a, b = 2 * lens[:, 0] - 1, 2 * lens[:, 1] - 1
        wide = np.abs(a) > np.abs(b)
        radius = np.where(wide, a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            angle = np.where(wide, np.pi / 4 * (b / a), np.pi / 2 - np.pi / 4 * (a / b))
        angle = np.where(radius == 0, 0, angle)
        radius = radius * self.aperture / 4
        lengths = np.linalg.norm(self.frame, axis=1)
        points = _columns(radius * np.cos(angle) / lengths[0], radius * np.sin(angle) / lengths[1], 0 * radius)
        step = 2.0 ** (np.ceil(np.log2(self.aperture / 4 / lengths[:2].min())) - 18)
        rounded: Array = np.rint(points / step) * step
        return rounded

    def _fisheye(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """The plane's points and their distance in radii of the circle."""
        x, y = 2 * x * float(np.linalg.norm(self.right)), 2 * y * float(np.linalg.norm(self.up))
        return x, y, np.hypot(x, y)

    def _omnimax(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The plane's points in radii of the dome: it fills the width, or is as high as the image at the top."""
        aspect = float(np.linalg.norm(self.right)) / float(np.linalg.norm(self.up))
        if aspect <= 1:
            return 2 * x, 2 * y / aspect
        scale = 2 / min(aspect, _OMNIMAX_ASPECT)
        return scale * aspect * x, 1 - scale * (0.5 - y)


def _vector(name: str, given: Any) -> Array:
    try:
        vector = np.array(given, np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"a camera's {name} is three finite numbers, not {given!r}")
    vector.flags.writeable = False
    return vector


def _image_plane(width: int, height: int, positions: NDArray[Any]) -> tuple[Array, Array]:
    """To the right and up from the image's centre, in widths and heights."""
    positions = np.asarray(positions, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise ValueError(f"positions are an array of shape (n, 2), not {positions.shape}")
    return positions[:, 0] / width - 0.5, 0.5 - positions[:, 1] / height


def _columns(x: Array, y: Array, z: Array) -> Array:
    return np.stack([x, y, z], axis=1)


def _odd(r: Array) -> Array:
    """The angle from the axis at distance r from the centre of an "omnimax" image, radians."""
    a, b, c = _OMNIMAX
    angle: Array = r * (a + r * r * (b + r * r * c))
    return angle


def _turned(vectors: Array, axis: Array, angle: Array) -> Array:
    """(n, 3) vectors turned about `axis`, of length 1, by an angle in radians each (Rodrigues' formula)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned: Array = vectors * c + np.cross(axis, vectors) * s + axis * (vectors @ axis)[:, None] * (1 - c)
    return turned


def _polar(x: Array, y: Array, r: Array, angle: Array) -> Array:
    """Unit vectors at `angle` from the axis towards (x, y), whose length is r."""
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(r > 0, np.sin(angle) / r, 0)
    return _columns(x * s, y * s, np.cos(angle))
