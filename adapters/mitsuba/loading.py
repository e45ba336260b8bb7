"""From what a caller names (a scene, its sensor, an integrator) to Mitsuba's objects, with a sentence for
what will not do."""

from __future__ import annotations

import contextlib
import inspect
import os
import re
import threading
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi

from ... import scenes
from ..inputs import check_size

__all__ = [
    "check_film",
    "check_plugins",
    "files_beside",
    "filter_of",
    "guarded",
    "integrator_of",
    "is_scene",
    "load_scene",
    "log_as_warnings",
    "resize",
    "scene_file",
    "sensor_of",
    "takes_mode",
]

_logging = threading.RLock()
_FILTERS = {"BoxFilter": "box", "TentFilter": "tent", "GaussianFilter": "gaussian"}


def is_scene(value: object) -> bool:
    """Whether `value` is a `mi.Scene`, of any variant."""
    kinds = type(value).__mro__
    return any(kind.__name__ == "Scene" and kind.__module__.partition(".")[0] == "mitsuba" for kind in kinds)


def load_scene(scene: Any, variant: str, size: tuple[int, int] | None = None) -> Any:
    """The `mi.Scene` meant by a scene, a scene dictionary, an `.xml` file or the name of a built-in scene.

    With `size`, (width, height) in pixels, films get that size before anything is made of them, so that a
    camera's field of view holds along the axis that the scene names. A `mi.Scene` is returned as it is.

    Raises FileNotFoundError for a missing file, OSError for one that cannot be read, ValueError for an
    unknown name, for content that Mitsuba cannot load and for a size that is none or meets a film with a
    crop, TypeError for anything else.
    """
    if size is not None:
        check_size(size)
    if is_scene(scene):
        return scene
    config = mi.parser.ParserConfig(variant)
    if isinstance(scene, Mapping):
        if scene.get("type") != "scene":
            raise ValueError(f'a scene dictionary has "type": "scene"; this one has {scene.get("type")!r}')
        what = "the scene dictionary"
        parsed = guarded(what, mi.parser.parse_dict, config, dict(scene))
    else:
        what = str(scene)
        parsed = guarded(what, mi.parser.parse_file, config, str(scene_file(scene)))
    guarded(what, mi.parser.transform_all, config, parsed)
    if size is not None:
        resize(parsed, size)
    with files_beside(scene), log_as_warnings():
        if not isinstance(scene, Mapping):
            check_plugins(what, parsed)
        return guarded(what, mi.parser.instantiate, config, parsed)


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
            has = {0: "no sensor", 1: "one sensor, number 0"}.get(count, f"{count} sensors, 0 to {count - 1}")
            raise ValueError(f"the scene has {has}, so there is no sensor {sensor}")
        sensor = scene.sensors()[sensor]
    film = sensor.film()
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"the sensor's film is a {film.class_name()}, which does not record RGB; use an hdrfilm")
    return sensor


def integrator_of(scene: Any, integrator: Any) -> Any:
    """The integrator meant by None (the scene's own), a plugin's name, a plugin's dictionary or a
    `mi.Integrator`.

    Raises ValueError for one that does not return radiance for a ray, TypeError for what is no integrator.
    """
    if integrator is None:
        integrator = scene.integrator()
        if integrator is None:
            raise ValueError('the scene names no integrator; add one, or pass integrator="path"')
    elif isinstance(integrator, str | Mapping):
        plugin = {"type": integrator} if isinstance(integrator, str) else dict(integrator)
        integrator = guarded(f"the integrator {plugin.get('type')!r}", mi.load_dict, plugin)
    if hasattr(integrator, "pmc_nested"):  # our own plugin stands for the integrator it steers
        integrator = integrator.pmc_nested
    if not isinstance(integrator, mi.Integrator):
        raise TypeError(
            f"an integrator is a plugin's name, a plugin's dictionary or a mi.Integrator of the variant "
            f"{mi.variant()}, not {type(integrator).__name__}"
        )
    if not isinstance(integrator, mi.SamplingIntegrator):
        raise ValueError(
            f"the integrator {integrator.class_name()} does not return radiance for a ray (light tracers splat onto "
            "pixels of their own choice), so that no pixel can be sampled at will; use one that does, such as path"
        )
    return integrator


def takes_mode(integrator: Any) -> bool:
    """Whether `integrator.sample` is that of Mitsuba's differentiable integrators, which takes a mode and
    returns four values."""
    try:
        return "mode" in inspect.signature(integrator.sample).parameters
    except (TypeError, ValueError):  # compiled integrators have no signature to inspect
        return False


def check_film(sensor: Any, size: tuple[int, int]) -> None:
    """Raises ValueError if the sensor's film is not of the size (width, height) that was asked for."""
    film = sensor.film()
    if tuple(film.crop_size()) != tuple(size):
        raise ValueError(
            f"the sensor's film has {_by(film.crop_size())} pixels, not {_by(size)}; a scene that is an "
            "object, or names no film, keeps its size: change the film there"
        )


