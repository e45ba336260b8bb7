"""What a scene file says, and the files that it names, as one digest."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

__all__ = ["digest"]

_QUOTED = re.compile(rb'"([^"\r\n]{1,1000})"')
_LARGEST = 2**30  # bytes; of larger files size and time count
_NAMES_OTHERS = {".xml", ".pov", ".inc", ".ini", ".mcr", ".gltf", ".glb"}


def digest(file: str | os.PathLike[str]) -> str:
    """16 hexadecimal digits of a scene file's contents and of those that it names between quotes, and these in their
    turn: meshes and textures of Mitsuba's XML and of glTF, includes of POV-Ray. Names are looked for beside the file
    that has them, so that libraries elsewhere do not count. Raises OSError where the scene cannot be read.
    """
    parts = hashlib.sha256()
    seen: set[Path] = set()
    todo = [Path(file)]
    while todo:
        path = todo.pop(0)
        status = path.stat()
        large = status.st_size > _LARGEST
        contents = f"{status.st_size} {status.st_mtime_ns}".encode() if large else path.read_bytes()
        parts.update(hashlib.sha256(contents).digest())
        seen.add(path.resolve())
        if path.suffix.lower() in _NAMES_OTHERS:
            named = [path.parent / os.fsdecode(name) for name in _QUOTED.findall(contents) if b"\0" not in name]
            todo += [other for other in dict.fromkeys(named) if _is_file(other) and other.resolve() not in seen]
            seen.update(other.resolve() for other in todo)
    return parts.hexdigest()[:16]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # what is no name: too long, say
        return False
