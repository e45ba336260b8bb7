"""SDL as tokens, and changes to a scene's text that reach the files that it includes."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from .program import read_text, write_text
from .source import Source

__all__ = ["Token", "changed", "tokens", "with_size"]

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
    """The scene with `change` made to its text and to the files that it includes.

    Included files that change are written to `folder`, under the names by which they are included; it has to be empty
    and to stay as long as the scene. They are put beside the scene, where POV-Ray looks first: before all libraries, of
    which those of its own settings come first. The files are those that are included by a relative name written out,
    from the scene's libraries or POV-Ray's own, and where a name is put together, all `.inc` files of the libraries.
    """
    libraries = [*_own_libraries(), *source.libraries]
    beside = dict(source.files)
    waiting, seen = list(_included(source.text, source.libraries)), set()
    while waiting:
        name = waiting.pop()
        first, *rest = Path(name).parts or ("",)
        ours = beside[first].joinpath(*rest) if first in beside else None
        file = ours if ours is not None and ours.is_file() else _find(name, libraries)
        if name in seen or file is None:
            continue
        seen.add(name)
        text = read_text(file)
        waiting += _included(text, source.libraries)
        new = change(text)
        # With its ending, under which POV-Ray looks for it first.
        place = (folder / name).with_name(file.name)
        if (new != text or file == ours) and not Path(name).is_absolute() and ".." not in Path(name).parts:
            place.parent.mkdir(parents=True, exist_ok=True)
            write_text(place, new)
    beside.update((place.name, place) for place in sorted(folder.iterdir()))
    return dataclasses.replace(source, text=change(source.text), files=tuple(beside.items()))


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
