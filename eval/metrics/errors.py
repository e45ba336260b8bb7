"""Errors of linear values: squared, relative, absolute and of the mean."""

import math

import numpy as np
from numpy.typing import ArrayLike

from .pair import Pixels, luminance_of, pair, variance_of


def mse(test: ArrayLike, reference: ArrayLike, *, reference_variance: ArrayLike | None = None) -> float:
    """Mean squared error over pixels and channels (scikit-image), less the reference's own variance."""
    from skimage.metrics import mean_squared_error

    x, r = pair(test, reference)
    return float(mean_squared_error(r, x)) - float(variance_of(reference_variance, r.shape).mean())


def squared_error_map(test: ArrayLike, reference: ArrayLike, *, reference_variance: ArrayLike | None = None) -> Pixels:
    """Terms of :func:`mse`, ``d^2`` less the reference's variance, shape (height, width, 3)."""
    x, r = pair(test, reference)
    return (x - r) ** 2 - variance_of(reference_variance, r.shape)


def rmse(test: ArrayLike, reference: ArrayLike, *, reference_variance: ArrayLike | None = None) -> float:
    """Square root of :func:`mse`; 0 where the subtraction of the reference's variance leaves nothing."""
    return math.sqrt(max(mse(test, reference, reference_variance=reference_variance), 0.0))


def psnr(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    peak: float = 1.0,
    reference_variance: ArrayLike | None = None,
) -> float:
    """Peak signal-to-noise ratio of linear values in dB, ``10 log10(peak^2 / MSE)``; infinite if MSE is 0.

    ``peak`` is the linear value that counts as the signal's peak: 1.0 is diffuse white.
    """
    error = mse(test, reference, reference_variance=reference_variance)
    return 10.0 * math.log10(peak * peak / error) if error > 0.0 else math.inf


def relmse(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    epsilon: float = 0.01,
    trim: float = 0.0,
    reference_variance: ArrayLike | None = None,
) -> float:
    """Relative mean squared error, ``mean(d^2 / (r^2 + epsilon))`` over pixels and channels.

    ``trim`` is the fraction of the largest terms left out (0.001 drops the worst 0.1 %, so that single
    bright specks do not decide); it must lie in [0, 1). Which are largest is decided before the reference's
    variance is subtracted.
    """
    if not 0.0 <= trim < 1.0:
        raise ValueError(f"trim must be a fraction of the values in [0, 1), for example 0.001; it is {trim!r}.")
    terms = relmse_map(test, reference, epsilon=epsilon).ravel()
    left = relmse_map(test, reference, epsilon=epsilon, reference_variance=reference_variance).ravel()
    dropped = math.floor(trim * terms.size)
    if dropped:
        left = left[np.argpartition(terms, terms.size - dropped)[: terms.size - dropped]]
    return float(left.mean())


def relmse_map(
    test: ArrayLike, reference: ArrayLike, *, epsilon: float = 0.01, reference_variance: ArrayLike | None = None
) -> Pixels:
    """Terms of :func:`relmse`, shape (height, width, 3)."""
    _, r = pair(test, reference)
    return squared_error_map(test, reference, reference_variance=reference_variance) / (r * r + _above_zero(epsilon))


def smape(test: ArrayLike, reference: ArrayLike, *, epsilon: float = 0.01) -> float:
    """Symmetric mean absolute percentage error, ``mean(2 |d| / (|r| + |x| + 2 epsilon))``, 0 to 2."""
    return float(smape_map(test, reference, epsilon=epsilon).mean())


def smape_map(test: ArrayLike, reference: ArrayLike, *, epsilon: float = 0.01) -> Pixels:
    """Terms of :func:`smape`, shape (height, width, 3)."""
    x, r = pair(test, reference)
    return 2.0 * np.abs(x - r) / (np.abs(r) + np.abs(x) + 2.0 * _above_zero(epsilon))


def bias(test: ArrayLike, reference: ArrayLike) -> float:
    """Relative error of the mean luminance, ``mean(dY) / mean(Y_r)``; raises for a black reference."""
    x, r = pair(test, reference)
    mean = float(luminance_of(r).mean())
    if mean == 0.0:
        raise ValueError("the reference is black, so no bias relative to its mean luminance exists.")
    return float((luminance_of(x) - luminance_of(r)).mean()) / mean


def _above_zero(epsilon: float) -> float:
    if not (epsilon > 0.0 and math.isfinite(epsilon)):
        raise ValueError(f"epsilon must be a positive number, for example 0.01; it is {epsilon!r}.")
    return epsilon
