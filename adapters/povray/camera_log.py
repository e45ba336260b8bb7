"""A scene's text changed so that POV-Ray writes down what its `camera` statements say.

SDL cannot read a camera back, but it can write values: each item of a statement is evaluated once, into a variable that
is written to a file and then used. So conditions, loops, macros and random numbers stay what they are.
"""

from __future__ import annotations

from .sdl import Token, tokens

__all__ = ["LOG", "with_log"]

LOG = "pmc_camera.txt"
TYPES = ("perspective", "orthographic", "fisheye", "ultra_wide_angle", "omnimax", "panoramic", "spherical")
VECTORS = ("location", "right", "up", "direction", "sky", "look_at", "focal_point")
_TURNS = ("translate", "rotate", "scale", "matrix", "transform")
_FLOATS = ("angle", "aperture", "cylinder")
_UNUSED = ("confidence", "variance")  # they, and the number of blur_samples, are about POV-Ray's own sampling
_ITEMS = {*TYPES, *VECTORS, *_TURNS, *_FLOATS, *_UNUSED, "blur_samples", "normal", "mesh_camera", "bokeh"}
_OPENING = {"#if", "#ifdef", "#ifndef", "#switch", "#while", "#for", "#macro"}
_BRACKETS = {"(": ")", "[": "]", "{": "}"}


def with_log(text: str) -> str:
    """The scene with directives in its camera statements, all on the lines that they are about."""
    if "camera" not in text:
        return text
    return _Writer(text).changed()


def _write(*parts: str, before: str = "") -> str:
    """A directive that adds a line; it opens the file each time, for an included file cannot know whether it is open.

    Old scenes do not know all of the language.
    """
    return (
        f" #declare pmc_version=version; #version 3.7; {before}"
        f'#fopen pmc_file "{LOG}" append #write(pmc_file,{",".join(parts)},"\\n") #fclose pmc_file '
        "#version pmc_version; "
    )


def _value(variable: str) -> str:
    return f'vstr(3,{variable}," ",0,17)'


