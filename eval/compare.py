"""All metrics of one image against another, each with the constants that shaped it, and their maps."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


@dataclass(frozen=True)
class ErrorMap:
    """A metric's per-pixel terms: ``values`` (height, width), of RGB errors the mean over the channels.

    ``metric`` is the function's name in :mod:`pmc_sampler.eval.metrics`, ``name`` the one in tables; ``best`` is
    the value of equal images.
    """

    metric: str
    name: str
    values: NDArray[np.float64]
    unit: str
    constants: dict[str, float]
    best: float = 0.0


@dataclass(frozen=True)
class Noise:
    """The variance of a reference's own mean: of RGB (height, width, 3) and of luminance (height, width)."""

    rgb: NDArray[np.floating]
    luminance: NDArray[np.floating]

    def added(self, reference: ArrayLike, white_luminance: float = metrics.WHITE_LUMINANCE) -> dict[str, float]:
        """What it adds to the MSE and to the tvi error, and is subtracted."""
        zero = metrics.tvi_error(
            reference, reference, white_luminance=white_luminance, reference_variance=self.luminance
        )
        return {"MSE": float(np.mean(self.rgb, dtype=np.float64)), "tvi error": -zero}


def compare(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = metrics.WHITE_LUMINANCE,
    exposure: float = 1.0,
    pixels_per_degree: float = metrics.PIXELS_PER_DEGREE,
    noise: Noise | None = None,
) -> list[Measure]:
    """Every metric of :mod:`pmc_sampler.eval.metrics` on linear RGB images of shape (height, width, 3).

    ``white_luminance`` in cd/m2 for metrics of visibility, ``exposure`` for display-encoded ones. The reference's
    own ``noise`` is subtracted from squared errors where it is known. SSIM is left out for images under 11x11
    pixels, HDR-FLIP and the bias for a black reference: they do not exist there. Raises ``ValueError`` as the
    metrics do.
    """
    return [
        Measure(row.name, row.value(test, reference, **row.arguments), row.unit, row.constants)
        for row in _rows(reference, white_luminance, exposure, pixels_per_degree, noise)
    ]


def error_maps(
    test: ArrayLike,
    reference: ArrayLike,
    *,
    white_luminance: float = metrics.WHITE_LUMINANCE,
    exposure: float = 1.0,
    pixels_per_degree: float = metrics.PIXELS_PER_DEGREE,
    noise: Noise | None = None,
) -> list[ErrorMap]:
    """The map of every metric that has one; arguments, omissions and errors as :func:`compare`."""
    found = []
    for row in _rows(reference, white_luminance, exposure, pixels_per_degree, noise):
        if row.terms is None:
            continue
        values = row.terms(test, reference, **row.arguments)
        values = values.mean(axis=2) if values.ndim == 3 else values
        metric = row.value.__name__
        found.append(ErrorMap(metric, row.name, values, row.unit, row.constants, row.best))
    return found


def constants(white_luminance: float = metrics.WHITE_LUMINANCE) -> dict[str, dict[str, float]]:
    """The constants of every metric that has some, by its name, as a benchmark takes them.

    The exposures of HDR-FLIP are left out: they follow from each reference.
    """
    rows = _rows(np.ones((16, 16, 3)), white_luminance, 1.0, metrics.PIXELS_PER_DEGREE)
    found = {row.name: {k: v for k, v in row.constants.items() if not k.endswith("_exposure")} for row in rows}
    return {name: values for name, values in found.items() if values}


@dataclass(frozen=True)
class _Row:
    name: str
    value: Callable[..., float]
    terms: Callable[..., NDArray[np.float64]] | None = None
    unit: str = ""
    arguments: dict[str, object] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)
    best: float = 0.0


def _rows(reference: ArrayLike, white: float, exposure: float, ppd: float, noise: Noise | None = None) -> list[_Row]:
    m = metrics
    own: dict[str, object] = {} if noise is None else {"reference_variance": noise.rgb}
    own_y: dict[str, object] = {} if noise is None else {"reference_variance": noise.luminance}
    r = np.asarray(reference, dtype=np.float64)
    cd: dict[str, object] = {"white_luminance": white}
    shown: dict[str, object] = {"exposure": exposure}
    angle: dict[str, object] = {"pixels_per_degree": ppd}
    cd_, shown_, angle_ = {"white_luminance_cd_m2": white}, {"exposure": exposure}, {"pixels_per_degree": ppd}
    rows = [
        _Row("tvi error", m.tvi_error, m.tvi_error_map, "thresholds^2", {**cd, **own_y}, cd_),
        _Row("mean threshold ratio", m.threshold_ratio, m.threshold_ratio_map, "thresholds", cd, cd_),
        _Row("visible pixels", m.visible_pixels, None, "", cd, cd_),
        _Row("Yee", m.yee, None, "", {**cd, **angle}, {**cd_, **angle_}),
        _Row("MSE", m.mse, m.squared_error_map, "", own),
        _Row("RMSE", m.rmse, None, "", own),
        _Row("PSNR", m.psnr, None, "dB", {"peak": 1.0, **own}, {"peak": 1.0}),
        _Row("relMSE", m.relmse, m.relmse_map, "", {"epsilon": 0.01, **own}, {"epsilon": 0.01}),
        _Row("relMSE, trimmed", m.relmse, None, "", {"trim": 0.001, **own}, {"epsilon": 0.01, "trim": 0.001}),
        _Row("SMAPE", m.smape, m.smape_map, "", {"epsilon": 0.01}, {"epsilon": 0.01}),
        _Row("PU21-PSNR", m.pu21_psnr, None, "dB", cd, cd_ | {"peak": 256.0}),
        _Row("delta E 2000", m.delta_e, m.delta_e_map, "", shown, shown_),
        _Row("LDR-FLIP", m.ldr_flip, m.ldr_flip_map, "", {**shown, **angle}, {**shown_, **angle_}),
    ]
    if min(r.shape[:2], default=0) >= 11:
        sigma = {"sigma": 1.5}
        rows.append(_Row("SSIM", m.ssim, m.ssim_map, "", shown, shown_ | sigma, best=1.0))
        rows.append(_Row("PU21-SSIM", m.pu21_ssim, None, "", cd, cd_ | sigma))
    if r.size and np.isfinite(r).all() and r.max() > 0.0:
        start, stop = m.flip_exposures(r)
        range_ = {"start_exposure": start, "stop_exposure": stop}
        arguments = {**angle, "exposures": (start, stop)}
        rows.append(_Row("HDR-FLIP", m.flip, m.flip_map, "", arguments, angle_ | range_))
        rows.append(_Row("bias", m.bias))
    return rows
