"""Materials and textures of a glTF file as those of the OpenCL tracer.

The tracer looks all textures of a mesh up at one set of coordinates. Those that a material wants elsewhere than its
first one (base colour, normal, metallic and roughness, emission, in this order) are left out with a warning.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf_file import Document
from .gltf_images import pixels
from .gltf_values import extension, numbers, pick, title, whole
from .scene import RGB, Floats, Material, Texture

__all__ = ["Look", "Materials"]

_WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_NEAREST = 9728


@dataclass(frozen=True, eq=False)
class Look:
    """How a mesh looks: what is not its shape.

    material: index into `Materials.materials`; radiance, radiance_texture, emits_both_sides: as a `Mesh` has them.
    uv_set: the number of the texture coordinates that its textures use, None for no textures.
    to_uv: (3, 3), from the file's (u, v, 1), v down, to the tracer's, v up.
    lights_up: whether the emission is meant to light other things.
    """

    material: int
    radiance: RGB | None
    radiance_texture: int | None
    emits_both_sides: bool
    uv_set: int | None
    to_uv: NDArray[np.float64]
    lights_up: bool


@dataclass(frozen=True, eq=False)
class _Image:
    """A texture as a material names it; what: how messages call it."""

    info: Any
    uv_set: int
    to_uv: NDArray[np.float64]
    what: str


@dataclass
class Materials:
    """Collects materials and textures, each once; `materials` and `textures` are what a `Scene` takes."""

    document: Document
    materials: list[Material] = field(default_factory=list)
    textures: list[Texture] = field(default_factory=list)
    _looks: dict[tuple[int | None, bool, frozenset[int]], Look] = field(default_factory=dict)
    _textures: dict[tuple[int, str, bool, bool], int] = field(default_factory=dict)
    _pixels: dict[tuple[int, bool], Floats] = field(default_factory=dict)

    def look(self, index: int | None, colors: bool, uv_sets: Set[int]) -> Look:
        """The material number `index` (None: the specification's default) on a mesh with or without vertex colours,
        and with these sets of texture coordinates.

        Raises ValueError for what breaks the specification (sections 3.8 and 3.9), and what `pixels` raises.
        """
        key = (index, colors, frozenset(uv_sets))
        if key not in self._looks:
            self._looks[key] = self._default(colors) if index is None else self._read(index, colors, uv_sets)
        return self._looks[key]

    def _default(self, colors: bool) -> Look:
        self.materials.append(Material("metallic-roughness", color=(1.0, 1.0, 1.0), vertex_colors=colors))
        return Look(len(self.materials) - 1, None, None, False, None, np.eye(3), False)

    def _read(self, index: int, colors: bool, uv_sets: Set[int]) -> Look:
        material = pick(self.document.model.materials, index, "the material of a primitive")
        label = title("material", index, material.name)
        unlit = extension(material, "KHR_materials_unlit") is not None
        images = self._images(material, unlit, label, uv_sets)
        base = material.pbrMetallicRoughness
        red, green, blue, alpha = _factors(base, "baseColorFactor", (1.0,) * 4, f"the base colour of {label}")
        color_texture = self._texture(images.get("color"), srgb=True)
        both_sides = bool(material.doubleSided)
        made = self._alpha(
            material,
            Material(
                "metallic-roughness",
                color=(red, green, blue),
                color_texture=color_texture,
                opacity=alpha,
                vertex_colors=colors,
                two_sided=both_sides,
            ),
            label,
        )
        radiance: RGB | None
        if unlit:
            # It shines with its base colour and reflects nothing; the colour's alpha still counts.
            if colors:
                self.document.warn(f"the vertex colours on {label}, which is unlit, are left out")
            radiance, radiance_texture = (red, green, blue), color_texture
            made = replace(made, kind="diffuse", color=(0.0, 0.0, 0.0))
            if not made.cut_out:
                made = replace(made, color_texture=None)
        else:
            (metallic,) = _factors(base, "metallicFactor", (1.0,), f"the metallic factor of {label}")
            (roughness,) = _factors(base, "roughnessFactor", (1.0,), f"the roughness factor of {label}")
            scale = 1.0
            if "normal" in images:
                (scale,) = numbers(_or(images["normal"].info.scale, 1.0), 1, f"the normal scale of {label}")
            made = replace(
                made,
                metallic=metallic,
                roughness=roughness,
                metallic_roughness_texture=self._texture(images.get("metallic and roughness"), srgb=False),
                normal_texture=self._texture(images.get("normal"), srgb=False),
                normal_scale=scale,
                **self._volume(material, label),
            )
            if made.transmission > 0.0 and not made.thin:
                made = replace(made, two_sided=False)  # its inside is told by the normal
            radiance = _emission(material, label)
            radiance_texture = self._texture(images.get("emission"), srgb=True) if radiance else None
        self.materials.append(made)
        used = next(iter(images.values()), None)
        return Look(
            len(self.materials) - 1,
            radiance,
            radiance_texture,
            both_sides,
            used.uv_set if used else None,
            used.to_uv if used else np.eye(3),
            radiance is not None and not unlit,
        )

    def _alpha(self, material: Any, made: Material, label: str) -> Material:
        """`made` with the alpha mode (section 3.9.6)."""
        mode = _or(material.alphaMode, "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"the alphaMode of {label} is {mode!r}: expected OPAQUE, MASK or BLEND")
        if mode == "OPAQUE":
            return replace(made, opacity=1.0)
        # Where alpha is 1 all over, which exporters leave as BLEND, rays need not stop to look.
        whole_texture = made.color_texture is None or self.textures[made.color_texture].pixels[..., 3].min() == 1.0
        if mode == "BLEND":
            return replace(made, cut_out=made.opacity < 1.0 or made.vertex_colors or not whole_texture)
        (cutoff,) = numbers(_or(material.alphaCutoff, 0.5), 1, f"the alphaCutoff of {label}", 0.0)
        return replace(made, cut_out=True, alpha_cutoff=cutoff)

    def _volume(self, material: Any, label: str) -> dict[str, Any]:
        """Transmission and refraction, of three extensions."""
        found: dict[str, Any] = {}
        if (ior := extension(material, "KHR_materials_ior")) is not None:
            (eta,) = numbers(ior.get("ior", 1.5), 1, f"the index of refraction of {label}", 0.0)
            if 0.0 < eta < 1.0:
                raise ValueError(f"the index of refraction of {label} is {eta:g}: expected 1 or more")
            if eta == 0.0:  # stands for a reflectance of 1 from everywhere
                self.document.warn(f"the index of refraction of {label} is 0, which is left out")
                eta = 1.5
            found["eta"] = eta
        if (transmission := extension(material, "KHR_materials_transmission")) is not None:
            what = f"the transmission of {label}"
            (found["transmission"],) = numbers(transmission.get("transmissionFactor", 0.0), 1, what, 0.0, 1.0)
            if transmission.get("transmissionTexture") is not None:
                self.document.warn(f"the transmission texture of {label} is left out")
        if (volume := extension(material, "KHR_materials_volume")) is not None:
            (thickness,) = numbers(volume.get("thicknessFactor", 0.0), 1, f"the thickness of {label}", 0.0)
            found["thin"] = thickness == 0.0
            tint = numbers(volume.get("attenuationColor", [1.0, 1.0, 1.0]), 3, f"the attenuation of {label}", 0.0, 1.0)
            if thickness > 0.0 and volume.get("attenuationDistance") is not None and min(tint) < 1.0:
                self.document.warn(f"the attenuation in the volume of {label} is left out")
        return found

    def _images(self, material: Any, unlit: bool, label: str, uv_sets: Set[int]) -> dict[str, _Image]:
        """The textures of a material, all of them with the same coordinates."""
        base = material.pbrMetallicRoughness
        infos = {"color": base.baseColorTexture if base else None}
        if not unlit:
            infos["normal"] = material.normalTexture
            infos["metallic and roughness"] = base.metallicRoughnessTexture if base else None
            infos["emission"] = material.emissiveTexture
        found: dict[str, _Image] = {}
        for name, info in infos.items():
            if info is None:
                continue
            image = _image(info, f"the {name} texture of {label}")
            if image.uv_set not in uv_sets:
                self.document.warn(f"{image.what} is left out on meshes without TEXCOORD_{image.uv_set}")
                continue
            first = next(iter(found.values()), image)
            if image.uv_set != first.uv_set or not np.allclose(image.to_uv, first.to_uv):
                self.document.warn(f"{image.what} is left out: its coordinates are not those of {first.what}")
                continue
            found[name] = image
        return found

    def _texture(self, image: _Image | None, srgb: bool) -> int | None:
        """The index of a texture (section 3.8), the same for equal ones."""
        if image is None:
            return None
        model = self.document.model
        texture = pick(model.textures, image.info.index, image.what)
        source = texture.source
        if source is None:
            source = (extension(texture, "EXT_texture_webp") or {}).get("source")
        if source is None:
            raise ValueError(f"{image.what}, texture {image.info.index}, has no image: expected a 'source'")
        wrap, nearest = "repeat", False
        if texture.sampler is not None:
            sampler = pick(model.samplers, texture.sampler, f"the sampler of {image.what}")
            modes = [_or(mode, 10497) for mode in (sampler.wrapS, sampler.wrapT)]
            for mode in modes:
                if mode not in _WRAPS:
                    raise ValueError(f"sampler {texture.sampler} wraps as {mode}: expected one of {sorted(_WRAPS)}")
            if modes[0] != modes[1]:
                self.document.warn(f"sampler {texture.sampler} wraps u and v in two ways, of which v's is left out")
            wrap, nearest = _WRAPS[modes[0]], sampler.magFilter == _NEAREST
        key = (whole(source, f"the image of {image.what}"), wrap, nearest, srgb)
        if key not in self._textures:
            if (source, srgb) not in self._pixels:
                self._pixels[source, srgb] = pixels(self.document, source, srgb)
            self.textures.append(Texture(self._pixels[source, srgb], wrap, nearest))
            self._textures[key] = len(self.textures) - 1
        return self._textures[key]


def _image(info: Any, what: str) -> _Image:
    """Where a material looks up a texture, with KHR_texture_transform."""
    uv_set, matrix = _or(info.texCoord, 0), np.eye(3)
    if (transform := extension(info, "KHR_texture_transform")) is not None:
        uv_set = _or(transform.get("texCoord"), uv_set)
        (angle,) = numbers(transform.get("rotation", 0.0), 1, f"the rotation of {what}")
        u, v = numbers(transform.get("offset", [0.0, 0.0]), 2, f"the offset of {what}")
        scale = numbers(transform.get("scale", [1.0, 1.0]), 2, f"the scale of {what}")
        # Counter-clockwise as seen, with v down. The extension's listing has it the other way round, against its text
        # and all readers: github.com/KhronosGroup/glTF/issues/1563.
        cos, sin = math.cos(angle), math.sin(angle)
        matrix = np.array([[cos, sin, u], [-sin, cos, v], [0.0, 0.0, 1.0]]) @ np.diag([*scale, 1.0])
    upright = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
    return _Image(info, whole(uv_set, f"the texCoord of {what}"), upright @ matrix, what)


def _emission(material: Any, label: str) -> RGB | None:
    red, green, blue = _factors(material, "emissiveFactor", (0.0,) * 3, f"the emission of {label}")
    strength = 1.0
    if (found := extension(material, "KHR_materials_emissive_strength")) is not None:
        (strength,) = numbers(found.get("emissiveStrength", 1.0), 1, f"the emissive strength of {label}", 0.0)
    return (red * strength, green * strength, blue * strength) if max(red, green, blue) * strength > 0.0 else None


def _factors(holder: Any, key: str, default: tuple[float, ...], what: str) -> tuple[float, ...]:
    """Factors from 0 to 1."""
    given = getattr(holder, key) if holder else None
    return default if given is None else numbers(given, len(default), what, 0.0, 1.0)


def _or(value: Any, default: Any) -> Any:
    return default if value is None else value
