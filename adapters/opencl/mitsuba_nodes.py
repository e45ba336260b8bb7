"""The plugins of a parsed Mitsuba scene file, and refusals that say where they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

__all__ = ["Node", "matrix", "rgb", "value"]


@dataclass(frozen=True)
class Node:
    """A plugin of a parsed file: `state` is the `mi.parser.ParserState`, `index` its place in there."""

    state: Any
    index: int

    @property
    def props(self) -> Any:
        """The plugin's `mi.Properties`."""
        return self.state.nodes[self.index].props

    @property
    def type(self) -> Any:
        """The `mi.ObjectType`."""
        return self.state.nodes[self.index].type

    @property
    def kind(self) -> str:
        """The plugin's name."""
        return str(self.props.plugin_name())

    @property
    def where(self) -> str:
        """The plugin's name, its id if it has one, and its place in the file."""
        name = f" {self.props.id()!r}" if self.props.id() else ""
        return f"{self.kind}{name} at {mi.parser.file_location(self.state, self.state.nodes[self.index])}"

    def children(self) -> dict[str, Node]:
        """The plugins nested in this one, by property."""
        return {
            key: Node(self.state, self.props[key].index())
            for key in self.props.keys()  # noqa: SIM118
            if self.props.type(key) == mi.Properties.Type.ResolvedReference
        }

    def of(self, *types: Any) -> list[Node]:
        """The nested plugins of the given `mi.ObjectType`s."""
        return [child for child in self.children().values() if child.type in types]

    def get(self, key: str, default: Any) -> Any:
        """A property that is no plugin."""
        return self.props.get(key, default)

    def allow(self, names: Iterable[str], types: Iterable[Any] = ()) -> None:
        """Raises ValueError for a property that is not in `names`, or a nested plugin that is not of `types` either."""
        names, types, children = tuple(names), tuple(types), self.children()
        for key in self.props.keys():  # noqa: SIM118
            if key in names:
                continue
            if key not in children:
                raise ValueError(f"{self.where} has {key!r}, which is not supported; supported are {', '.join(names)}")
            if children[key].type not in types:
                raise ValueError(f"{children[key].where} is not supported in {self.kind}")

    def refuse(self, supported: Iterable[str]) -> ValueError:
        """The error for a plugin outside the subset."""
        return ValueError(f"{self.where} is not supported; supported are {', '.join(supported)}")


def matrix(transform: Any) -> NDArray[np.float64]:
    """A Mitsuba transform's matrix."""
    return np.array(transform.matrix, dtype=np.float64)


def rgb(values: Any) -> tuple[float, float, float]:
    """One or three numbers as RGB."""
    red, green, blue = np.broadcast_to(np.array(values, dtype=np.float64).ravel(), 3)
    return float(red), float(green), float(blue)


def value(node: Node | None, key: str, params: Any, path: str, default: float | None) -> tuple[float, float, float]:
    """The RGB of a spectrum as Mitsuba holds it: `params` are those of an object, `path` is the spectrum's there.

    Raises ValueError where the spectrum is a texture or another plugin.
    """
    if node is not None and key in node.children():
        child = node.children()[key]
        raise ValueError(f"{child.where} is not supported as {key!r} of {node.kind}; give a constant there")
    if f"{path}.value" in params:
        return rgb(params[f"{path}.value"])
    if default is None:
        raise ValueError(f"{node.where if node else 'a plugin'} has a {key!r} that is no constant")
    return rgb(default)
