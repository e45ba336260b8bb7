"""Metrics in units of what the eye can see: thresholds versus intensity, and Yee's model."""

import math

import numpy as np
from numpy.typing import ArrayLike

from pmc_sampler import tvi

from .pair import Pixels, luminance_of, pair, variance_of
from .viewing import PIXELS_PER_DEGREE, WHITE_LUMINANCE, check_pixels_per_degree, check_white_luminance


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
    x, r = pair(test, reference)
    threshold = _threshold(r, white_luminance)
    squares = ((luminance_of(x) - luminance_of(r)) * white_luminance / threshold) ** 2
    variance = variance_of(reference_variance, r.shape[:2])
    return squares - variance * (white_luminance / threshold) ** 2


def threshold_ratio(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """Mean of absolute luminance differences in thresholds, ``mean(abs(dY) / tvi(Y_r))``.

    Hoberock and Hart 2010, "Arbitrary importance functions for Metropolis light transport"
    (doi:10.1111/j.1467-8659.2010.01713.x).
    """
    return float(threshold_ratio_map(test, reference, white_luminance=white_luminance).mean())


def threshold_ratio_map(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> Pixels:
    """Per-pixel terms of :func:`threshold_ratio`, shape (height, width)."""
    x, r = pair(test, reference)
    return np.abs(luminance_of(x) - luminance_of(r)) * white_luminance / _threshold(r, white_luminance)


def visible_pixels(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """Fraction of pixels whose luminance differs from the reference by more than one threshold, 0 to 1."""
    return float((threshold_ratio_map(test, reference, white_luminance=white_luminance) > 1.0).mean())


def yee(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = WHITE_LUMINANCE,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
) -> float:
    """Fraction of pixels that Yee's perceptual test tells apart, 0 to 1, as OpenImageIO's ``compare_Yee`` has it.

    Yee 2004, "A perceptual metric for production testing" (Journal of Graphics Tools 9(4),
    doi:10.1080/10867651.2004.10504900). A pixel fails where luminance differs by more than the threshold at
    its adaptation level, raised by contrast sensitivity and masking, or where colour differs. OpenImageIO
    asks for a horizontal field of view: it is the image's width at ``pixels_per_degree``. Negative values,
    which the metric does not know, count as 0.
    """
    import OpenImageIO

    x, r = pair(test, reference)
    halves = r.shape[1] / 2 / check_pixels_per_degree(pixels_per_degree)
    # The inverse of OpenImageIO's pixels per degree = width / (2 tan(fov / 2) 180 / pi).
    field_of_view = 2.0 * math.degrees(math.atan(math.radians(halves)))
    first, second = (
        OpenImageIO.ImageBuf(np.ascontiguousarray(np.maximum(image, 0.0), dtype=np.float32)) for image in (r, x)
    )
    found = OpenImageIO.CompareResults()
    white = check_white_luminance(white_luminance)
    OpenImageIO.ImageBufAlgo.compare_Yee(first, second, found, luminance=white, fov=field_of_view)
    if first.has_error:
        raise ValueError(f"OpenImageIO cannot compare these images: {first.geterror()}.")
    return float(found.nfail / (r.shape[0] * r.shape[1]))


def _threshold(reference: Pixels, white_luminance: float) -> Pixels:
    white = check_white_luminance(white_luminance)
    return np.asarray(tvi(luminance_of(reference) * white), dtype=np.float64)