class _Writer:
    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = tokens(text)
        self._new: list[tuple[int, int, str]] = []  # from, to, what is there instead

    def changed(self) -> str:
        known = {"camera"}
        for k, token in enumerate(self._tokens):
            if token.text == "camera" and self._is(k + 1, "{"):
                end = self._closing(k + 1)
                name = self._declared(k)
                if name is not None:
                    known.add(name)
                if end is not None and not self._is(k - 1, "mesh_camera"):
                    self._statement(k, end, name)
            elif self._is(k, "=") and k + 2 < len(self._tokens) and self._tokens[k + 1].text in known:
                name = self._declared(k + 1)
                if name is not None and self._is(k + 2, ";"):
                    known.add(name)
                    place = self._tokens[k + 2].end
                    self._insert(place, _write(f'"alias {name} {self._tokens[k + 1].text}"'))
        pieces, place = [], 0
        for start, end, new in sorted(self._new, key=lambda change: change[:2]):
            pieces += [self._text[place:start], new]
            place = end
        return "".join((*pieces, self._text[place:]))

    def _insert(self, place: int, new: str) -> None:
        self._new.append((place, place, new))

    def _is(self, k: int, text: str) -> bool:
        return 0 <= k < len(self._tokens) and self._tokens[k].text == text and self._tokens[k].kind != "string"

    def _closing(self, k: int) -> int | None:
        """The bracket that closes the one at k."""
        opening = self._tokens[k].text
        depth = 0
        for j in range(k, len(self._tokens)):
            if self._is(j, opening):
                depth += 1
            elif self._is(j, _BRACKETS[opening]):
                depth -= 1
                if depth == 0:
                    return j
        return None

    def _declared(self, k: int) -> str | None:
        """The variable that gets what stands at k, in one word; elements of arrays with their brackets."""
        if not self._is(k - 1, "="):
            return None
        start = k - 2
        if self._is(start, "]"):
            while start > 0 and not self._is(start, "["):
                start -= 1
            start -= 1
        if start < 1 or self._tokens[start - 1].text not in ("#declare", "#local"):
            return None
        return "".join(token.text for token in self._tokens[start : k - 1])

    def _statement(self, k: int, end: int, name: str | None) -> None:
        target = "camera" if name is None else f"declare {name}"
        kind = "default" if self._in_default(k) else target
        self._insert(self._tokens[k + 1].end, _write(f'"begin {kind} "', "str(pmc_version,0,4)"))
        self._insert(self._tokens[end].start, _write('"end"'))
        j = k + 2
        while j < end:
            j = self._item(j, end)

    def _in_default(self, k: int) -> bool:
        """Whether what stands at k is an item of a `#default`, at whatever place among others."""
        depth = 0
        for j in range(k - 1, 0, -1):
            if self._is(j, "}"):
                depth += 1
            elif self._is(j, "{"):
                if depth == 0:
                    return self._is(j - 1, "#default")
                depth -= 1
        return False

    def _item(self, k: int, end: int) -> int:
        """Takes the item or directive at k; returns where the next one is."""
        token = self._tokens[k]
        if token.kind == "directive":
            return self._directive(k, end)
        if token.kind != "word":
            return k + 1
        word = token.text
        if word in TYPES:
            self._insert(token.start, _write(f'"item {word}"'))
            return k + 1
        if word in _UNUSED:
            return self._after(k, end)
        if word in ("normal", "blur_samples", "mesh_camera", "bokeh"):
            self._insert(token.start, _write(f'"item {word}"'))
            return self._after(k, end)
        if word in VECTORS or word in _FLOATS:
            after = self._after(k, end)
            self._vector(token, k + 1, after)
            return after
        if word in _TURNS:
            after = self._after(k, end)
            self._transform(k, after - 1)
            return after
        if self._is(k + 1, "("):
            # A macro: those used here give a transformation, as those of transforms.inc do.
            close = self._closing(k + 1)
            if close is not None and close < end:
                self._transform(k, close)
                return close + 1
        after = k + 1
        if self._is(after, "["):
            after = (self._closing(after) or after) + 1
        words = "".join(token.text for token in self._tokens[k:after])
        self._insert(token.start, _write(f'"item use {words}"'))
        return after

    def _after(self, k: int, end: int) -> int:
        """The token after the item at k, whose expression may begin with a condition."""
        j = k + 1
        if j < end and self._tokens[j].text in _OPENING and self._tokens[j].kind == "directive":
            depth = 0
            while j < end:
                if self._tokens[j].text in _OPENING:
                    depth += 1
                elif self._tokens[j].text == "#end":
                    depth -= 1
                    if depth == 0:
                        return j + 1
                j += 1
            return end
        while j < end:
            token = self._tokens[j]
            if token.kind == "directive" or (token.kind == "word" and token.text in _ITEMS):
                return j
            if j > k + 1 and token.kind == "word" and self._is(j + 1, "(") and self._ends_operand(j - 1):
                return j  # a macro after an expression that is complete
            if token.text in _BRACKETS and token.kind == "mark":
                j = (self._closing(j) or end) + 1
                if self._tokens[k].text in ("transform", "normal", "mesh_camera") and self._is(j - 1, "}"):
                    return min(j, end)
                continue
            j += 1
        return end

    def _ends_operand(self, k: int) -> bool:
        return self._tokens[k].kind in ("number", "word") or self._tokens[k].text in (")", "]", ">", "}")

    def _vector(self, token: Token, first: int, after: int) -> None:
        """`word EXPRESSION` becomes a variable that is written and used; `angle` may have two."""
        if after <= first:
            return
        last = after - 1
        if self._is(last, ",") and last > first:
            last -= 1
        parts = self._split(first, last) if token.text == "angle" else [(first, last)]
        before, used = "", []
        for number, (a, b) in enumerate(parts):
            before += f"#declare pmc_{number}=({self._code(a, b)})+<0,0,0>; "
            used.append(f"pmc_{number}.x" if token.text in _FLOATS else f"pmc_{number}")
        values = ',"\t",'.join(_value(f"pmc_{number}") for number in range(len(parts)))
        new = _write(f'"item {token.text} "', values, before=before)
        self._new.append((token.start, self._tokens[after - 1].end, new + f"{token.text} {','.join(used)} "))

    def _split(self, first: int, last: int) -> list[tuple[int, int]]:
        """Two expressions with a comma between them, or two numbers without."""
        j = first
        while j < last:
            token = self._tokens[j]
            if token.text in _BRACKETS and token.kind == "mark":
                j = self._closing(j) or last
            elif token.text == ",":
                return [(first, j - 1), (j + 1, last)]
            elif token.kind == "number" and self._tokens[j + 1].kind == "number":
                return [(first, j), (j + 1, last)]
            j += 1
        return [(first, last)]

    def _transform(self, first: int, last: int) -> None:
        """A transformation becomes a variable; a function tells where it puts the origin and the axes."""
        points = ',"\t",'.join(_value(f"pmc_f({point})") for point in ("0,0,0", "1,0,0", "0,1,0", "0,0,1"))
        new = (
            _write(
                '"item matrix "',
                points,
                before=f"#declare pmc_t=transform{{{self._code(first, last)}}} "
                "#declare pmc_f=function{transform{pmc_t}} ",
            )
            + "#undef pmc_f transform{pmc_t} "
        )
        self._new.append((self._tokens[first].start, self._tokens[last].end, new))

    def _code(self, first: int, last: int) -> str:
        """The text of tokens, without comments, on as many lines."""
        pieces, place = [], self._tokens[first].start
        for token in self._tokens[first : last + 1]:
            gap = self._text[place : token.start]
            pieces += ["\n" * gap.count("\n") or " " * bool(gap), token.text]
            place = token.end
        return "".join(pieces)

    def _directive(self, k: int, end: int) -> int:
        """Past a directive and its own expression."""
        word = self._tokens[k].text
        if self._is(k + 1, "("):
            return min((self._closing(k + 1) or end) + 1, end)
        if word in ("#declare", "#local", "#version", "#undef", "#default"):
            j = k + 1
            while j < end and not self._is(j, ";"):
                if self._tokens[j].kind == "directive":
                    return j
                if self._tokens[j].text in _BRACKETS and self._tokens[j].kind == "mark":
                    j = self._closing(j) or end
                j += 1
            return min(j + 1, end)
        if word in ("#macro",):
            return k + 2
        if word in ("#include", "#debug", "#warning", "#error", "#fopen", "#write", "#read"):
            j = k + 1
            while (
                j < end
                and (self._tokens[j].kind != "word" or self._tokens[j].text not in _ITEMS)
                and (self._tokens[j].kind != "directive")
            ):
                j = (self._closing(j) or end) + 1 if self._tokens[j].text in _BRACKETS else j + 1
            return min(j, end)
        return k + 1
