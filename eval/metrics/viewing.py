"""The viewer that metrics of visibility assume, unless told otherwise."""

import math

WHITE_LUMINANCE = 100.0
"""cd/m2 that a luminance of 1.0 stands for."""

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""Pixels per degree of visual angle, FLIP's: a display of 3840 pixels, 0.7 m wide, seen from 0.7 m."""


def check_white_luminance(white_luminance: float) -> float:
    """The value, where it can be one."""
    return _positive("white_luminance", "number of cd/m2, for example 100", white_luminance)


def check_pixels_per_degree(pixels_per_degree: float) -> float:
    """The value, where it can be one."""
    return _positive("pixels_per_degree", "number, for example 67", pixels_per_degree)


def _positive(name: str, expected: str, value: float) -> float:
    if not (value > 0.0 and math.isfinite(value)):
        raise ValueError(f"{name} must be a positive {expected}; it is {value!r}.")
    return value
