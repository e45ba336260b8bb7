"""A scene as POV-Ray gets it: its text, and what every run of it is given besides."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from . import program

__all__ = ["Source", "image", "of_file"]

_IMAGE = "image.exr"
# EXR, no anti-aliasing, and neither the debug nor the render messages. Warnings stay: without them errors go, too.
_FLAGS = ("+FE", f"+O{_IMAGE}", "-A", "-GD", "-GR", "-GS")


@dataclass(frozen=True)
class Source:
    """A scene's text with the file that it is from, the folders of its includes, switches, and the time a run has.

    files: those of ours that are put beside the text, as "name" -> where it is. renamed: those of them that have a name
    of ours, as that -> the scene's. sandboxed: see `program.Process`.
    """

    file: Path
    text: str
    libraries: tuple[Path, ...]
    switches: tuple[str, ...]
    timeout: float
    files: tuple[tuple[str, Path], ...] = ()
    sandboxed: bool = False
    renamed: tuple[tuple[str, str], ...] = ()

    def start(self, folder: Path, arguments: Sequence[str] = (), more: str = "") -> program.Process:
        """POV-Ray in `folder`, for the text and then `more`; by default it writes the `image`."""
        for name, place in self.files:
            (folder / name).symlink_to(place)
        arguments = (*_FLAGS, *self.switches, *arguments)
        process = program.Process(folder, self.text + more, arguments, self.libraries, self.sandboxed)
        process.names |= {"scene.pov": str(self.file), **dict(self.renamed)}
        return process

    def run(self, folder: Path, arguments: Sequence[str] = (), more: str = "") -> program.Result:
        """`start`, to its end. Raises ValueError if POV-Ray fails, TimeoutError if it takes too long."""
        result = self.start(folder, arguments, more).wait(self.timeout)
        result.check(str(self.file))
        return result


def image(folder: Path) -> Path:
    """The image that POV-Ray makes in `folder`; it adds a frame's number to its name."""
    return next(folder.glob("image*.exr"), folder / _IMAGE)


def of_file(
    file: Path, libraries: Sequence[Path], switches: Sequence[str], timeout: float, sandboxed: bool = False
) -> Source:
    """The scene in a file. Raises FileNotFoundError, or OSError if it cannot be read."""
    if not file.exists():
        raise FileNotFoundError(f"there is no scene file {file}")
    try:
        text = program.read_text(file)
    except OSError as error:
        raise OSError(f"the scene file {file} cannot be read: {error.strerror}") from error
    folders = (file.absolute().parent, *(Path(os.path.abspath(folder)) for folder in libraries))
    return Source(file, text, folders, tuple(switches), timeout, sandboxed=sandboxed)
