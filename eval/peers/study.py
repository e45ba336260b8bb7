"""Adaptive against uniform sampling of one renderer: runs, and the budget at which they meet."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from .. import measures, metrics, statistics
from ..references import Reference
from .process import Picture

Row = dict[str, Any]

PILOT_SEED = 0x5EED_FF00
"""Of the renders that look for a threshold; measured runs have small seeds, and references their own."""


def row(picture: Picture, reference: Reference, white_luminance: float, names: Iterable[str] = measures.DEFAULT) -> Row:
    """The figures of a run: metrics, bias of mean luminance, achieved samples per pixel, seconds."""
    return {
        "spp": picture.spp,
        **measures.measure(picture.rgb, reference, white_luminance, names),
        "bias": metrics.bias(picture.rgb, reference.mean),
        "reference_bias": reference.bias_error,
        "seconds": picture.seconds,
    }


def threshold_for(
    spp: float,
    achieved: Callable[[float], float],
    *,
    start: float = 0.02,
    tolerance: float = 0.02,
    pilots: int = 10,
) -> float:
    """The noise threshold at which adaptive sampling takes ``spp`` samples a pixel on average.

    ``achieved(threshold)``, which falls as the threshold rises, renders once. The search is a bisection in the
    logarithm after steps of a factor of 4; it ends within a share of ``tolerance`` of ``spp``, or after ``pilots``
    renders with the nearest. Raises ValueError where no threshold comes within a tenth of ``spp``.
    """
    low, high = 0.0, math.inf  # too many samples, too few
    threshold, best, miss = start, start, math.inf
    for _ in range(pilots):
        off = achieved(threshold) / spp - 1.0
        if abs(off) < miss:
            best, miss = threshold, abs(off)
        if miss <= tolerance:
            break
        if off > 0.0:
            low = threshold
        else:
            high = threshold
        if low == 0.0 or math.isinf(high):
            threshold *= 4.0 if off > 0.0 else 0.25
        else:
            threshold = math.sqrt(low * high)
    if miss > 0.1:
        raise ValueError(
            f"no noise threshold gives {spp:g} samples a pixel: the nearest is {miss:.0%} off; fewer samples before a "
            "pixel may stop, or more for all, are needed."
        )
    return best


def gains(rows: Sequence[Row], base: Sequence[Row], name: str) -> statistics.Interval:
    """Uniform sampling's error over the adaptive one's at equal samples: median and interval over common seeds.

    Achieved samples per pixel differ a little; errors count as falling in proportion to them. Raises ValueError where
    no seed is common.
    """
    uniform = {one["seed"]: one[name] * one["spp"] for one in base}
    common = [one for one in rows if one["seed"] in uniform]
    return statistics.ratio_interval(
        [uniform[one["seed"]] for one in common], [one[name] * one["spp"] for one in common]
    )
