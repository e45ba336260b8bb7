"""Image errors: pure functions of a test image and a reference.

Images are linear RGB of shape (height, width, 3); ``luminance`` means Rec. 709. Every free constant is a
keyword argument, so that whoever prints a figure can print what shaped it. ``NAME_map`` gives the per-pixel
terms behind the figure ``NAME``, where there are such.

A reference has noise of its own, which adds its variance to every squared error. Metrics that square take
``reference_variance``, the variance of the reference *mean* (not of one sample), and subtract what it
contributes: of shape (height, width, 3) for errors of RGB, (height, width) for errors of luminance. What is
left estimates the error against the true image without bias, and may come out slightly negative when the
test is as good as the reference.

All functions raise ``ValueError`` when shapes do not match or an image holds a value that is not finite.
"""

from .encoded import (
    delta_e,
    delta_e_map,
    flip,
    flip_exposures,
    flip_map,
    ldr_flip,
    ldr_flip_map,
    pu21_encode,
    pu21_psnr,
    pu21_ssim,
    ssim,
    ssim_map,
)
from .errors import bias, mse, psnr, relmse, relmse_map, rmse, smape, smape_map, squared_error_map
from .viewing import PIXELS_PER_DEGREE, WHITE_LUMINANCE
from .visibility import threshold_ratio, threshold_ratio_map, tvi_error, tvi_error_map, visible_pixels, yee

__all__ = [
    "PIXELS_PER_DEGREE",
    "WHITE_LUMINANCE",
    "bias",
    "delta_e",
    "delta_e_map",
    "flip",
    "flip_exposures",
    "flip_map",
    "ldr_flip",
    "ldr_flip_map",
    "mse",
    "psnr",
    "pu21_encode",
    "pu21_psnr",
    "pu21_ssim",
    "relmse",
    "relmse_map",
    "rmse",
    "smape",
    "smape_map",
    "squared_error_map",
    "ssim",
    "ssim_map",
    "threshold_ratio",
    "threshold_ratio_map",
    "tvi_error",
    "tvi_error_map",
    "visible_pixels",
    "yee",
]
