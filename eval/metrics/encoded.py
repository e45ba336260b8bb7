"""Metrics of encoded images: what a display, or the eye before one, makes of linear values.

SSIM, LDR-FLIP and delta E compare what :mod:`pmc_sampler.eval.display` shows at an ``exposure`` (a factor on
the linear values). PU21 encodes luminance in cd/m2 and HDR-FLIP covers a range of exposures, so that neither
needs one.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..display import display, tone_map
from .pair import Pixels, luminance_of, pair
from .viewing import PIXELS_PER_DEGREE, WHITE_LUMINANCE, check_pixels_per_degree, check_white_luminance

SSIM_WINDOW = 11  # pixels: the Gaussian of sigma 1.5, cut off at 3.5 sigma


def ssim(test: ArrayLike, reference: ArrayLike, *, exposure: float = 1.0) -> float:
    """Structural similarity of the display-encoded images, 1 for equal ones.

    Wang et al. 2004 (doi:10.1109/TIP.2003.819861), as scikit-image computes it with the paper's Gaussian
    window (sigma 1.5, population statistics), averaged over R, G and B; encoding by
    :func:`pmc_sampler.eval.display.display` at ``exposure``. Images must be at least 11x11 pixels.
    """
    x, r = pair(test, reference)
    return _ssim(display(x, exposure), display(r, exposure), data_range=1.0)[0]


def ssim_map(test: ArrayLike, reference: ArrayLike, *, exposure: float = 1.0) -> Pixels:
    """SSIM around each pixel, averaged over R, G and B, shape (height, width).

    :func:`ssim` is its mean without the five pixels at each border, whose windows lack a part.
    """
    x, r = pair(test, reference)
    return np.asarray(_ssim(display(x, exposure), display(r, exposure), data_range=1.0)[1].mean(axis=2))


def pu21_encode(luminance_cd_m2: ArrayLike) -> Pixels:
    """Perceptually uniform values of luminance in cd/m2; same shape. 100 cd/m2 becomes 256, the black of a display 0.

    PU21 with the fit "banding and glare" (Mantiuk and Azimi 2021, doi:10.1109/PCS50896.2021.9477471),
    ``V = p7 (((p1 + p2 Y^p4) / (1 + p3 Y^p4))^p5 - p6)``, with Y clamped to the 0.005 to 10000 cd/m2 it is
    fitted to and negative V to 0. No maintained package has it.
    """
    p1, p2, p3, p4 = 0.353487901, 0.3734658629, 8.277049286e-5, 0.9062562627
    p5, p6, p7 = 0.09150303166, 0.9099517204, 596.3148142
    power = np.clip(np.asarray(luminance_cd_m2, dtype=np.float64), 0.005, 10_000.0) ** p4
    return np.asarray(np.maximum(p7 * (((p1 + p2 * power) / (1.0 + p3 * power)) ** p5 - p6), 0.0))


def pu21_psnr(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """PSNR of the PU21 values of luminance in dB, peak 256 (its authors' "PSNRY"); infinite for equal images."""
    from skimage.metrics import peak_signal_noise_ratio

    x, r = _pu21(test, reference, white_luminance)
    if np.array_equal(x, r):
        return float("inf")  # scikit-image divides by zero there, with a warning
    return float(peak_signal_noise_ratio(r, x, data_range=256.0))


def pu21_ssim(test: ArrayLike, reference: ArrayLike, *, white_luminance: float = WHITE_LUMINANCE) -> float:
    """SSIM of the PU21 values of luminance, window as :func:`ssim`, data range 256; 1 for equal images."""
    return _ssim(*_pu21(test, reference, white_luminance), data_range=256.0)[0]


def delta_e(test: ArrayLike, reference: ArrayLike, *, exposure: float = 1.0) -> float:
    """Mean CIEDE2000 colour difference of the tone-mapped images; about 1 is just noticeable on large patches.

    CIE 142-2001, tested by Sharma et al. 2005 (doi:10.1002/col.20070), as colour-science computes it.
    Tone-mapping by :func:`pmc_sampler.eval.display.tone_map`; 1 is the white of sRGB (D65).
    """
    return float(delta_e_map(test, reference, exposure=exposure).mean())


def delta_e_map(test: ArrayLike, reference: ArrayLike, *, exposure: float = 1.0) -> Pixels:
    """Per-pixel terms of :func:`delta_e`, shape (height, width)."""
    import colour

    x, r = (
        colour.XYZ_to_Lab(colour.RGB_to_XYZ(tone_map(image, exposure), "sRGB", apply_cctf_decoding=False))
        for image in pair(test, reference)
    )
    return np.asarray(colour.delta_E(r, x, method="CIE 2000"), dtype=np.float64)


def ldr_flip(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    exposure: float = 1.0,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
) -> float:
    """Mean LDR-FLIP of the display-encoded images, 0 to 1.

    Andersson et al. 2020 (doi:10.1145/3406183; package ``flip-evaluator``); encoding by
    :func:`pmc_sampler.eval.display.display` at ``exposure``.
    """
    return float(ldr_flip_map(test, reference, exposure=exposure, pixels_per_degree=pixels_per_degree).mean())


def ldr_flip_map(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    exposure: float = 1.0,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
) -> Pixels:
    """Per-pixel terms of :func:`ldr_flip`, shape (height, width)."""
    x, r = pair(test, reference)
    return _flip(display(x, exposure), display(r, exposure), "LDR", pixels_per_degree)[0]


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
    return float(flip_map(test, reference, pixels_per_degree=pixels_per_degree, exposures=exposures).mean())


def flip_map(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    pixels_per_degree: float = PIXELS_PER_DEGREE,
    exposures: tuple[float, float] | None = None,
) -> Pixels:
    """Per-pixel terms of :func:`flip`, shape (height, width): the largest LDR-FLIP over all exposures."""
    x, r = pair(test, reference)
    return _hdr_flip(x, r, pixels_per_degree, exposures)[0]


def flip_exposures(reference: ArrayLike) -> tuple[float, float]:
    """The exposure range (start, stop) that HDR-FLIP derives from a reference."""
    _, r = pair(reference, reference)
    _, used = _hdr_flip(r, r, PIXELS_PER_DEGREE, None)
    return float(used["startExposure"]), float(used["stopExposure"])


def _hdr_flip(
    x: Pixels, r: Pixels, pixels_per_degree: float, exposures: tuple[float, float] | None
) -> tuple[Pixels, dict[str, Any]]:
    if not r.max() > 0.0 and exposures is None:
        raise ValueError("HDR-FLIP cannot derive exposures from a black reference: pass exposures=(start, stop).")
    chosen: dict[str, float] = {}
    if exposures is not None:
        if not exposures[0] <= exposures[1]:
            raise ValueError(f"exposures must be (start, stop) in stops with start <= stop; they are {exposures}.")
        chosen = {"startExposure": exposures[0], "stopExposure": exposures[1]}
    return _flip(np.maximum(x, 0.0), np.maximum(r, 0.0), "HDR", pixels_per_degree, **chosen)


def _flip(
    x: ArrayLike, r: ArrayLike, dynamic_range: str, pixels_per_degree: float, **chosen: float
) -> tuple[Pixels, dict[str, Any]]:
    import flip_evaluator

    errors, _, used = flip_evaluator.evaluate(
        np.ascontiguousarray(r, dtype=np.float32),
        np.ascontiguousarray(x, dtype=np.float32),
        dynamic_range,
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": check_pixels_per_degree(pixels_per_degree), **chosen},
    )
    return np.asarray(errors, dtype=np.float64)[..., 0], used


def _ssim(x: ArrayLike, r: ArrayLike, data_range: float) -> tuple[float, Pixels]:
    from skimage.metrics import structural_similarity

    a, b = np.asarray(x, dtype=np.float64), np.asarray(r, dtype=np.float64)
    if min(b.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"SSIM needs images of at least {SSIM_WINDOW}x{SSIM_WINDOW} pixels, the window of its definition; "
            f"these are {b.shape[1]}x{b.shape[0]}."
        )
    mean, local = structural_similarity(
        b,
        a,
        data_range=data_range,
        channel_axis=2 if b.ndim == 3 else None,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return float(mean), np.asarray(local, dtype=np.float64)


def _pu21(test: ArrayLike, reference: ArrayLike, white_luminance: float) -> tuple[Pixels, Pixels]:
    white = check_white_luminance(white_luminance)
    x, r = pair(test, reference)
    return pu21_encode(luminance_of(x) * white), pu21_encode(luminance_of(r) * white)
