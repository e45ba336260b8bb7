"""SDL as tokens, and changes to a scene's text that reach the files that it includes."""

from __future__ import annotations

import dataclasses
import itertools
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .program import read_text, write_text
from .source import Source

__all__ = ["Token", "changed", "texts", "tokens", "with_size"]

# Comments and white space are left out; `/*` nests and is followed by hand.
_TOKEN = re.compile(
    r"""
    (?P<skip>\s+|//[^\n]*) | (?P<nested>/\*)
    | (?P<string>"(?:\\.|[^"\\])*")
    | (?P<directive>\#[ \t]*[A-Za-z_]\w*)
    | (?P<word>[A-Za-z_]\w*)
    | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)
    | (?P<mark>.)
    """,
    re.VERBOSE | re.DOTALL,
)
_EDGE = re.compile(r"/\*|\*/")
# Where POV-Ray itself has its folders of includes from; Debian's and the one of a build from source.
_SETTINGS = ("/etc/povray/3.7/povray.ini", "/usr/local/etc/povray/3.7/povray.ini", "~/.povray/3.7/povray.ini")


@dataclass(frozen=True)
class Token:
    """A piece of SDL: text[start:end] is `text`.

    kind: "string", "directive" (with `text` such as "#if", without spaces), "word", "number" or "mark".
    """

    kind: str
    text: str
    start: int
    end: int


def tokens(text: str) -> list[Token]:
    """The tokens of SDL, without white space and comments. What is no SDL gives tokens of some kind."""
    found = []
    place = 0
    while match := _TOKEN.match(text, place):
        kind, place = str(match.lastgroup), match.end()
        if kind == "nested":
            depth = 1
            while depth and (edge := _EDGE.search(text, place)):
                depth += 1 if edge[0] == "/*" else -1
                place = edge.end()
            if depth:
                break
        elif kind != "skip":
            word = re.sub(r"\s", "", match[0]) if kind == "directive" else match[0]
            found.append(Token(kind, word, match.start(), place))
    return found


def with_size(text: str, width: int, height: int) -> str:
    """SDL with the size of an image in pixels in place of `image_width` and `image_height`.

    A batch is an image of a size of its own, and a scene's textures and objects may depend on that of the picture.
    """
    if "image_width" not in text and "image_height" not in text:
        return text
    sizes = {"image_width": str(width), "image_height": str(height)}
    pieces, place = [], 0
    for token in tokens(text):
        if token.kind == "word" and token.text in sizes:
            pieces += [text[place : token.start], sizes[token.text]]
            place = token.end
    return "".join((*pieces, text[place:]))


def changed(source: Source, change: Callable[[str], str], folder: Path) -> Source:
    """The scene with `change` made to its text and to the files that it includes; see `_reached` for which.

    Included files that change are written to `folder`, which has to be empty and to stay as long as the scene. They
    are put beside the scene, where POV-Ray looks first: before all libraries, of which those of its own settings come
    first. Their names are those by which they are included, but for absolute paths and paths upwards: for these the
    statement changes, too, and with it the file that it is in.
    """
    reached = _reached(source)
    new = {name: change(file.text) for name, file in reached.items()}
    differ = {name for name, file in reached.items() if file.ours or new[name] != file.text}
    while more := {name for name, file in reached.items() if file.outside & differ} - differ:
        differ |= more
    names = {
        name: f"pmc_{zlib.crc32(name.encode('utf-8', 'surrogateescape')):08x}_{reached[name].path.name}"
        for name in differ
        if _is_outside(name)
    }
    for name in sorted(differ):
        # With its ending, under which POV-Ray looks for it first.
        place = folder / names[name] if name in names else (folder / name).with_name(reached[name].path.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        write_text(place, _renamed(new[name], names))
    beside = dict(source.files) | {place.name: place for place in sorted(folder.iterdir())}
    renamed = dict(source.renamed) | {ours: name for name, ours in names.items()}
    return dataclasses.replace(
        source,
        text=_renamed(change(source.text), names),
        files=tuple(beside.items()),
        renamed=tuple(renamed.items()),
    )


def texts(source: Source) -> list[str]:
    """The scene's text and those of the files that it includes; see `_reached` for which."""
    return [source.text, *(file.text for file in _reached(source).values())]


@dataclass(frozen=True)
class _File:
    """An included file: where it is, its text, and whether a change before has made it."""

    path: Path
    text: str
    ours: bool

    @property
    def outside(self) -> set[str]:
        """The names of those that it includes itself from outside the libraries."""
        return {name for name in _included(self.text, ()) if _is_outside(name)}


def _reached(source: Source) -> dict[str, _File]:
    """The included files, by the names by which they are included.

    They are those whose name is written out, from beside the scene, its libraries or POV-Ray's own; where a name is put
    together, all `.inc` files of the scene's libraries.
    """
    libraries = [*_own_libraries(), *source.libraries]
    beside = dict(source.files)
    found: dict[str, _File] = {}
    waiting, seen = list(_included(source.text, source.libraries)), set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        first, *rest = Path(name).parts or ("",)
        ours = beside[first].joinpath(*rest) if first in beside else None
        path = ours if ours is not None and ours.is_file() else _find(name, libraries)
        if path is not None:
            found[name] = _File(path, read_text(path), path == ours)
            waiting += _included(found[name].text, source.libraries)
    return found


def _is_outside(name: str) -> bool:
    """Whether a file of that name cannot be put beside the scene."""
    return Path(name).is_absolute() or ".." in Path(name).parts


def _renamed(text: str, names: Mapping[str, str]) -> str:
    """SDL that includes files under other names."""
    pieces, place = [], 0
    for directive, name in itertools.pairwise(tokens(text) if names else ()):
        if directive.kind == "directive" and directive.text == "#include" and name.text[1:-1] in names:
            pieces += [text[place : name.start], f'"{names[name.text[1:-1]]}"']
            place = name.end
    return "".join((*pieces, text[place:]))


def _included(text: str, libraries: Sequence[Path]) -> Iterator[str]:
    """The names of the files that a text includes."""
    if "include" not in text:
        return
    found = tokens(text)
    for directive, name in itertools.pairwise(found):
        if directive.text == "#include" and directive.kind == "directive":
            if name.kind == "string":
                yield name.text[1:-1]
            else:
                for library in libraries:
                    yield from sorted(file.name for file in library.glob("*.inc"))


def _find(name: str, libraries: Sequence[Path]) -> Path | None:
    """The first file of that name, with the endings that POV-Ray adds."""
    for library in libraries:
        for ending in ("", ".inc"):
            file = library / (name + ending)
            if file.is_file():
                return file
    return None


def _own_libraries() -> list[Path]:
    """The folders that POV-Ray's own settings name."""
    folders = []
    for settings in _SETTINGS:
        file = Path(settings).expanduser()
        if file.is_file():
            lines = re.findall(r"^\s*library_path\s*=\s*(.*?)\s*$", read_text(file), re.IGNORECASE | re.MULTILINE)
            folders += [Path(line.strip("\"'").replace("%HOME%", str(Path.home()))) for line in lines]
    return folders
