"""From what `camera` statements say to the camera that POV-Ray makes of them.

Up to version 3.1 of the language items act one after another; since 3.5 they act in one order, whatever theirs is: the
angle, the size of orthographic images, `look_at`, then all transformations. Both as the manual says, and measured.
"""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .camera import Array, Camera
from .camera_log import TYPES, VECTORS

__all__ = ["camera_of"]

_PARALLEL = 1e-10  # |sky x direction| below which there is no right by them
_SIDES = {"right", "up"}


def _unit(*vector: float) -> Array:
    return np.array(vector, np.float64)


@dataclass
class _State:
    """A camera between two items."""

    kind: str = "perspective"
    location: Array = field(default_factory=lambda: _unit(0, 0, 0))
    right: Array = field(default_factory=lambda: _unit(1.33, 0, 0))
    up: Array = field(default_factory=lambda: _unit(0, 1, 0))
    direction: Array = field(default_factory=lambda: _unit(0, 0, 1))
    sky: Array = field(default_factory=lambda: _unit(0, 1, 0))
    look_at: Array = field(default_factory=lambda: _unit(0, 0, 1))
    angle: float | None = None
    vertical_angle: float | None = None
    cylinder: int = 1
    aperture: float = 0.0
    blurs: bool = False
    focal_point: Array | None = None
    focal_distance: float | None = None
    turns: list[Array] = field(default_factory=list)  # a default's act on it, and again on each camera made from it
    given: set[str] = field(default_factory=set)
    used: bool = False

    def turn(self, points: Array) -> None:
        """points: (4, 3), where the transformation puts the origin and the ends of the axes."""
        matrix = points[1:] - points[0]
        self.location = self.location @ matrix + points[0]
        self.right, self.up, self.direction = (v @ matrix for v in (self.right, self.up, self.direction))

    def widen(self) -> None:
        """Makes the direction as long as the angle asks for."""
        if self.angle and self.kind in ("perspective", "orthographic"):
            length = np.linalg.norm(self.right) / (2 * np.tan(np.radians(self.angle) / 2))
            self.direction = self.direction / np.linalg.norm(self.direction) * length

    def spread(self) -> None:
        """Makes an orthographic image as wide as the perspective one at the point that is looked at."""
        size = np.linalg.norm(self.look_at - self.location) / np.linalg.norm(self.direction)
        if size > 0:
            self.right, self.up = self.right * size, self.up * size

    def look(self) -> None:
        """Turns the camera to `look_at`, its right perpendicular to the sky; lengths and handedness stay."""
        lengths = [np.linalg.norm(v) for v in (self.right, self.up, self.direction)]
        left = not np.cross(self.up, self.direction) @ self.right > 0  # also with up along direction, as POV-Ray has it
        ahead = self.look_at - self.location
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(self.sky, ahead)
        if np.linalg.norm(right) < _PARALLEL:
            right = self.right - (self.right @ ahead) * ahead
        with np.errstate(invalid="ignore"):
            right = right / np.linalg.norm(right)  # NaN if that too is parallel: no camera, which `Camera` refuses
        self.right = right * (-lengths[0] if left else lengths[0])
        self.up = np.cross(ahead, right) * lengths[1]
        self.direction = ahead * lengths[2]

    def focus(self) -> None:
        if self.focal_point is not None:
            self.focal_distance = float(np.linalg.norm(self.focal_point - self.location))

    def camera(self) -> Camera:
        return Camera(
            self.kind,
            self.location,
            self.right,
            self.up,
            self.direction,
            self.angle if self.kind not in ("perspective", "orthographic", "omnimax", "panoramic") else None,
            self.vertical_angle if self.kind == "spherical" else None,
            self.cylinder,
            self.aperture if self.blurs else 0.0,
            1.0 if self.focal_distance is None else self.focal_distance,
        )


def camera_of(log: str, file: str) -> Camera:
    """The camera of the last statement that was executed.

    Raises ValueError for a scene without a camera and for a camera that only POV-Ray itself can use.
    """
    known: dict[str, _State] = {}
    default, last, state, version, target = _State(), None, _State(), 0.0, ""
    for line in log.splitlines():
        verb, _, rest = line.partition(" ")
        if verb == "begin":
            target, _, number = rest.rpartition(" ")
            version = float(number)
            state = copy.deepcopy(default if version >= 3.5 else _State())
            state.given = set()
        elif verb == "item":
            name, _, values = rest.partition(" ")
            if name == "use":
                if values not in known:
                    raise ValueError(
                        f"the camera of {file} uses {values}, which is no camera that could be followed; give the "
                        "camera's location, right, up and direction"
                    )
                state = dataclasses.replace(copy.deepcopy(known[values]), turns=[], given=set(), used=True)
            else:
                numbers = [[float(value) for value in part.split()] for part in values.split("\t")] if values else []
                _item(state, name, numbers, version >= 3.5, file)
        elif verb == "end":
            if version >= 3.5:
                _finish(state)
            if target == "camera":
                last = state
            elif target == "default":
                default = state
            else:
                known[target.partition(" ")[2]] = state
        elif verb == "alias":
            new, _, old = rest.partition(" ")
            if old in known:
                known[new] = known[old]
    if last is None:
        raise ValueError(
            f"{file} has no camera that could be found; add one, or give its location, right, up and direction"
        )
    return last.camera()


def _item(state: _State, name: str, values: list[list[float]], late: bool, file: str) -> None:
    """One item; `late` where it acts at the statement's end."""
    if name in ("mesh_camera", "normal", "bokeh"):
        raise ValueError(
            f"the camera of {file} has {'the type mesh_camera' if name == 'mesh_camera' else f'a {name}'}, which only "
            "POV-Ray itself can follow; use another camera, or give its location, right, up and direction"
        )
    state.given.add(name)
    if name in TYPES:
        state.kind = name
        if name == "orthographic" and not late:
            state.spread()
    elif name == "cylinder":
        state.kind, state.cylinder = name, int(values[0][0])
    elif name in VECTORS:
        setattr(state, name, _unit(*values[0]))
        if name == "look_at" and not late:
            state.look()
    elif name == "angle":
        state.angle = values[0][0]
        state.vertical_angle = values[1][0] if len(values) > 1 else None
        if not late:
            state.widen()
    elif name == "blur_samples":
        state.blurs = True
    elif name == "aperture":
        state.aperture = values[0][0]
    elif name == "matrix":
        points: Any = np.array(values)
        if late:
            state.turns.append(points)
        else:
            state.turn(points)
    if not late:
        state.focus()


def _finish(state: _State) -> None:
    """What a statement does at its end; one that begins with another camera is only transformed."""
    if not state.used:
        wide = "angle" in state.given and state.angle
        if wide:
            state.widen()
        if state.kind == "orthographic" and (wide or not state.given & _SIDES):
            state.spread()
        if "look_at" in state.given:
            state.look()
        state.focus()
    for points in state.turns:
        state.turn(points)
