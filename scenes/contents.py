"""What a scene file says, and the files that it names, as one digest."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

__all__ = ["digest"]

_QUOTED = re.compile(rb'"([^"\r\n]{1,1000})"')
_VALUE = re.compile(rb"=[ \t]*([^\s\"';][^\r\n;]{0,1000})")  # of an INI file, where it has no quotes
_LARGEST = 2**30  # bytes; of larger files size and time count
_NAMES_OTHERS = {".xml", ".pov", ".inc", ".ini", ".mcr", ".gltf", ".glb"}


def digest(file: str | os.PathLike[str]) -> str:
    """16 hexadecimal digits of a scene file's contents and of those that it names, and these in their turn.

    Names stand between quotes, or as values in INI files: meshes and textures of Mitsuba's XML and of glTF, scenes and
    includes of POV-Ray. They are looked for beside the file that has them, so that libraries elsewhere do not count.
    Raises OSError where the scene cannot be read.
    """
    parts = hashlib.sha256()
    found = [Path(file)]
    seen = {found[0].resolve()}
    for path in found:  # which grows meanwhile
        status = path.stat()
        large = status.st_size > _LARGEST
        contents = f"{status.st_size} {status.st_mtime_ns}".encode() if large else path.read_bytes()
        parts.update(hashlib.sha256(contents).digest())
        if path.suffix.lower() not in _NAMES_OTHERS:
            continue
        names = _QUOTED.findall(contents)
        if path.suffix.lower() == ".ini":
            names += [value.strip() for value in _VALUE.findall(contents)]
        for name in dict.fromkeys(names):
            other = path.parent / os.fsdecode(name)
            if os.path.isfile(other) and other.resolve() not in seen:  # of Path.is_file long names are an error
                seen.add(other.resolve())
                found.append(other)
    return parts.hexdigest()[:16]
