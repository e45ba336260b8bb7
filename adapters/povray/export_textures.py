"""Textures of a scene as image files beside its SDL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..opencl.scene import Material, Scene, Texture
from .export_text import vector, write_image

__all__ = ["Textures", "lookup"]

_MOST_PIXELS = 1 << 26


class Textures:
    """Writes what is asked for, each image once, and gives it as an `image_map` pigment.

    folder: where the SDL is.
    """

    def __init__(self, scene: Scene, folder: Path) -> None:
        self._scene = scene
        self._folder = folder
        self._known: dict[tuple[Any, ...], str] = {}
        self._ranges: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}
        for mesh in scene.meshes:
            for index in (scene.materials[mesh.material].color_texture, mesh.radiance_texture):
                if index is not None and mesh.uvs is not None and len(mesh.uvs):
                    low, high = mesh.uvs.min(axis=0), mesh.uvs.max(axis=0)
                    if index in self._ranges:
                        low, high = np.minimum(low, self._ranges[index][0]), np.maximum(high, self._ranges[index][1])
                    self._ranges[index] = low, high

    def pigment(
        self,
        index: int,
        factor: tuple[float, float, float],
        material: Material | None = None,
        inside: float = 0.0,
        outward: float = 1.0,
    ) -> str:
        """The pigment for texture number `index` times `factor`; with a `material` that is cut out, its alpha too.

        A color c becomes outward c / (1 - inside c).

        Raises ValueError for what POV-Ray cannot hold, OSError if the image cannot be written.
        """
        cut_out = (material.opacity, material.alpha_cutoff) if material is not None and material.cut_out else None
        key = (index, factor, cut_out, inside, outward)
        if key not in self._known:
            self._known[key] = self._write(index, factor, cut_out, inside, outward)
        return self._known[key]

    def _write(
        self,
        index: int,
        factor: tuple[float, float, float],
        cut_out: tuple[float, float | None] | None,
        inside: float,
        outward: float,
    ) -> str:
        texture = self._scene.textures[index]
        pixels = texture.pixels * np.array([*factor, 1.0], np.float32)
        pixels[..., :3] *= outward / (1.0 - inside * pixels[..., :3])
        if cut_out is None:
            pixels = pixels[..., :3]
        else:
            opacity, cutoff = cut_out
            alpha = np.clip(pixels[..., 3] * opacity, 0.0, 1.0)
            pixels[..., 3] = alpha if cutoff is None else alpha >= cutoff
        low, high = np.zeros(2), np.ones(2)  # the place of the image in (u, v)
        if texture.wrap == "mirror":  # POV-Ray repeats alone: an image with its reflections
            pixels = np.concatenate([pixels, pixels[:, ::-1]], axis=1)
            pixels = np.concatenate([pixels[::-1], pixels], axis=0)
            high = np.array([2.0, 2.0])
        elif texture.wrap == "clamp":
            pixels, low, high = self._clamped(pixels, index)
        file = f"texture{len(self._known)}.exr"
        write_image(self._folder / file, pixels)
        straight = " premultiplied off" if pixels.shape[2] == 4 else ""
        smooth = "" if texture.nearest else " interpolate 2"
        place = f" scale {vector([*(high - low), 1.0])} translate {vector([*low, 0.0])}"
        moved = place if texture.wrap != "repeat" else ""
        return f'pigment {{ uv_mapping image_map {{ exr "{file}"{straight}{smooth} }}{moved} }}'

    def _clamped(
        self, pixels: NDArray[np.float32], index: int
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any]]:
        """The image with its border repeated as far as coordinates go, and where it lies."""
        size = np.array([pixels.shape[1], pixels.shape[0]])
        lowest, highest = self._ranges.get(index, (np.zeros(2), np.ones(2)))
        before = np.ceil(np.maximum(-lowest, 0.0) * size).astype(int) + 1
        after = np.ceil(np.maximum(highest - 1.0, 0.0) * size).astype(int) + 1
        whole = size + before + after
        if int(whole[0]) * int(whole[1]) > _MOST_PIXELS:
            raise ValueError(
                f"texture {index} is clamped and its coordinates go from {tuple(lowest.tolist())} to "
                f"{tuple(highest.tolist())}: POV-Ray would need an image of {whole[0]}x{whole[1]} pixels; make it "
                "repeat"
            )
        margins = ((after[1], before[1]), (before[0], after[0]), (0, 0))  # v is up, the top row first
        return np.pad(pixels, margins, mode="edge"), -before / size, 1.0 + after / size


def lookup(texture: Texture, uv: NDArray[Any]) -> NDArray[np.float64]:
    """The colours (n, 3) at coordinates (n, 2), bilinear or nearest, as the tracer finds them."""
    height, width = texture.pixels.shape[:2]
    at = np.stack([uv[:, 0] * width, (1.0 - uv[:, 1]) * height], axis=1)
    if texture.nearest:
        return _texels(texture, np.floor(at).astype(int))
    corner = np.floor(at - 0.5).astype(int)
    share = at - 0.5 - corner
    total = np.zeros((len(uv), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
            total += weight[:, None] * _texels(texture, corner + np.array([dx, dy]))
    return total


def _texels(texture: Texture, at: NDArray[np.int_]) -> NDArray[np.float64]:
    size = np.array([texture.pixels.shape[1], texture.pixels.shape[0]])
    if texture.wrap == "clamp":
        at = np.clip(at, 0, size - 1)
    elif texture.wrap == "mirror":
        at = at % (2 * size)
        at = np.where(at < size, at, 2 * size - 1 - at)
    else:
        at = at % size
    found: NDArray[np.float64] = texture.pixels[at[:, 1], at[:, 0], :3].astype(np.float64)
    return found
