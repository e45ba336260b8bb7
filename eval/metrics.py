"""Image errors: pure functions of a test image and a reference.

Images are linear RGB of shape (height, width, 3); ``luminance`` means Rec. 709. Every free constant is a
keyword argument, so that whoever prints a figure can print what shaped it.

A reference has noise of its own, which adds its variance to every squared error. Metrics that square take
``reference_variance``, the variance of the reference *mean* (not of one sample), and subtract what it
contributes: of shape (height, width, 3) for errors of RGB, (height, width) for errors of luminance. What is
left estimates the error against the true image without bias, and may come out slightly negative when the
test is as good as the reference.

All functions raise ``ValueError`` when shapes do not match or an image holds a value that is not finite.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmc_sampler import luminance, tvi

from .display import display

Pixels = NDArray[np.float64]

WHITE_LUMINANCE = 100.0
"""cd/m2 that a luminance of 1.0 stands for, unless said otherwise."""

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""FLIP's viewing conditions: a display of 3840 pixels, 0.7 m wide, seen from 0.7 m."""


def tvi_error(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = WHITE_LUMINANCE,
    reference_variance: ArrayLike | None = None,
) -> float:
    """Mean of squared luminance differences in units of the visibility threshold: 1.0 is "one threshold".

    ``mean((dY / tvi(Y_r))^2)`` with ``dY`` and ``Y_r`` in cd/m2; ``tvi`` as in Ferwerda et al. 1996
    (doi:10.1145/237170.237262), combined over rods and cones as in Ward Larson et al. 1997
    (doi:10.1109/2945.646233).
    """
    return float(
        tvi_error_map(test, reference, white_luminance=white_luminance, reference_variance=reference_variance).mean()
    )


def tvi_error_map(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = WHITE_LUMINANCE,
    reference_variance: ArrayLike | None = None,
) -> Pixels:
    """Per-pixel terms of :func:`tvi_error`, shape (height, width)."""
    x, r = _pair(test, reference)
    threshold = _threshold(r, white_luminance)
    squares = ((_luminance(x) - _luminance(r)) * white_luminance / threshold) ** 2
    variance = _variance(reference_variance, r.shape[:2])
    return squares - variance * (white_luminance / threshold) ** 2


