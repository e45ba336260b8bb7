"""All metrics of one image against another, each with the constants that shaped it."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from . import metrics


@dataclass(frozen=True)
class Measure:
    """One figure: ``name``, ``value``, ``unit`` (may be empty) and the free ``constants`` behind it."""

    name: str
    value: float
    unit: str = ""
    constants: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """The same as a mapping, for JSON."""
        return asdict(self)


def compare(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = metrics.WHITE_LUMINANCE,
    exposure: float = 1.0,
    pixels_per_degree: float = metrics.PIXELS_PER_DEGREE,
) -> list[Measure]:
    """Every metric of :mod:`pmc_sampler.eval.metrics` on linear RGB images of shape (height, width, 3).

    ``white_luminance`` in cd/m2 for metrics of visibility, ``exposure`` for display-encoded ones. Nothing
    of the reference's own noise is subtracted: an image file does not hold it. SSIM is left out for images
    under 11x11 pixels, HDR-FLIP and the bias for a black reference: they do not exist there. Raises
    ``ValueError`` as the metrics do.
    """
    return list(_measures(test, reference, white_luminance, exposure, pixels_per_degree))


def _measures(test: ArrayLike, reference: ArrayLike, white: float, exposure: float, ppd: float) -> Iterator[Measure]:
    cd = {"white_luminance_cd_m2": white}
    yield Measure("tvi error", metrics.tvi_error(test, reference, white_luminance=white), "thresholds^2", cd)
    yield Measure(
        "mean threshold ratio",
        metrics.threshold_ratio(test, reference, white_luminance=white),
        "thresholds",
        cd,
    )
    yield Measure("visible pixels", metrics.visible_pixels(test, reference, white_luminance=white), "", cd)
    yield Measure("MSE", metrics.mse(test, reference))
    yield Measure("RMSE", metrics.rmse(test, reference))
    yield Measure("PSNR", metrics.psnr(test, reference, peak=1.0), "dB", {"peak": 1.0})
    if min(np.shape(reference)[:2]) >= 11:
        yield Measure(
            "SSIM", metrics.ssim(test, reference, exposure=exposure), "", {"exposure": exposure, "sigma": 1.5}
        )
    yield Measure("relMSE", metrics.relmse(test, reference), "", {"epsilon": 0.01})
    yield Measure("relMSE, trimmed", metrics.relmse(test, reference, trim=0.001), "", {"epsilon": 0.01, "trim": 0.001})
    yield Measure("SMAPE", metrics.smape(test, reference), "", {"epsilon": 0.01})
    if not np.max(np.asarray(reference)) > 0.0:
        return
    exposures = metrics.flip_exposures(reference)
    yield Measure(
        "HDR-FLIP",
        metrics.flip(test, reference, pixels_per_degree=ppd, exposures=exposures),
        "",
        {"pixels_per_degree": ppd, "start_exposure": exposures[0], "stop_exposure": exposures[1]},
    )
    yield Measure("bias", metrics.bias(test, reference))
