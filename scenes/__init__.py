"""The built-in scenes: Mitsuba 3 XML files beside this module, found by name.

Every renderer of the project reads these files. They keep to a subset that all of them render: shapes
`rectangle`, `cube`, `sphere`, `ply` and `obj`; BSDFs `diffuse`, `dielectric`, `roughdielectric`, `conductor`,
`roughconductor`, `plastic`, `twosided` and `mask`, the rough ones with the distribution `ggx`; textures `bitmap` and
`checkerboard`, not on spheres; emitters `area`, `point`, `directional`, `constant` and `envmap`; sensors
`perspective` and `thinlens`. Each file takes the parameters `width`, `height`, `spp` and `max_depth`,
and opens with a comment whose first sentence describes it.

A new scene is a new file: nothing else has to be told about it.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path

from .contents import digest

__all__ = ["describe", "digest", "names", "path"]

_FOLDER = Path(__file__).resolve().parent
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


def names() -> list[str]:
    """The names of the built-in scenes, sorted."""
    return sorted(file.stem for file in _FOLDER.glob("*.xml"))


def path(name: str) -> Path:
    """The XML file of the built-in scene `name`.

    Raises ValueError for a name that is not among `names()`.
    """
    known = names()
    if name not in known:
        near = difflib.get_close_matches(str(name), known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"no built-in scene is called {name!r}; there are {', '.join(known)}{hint}")
    return _FOLDER / f"{name}.xml"


def describe(name: str) -> str:
    """One sentence on the built-in scene `name`: the first of the comment its file opens with.

    Raises ValueError for a name that is not among `names()`.
    """
    comment = _COMMENT.search(path(name).read_text(encoding="utf-8"))
    if comment is None:
        return ""
    sentence, _, _ = " ".join(comment.group(1).split()).partition(". ")
    return sentence.rstrip(".") + "."
