"""The nodes of a glTF file's scene, each with its place in the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf_file import Document
from .gltf_values import numbers, pick, title

__all__ = ["Placed", "placed_nodes"]


@dataclass(frozen=True, eq=False)
class Placed:
    """A node of a scene: its number in the file, pygltflib's object, its matrix to the world, (4, 4), and its name."""

    index: int
    node: Any
    matrix: NDArray[np.float64]
    name: str


def placed_nodes(document: Document) -> list[Placed]:
    """The nodes of the default scene, of the first one, or of a file without scenes all, parents before children.

    Raises ValueError where nodes form no tree (section 3.5.2), or a node's transform is malformed.
    """
    model = document.model
    if model.scenes:
        which = 0 if model.scene is None else model.scene
        roots = list(pick(model.scenes, which, "the default scene").nodes or [])
    else:
        inner = {child for node in model.nodes for child in node.children or []}
        roots = [i for i in range(len(model.nodes)) if i not in inner]
    found: list[Placed] = []
    seen: set[int] = set()
    waiting = [(index, np.eye(4)) for index in reversed(roots)]  # no recursion: a file may nest as deep as it likes
    while waiting:
        index, parent = waiting.pop()
        node = pick(model.nodes, index, "a node of the scene")
        name = title("node", index, node.name)
        if index in seen:
            raise ValueError(f"{name} is reached twice: expected a tree, where a node has one parent and no cycle")
        seen.add(index)
        matrix = parent @ _local(node, name)
        found.append(Placed(index, node, matrix, name))
        waiting.extend((child, matrix) for child in reversed(node.children or []))
    return found


def _local(node: Any, name: str) -> NDArray[np.float64]:
    """A node's matrix to its parent, (4, 4) (section 3.5.3)."""
    if node.matrix:
        columns = numbers(node.matrix, 16, f"the matrix of {name}")
        return np.array(columns).reshape(4, 4).T
    made = np.eye(4)
    if node.rotation:
        quaternion = np.array(numbers(node.rotation, 4, f"the rotation of {name}"))
        length = float(np.linalg.norm(quaternion))
        if not length > 0.0:
            raise ValueError(f"the rotation of {name} is zero: expected a unit quaternion")
        x, y, z, w = quaternion / length
        made[:3, :3] = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    if node.scale:
        made[:3, :3] *= numbers(node.scale, 3, f"the scale of {name}")
    if node.translation:
        made[:3, 3] = numbers(node.translation, 3, f"the translation of {name}")
    return made
