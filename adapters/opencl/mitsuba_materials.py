"""Mitsuba's BSDFs and textures as materials of the OpenCL tracer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .mitsuba_nodes import Node, matrix, value
from .scene import Floats, Material, Texture

__all__ = ["Image", "Materials", "image"]

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])  # Mitsuba's
_WRAPS = ("repeat", "mirror", "clamp")


@dataclass(frozen=True, eq=False)
class Image:
    """A texture and where a mesh's coordinates meet it: `to_uv`, (3, 3), goes from Mitsuba's (u, v) to the tracer's."""

    texture: Texture
    to_uv: NDArray[np.float64]
    node: Node


@dataclass
class Materials:
    """Collects materials and textures, each once."""

    materials: list[Material] = field(default_factory=list)
    textures: list[Texture] = field(default_factory=list)
    _known: dict[tuple[int | None, bool], tuple[int, Images]] = field(default_factory=dict)

    def add(self, node: Node | None, bsdf: Any, flip_green: bool = False) -> tuple[int, Images]:
        """The index of the material of a Mitsuba object made from `node` (None: Mitsuba's default), and its images.

        With `flip_green` a normal map's y is turned round. Raises ValueError for what is not supported.
        """
        key = (node.index, flip_green) if node else (None, flip_green)
        if node is None or key not in self._known:  # defaults differ: Mitsuba's is black on emitters
            params = mi.traverse(bsdf)
            material, images = _read(node, params, "")
            textures: dict[str, Any] = {}
            for name, found in images.items():
                texture = found.texture
                if name == "normal_texture" and flip_green:
                    texture = replace(texture, pixels=_green_flipped(texture.pixels))
                textures[name] = self.texture(texture)
            self.materials.append(replace(material, **textures))
            self._known[key] = len(self.materials) - 1, images
        return self._known[key]

    def texture(self, texture: Texture) -> int:
        """The index of a texture, the same for equal ones."""
        for i, known in enumerate(self.textures):
            same = (known.wrap, known.nearest) == (texture.wrap, texture.nearest)
            if same and np.array_equal(known.pixels, texture.pixels):
                return i
        self.textures.append(texture)
        return len(self.textures) - 1


Images = dict[str, Image]
Read = tuple[Material, Images]


def _read(node: Node | None, params: Any, path: str) -> Read:
    if node is None:
        return Material("diffuse", color=value(None, "reflectance", params, "reflectance", None)), {}
    if node.kind not in _READERS:
        raise node.refuse(_READERS)
    return _READERS[node.kind](node, params, path)


def _diffuse(node: Node, params: Any, path: str) -> Read:
    node.allow(["reflectance"])
    color, images = _color(node, "reflectance", params, path)
    return Material("diffuse", color=color), images


def _plastic(node: Node, params: Any, path: str) -> Read:
    node.allow(["diffuse_reflectance", "specular_reflectance", "int_ior", "ext_ior", "nonlinear"])
    color, images = _color(node, "diffuse_reflectance", params, path)
    specular = value(node, "specular_reflectance", params, f"{path}specular_reflectance", 1.0)
    eta = float(params[f"{path}eta"])
    nonlinear = bool(node.get("nonlinear", False))
    return Material("plastic", color=color, specular_reflectance=specular, eta=eta, nonlinear=nonlinear), images


def _dielectric(node: Node, params: Any, path: str) -> Read:
    rough = node.kind == "roughdielectric"
    names = ["int_ior", "ext_ior", "specular_reflectance", "specular_transmittance"]
    node.allow([*names, *_ROUGHNESS] if rough else names)
    material = Material(
        node.kind,
        eta=float(params[f"{path}eta"]),
        specular_reflectance=value(node, "specular_reflectance", params, f"{path}specular_reflectance", 1.0),
        specular_transmittance=value(node, "specular_transmittance", params, f"{path}specular_transmittance", 1.0),
    )
    return (replace(material, alpha=_alpha(node, params, path)) if rough else material), {}


