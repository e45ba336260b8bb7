"""Options of POV-Ray that users give: switches, `NAME=VALUE` and INI files, as far as they concern the scene."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Options", "read"]

_PASSED = re.compile(
    r"[+-](K[-+.\d].*|MV[\d.]+|Q\d+|MB\d*|BM\d|UR|UL|UV|SU)"
    r"|(Declare|Clock|Version|Quality|Bounding|Bounding_Method|Bounding_Threshold|BSP_\w+|Split_Unions|Remove_Bounds"
    r"|Vista_Buffer|Light_Buffer)\s*=.*",
    re.IGNORECASE,
)
_WHOLE = ("a whole number from 0", r"\d{1,9}")
_NUMBER = ("a number", r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?")
# Of animations: the switch, its long name and what its value looks like.
_FRAMES = {
    "KFI": ("Initial_Frame", _WHOLE),
    "KFF": ("Final_Frame", _WHOLE),
    "KI": ("Initial_Clock", _NUMBER),
    "KF": ("Final_Clock", _NUMBER),
    "SF": ("Subset_Start_Frame", _WHOLE),
    "EF": ("Subset_End_Frame", _WHOLE),
    "KC": ("Cyclic_Animation", ("on or off", r"on|off|yes|no|true|false|1|0|")),
}
_MOST_FILES = 1000
_HERE = (
    "what can be given is Declare=NAME=VALUE, Library_Path=FOLDER or +LFOLDER, Width, Height, Clock or +K, a frame of "
    "an animation (Initial_Frame, Final_Frame, Initial_Clock, Final_Clock, Cyclic_Animation, Subset_Start_Frame, or "
    "+KFI, +KFF, +KI, +KF, +KC, +SF), Version, Quality or +Q, the options for bounding, and INI files (NAME.ini or "
    "NAME.ini[SECTION])"
)


@dataclass
class Options:
    """What was asked for: the scene's file, its size in pixels, folders with its files, and switches for POV-Ray."""

    scene: Path | None = None
    width: int | None = None
    height: int | None = None
    libraries: tuple[Path, ...] = ()
    switches: tuple[str, ...] = ()
    frames: dict[str, str] = field(default_factory=dict)  # of an animation: values by the names of their switches


def read(options: Sequence[str]) -> Options:
    """The options together; later ones go before earlier ones.

    Of an INI file what concerns output, display, anti-aliasing and threads is left out, for that is ours; its relative
    paths are taken from where it is if they exist there, else from the working folder. Of an animation one frame is
    chosen (`Subset_Start_Frame` or `+SF`); POV-Ray then has its number and clock.

    Raises ValueError for an option that is unknown or ours, or malformed, and for an animation of which no single frame
    is chosen; FileNotFoundError for an INI file or folder that is missing.
    """
    if isinstance(options, str):
        raise TypeError(f"options are a sequence of strings such as ['Declare=N=3'], not the string {options!r}")
    result = Options()
    for option in options:
        before, result.frames = result.frames, {}
        name, section = _ini(option)
        if name is None:
            if not _take(result, option, Path()):
                raise ValueError(f"{option!r} is no option of POV-Ray that can be given here; {_HERE}")
        else:
            for line in _lines(Path(name), section):
                _take(result, line, Path(name).parent)
        if "SF" in result.frames:
            before.pop("EF", None)  # the end of what was chosen before
        result.frames = before | result.frames
    result.switches += _one_frame(result.frames)
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
    elif frame := _frame(option):
        name, value = frame
        result.frames[name] = value
    elif _PASSED.fullmatch(option):
        option = re.sub(r"\s*=\s*", "=", option)
        if re.search(r"\s", option) or not option.isascii():
            raise ValueError(f"POV-Ray takes no spaces and no letters beyond ASCII in an option: {option!r}")
        result.switches += (option,)
    else:
        return False
    return True


def _frame(option: str) -> tuple[str, str] | None:
    """The switch and the value of an option for animations, or None. Raises ValueError for a value that is none."""
    for switch, (name, (expected, pattern)) in _FRAMES.items():
        match = re.fullmatch(rf"(?:{name}\s*=|[+-]{switch})(.*)", option, re.IGNORECASE)
        if match is None:
            continue
        value = match[1].strip().strip("\"'").strip()
        if not re.fullmatch(pattern, value, re.IGNORECASE):
            raise ValueError(f"{option!r}: expected {expected} ({name} or +{switch})")
        on = option[0] != "-" and value.lower() not in ("off", "no", "false", "0")
        return switch, value if switch != "KC" else ("+" if on else "-")
    return None


def _one_frame(frames: dict[str, str]) -> tuple[str, ...]:
    """The switches for one frame of an animation; none where there is no animation."""
    first, last = int(frames.get("KFI", 1)), int(frames.get("KFF", 0))
    chosen = int(frames.get("SF", first if first == last else -1))
    if last == 0:
        if "SF" in frames:
            raise ValueError(f"frame {chosen} of no animation: give its last frame, too (Final_Frame=N or +KFFN)")
        return ()
    if chosen < 0 or int(frames.get("EF", chosen)) != chosen:
        raise ValueError(
            f"the options are for an animation of frames {first} to {last}, and one is rendered at a time: choose it "
            f"by Subset_Start_Frame={first} or +SF{first}"
        )
    if not first <= chosen <= last:
        raise ValueError(f"frame {chosen} is not one of the animation's, {first} to {last}")
    clocks = tuple(f"+{switch}{frames[switch]}" for switch in ("KI", "KF") if switch in frames)
    cyclic = (f"{frames['KC']}KC",) if "KC" in frames else ()
    return (f"+KFI{first}", f"+KFF{last}", *clocks, *cyclic, f"+SF{chosen}", f"+EF{chosen}")


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
