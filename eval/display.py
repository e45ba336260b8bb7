"""From linear radiance to what a screen shows: exposure, a highlight shoulder and the sRGB curve.

One function serves the PNG beside every render and the metrics that want display-encoded values, so that a
figure and the picture next to it speak of the same image.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

SHOULDER = 0.8
"""Display value up to which the tone curve is the identity; brighter values are bent towards 1."""


def tone_map(rgb: ArrayLike, exposure: float = 1.0, shoulder: float = SHOULDER) -> NDArray[np.float32]:
    """Map linear RGB of any range to linear RGB in [0, 1].

    Values whose largest channel is at most ``shoulder`` stay as they are; above it the largest channel
    ``x`` becomes ``1 - d^2 / (x + d - shoulder)`` with ``d = 1 - shoulder``, which is smooth and tends to
    1, and the other channels are scaled with it and drawn towards white, as a bright coloured light looks.
    The curve is the shoulder of the Khronos PBR Neutral tone mapper (Khronos Group, 2024, specification
    "PBR Neutral"), without its toe.

    Parameters: ``rgb`` of shape (..., 3), linear; ``exposure`` multiplies it first; negative values show as
    0. Returns float32 of the same shape.
    """
    x = np.maximum(np.asarray(rgb, dtype=np.float64) * exposure, 0.0)
    peak = x.max(axis=-1, keepdims=True)
    d = 1.0 - shoulder
    bright = peak > shoulder
    excess = np.where(bright, peak, shoulder)
    bent = 1.0 - d * d / (excess + d - shoulder)
    mapped = x * (bent / excess)
    white = 1.0 - 1.0 / (0.15 * (excess - bent) + 1.0)
    mapped = mapped + (bent - mapped) * white
    return np.where(bright, mapped, x).astype(np.float32)


def srgb_encode(linear: ArrayLike) -> NDArray[np.float32]:
    """Apply the sRGB transfer curve (IEC 61966-2-1) to values clipped to [0, 1]; any shape, float32 out."""
    x = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float32]:
    """Undo :func:`srgb_encode` on values in [0, 1]; any shape, float32 out."""
    x = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def display(rgb: ArrayLike, exposure: float = 1.0) -> NDArray[np.float32]:
    """Tone-map and sRGB-encode linear RGB of shape (..., 3); values in [0, 1], float32."""
    return srgb_encode(tone_map(rgb, exposure))
