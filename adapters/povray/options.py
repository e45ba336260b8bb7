"""Options of POV-Ray that users give: switches, `NAME=VALUE` and INI files, as far as they concern the scene."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Options", "read"]

_PASSED = re.compile(
    r"[+-](K[-+.\d].*|MV[\d.]+|Q\d+|MB\d*|BM\d|UR|UL|UV|SU)"
    r"|(Declare|Clock|Version|Quality|Bounding|Bounding_Method|Bounding_Threshold|BSP_\w+|Split_Unions|Remove_Bounds"
    r"|Vista_Buffer|Light_Buffer)\s*=.*",
    re.IGNORECASE,
)
_MOST_FILES = 1000
_HERE = (
    "what can be given is Declare=NAME=VALUE, Library_Path=FOLDER or +LFOLDER, Width, Height, Clock or +K, Version, "
    "Quality or +Q, the options for bounding, and INI files (NAME.ini or NAME.ini[SECTION])"
)


@dataclass
class Options:
    """What was asked for: the scene's file, its size in pixels, folders with its files, and switches for POV-Ray."""

    scene: Path | None = None
    width: int | None = None
    height: int | None = None
    libraries: tuple[Path, ...] = ()
    switches: tuple[str, ...] = ()


def read(options: Sequence[str]) -> Options:
    """The options together; later ones go before earlier ones.

    Of an INI file what concerns output, display, anti-aliasing, threads and animation is left out, for that is ours;
    its relative paths are taken from where it is if they exist there, else from the working folder.

    Raises ValueError for an option that is unknown or ours, or malformed; FileNotFoundError for an INI file or folder
    that is missing.
    """
    if isinstance(options, str):
        raise TypeError(f"options are a sequence of strings such as ['Declare=N=3'], not the string {options!r}")
    result = Options()
    for option in options:
        name, section = _ini(option)
        if name is None:
            if not _take(result, option, Path()):
                raise ValueError(f"{option!r} is no option of POV-Ray that can be given here; {_HERE}")
            continue
        for line in _lines(Path(name), section):
            _take(result, line, Path(name).parent)
    return result


def _take(result: Options, option: str, folder: Path) -> bool:
    """Adds an option; whether it is one that is taken."""
    if match := re.fullmatch(r"(?:Width\s*=|[+-]W)\s*(\d{1,6})", option, re.IGNORECASE):
        result.width = int(match[1])
    elif match := re.fullmatch(r"(?:Height\s*=|[+-]H)\s*(\d{1,6})", option, re.IGNORECASE):
        result.height = int(match[1])
    elif match := re.fullmatch(r"(?:Library_Path\s*=|[+-]L)\s*(.+)", option, re.IGNORECASE):
        path = _path(match[1], folder)
        if not path.is_dir():
            raise FileNotFoundError(f"there is no folder {path} (from {option!r})")
        result.libraries += (path,)
    elif match := re.fullmatch(r"(?:Input_File_Name\s*=|[+-]I)\s*(.+)", option, re.IGNORECASE):
        path = _path(match[1], folder)
        result.scene = path if path.exists() or path.suffix else path.with_suffix(".pov")
    elif _PASSED.fullmatch(option):
        option = re.sub(r"\s*=\s*", "=", option)
        if re.search(r"\s", option) or not option.isascii():
            raise ValueError(f"POV-Ray takes no spaces and no letters beyond ASCII in an option: {option!r}")
        result.switches += (option,)
    else:
        return False
    return True


def _path(text: str, folder: Path) -> Path:
    path = Path(os.path.expanduser(text.strip().strip("\"'")))  # that of pathlib raises for ~NOBODY
    return folder / path if (folder / path).exists() else path


def _ini(option: str) -> tuple[str | None, str]:
    """The INI file and its section that an option names, or None."""
    match = re.fullmatch(r"(.+\.ini)(?:\[(.*)\])?", option, re.IGNORECASE)
    if match is None or re.match(r"\w+\s*=|[+-]", option):
        return None, ""
    return match[1], match[2] or ""


def _lines(file: Path, section: str, depth: int = 0, read: Iterator[int] | None = None) -> Iterator[str]:
    """The options in an INI file: those before its first section, and those of `section`.

    read: counts the files, of which few that include each other many times would make many.
    """
    read = itertools.count(1) if read is None else read
    if depth > 10 or next(read) > _MOST_FILES:
        raise ValueError(f"the INI files around {file} include each other without end")
    try:
        text = file.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError as error:
        raise FileNotFoundError(f"the INI file {file} cannot be read: {error.strerror}") from error
    current, seen = "", {""}
    for line in text.splitlines():
        line = re.sub(r'^((?:[^;"]|"[^"]*")*);.*$', r"\1", line).strip()
        if match := re.fullmatch(r"\[(.*)\]", line):
            current = match[1].strip().lower()
            seen.add(current)
        elif line and current in ("", section.lower()):
            if match := re.fullmatch(r"(?:Include_Ini\s*=\s*)?\"?([^=+\-\"][^=\"]*\.ini)\"?", line, re.IGNORECASE):
                yield from _lines(_path(match[1], file.parent), "", depth + 1, read)
            elif line[0] in "+-":
                yield from line.split()
            else:
                yield line
    if section.lower() not in seen:
        raise ValueError(f"the INI file {file} has no section [{section}]")