def _conductor(node: Node, params: Any, path: str) -> Read:
    rough = node.kind == "roughconductor"
    names = ["material", "eta", "k", "specular_reflectance"]
    node.allow([*names, *_ROUGHNESS] if rough else names)
    material = Material(
        node.kind,
        conductor_eta=value(node, "eta", params, f"{path}eta", None),
        conductor_k=value(node, "k", params, f"{path}k", None),
        specular_reflectance=value(node, "specular_reflectance", params, f"{path}specular_reflectance", 1.0),
    )
    return (replace(material, alpha=_alpha(node, params, path)) if rough else material), {}


_ROUGHNESS = ("distribution", "alpha", "sample_visible")


def _alpha(node: Node, params: Any, path: str) -> float:
    distribution = node.get("distribution", "beckmann")
    if distribution != "ggx":
        default = "" if "distribution" in node.props else ", Mitsuba's default"
        raise ValueError(f"{node.where} has the distribution {distribution!r}{default}; supported is 'ggx'")
    if not node.get("sample_visible", True):
        raise ValueError(f"{node.where} has 'sample_visible' off; supported is on")
    return value(node, "alpha", params, f"{path}alpha", None)[0]


def _twosided(node: Node, params: Any, path: str) -> Read:
    material, images = _read(_nested(node, []), params, f"{path}brdf_0.")
    return replace(material, two_sided=True), images


def _mask(node: Node, params: Any, path: str) -> Read:
    material, images = _read(_nested(node, ["opacity"]), params, f"{path}nested_bsdf.")
    if material.cut_out:
        raise ValueError(f"{node.where} is around another mask; supported is one")
    if "opacity" not in node.children():
        opacity = float(np.dot(value(node, "opacity", params, f"{path}opacity", 0.5), _LUMINANCE / _LUMINANCE.sum()))
        return replace(material, opacity=opacity, cut_out=True), images
    mask = image(node.children()["opacity"], params, f"{path}opacity")
    alpha = mask.texture.pixels[..., :3] @ _LUMINANCE.astype(np.float32)
    if np.ptp(mask.texture.pixels[..., :3], axis=-1).max() == 0.0:
        alpha = mask.texture.pixels[..., 0]  # grey as it is
    if mask.node.kind == "checkerboard" and _swaps_opacity():
        alpha = alpha[::-1]
    pixels = np.ones((*alpha.shape, 4), np.float32)
    if "color_texture" in images:  # the tracer has one texture for colour and opacity
        color = images["color_texture"]
        alike = (color.texture.wrap, color.texture.nearest) == (mask.texture.wrap, mask.texture.nearest)
        if color.texture.pixels.shape[:2] != alpha.shape or not alike or not np.allclose(color.to_uv, mask.to_uv):
            raise ValueError(
                f"{node.where} has an opacity texture unlike the colour's; supported are two of the same size, "
                "wrap_mode, filter_type and to_uv"
            )
        pixels[..., :3] = color.texture.pixels[..., :3]
    pixels[..., 3] = np.clip(alpha, 0.0, 1.0)
    images = {**images, "color_texture": replace(mask, texture=replace(mask.texture, pixels=pixels))}
    return replace(material, cut_out=True), images


def _swaps_opacity() -> bool:
    """Whether Mitsuba's checkerboard swaps its colours where one number is asked for, as that of 3.9 does."""
    board = mi.load_dict({"type": "checkerboard", "color0": 0.0, "color1": 1.0})
    place = mi.SurfaceInteraction3f()
    place.uv = mi.Point2f(0.25, 0.25)
    return float(board.eval_1(place)) > 0.5