def threshold_ratio(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """Mean of absolute luminance differences in thresholds, ``mean(abs(dY) / tvi(Y_r))``.

    Hoberock and Hart 2010, "Arbitrary importance functions for Metropolis light transport"
    (doi:10.1111/j.1467-8659.2010.01713.x).
    """
    return float(threshold_ratio_map(test, reference, white_luminance=white_luminance).mean())


def threshold_ratio_map(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> Pixels:
    """Per-pixel terms of :func:`threshold_ratio`, shape (height, width)."""
    x, r = _pair(test, reference)
    return np.abs(_luminance(x) - _luminance(r)) * white_luminance / _threshold(r, white_luminance)


def visible_pixels(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """Fraction of pixels whose luminance differs from the reference by more than one threshold, 0 to 1."""
    return float((threshold_ratio_map(test, reference, white_luminance=white_luminance) > 1.0).mean())


def mse(test: ArrayLike, reference: ArrayLike, *, reference_variance: ArrayLike | None = None) -> float:
    """Mean squared error over pixels and channels (scikit-image), less the reference's own variance."""
    from skimage.metrics import mean_squared_error

    x, r = _pair(test, reference)
    return float(mean_squared_error(r, x)) - float(_variance(reference_variance, r.shape).mean())


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


def ssim(test: ArrayLike, reference: ArrayLike, *, exposure: float = 1.0) -> float:
    """Structural similarity of the display-encoded images, 1 for equal ones.

    Wang et al. 2004 (doi:10.1109/TIP.2003.819861), as scikit-image computes it with the paper's Gaussian
    window (sigma 1.5, population statistics), averaged over R, G and B; encoding by
    :func:`pmc_sampler.eval.display.display` at ``exposure``. Images must be at least 11x11 pixels.
    """
    from skimage.metrics import structural_similarity

    x, r = _pair(test, reference)
    if min(r.shape[:2]) < 11:
        raise ValueError(
            f"SSIM needs images of at least 11x11 pixels, the window of its definition; these are "
            f"{r.shape[1]}x{r.shape[0]}."
        )
    return float(
        structural_similarity(
            display(r, exposure).astype(np.float64),
            display(x, exposure).astype(np.float64),
            data_range=1.0,
            channel_axis=2,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


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
    bright specks do not decide); it must lie in [0, 1).
    """
    if not 0.0 <= trim < 1.0:
        raise ValueError(f"trim must be a fraction of the values in [0, 1), for example 0.001; it is {trim!r}.")
    x, r = _pair(test, reference)
    scale = 1.0 / (r * r + epsilon)
    terms = ((x - r) ** 2 * scale).ravel()
    noise = (_variance(reference_variance, r.shape) * scale).ravel()
    dropped = math.floor(trim * terms.size)
    if dropped:
        kept = np.argpartition(terms, terms.size - dropped)[: terms.size - dropped]
        terms, noise = terms[kept], noise[kept]
    return float(terms.mean() - noise.mean())


def smape(test: ArrayLike, reference: ArrayLike, *, epsilon: float = 0.01) -> float:
    """Symmetric mean absolute percentage error, ``mean(2 |d| / (|r| + |x| + 2 epsilon))``, 0 to 2."""
    x, r = _pair(test, reference)
    return float((2.0 * np.abs(x - r) / (np.abs(r) + np.abs(x) + 2.0 * epsilon)).mean())


def flip(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    exposures: tuple[float, float] | None = None,
) -> float:
    """Mean HDR-FLIP, 0 to 1 (Andersson et al. 2021, doi:10.2312/egs.20211015; package ``flip-evaluator``).

    ``exposures`` is the range (start, stop) in stops over which the images are compared. Without it the
    package derives the range from the reference; :func:`flip_exposures` says which, so that it can be fixed
    per scene. Negative values, which the metric does not know, count as 0.
    """
    value, _ = _flip(test, reference, pixels_per_degree, exposures)
    return value


def flip_exposures(reference: ArrayLike) -> tuple[float, float]:
    """The exposure range (start, stop) that HDR-FLIP derives from a reference."""
    _, found = _flip(reference, reference, PIXELS_PER_DEGREE, None)
    return found


def bias(test: ArrayLike, reference: ArrayLike) -> float:
    """Relative error of the mean luminance, ``mean(dY) / mean(Y_r)``; raises for a black reference."""
    x, r = _pair(test, reference)
    mean = float(_luminance(r).mean())
    if mean == 0.0:
        raise ValueError("the reference is black, so no bias relative to its mean luminance exists.")
    return float((_luminance(x) - _luminance(r)).mean()) / mean


def _flip(
    test: ArrayLike,
    reference: ArrayLike,
    pixels_per_degree: float,
    exposures: tuple[float, float] | None,
) -> tuple[float, tuple[float, float]]:
    import flip_evaluator

    x, r = _pair(test, reference)
    if not r.max() > 0.0 and exposures is None:
        raise ValueError("HDR-FLIP cannot derive exposures from a black reference: pass exposures=(start, stop).")
    parameters: dict[str, float] = {"ppd": pixels_per_degree}
    if exposures is not None:
        if not exposures[0] <= exposures[1]:
            raise ValueError(f"exposures must be (start, stop) in stops with start <= stop; they are {exposures}.")
        parameters["startExposure"], parameters["stopExposure"] = exposures
    _, mean, used = flip_evaluator.evaluate(
        np.maximum(r, 0.0).astype(np.float32),
        np.maximum(x, 0.0).astype(np.float32),
        "HDR",
        applyMagma=False,
        parameters=parameters,
    )
    return float(mean), (float(used["startExposure"]), float(used["stopExposure"]))


def _pair(test: ArrayLike, reference: ArrayLike) -> tuple[Pixels, Pixels]:
    x, r = np.asarray(test, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    for name, image in (("test", x), ("reference", r)):
        if image.ndim != 3 or image.shape[2] != 3 or not image.size:
            raise ValueError(f"the {name} image must be linear RGB of shape (height, width, 3), not {image.shape}.")
    if x.shape != r.shape:
        raise ValueError(
            f"test and reference must have one size; the test is {x.shape[1]}x{x.shape[0]} pixels, "
            f"the reference {r.shape[1]}x{r.shape[0]}."
        )
    for name, image in (("test", x), ("reference", r)):
        bad = image.size - int(np.isfinite(image).sum())
        if bad:
            raise ValueError(f"the {name} image holds {bad} values that are not finite; no error of it can be given.")
    return x, r


def _luminance(rgb: Pixels) -> Pixels:
    return np.asarray(luminance(rgb), dtype=np.float64)


def _threshold(reference: Pixels, white_luminance: float) -> Pixels:
    if not white_luminance > 0.0:
        raise ValueError(
            f"white_luminance must be a positive number of cd/m2, for example 100; it is {white_luminance!r}."
        )
    return np.asarray(tvi(_luminance(reference) * white_luminance), dtype=np.float64)


def _variance(variance: ArrayLike | None, shape: tuple[int, ...]) -> Pixels:
    if variance is None:
        return np.zeros(shape)
    v = np.asarray(variance, dtype=np.float64)
    if v.shape != shape:
        raise ValueError(
            f"reference_variance must have the shape {shape} of what is compared, luminance or RGB; "
            f"its shape is {v.shape}."
        )
    if not np.isfinite(v).all() or v.min() < 0.0:
        raise ValueError("reference_variance must be finite and not negative.")
    return v
