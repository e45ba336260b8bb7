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
    },
    "emitter": {"area", "point", "directional", "constant", "envmap"},
    "sensor": {"perspective", "thinlens"},
    "integrator": {"path"},
    "film": {"hdrfilm"},
    "rfilter": {"box"},
    "sampler": {"independent"},
}


def test_names() -> None:
    assert {"cornell-box", "cornell-box-mirrors", "diffuse", "thin-lens"} <= set(NAMES)
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
    assert {element.get("name"): element.get("value") for element in root.findall("default")} == {
        "width": "640",
        "height": "480",
        "spp": "64",
        "max_depth": "12",
    }
    defined = {element.get("id") for element in root.iter() if element.get("id")}
    assert {element.get("id") for element in root.iter("ref")} <= defined


def picture(mi: Any, name: str, spp: int) -> Any:
    scene = mi.load_file(str(scenes.path(name)), width="64", height="48")
    return np.array(mi.render(scene, spp=spp, seed=1)) @ np.array([0.2126, 0.7152, 0.0722])


@pytest.mark.needs("mitsuba")
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("cornell-box", 0.25, 0.45),
        ("cornell-box-mirrors", 0.25, 0.5),
        ("diffuse", 0.3, 0.6),
        ("thin-lens", 0.1, 0.4),
    ],
)
def test_mean_luminance(name: str, low: float, high: float, require: Any) -> None:
    """Where a luminance of 1 is white, a picture is neither black nor blown out; noise is below a hundredth
    of the range."""
    mi = require("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    assert low < picture(mi, name, 128).mean() < high


@pytest.mark.needs("mitsuba")
def test_caustic_under_the_ball(require: Any) -> None:
    """The brightest of the floor is under the glass ball, several times brighter than the floor beside, with
    its shadow between."""
    mi = require("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    floor = picture(mi, "cornell-box", 512)[40:, :]
    row, column = np.unravel_index(np.argmax(floor), floor.shape)
    assert 36 <= column <= 45
    assert floor[row, column] > 4 * np.median(floor)
    assert floor[row, 33:51].min() < 0.7 * np.median(floor)
