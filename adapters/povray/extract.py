"""The camera of a scene, as POV-Ray itself evaluates it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from .camera import Camera
from .camera_log import LOG, with_log
from .camera_rules import camera_of
from .program import Result, private_folder, read_text
from .sdl import changed
from .source import Source

__all__ = ["extracting"]

_END = "pmc: the scene is read\n"  # no line of the log that names a variable ends so
# At the end of the scene, of which nothing is rendered.
_STOP = (
    f'\n#version 3.7; #fopen pmc_file "{LOG}" append #write(pmc_file,"{_END.strip()}\\n") #fclose pmc_file '
    '#error "done"\n'
)


@contextlib.contextmanager
def extracting(source: Source, width: int, height: int) -> Iterator[Callable[[], Camera]]:
    """POV-Ray under way to find the camera that an image of `width` by `height` pixels of the scene has.

    It reads a copy of the scene and of the files that it includes, in which the camera statements write down what they
    say; it renders nothing. The function that is given waits for it and returns the camera.

    It raises ValueError for a scene that does not parse, with POV-Ray's message; for one with no camera, with a camera
    of a kind that only POV-Ray itself can use or with one that cannot be followed: then the user has to give it.
    TimeoutError for one that takes too long.
    """
    with private_folder() as place, _reading(changed(source, with_log, place), width, height) as read:
        yield lambda: _camera(source, width, height, *read())


def _camera(source: Source, width: int, height: int, result: Result, log: str) -> Camera:
    if not log.endswith(_END):
        # The fault may lie in our changes: the scene as it is tells.
        with _reading(source, width, height) as read:
            plain, end = read()
        if end.endswith(_END):
            raise ValueError(
                f"the camera of {source.file} is written in a way that cannot be followed "
                f"({result.error.rstrip('.')}); give its location, right, up and direction"
            )
        plain.check(str(source.file))
        raise ValueError(f"POV-Ray did not read {source.file} to its end; is an #if or a comment left open?")
    return camera_of(log, str(source.file))


@contextlib.contextmanager
def _reading(source: Source, width: int, height: int) -> Iterator[Callable[[], tuple[Result, str]]]:
    """POV-Ray that reads the scene for an image of that size; how it ends, and what the scene has written down."""
    with private_folder() as folder, contextlib.ExitStack() as stack:
        log = folder / LOG

        def read() -> tuple[Result, str]:
            result = process.wait(source.timeout, lambda: _ends(log))
            return result, read_text(log) if log.is_file() else ""

        process = source.start(folder, (f"+W{width}", f"+H{height}"), _STOP)
        stack.callback(process.kill)
        yield read


def _ends(log: Path) -> bool:
    """Whether the scene has been read to its end."""
    try:
        with log.open("rb") as file:
            file.seek(-min(log.stat().st_size, len(_END)), os.SEEK_END)
            return file.read() == _END.encode()
    except FileNotFoundError:
        return False
