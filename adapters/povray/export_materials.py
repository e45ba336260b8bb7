"""Materials of a scene as POV-Ray's textures and interiors.

Exact, as far as POV-Ray's one bounce goes: diffuse surfaces; smooth dielectrics; the coat of smooth plastic and what it
lets through on the way in. Near:

- Conductors have Schlick's Fresnel reflectance over the right one at normal incidence: for silver and gold within 0.03.
- The base of plastic has the mean over all directions of what the coat lets out: the right albedo, edges too bright.
- Rough surfaces have micro-normals too small to be seen, new ones at every position. Their slopes have the quantiles of
  the GGX distribution to 10 % up to alpha 0.2 and the 90th percentile, and shorter tails beyond. Nothing masks them:
  at alpha 0.2 a ball is up to 8 % brighter than in the tracer, which loses what would scatter twice.
- Rough highlights of point and directional lights are POV-Ray's `specular`. Other lamps are seen in the reflections, so
  that such highlights are left out in scenes that have both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..opencl.scene import RGB, Material, Mesh, Scene, Sphere
from .export_text import number, times, vector
from .export_textures import Textures

__all__ = ["Materials", "Surface"]

BLACK = "texture { pigment { rgb 0 } finish { diffuse 0 } }"
_GLASS = ("dielectric", "roughdielectric")
_BUMPS = 1.0 / 0.38  # the median slope of POV-Ray's bumps of amount 1
_QUANTILES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.985)  # at which slopes are given
_GRAIN = 2e-5  # of the scene's extent: far below a pixel


@dataclass(frozen=True)
class Surface:
    """SDL of one object: textures on its front and its back, "" where alike, and its interior.

    shines_through: whether it is a target of photons.
    """

    front: str
    back: str
    interior: str
    shines_through: bool


class Materials:
    """Gives an object's surface.

    extent: the scene's, which says how small micro-normals are; highlights: whether rough surfaces show highlights of
    their own.
    """

    def __init__(self, scene: Scene, textures: Textures, extent: float, highlights: bool) -> None:
        self._scene = scene
        self._textures = textures
        self._grain = extent * _GRAIN
        self._highlights = highlights

    def surface(self, thing: Mesh | Sphere, inside_out: bool) -> Surface:
        """What `thing` looks like. inside_out: whether its front is towards the inside.

        Raises ValueError for what POV-Ray cannot show, OSError if a texture cannot be written.
        """
        material = self._scene.materials[thing.material]
        self._check(material, thing)
        glass = material.kind in _GLASS or (material.transmission > 0.0 and material.kind == "metallic-roughness")
        plain = self._layers(material)
        front = self._lamp(thing, material, plain) if thing.radiance is not None else plain
        back = plain if material.two_sided or glass else self._black(material)
        if isinstance(thing, Mesh) and thing.emits_both_sides and thing.radiance is not None:
            back = self._lamp(thing, material, back)
        eta = 1.0 if glass and material.kind not in _GLASS and material.thin else material.eta
        # POV-Ray tells inside from outside by the object, the tracer by the normal.
        interior = f"interior {{ ior {number(1.0 / eta if inside_out and glass else eta)} }}"
        if material.kind in ("diffuse", "conductor", "roughconductor"):
            interior = ""
        mirrors = glass or material.kind in ("conductor", "roughconductor")
        return Surface(front, "" if back == front else back, interior, mirrors)

    def _check(self, material: Material, thing: Mesh | Sphere) -> None:
        name = thing.name
        if material.normal_texture is not None:
            raise ValueError(f"{name} has a normal map, which POV-Ray does not have; remove it")
        if material.metallic_roughness_texture is not None:
            raise ValueError(f"{name} has a metallic-roughness texture, which POV-Ray does not have; use factors alone")
        if material.vertex_colors and isinstance(thing, Mesh) and thing.colors is not None:
            raise ValueError(f"{name} has vertex colours, which are not written for POV-Ray; use a texture")
        if material.cut_out and material.kind != "diffuse":
            raise ValueError(
                f"{name} is a {material.kind} that is cut out; for POV-Ray diffuse surfaces alone can be cut out"
            )
        if thing.radiance is not None and max(thing.radiance) > 0.0 and material.kind in (*_GLASS, "plastic"):
            raise ValueError(f"{name} is a lamp of {material.kind}; for POV-Ray lamps are diffuse or conductors")
        if material.color_texture is not None and material.kind == "metallic-roughness" and 0 < material.metallic < 1:
            raise ValueError(
                f"{name} is {material.metallic:g} metallic and textured, which POV-Ray cannot mix; use 0 or 1"
            )

    def _layers(self, material: Material) -> str:
        """The textures, lowest first."""
        kind = material.kind
        if kind == "diffuse":
            return _texture(self._diffuse(material, material.color))
        if kind == "plastic":
            coat = f"0, rgb {vector(material.specular_reflectance)} fresnel on"
            return _texture(self._plastic_base(material)) + self._coat(coat)
        if kind in _GLASS:
            pigment = f"pigment {{ rgbf {vector([*material.specular_transmittance, 1.0])} }}"
            mirror = f"reflection {{ 0, rgb {vector(material.specular_reflectance)} fresnel on }} conserve_energy"
            return f"texture {{ {pigment} finish {{ diffuse 0 {mirror} }}{self._rough(material)} }}"
        if kind in ("conductor", "roughconductor"):
            normal = normal_reflectance(material)
            at_normal = vector(r * s for r, s in zip(normal, material.specular_reflectance, strict=True))
            mirror = f"reflection {{ rgb {at_normal}, rgb {vector(material.specular_reflectance)} falloff 5 }}"
            finish = f"finish {{ diffuse 0 {mirror}{self._highlight(material)} }}"
            return f"texture {{ pigment {{ rgb {at_normal} }} {finish}{self._rough(material)} }}"
        return self._metallic_roughness(material)

    def _metallic_roughness(self, material: Material) -> str:
        metallic = material.metallic
        rough = self._rough(material)
        if metallic == 1.0 and material.color_texture is not None:
            pigment = self._textures.pigment(material.color_texture, material.color)
            return f"texture {{ {pigment} finish {{ diffuse 0 reflection {{ 1 metallic }} }}{rough} }}"
        coat = ((material.eta - 1.0) / (material.eta + 1.0)) ** 2
        mixed = [coat + (c - coat) * metallic for c in material.color]
        # The base gets what the dielectric share of the coat lets through, and POV-Ray takes from it what all of the
        # coat reflects: with Schlick's formula one is the other times a constant.
        red, green, blue = (
            c * (1.0 - metallic) * (1.0 - coat) / max(1.0 - f, 1e-6) for c, f in zip(material.color, mixed, strict=True)
        )
        base = _texture(self._diffuse(material, (red, green, blue), window=material.transmission))
        return base + self._coat(f"rgb {vector(mixed)}, 1 falloff 5", rough)

    def _diffuse(self, material: Material, color: RGB, albedo: str = "1", window: float = 0.0) -> str:
        """What reflects `color` times `albedo`; the share `window` of light goes through, coloured."""
        if material.color_texture is not None:
            pigment = self._textures.pigment(material.color_texture, color, material)
            if window > 0.0:
                raise ValueError(
                    "a material lets light through and is textured, which POV-Ray cannot show; use a color"
                )
        elif window > 0.0:
            pigment = f"pigment {{ rgbf {vector([*color, window])} }}"
        else:
            pigment = f"pigment {{ rgbt {vector([*color, 1.0 - self._opacity(material)])} }}"
        return f"{pigment} finish {{ diffuse albedo {albedo} }}"

    def _plastic_base(self, material: Material) -> str:
        """A base under a coat, whose light goes in and out by it, and back and forth between both."""
        back = mean_fresnel(1.0 / material.eta)
        outward = (1.0 - mean_fresnel(material.eta)) / material.eta**2
        if not material.nonlinear:
            red, green, blue = (c * outward / (1.0 - back) for c in material.color)
        elif material.color_texture is None:
            red, green, blue = (c * outward / (1.0 - c * back) for c in material.color)
        else:
            pigment = self._textures.pigment(material.color_texture, material.color, inside=back, outward=outward)
            return f"{pigment} finish {{ diffuse albedo 1 }}"
        return self._diffuse(material, (red, green, blue))

    def _opacity(self, material: Material) -> float:
        if not material.cut_out:
            return 1.0
        return material.opacity if material.alpha_cutoff is None else float(material.opacity >= material.alpha_cutoff)

    def _black(self, material: Material) -> str:
        """The back of a surface that scatters on its front: black, and not there where it is cut out."""
        if not material.cut_out:
            return BLACK
        if material.color_texture is None:
            return _texture(
                f"pigment {{ rgbt <0,0,0,{number(1.0 - self._opacity(material))}> }} finish {{ diffuse 0 }}"
            )
        return _texture(self._textures.pigment(material.color_texture, (0.0, 0.0, 0.0), material))

    def _coat(self, reflection: str, normal: str = "") -> str:
        """A clear layer that takes from those below what it reflects."""
        mirror = f"reflection {{ {reflection} }} conserve_energy"
        return f" texture {{ pigment {{ rgbt 1 }} finish {{ diffuse 0 {mirror} }}{normal} }}"

    def _lamp(self, thing: Mesh | Sphere, material: Material, plain: str) -> str:
        """The textures `plain` and what `thing` emits."""
        radiance = thing.radiance or (0.0, 0.0, 0.0)
        textured = thing.radiance_texture if isinstance(thing, Mesh) else None
        # What is averaged is halved.
        alone = plain == BLACK or (material.kind == "diffuse" and max(material.color) == 0.0)
        glow = times(radiance, 1.0 if alone else 2.0)
        if textured is not None:
            image = self._textures.pigment(textured, (1.0, 1.0, 1.0))
            pigment = f"{image} finish {{ emission rgb {vector(glow)} diffuse 0 }}"
        else:
            pigment = f"pigment {{ rgb {vector(glow)} }} finish {{ emission 1 diffuse 0 }}"
        if alone:
            return f"texture {{ {pigment} }}"
        if material.kind != "diffuse":
            raise ValueError(f"{thing.name} is a lamp of {material.kind}; for POV-Ray lamps are diffuse")
        doubled = self._diffuse(material, material.color, "2")
        return f"texture {{ average texture_map {{ [1 {pigment}] [1 {doubled}] }} }}"

    def _alpha(self, material: Material) -> float:
        """Of GGX; 0 for a smooth surface."""
        if material.kind == "metallic-roughness":
            return material.roughness**2
        return material.alpha if material.kind.startswith("rough") else 0.0

    def _rough(self, material: Material) -> str:
        """Micro-normals: a random number in each cell says by how much bumps of random direction tilt."""
        alpha = self._alpha(material)
        if alpha < 1e-3:
            return ""
        # The share q of GGX's projected normals is less steep than alpha sqrt(q / (1 - q)) (Walter et al. 2007).
        steps = " ".join(f"[{number(q)} bumps {number(alpha * _BUMPS * math.sqrt(q / (1.0 - q)))}]" for q in _QUANTILES)
        return f" normal {{ cells normal_map {{ {steps} }} scale {number(self._grain)} }}"

    def _highlight(self, material: Material) -> str:
        alpha = self._alpha(material)
        if not self._highlights or alpha < 1e-3:
            return ""
        # A third of the slopes, since the micro-normals spread it too: 11 % more than it should have in variance.
        exponent = max(2.0 / (alpha / 3.0) ** 2 - 2.0, 1.0)
        return f" specular albedo 1 roughness {number(1.0 / exponent)} metallic"


def _texture(body: str) -> str:
    return f"texture {{ {body} }}"


def normal_reflectance(material: Material) -> tuple[float, ...]:
    """A conductor's reflectance at normal incidence, RGB."""
    return tuple(
        ((n - 1.0) ** 2 + k**2) / ((n + 1.0) ** 2 + k**2)
        for n, k in zip(material.conductor_eta, material.conductor_k, strict=True)
    )


def mean_fresnel(eta: float) -> float:
    """The mean, over directions by their cosine, of a dielectric's unpolarised reflectance; eta: far side over near."""
    cosine = np.sqrt((np.arange(4096) + 0.5) / 4096)
    squared = 1.0 - (1.0 - cosine**2) / eta**2
    beyond = np.sqrt(np.maximum(squared, 0.0))
    s, p = (cosine - eta * beyond) / (cosine + eta * beyond), (eta * cosine - beyond) / (eta * cosine + beyond)
    reflectance = np.where(squared > 0.0, 0.5 * (s**2 + p**2), 1.0)
    mean = float(reflectance.mean())
    if not math.isfinite(mean):
        raise ValueError(f"the index of refraction {eta:g} is no number above 0")
    return mean
