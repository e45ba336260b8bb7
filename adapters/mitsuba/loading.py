"""From what a caller names (a scene, its sensor, an integrator) to Mitsuba's objects, with a sentence for
what will not do."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi

from ... import scenes

__all__ = ["integrator_of", "is_scene", "load_scene", "resize", "sensor_of", "takes_mode"]


def is_scene(value: object) -> bool:
    """Whether `value` is a `mi.Scene`, of any variant."""
    kinds = type(value).__mro__
    return any(kind.__name__ == "Scene" and kind.__module__.partition(".")[0] == "mitsuba" for kind in kinds)


def load_scene(scene: Any) -> Any:
    """The `mi.Scene` meant by a scene, a scene dictionary, an `.xml` file or the name of a built-in scene.

    Raises FileNotFoundError for a missing file, OSError for one that cannot be read, ValueError for an
    unknown name and for content that Mitsuba cannot load, TypeError for anything else.
    """
    if is_scene(scene):
        return scene
    if isinstance(scene, Mapping):
        if scene.get("type") != "scene":
            raise ValueError(f'a scene dictionary has "type": "scene"; this one has {scene.get("type")!r}')
        return _guarded("the scene dictionary", mi.load_dict, dict(scene))
    if not isinstance(scene, str | os.PathLike):
        raise TypeError(
            "a scene is a mi.Scene, a scene dictionary, an .xml file or a built-in scene's name, "
            f"not {type(scene).__name__}"
        )
    name = os.fspath(scene)
    if name in scenes.names() or (Path(name).name == name and not Path(name).suffix):
        return _guarded(name, mi.load_file, str(scenes.path(name)))
    file = Path(name)
    if file.suffix.lower() != ".xml":
        raise ValueError(
            f"Mitsuba reads scenes from .xml files and {name} is none; the built-in scenes are "
            f"{', '.join(scenes.names())}"
        )
    if not file.exists():
        raise FileNotFoundError(f"there is no scene file {name}")
    try:
        with file.open("rb") as stream:
            stream.read(1)
    except OSError as error:
        raise OSError(f"the scene file {name} cannot be read: {error.strerror}") from error
    return _guarded(name, mi.load_file, str(file))


def sensor_of(scene: Any, sensor: Any) -> Any:
    """The sensor with the index `sensor` in `scene`; a `mi.Sensor` is taken as it is.

    Raises ValueError for an index that the scene does not have and for a film that does not record radiance
    as RGB.
    """
    if isinstance(sensor, bool) or not isinstance(sensor, int | mi.Sensor):
        raise TypeError(f"a sensor is the index of one in the scene or a mi.Sensor, not {sensor!r}")
    if isinstance(sensor, int):
        count = len(scene.sensors())
        if not 0 <= sensor < count:
            has = f"{count} sensors, 0 to {count - 1}" if count > 1 else "one sensor, number 0"
            raise ValueError(f"the scene has {has}; there is no sensor {sensor}")
        sensor = scene.sensors()[sensor]
    film = sensor.film()
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(
            f"the sensor's film is a {film.class_name()}, which does not record RGB; use an hdrfilm"
        )
    return sensor


def integrator_of(scene: Any, integrator: Any) -> Any:
    """The integrator meant by None (the scene's own), a plugin's name, a plugin's dictionary or a
    `mi.Integrator`.

    Raises ValueError for one that does not return radiance for a ray.
    """
    if integrator is None:
        integrator = scene.integrator()
        if integrator is None:
            raise ValueError('the scene names no integrator; add one, or pass integrator="path"')
    elif isinstance(integrator, str | Mapping):
        plugin = {"type": integrator} if isinstance(integrator, str) else dict(integrator)
        integrator = _guarded(f"the integrator {plugin.get('type')!r}", mi.load_dict, plugin)
    if hasattr(integrator, "pmc_nested"):  # our own plugin stands for the integrator it steers
        integrator = integrator.pmc_nested
    if not isinstance(integrator, mi.SamplingIntegrator):
        name = integrator.class_name() if isinstance(integrator, mi.Integrator) else type(integrator).__name__
        raise ValueError(
            f"the integrator {name} does not return radiance for a ray (light tracers splat onto pixels of "
            "their own choice), so that no pixel can be sampled at will; use one that does, such as path"
        )
    return integrator


def takes_mode(integrator: Any) -> bool:
    """Whether `integrator.sample` is that of Mitsuba's differentiable integrators, which takes a mode and
    returns four values."""
    try:
        return "mode" in inspect.signature(integrator.sample).parameters
    except (TypeError, ValueError):  # compiled integrators have no signature to inspect
        return False


def resize(sensor: Any, size: tuple[int, int], ours: bool) -> None:
    """Gives the sensor's film the size (width, height) in pixels.

    A scene that the caller made is not changed behind his back: `ours` says that this one was loaded here.
    Raises ValueError for sizes that are none, for a film with a crop, and for a scene of the caller's whose
    film is of another size.
    """
    if len(size) != 2 or any(isinstance(side, bool) or side != int(side) or side < 1 for side in size):
        raise ValueError(f"a size is (width, height) in whole pixels, at least 1 by 1, not {size!r}")
    film = sensor.film()
    if tuple(film.crop_size()) == tuple(size):
        return
    if tuple(film.crop_size()) != tuple(film.size()):
        raise ValueError(
            f"the film is cropped to {_by(film.crop_size())} of {_by(film.size())} pixels; "
            "drop the crop or the size"
        )
    if not ours:
        raise ValueError(
            f"the scene's film has {_by(film.size())} pixels, not {_by(size)}; a scene given as an object "
            "keeps its film, so change that, or hand over the file or dictionary"
        )
    parameters = mi.traverse(sensor)
    parameters["film.size"] = mi.ScalarVector2u(*size)
    parameters["film.crop_size"] = mi.ScalarVector2u(*size)
    parameters.update()


def _by(size: Any) -> str:
    return f"{size[0]}x{size[1]}"


def _guarded(what: str, load: Any, argument: Any) -> Any:
    """`load(argument)`, its failure turned into one sentence."""
    try:
        loaded = load(argument)
    except (
        Exception
    ) as error:  # Mitsuba raises RuntimeError, ValueError or nanobind's own, by place of failure
        reason = re.sub(r"^\[\w+\.cpp:\d+\] ", "", " ".join(str(error).split()))
        raise ValueError(f"Mitsuba cannot load {what}: {reason}") from error
    return loaded
