"""The errors that a benchmark measures, by name: each metric with what a reference and a suite know."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import luminance

from . import metrics
from .baselines.allocation import threshold_deviation
from .compare import Noise
from .references import Reference
from .statistics import neyman_limit

TILE = 16
"""Side in pixels of the tiles whose mean luminance is kept of every run, for tests of bias."""

Image = NDArray[Any]
Measure = Callable[[Image, Reference, float], float]

MEASURES: dict[str, Measure] = {
    "mse": lambda x, r, white: metrics.mse(x, r.mean, reference_variance=r.variance),
    "rmse": lambda x, r, white: metrics.rmse(x, r.mean, reference_variance=r.variance),
    "psnr": lambda x, r, white: metrics.psnr(x, r.mean, reference_variance=r.variance),
    "relmse": lambda x, r, white: metrics.relmse(x, r.mean, reference_variance=r.variance),
    "relmse_trimmed": lambda x, r, white: metrics.relmse(x, r.mean, trim=0.001, reference_variance=r.variance),
    "smape": lambda x, r, white: metrics.smape(x, r.mean),
    "tvi_error": lambda x, r, white: metrics.tvi_error(
        x, r.mean, white_luminance=white, reference_variance=r.luminance_variance
    ),
    "threshold_ratio": lambda x, r, white: metrics.threshold_ratio(x, r.mean, white_luminance=white),
    "visible_pixels": lambda x, r, white: metrics.visible_pixels(x, r.mean, white_luminance=white),
    "ssim": lambda x, r, white: metrics.ssim(x, r.mean),
    "flip": lambda x, r, white: metrics.flip(x, r.mean, exposures=metrics.flip_exposures(r.mean)),
    "ldr_flip": lambda x, r, white: metrics.ldr_flip(x, r.mean),
    "pu21_psnr": lambda x, r, white: metrics.pu21_psnr(x, r.mean, white_luminance=white),
    "pu21_ssim": lambda x, r, white: metrics.pu21_ssim(x, r.mean, white_luminance=white),
    "delta_e": lambda x, r, white: metrics.delta_e(x, r.mean),
    "yee": lambda x, r, white: metrics.yee(x, r.mean, white_luminance=white),
}
"""Functions of (image, reference, white_luminance); the reference's own noise is subtracted where it can be."""

ERRORS = {"mse": "MSE", "tvi_error": "tvi error"}
"""The squared errors, from which the noise of the reference is subtracted and which fall in proportion to the samples;
what they are called in tables."""

DEFAULT = tuple(MEASURES)
"""What is measured unless a suite says otherwise: all."""


def measure(image: Image, reference: Reference, white_luminance: float, names: Iterable[str]) -> dict[str, float]:
    """The named measures of an image (height, width, 3)."""
    return {name: MEASURES[name](image, reference, white_luminance) for name in names}


def reference_noise(reference: Reference, white_luminance: float) -> dict[str, float]:
    """What a measured error owes to the reference's own noise, for the columns ``reference.*`` of a row.

    ``mse`` and ``tvi_error``: what its variance adds to them, and is subtracted. ``mse.deviation`` and
    ``tvi_error.deviation``: the standard deviation of what that leaves, ``sqrt(2 R / (R + 1) sum((w v)^2)) / N``
    over N pixels of weight ``w``, channels taken as one: for normal noise whose variance ``v`` is estimated from R
    replicates, so that ``v^2`` is too large by (R + 1) / (R - 1), and the error of ``v`` itself comes on top.
    ``bias``: the standard error of its mean luminance, relative to it.
    """
    noise = Noise(reference.variance, reference.luminance_variance)
    added = noise.added(reference.mean, white_luminance)
    n = reference.luminance_variance.size
    known = np.sqrt(2.0 * reference.replicates / (reference.replicates + 1)) / n
    of_pixels = {
        "mse": reference.variance.mean(axis=2, dtype=np.float64),
        "tvi_error": threshold_deviation(
            reference.luminance_variance.astype(np.float64), _luminance(reference.mean), white_luminance
        )
        ** 2,
    }
    left = {f"{name}.deviation": float(known * np.sqrt((v**2).sum())) for name, v in of_pixels.items()}
    return {"mse": added["MSE"], "tvi_error": added["tvi error"], **left, "bias": reference.bias_error}


def neyman(radiance: Any, reference: Reference, white_luminance: float, spp: float) -> dict[str, float | None]:
    """The least MSE and tvi error that independent samples can have at ``spp`` samples a pixel on average.

    None where ``radiance`` does not know the variance of its samples, as a recording does (`variance`,
    `luminance_variance`).
    """
    if not hasattr(radiance, "variance") or not hasattr(radiance, "luminance_variance"):
        return {"mse": None, "tvi_error": None}
    mean = _luminance(reference.mean)
    deviations = {
        "mse": np.sqrt(np.asarray(radiance.variance, dtype=np.float64).mean(axis=2)),
        "tvi_error": threshold_deviation(np.asarray(radiance.luminance_variance), mean, white_luminance),
    }
    return {name: float((s**2).mean()) / spp / neyman_limit(s) for name, s in deviations.items()}


def tiles(image: Image) -> NDArray[np.float64]:
    """Mean luminance of tiles of ``TILE`` pixels; those at the right and the bottom may be smaller."""
    return tile_means(_luminance(image))


def tile_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of (height, width) values over tiles of ``TILE`` pixels."""
    rows, columns = (np.arange(0, side, TILE) for side in values.shape)
    sums = np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
    heights = np.diff(np.append(rows, values.shape[0]))
    widths = np.diff(np.append(columns, values.shape[1]))
    return np.asarray(sums / np.outer(heights, widths))


def _luminance(image: Image) -> NDArray[np.float64]:
    return np.asarray(luminance(np.asarray(image, dtype=np.float64)), dtype=np.float64)
