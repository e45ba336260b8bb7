"""Scenes small enough for tests, and whether a renderer agrees with `mi.render` on one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

VARIANT = "llvm_ad_rgb"


@pytest.fixture(autouse=True)
def same_variant(mi: Any) -> Any:
    """Every test finds the same variant active."""
    mi.set_variant(VARIANT)
    yield
    mi.set_variant(VARIANT)


@pytest.fixture(scope="session")
def agreement(mi: Any, batch_of: Any, image_from: Any, p_value_of: Any) -> Callable[..., float]:
    """A function from a renderer to the p-value of its agreeing with `mi.render` on a scene, its own by
    default: in RGB and in the channels after it."""

    def p_of(renderer: Any, scene: Any = None, sensor: Any = None, spp: int = 32, tile: int = 16) -> float:
        width, height, seeds = renderer.width, renderer.height, 16
        ours = np.array(
            [image_from(renderer(batch_of(width, height, spp, seed)), width, height) for seed in range(seeds)]
        )
        with mi.util.variant_context(renderer.variant):
            theirs = [
                np.array(
                    mi.render(
                        scene or renderer.scene,
                        sensor=sensor or renderer.sensor,
                        integrator=renderer.integrator,
                        spp=spp,
                        seed=1000 + seed,
                    )
                )
                for seed in range(seeds)
            ]
        return p_value_of(ours, np.broadcast_to(theirs, ours.shape), tile)

    return p_of


@pytest.fixture
def small_scene(mi: Any) -> Callable[..., dict[str, Any]]:
    """A function that gives a Cornell box with a glass ball as a dictionary, 32x32; what it is given replaces
    or joins."""

    def make(sensor: dict[str, Any] | None = None, film: dict[str, Any] | None = None, **parts: Any) -> dict[str, Any]:
        scene = mi.cornell_box()
        for box in ("small-box", "large-box"):
            del scene[box]
        scene["ball"] = {
            "type": "sphere",
            "center": [0.1, -0.5, 0.2],
            "radius": 0.4,
            "bsdf": {"type": "dielectric", "int_ior": 1.5},
        }
        own = {
            "type": "hdrfilm",
            "width": 32,
            "height": 32,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        }
        scene["sensor"]["film"] = {**own, **(film or {})}
        scene["sensor"].update(sensor or {})
        scene.update(parts)
        return {key: value for key, value in scene.items() if value is not None}

    return make
