"""Meshes of a glTF file as triangles in world space."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf_file import Document
from .gltf_materials import Materials
from .gltf_nodes import Placed
from .gltf_values import numbers, pick, title
from .scene import Mesh

__all__ = ["Meshes"]

_MODES = ("POINTS", "LINES", "LINE_LOOP", "LINE_STRIP", "TRIANGLES", "TRIANGLE_STRIP", "TRIANGLE_FAN")
_COORDINATES = ("TEXCOORD_0", "TEXCOORD_1")


@dataclass(frozen=True, eq=False)
class _Primitive:
    """A primitive's arrays in its own space; attributes: as the file calls them, (v, width) each, with POSITION."""

    triangles: NDArray[np.uint32]
    attributes: dict[str, NDArray[Any]]
    material: int | None
    name: str


@dataclass
class Meshes:
    """Collects the meshes of a scene: a transformed copy for each node that has one.

    meshes: what a `Scene` takes; lit: whether one of them emits, and is meant to light the others.
    """

    document: Document
    materials: Materials
    meshes: list[Mesh] = field(default_factory=list)
    lit: bool = False
    _read: dict[tuple[int, int, tuple[float, ...]], _Primitive | None] = field(default_factory=dict)
    _without: dict[str, None] = field(default_factory=dict)  # primitives without triangles, in order

    def add(self, node: Placed, world: dict[int, NDArray[np.float64]]) -> None:
        """The primitives of a node's mesh; `world` has the matrix, (4, 4), of each node of the scene.

        Raises ValueError for what breaks the specification (section 3.7.2), and what reading accessors and materials
        raises.
        """
        mesh = pick(self.document.model.meshes, node.node.mesh, f"the mesh of {node.name}")
        weights = self._weights(node, mesh)
        for number in range(len(mesh.primitives)):
            key = (node.node.mesh, number, weights)
            if key not in self._read:
                self._read[key] = self._primitive(*key)
            primitive = self._read[key]
            if primitive is not None:
                matrix = node.matrix if node.node.skin is None else self._skinned(node, primitive, world)
                self._place(primitive, matrix, node.name)

    def finish(self) -> None:
        """Warns, once, of all that has no triangles."""
        if self._without:
            self.document.warn(f"what has no triangles is left out: {', '.join(self._without)}")

    def _place(self, primitive: _Primitive, matrix: NDArray[np.float64], node: str) -> None:
        attributes = primitive.attributes
        vertices, normals, triangles = _transformed(
            attributes["POSITION"], attributes.get("NORMAL"), primitive.triangles, matrix
        )
        if len(triangles) == 0:
            return
        name = f"{primitive.name} in {node}"
        if not np.isfinite(vertices).all():  # said here, since the camera may be placed by them
            raise ValueError(f"the vertices of {name} are NaN or infinite in part: expected finite positions")
        uv_sets = {i for i, name in enumerate(_COORDINATES) if name in attributes}
        colors = attributes.get("COLOR_0")
        look = self.materials.look(primitive.material, colors is not None, uv_sets)
        uvs = None
        if look.uv_set is not None:
            given = attributes[_COORDINATES[look.uv_set]].astype(np.float64)
            uvs = (given @ look.to_uv[:2, :2].T + look.to_uv[:2, 2]).astype(np.float32)
        self.lit |= look.lights_up
        self.meshes.append(
            Mesh(
                vertices,
                triangles,
                look.material,
                normals=normals,
                uvs=uvs,
                colors=None if colors is None else _with_alpha(colors),
                radiance=look.radiance,
                radiance_texture=look.radiance_texture,
                emits_both_sides=look.emits_both_sides,
                name=name,
            )
        )

    def _weights(self, node: Placed, mesh: Any) -> tuple[float, ...]:
        """Those of the morph targets: the node's, else the mesh's, else 0. pygltflib's nodes drop theirs."""
        given = self.document.json["nodes"][node.index].get("weights", mesh.weights)
        return numbers(given, len(given), f"the weights of {node.name}") if isinstance(given, list) else ()

    def _primitive(self, mesh_index: int, number: int, weights: tuple[float, ...]) -> _Primitive | None:
        """A primitive with its morph targets applied; None where it has no triangles."""
        mesh = self.document.model.meshes[mesh_index]
        primitive = mesh.primitives[number]
        name = f"primitive {number} of {title('mesh', mesh_index, mesh.name)}"
        mode = _mode(primitive.mode, name)
        wanted = getattr(primitive.attributes, "__dict__", {})  # none, where they are empty
        if not mode.startswith("TRIANGLE") or wanted.get("POSITION") is None:
            self._without[f"{name} ({mode if wanted.get('POSITION') is not None else 'no POSITION'})"] = None
            return None
        attributes = self._attributes(wanted, name)
        count = len(attributes["POSITION"])
        for weight, target in zip(weights, primitive.targets or [], strict=False):
            for key in ("POSITION", "NORMAL"):
                if not isinstance(target, dict):
                    raise ValueError(f"a morph target of {name} is {target!r}: expected an object")
                if weight and key in attributes and target.get(key) is not None:
                    offsets = self.document.accessor(target[key], f"a morph target's {key} of {name}", ["VEC3"])
                    if len(offsets) != count:
                        raise ValueError(f"a morph target of {name} has {len(offsets)} vertices: expected {count}")
                    attributes[key] = attributes[key] + weight * offsets.astype(np.float64)
        if primitive.indices is None:
            indices = np.arange(count, dtype=np.uint32)
        else:
            indices = self.document.indices(primitive.indices, f"the indices of {name}")
            if len(indices) and int(indices.max()) >= count:
                raise ValueError(f"{name} names vertex {int(indices.max())} and has {count}; export the file anew")
        triangles = _triangles(indices, mode)
        if len(triangles) == 0:
            self._without[f"{name} ({len(indices)} vertices)"] = None
            return None
        return _Primitive(triangles, attributes, primitive.material, name)

    def _attributes(self, wanted: dict[str, Any], name: str) -> dict[str, NDArray[Any]]:
        types = {"POSITION": ["VEC3"], "NORMAL": ["VEC3"], "COLOR_0": ["VEC3", "VEC4"]}
        types |= {key: ["VEC2"] for key in _COORDINATES}
        influences = [key for key in wanted if key.startswith(("JOINTS_", "WEIGHTS_"))]
        types |= {key: ["VEC4"] for key in influences}
        found: dict[str, NDArray[Any]] = {}
        for key, kinds in types.items():
            if wanted.get(key) is not None:
                found[key] = self.document.accessor(wanted[key], f"the {key} of {name}", kinds)
                if len(found[key]) != len(found["POSITION"]):
                    raise ValueError(
                        f"{name} has {len(found['POSITION'])} vertices and {len(found[key])} elements of {key}: "
                        "expected as many"
                    )
        return found

    def _skinned(
        self, node: Placed, primitive: _Primitive, world: dict[int, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """The matrix of each vertex, (v, 4, 4), by the pose that the joints' nodes have (section 3.7.3)."""
        model, what = self.document.model, f"the skin of {node.name}"
        skin = pick(model.skins, node.node.skin, what)
        joints_of = skin.joints or []
        for joint in joints_of:
            if joint not in world:
                raise ValueError(f"{what} has the joint {joint!r}: expected the number of a node in the scene")
        matrices = np.array([world[joint] for joint in joints_of]).reshape(-1, 4, 4)
        if skin.inverseBindMatrices is not None:
            inverse = self.document.accessor(skin.inverseBindMatrices, f"the inverse bind matrices of {what}", ["MAT4"])
            if len(inverse) < len(matrices):
                raise ValueError(f"{what} has {len(matrices)} joints and {len(inverse)} matrices: expected as many")
            matrices = matrices @ inverse[: len(matrices)].reshape(-1, 4, 4).transpose(0, 2, 1)  # columns come first
        blended = np.zeros((len(primitive.attributes["POSITION"]), 4, 4))
        total = np.zeros(len(blended))
        for key, joints in primitive.attributes.items():
            weights = primitive.attributes.get(key.replace("JOINTS_", "WEIGHTS_"))
            if not key.startswith("JOINTS_") or weights is None:
                continue
            if joints.dtype.kind != "u" or (joints.size and int(joints.max()) >= len(matrices)):
                raise ValueError(f"{primitive.name} has joints that are none of the {len(matrices)} of {what}")
            for i in range(4):
                blended += weights[:, i, None, None] * matrices[joints[:, i]]
                total += weights[:, i]
        # Vertices without joints stay where the node is; weights are quantized and add up to 1 but nearly.
        held = total > 0.0
        blended[held] /= total[held, None, None]
        blended[~held] = node.matrix
        return blended


def _mode(mode: Any, name: str) -> str:
    mode = 4 if mode is None else mode
    if not 0 <= mode < len(_MODES):
        raise ValueError(f"{name} has the mode {mode}: expected 0 to {len(_MODES) - 1}")
    return _MODES[mode]


def _triangles(indices: NDArray[np.uint32], mode: str) -> NDArray[np.uint32]:
    """(t, 3) corners; vertices that do not fill a triangle are left over (section 3.7.2.1)."""
    if mode == "TRIANGLES":
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    count = max(len(indices) - 2, 0)
    i = np.arange(count)
    if mode == "TRIANGLE_FAN":
        return indices[np.stack([i + 1, i + 2, np.zeros_like(i)], axis=1)]
    triangles = indices[np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=1)]
    a, b, c = triangles.T
    joints = (a == b) | (b == c) | (c == a)  # triangles without an area, by which strips are joined
    return np.asarray(triangles[~joints])


def _transformed(
    positions: NDArray[Any], normals: NDArray[Any] | None, triangles: NDArray[np.uint32], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.uint32]]:
    """Vertices, normals and triangles in world space. matrix: (4, 4), or (v, 4, 4), one for each vertex.

    Where it mirrors, triangles turn round; where it leaves no area, there are none: so nodes are hidden.
    """
    linear = matrix[..., :3, :3]
    x, y, z = (linear[..., i] for i in range(3))
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-1)  # inverse transpose by det
    mirrored = np.asarray((x * cofactors[..., 0]).sum(axis=-1) < 0.0)
    placed = np.einsum("...ij,...j->...i", linear, positions.astype(np.float64)) + matrix[..., :3, 3]
    vertices = placed.astype(np.float32)
    around = None
    if normals is not None:
        turned = np.einsum("...ij,...j->...i", cofactors, normals.astype(np.float64))
        length = np.linalg.norm(turned, axis=1, keepdims=True) * np.where(mirrored, -1.0, 1.0)[..., None]
        around = (turned / np.where(length == 0.0, 1.0, length)).astype(np.float32)
    if not cofactors.any():
        triangles = triangles[:0]
    flips = mirrored[triangles[:, 0]] if mirrored.ndim else np.broadcast_to(mirrored, len(triangles))
    return vertices, around, np.where(flips[:, None], triangles[:, [0, 2, 1]], triangles)


def _with_alpha(colors: NDArray[Any]) -> NDArray[np.float32]:
    """(v, 4) from (v, 3) or (v, 4) (section 3.7.2.1)."""
    made = np.ones((len(colors), 4), np.float32)
    made[:, : colors.shape[1]] = colors
    return made
