"""The built-in scenes: found by name, within the subset of Mitsuba's format that all renderers read, and lit
as they say."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest

from pmc_sampler import scenes

NAMES = scenes.names()
SUBSET = {
    "shape": {"rectangle", "cube", "sphere", "ply", "obj"},
    "bsdf": {
        "diffuse",
        "dielectric",
        "roughdielectric",
        "conductor",
        "roughconductor",
        "plastic",
        "twosided",
        "mask",
    },
    "texture": {"bitmap", "checkerboard"},
    "emitter": {"area", "point", "directional", "constant", "envmap"},
    "sensor": {"perspective", "thinlens"},
    "integrator": {"path"},
    "film": {"hdrfilm"},
    "rfilter": {"box"},
    "sampler": {"independent"},
}


def test_names() -> None:
    assert {"cornell-box", "cornell-box-mirrors", "diffuse", "materials", "room", "thin-lens"} <= set(NAMES)
    assert sorted(NAMES) == NAMES


def test_unknown_names() -> None:
    with pytest.raises(
        ValueError,
        match=r"no built-in scene is called 'cornell'; there are cornell-box, .*did you mean 'cornell-box'",
    ):
        scenes.path("cornell")
    with pytest.raises(ValueError, match=r"no built-in scene is called '\.\./__init__'"):
        scenes.describe("../__init__")


@pytest.mark.parametrize("name", NAMES)
def test_description_is_one_sentence(name: str) -> None:
    sentence = scenes.describe(name)
    assert sentence.endswith(".")
    assert 20 < len(sentence) < 200
    assert "\n" not in sentence


@pytest.mark.parametrize("name", NAMES)
def test_parts_are_within_the_subset(name: str) -> None:
    root = ElementTree.parse(scenes.path(name)).getroot()
    for element in root.iter():
        if element.tag in SUBSET:
            assert element.get("type") in SUBSET[element.tag], element.tag
    width, height, depth = ("720", "405", "8") if name == "room" else ("640", "480", "12")
    assert {element.get("name"): element.get("value") for element in root.findall("default")} == {
        "width": width,
        "height": height,
        "spp": "64",
        "max_depth": depth,
    }
    defined = {element.get("id") for element in root.iter() if element.get("id")}
    assert {element.get("id") for element in root.iter("ref")} <= defined


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def loaded(mi: Any, name: str) -> Any:
    mi.set_variant("llvm_ad_rgb")
    return mi.load_file(str(scenes.path(name)), width="128", height="96")


@pytest.mark.needs("mitsuba")
@pytest.mark.parametrize("name", NAMES)
def test_mean_luminance(name: str, require: Any) -> None:
    """Where a luminance of 1 is white, no picture is black or blown out; noise is far below the margins.

    What is brighter, as a lamp in view is, counts as white.
    """
    mi = require("mitsuba")
    luminance = np.array(mi.render(loaded(mi, name), spp=32, seed=1)) @ LUMINANCE
    assert 0.05 < np.minimum(luminance, 1.0).mean() < 0.6


@pytest.mark.needs("mitsuba")
def test_caustic_under_the_ball(require: Any) -> None:
    """The floor is brightest under the glass ball, several times the floor beside it, a shadow between."""
    mi = require("mitsuba")
    scene = loaded(mi, "cornell-box")
    image = np.array(mi.render(scene, spp=256, seed=1)) @ LUMINANCE
    ball = next(shape for shape in scene.shapes() if shape.id() == "glass-ball")
    box = ball.bbox()
    centre, radius = np.array(box.center()), (box.max.x - box.min.x) / 2
    pixel = np.stack(np.meshgrid(np.arange(128) + 0.5, np.arange(96) + 0.5), axis=-1).reshape(-1, 2)
    place = mi.Point2f(*(pixel / [128, 96]).T)
    ray, _ = scene.sensors()[0].sample_ray(0, 0, place, mi.Point2f(0.5))
    hit = np.array(scene.ray_intersect(ray).p).T.reshape(96, 128, 3)
    on_floor = np.abs(hit[..., 1]) < 1e-4
    distance = np.linalg.norm((hit - centre)[..., [0, 2]], axis=-1) / radius
    beside = np.median(image[on_floor & (distance > 1.5)])
    assert image[on_floor & (distance < 0.7)].max() > 4 * beside
    assert np.quantile(image[on_floor & (distance > 0.6) & (distance < 1.1)], 0.25) < 0.7 * beside