def _normalmap(node: Node, params: Any, path: str) -> Read:
    nested = _nested(node, ["normalmap", "flip_invalid_normals", "use_shadowing_function"])
    for name in ("flip_invalid_normals", "use_shadowing_function"):
        if node.get(name, True):
            raise ValueError(f"{node.where} has {name!r} on, as by default, which is not supported: set it to false")
    material, images = _read(nested, params, f"{path}nested_bsdf.")
    if "normal_texture" in images:
        raise ValueError(f"{node.where} is around another normalmap; supported is one")
    if material.two_sided or material.cut_out:
        raise ValueError(f"{node.where} is around {nested.kind}; supported is the other way round")
    return material, {**images, "normal_texture": image(node.children()["normalmap"], params, f"{path}normalmap")}


def _nested(node: Node, names: list[str]) -> Node:
    """The one BSDF in `node`."""
    node.allow(names, [mi.ObjectType.BSDF])
    nested = node.of(mi.ObjectType.BSDF)
    if len(nested) != 1:
        raise ValueError(f"{node.where} holds {len(nested)} BSDFs; supported is one")
    return nested[0]


_READERS: dict[str, Callable[[Node, Any, str], Read]] = {
    "diffuse": _diffuse,
    "dielectric": _dielectric,
    "roughdielectric": _dielectric,
    "conductor": _conductor,
    "roughconductor": _conductor,
    "plastic": _plastic,
    "twosided": _twosided,
    "mask": _mask,
    "normalmap": _normalmap,
}


def _color(node: Node, key: str, params: Any, path: str) -> tuple[tuple[float, float, float], Images]:
    """A reflectance: its factor and its texture."""
    if key in node.children():
        return (1.0, 1.0, 1.0), {"color_texture": image(node.children()[key], params, f"{path}{key}")}
    return value(node, key, params, f"{path}{key}", 0.5), {}


def image(node: Node, params: Any, path: str) -> Image:
    """A bitmap, or a checkerboard as an image of 2x2 texels; `path` is the texture's in `params`.

    Raises ValueError for other textures.
    """
    if node.kind == "bitmap":
        # `format` is about storage alone
        node.allow(["filename", "filter_type", "wrap_mode", "raw", "to_uv", "accel", "format"])
        texture = Texture(
            _pixels(params[f"{path}.data"], bool(node.get("raw", False))),
            wrap=node.get("wrap_mode", "repeat"),
            nearest=node.get("filter_type", "bilinear") == "nearest",
        )
        if texture.wrap not in _WRAPS:
            raise ValueError(f"{node.where} has the wrap_mode {texture.wrap!r}; supported are {', '.join(_WRAPS)}")
    elif node.kind == "checkerboard":
        node.allow(["color0", "color1", "to_uv"])
        colors = [value(node, f"color{i}", params, f"{path}.color{i}", 0.4 - 0.2 * i) for i in range(2)]
        # Mitsuba's first colour is where u and v are both below or both above 1/2
        pixels = np.ones((2, 2, 4), np.float32)
        pixels[..., :3] = np.array(colors)[[[0, 1], [1, 0]]]
        texture = Texture(pixels, nearest=True)
    else:
        raise node.refuse(["bitmap", "checkerboard"])
    # Mitsuba's v = 0 is at the top of an image, the tracer's at its bottom
    upright = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
    return Image(texture, upright @ matrix(params[f"{path}.to_uv"]), node)


def _pixels(data: Any, raw: bool) -> Floats:
    """(height, width, 4) from a bitmap's tensor, which is linear except where it has 8 bits."""
    stored = np.array(data)
    pixels = stored.astype(np.float32)
    if stored.dtype == np.uint8:
        pixels /= np.float32(255)
        if not raw:
            pixels = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4).astype(np.float32)
    if pixels.shape[2] < 3:
        pixels = np.repeat(pixels[..., :1], 3, axis=2)
    return np.concatenate([pixels[..., :3], np.ones_like(pixels[..., :1])], axis=2)


def _green_flipped(pixels: Floats) -> Floats:
    flipped = pixels.copy()
    flipped[..., 1] = 1.0 - flipped[..., 1]
    return flipped
