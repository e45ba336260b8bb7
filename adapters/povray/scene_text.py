"""What has to be found in a scene's text: its global photons, and whether it asks for radiosity."""

from __future__ import annotations

from collections.abc import Iterator

from .sdl import tokens

__all__ = ["has_radiosity", "with_photons"]


def with_photons(text: str, statement: str) -> str:
    """SDL with `statement` in each block of `global_settings { photons { ... } }`; the same text where there is none.

    The same, too, if it names a file itself: then the scene's author keeps photons as he likes.
    """
    if "photons" not in text or any(token.text in ("save_file", "load_file") for token in tokens(text)):
        return text
    for name, place in reversed(list(_settings(text))):
        if name == "photons":
            text = f"{text[:place]} {statement} {text[place:]}"
    return text


def has_radiosity(text: str) -> bool:
    """Whether `global_settings` has a block `radiosity { ... }`, in effect or not."""
    return "radiosity" in text and any(name == "radiosity" for name, _ in _settings(text))


def _settings(text: str) -> Iterator[tuple[str, int]]:
    """The blocks within `global_settings`: name and place after the brace."""
    before, depth, inside = "", 0, None
    for token in tokens(text):
        if token.text == "{":
            depth += 1
            if before == "global_settings" and inside is None:
                inside = depth
            elif inside is not None and depth == inside + 1:
                yield before, token.end
        elif token.text == "}":
            if inside == depth:
                inside = None
            depth -= 1
        before = token.text