def filter_of(film: Any) -> dict[str, Any]:
    """The settings of a Config that reproduce a film's reconstruction filter.

    Raises ValueError for a filter with negative lobes, from which no sample can be drawn.
    """
    kernel = film.rfilter()
    name = kernel.class_name()
    if name not in _FILTERS:
        raise ValueError(
            f"the film's reconstruction filter is a {name}, which has negative lobes, and samples are placed "
            "by drawing from the filter; use box, tent or gaussian"
        )
    return {"filter": _FILTERS[name], "filter_radius": float(kernel.radius())}


def scene_file(scene: Any) -> Path:
    """The file meant by a path or a built-in scene's name; it can be read."""
    if not isinstance(scene, str | os.PathLike):
        raise TypeError(
            "a scene is a mi.Scene, a scene dictionary, an .xml file or a built-in scene's name, "
            f"not {type(scene).__name__}"
        )
    file = Path(scene)
    if str(scene) in scenes.names() or (file.name == str(scene) and not file.suffix):
        return scenes.path(str(scene))
    if file.suffix.lower() != ".xml":
        raise ValueError(
            f"Mitsuba reads scenes from .xml files and {scene} is none; the built-in scenes are "
            f"{', '.join(scenes.names())}"
        )
    if not file.exists():
        raise FileNotFoundError(f"there is no scene file {scene}")
    try:
        with file.open("rb") as stream:
            stream.read(1)
    except OSError as error:
        raise OSError(f"the scene file {scene} cannot be read: {error.strerror}") from error
    return file


@contextlib.contextmanager
def files_beside(scene: Any) -> Iterator[None]:
    """Lets a scene file name meshes and textures relative to where it is, as `mi.load_file` does."""
    before = mi.file_resolver()
    if not isinstance(scene, Mapping):
        resolver = mi.FileResolver(before)
        resolver.prepend(str(scene_file(scene).parent))
        mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def check_plugins(what: str, parsed: Any) -> None:
    """Raises ValueError where a parsed scene file names a plugin that is not Mitsuba's own.

    Mitsuba looks for the library of a plugin beside the scene and in the working folder, too, and loads it: a scene
    could so run code. Plugins that Python registered have no library, and are let pass.
    """
    own = Path(mi.__file__).resolve().parent
    for node in parsed.nodes:
        name = str(node.props.plugin_name())
        library = Path(str(mi.file_resolver().resolve(f"plugins/{name}.so"))).resolve()
        if not re.fullmatch(r"\w*", name, re.ASCII) or (library.is_file() and own not in library.parents):
            where = mi.parser.file_location(parsed, node)
            raise ValueError(
                f"Mitsuba cannot load {what}: {name!r} at {where} is no plugin of Mitsuba's own, and a scene file may "
                "bring no code along; give one of Mitsuba's, or register yours in Python"
            )


@contextlib.contextmanager
def log_as_warnings() -> Iterator[None]:
    """Gives what Mitsuba logs inside the block as warnings (UserWarning) at its end.

    Its own appender writes to standard output, which is for results. The log is the process's: one thread at a time.
    """
    said: list[str] = []

    class Kept(mi.Appender):  # type: ignore[misc]
        def append(self, level: Any, text: str) -> None:
            """Called by Mitsuba."""
            said.append(re.sub(r"^.*? (WARN|ERROR)\s+(\[\w+\] )?", "", " ".join(text.split())))

        def log_progress(self, *report: Any) -> None:
            """Called by Mitsuba, and of no use here."""

    with _logging:
        logger = mi.logger()
        before = [logger.appender(i) for i in range(logger.appender_count())]
        logger.clear_appenders()
        logger.add_appender(Kept())
        try:
            yield
        finally:
            logger.clear_appenders()
            for appender in before:
                logger.add_appender(appender)
    for text in said:
        warnings.warn(f"Mitsuba: {text}", stacklevel=4)


def resize(parsed: Any, size: tuple[int, int]) -> None:
    """Gives the films of a parsed scene a size."""
    for node in parsed.nodes:
        if node.type == mi.ObjectType.Film:
            if any(key.startswith("crop_") for key in node.props.keys()):  # noqa: SIM118
                raise ValueError(
                    f"the film has a crop window, which a size of {_by(size)} would undo; drop one of them"
                )
            node.props["width"], node.props["height"] = (int(side) for side in size)


def _by(size: Any) -> str:
    return f"{size[0]}x{size[1]}"


def guarded(what: str, load: Any, *arguments: Any) -> Any:
    """`load(*arguments)`, its failure turned into one sentence."""
    try:
        return load(*arguments)
    except Exception as error:  # Mitsuba raises RuntimeError, ValueError or nanobind's own, by place of failure
        raise ValueError(f"Mitsuba cannot load {what}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Mitsuba's message on one line, without places in its source and a Python plugin's traceback."""
    text = " ".join(str(error).split())
    text = re.sub(r"Traceback \(most recent call last\): .*?(\w+(?:Error|Exception): )", "", text)
    return re.sub(r"\[\w+\.cpp:\d+\] ", "", text)
