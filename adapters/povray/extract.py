"""The camera of a scene, as POV-Ray itself evaluates it."""

from __future__ import annotations

import dataclasses

from .camera import Camera
from .camera_log import LOG, with_log
from .camera_rules import camera_of
from .program import Result, private_folder, read_text
from .sdl import changed
from .source import Source

__all__ = ["extract"]

_END = "done\n"
# At the end of the scene, of which nothing is rendered.
_STOP = f'\n#version 3.7; #fopen pmc_file "{LOG}" append #write(pmc_file,"done\\n") #fclose pmc_file #error "done"\n'


def extract(source: Source, width: int, height: int) -> Camera:
    """The camera that an image of `width` by `height` pixels of the scene has.

    POV-Ray reads a copy of the scene and of the files that it includes, in which the camera statements write down
    what they say; it renders nothing.

    Raises ValueError for a scene that does not parse, with POV-Ray's message; for one with no camera, with a camera of
    a kind that only POV-Ray itself can use or with one that cannot be followed: then the user has to give it.
    TimeoutError for one that takes too long.
    """
    with private_folder() as place:
        logged = changed(source, with_log, place)
        result, log = _read(dataclasses.replace(logged, text=logged.text + _STOP), width, height)
    if not log.endswith(_END):
        # The fault may lie in our changes: the scene as it is tells.
        plain, end = _read(dataclasses.replace(source, text=source.text + _STOP), width, height)
        if end.endswith(_END):
            raise ValueError(
                f"the camera of {source.file} is written in a way that cannot be followed "
                f"({result.error.rstrip('.')}); give its location, right, up and direction"
            )
        plain.check(str(source.file))
        raise ValueError(f"POV-Ray did not read {source.file} to its end; is an #if or a comment left open?")
    return camera_of(log, str(source.file))


def _read(source: Source, width: int, height: int) -> tuple[Result, str]:
    """How POV-Ray ends that reads the scene for an image of that size, and what the scene has written down."""
    with private_folder() as folder:
        result = source.start(folder, (f"+W{width}", f"+H{height}"), root=folder).wait(source.timeout)
        log = folder / LOG
        return result, read_text(log) if log.is_file() else ""
