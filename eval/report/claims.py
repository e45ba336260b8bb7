"""Whether results bear out what the paper says of its method.

"Paper" is Y.-C. Lai and C. Dyer, "Population Monte Carlo Path Tracing", UW-Madison CS TR 1614, 2007, sections 5 and 6:
less error in caustics and near the light and slightly more elsewhere; small radii at edges and in caustics; less gain
where much of the image is hard.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import luminance

from .. import images, metrics
from ..baselines.allocation import threshold_deviation
from ..measures import TILE
from ..results import Results
from ..statistics import ENOUGH, Interval, ratio_interval
from ..suite import Method, Scene
from .figures import rounded
from .pictures import named_crops
from .words import headline, spoken

_SMOOTH = 7  # pixels: a reference of few replicates knows the noise of a single pixel badly
_SHARE = 0.1  # of the pixels are called hard, and as many edges
# The paper gives no figures to its "slightly more" error and its small radii: up to a quarter more, and a tenth more.
_SLIGHTLY = 0.8  # times the other's inverse
_MORE = 1.1
_Map = NDArray[np.floating]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Claim:
    """A claim, what it was tested on, whether it held (None: not shown either way) and by which figures."""

    text: str
    where: str
    held: bool | None
    figures: str

    @property
    def verdict(self) -> str:
        """The outcome in words."""
        return {True: "held", False: "did not hold", None: "not shown"}[self.held]


def claims(found: Results) -> list[Claim]:
    """The verdicts, for each method that starts from the preset "paper" against uniform sampling by the same numbers.

    Errors by place and radii are those of the first seed's images; gains are over all seeds.
    """
    said: list[Claim] = []
    for method in found.suite.methods:
        base = next((m for m in found.suite.methods if _uniform(m) and m.numbers == method.numbers), None)
        if method.settings.get("preset") != "paper" or base is None:
            continue
        gains: list[tuple[float, Interval, str]] = []
        for scene in found.suite.scenes:
            said += _by_place(found, scene, base, method, gains)
        if len(gains) > 1:
            said.append(order(gains, method.name, found.suite.seeds))
    return said


def noise_map(variance: _Map, mean: _Map, white_luminance: float) -> _Map:
    """Standard deviation of luminance in visibility thresholds, smoothed over 7x7 pixels; shape (height, width).

    ``variance`` of a pixel's luminance (height, width) and ``mean`` radiance (height, width, 3), in radiance units.
    """
    from scipy.ndimage import uniform_filter

    y = np.asarray(luminance(mean.astype(np.float64)), np.float64)
    s = threshold_deviation(variance.astype(np.float64), y, white_luminance)
    result: _Map = np.sqrt(np.maximum(uniform_filter(s**2, _SMOOTH), 0.0))
    return result


def most(values: _Map) -> _Mask:
    """The tenth of the pixels with the largest values, of those above the least by more than rounding."""
    result: _Mask = (values >= np.quantile(values, 1.0 - _SHARE)) & (values > values.min() + 1e-6 * np.ptp(values))
    return result


def edges(mean: _Map) -> _Mask:
    """The tenth of the pixels with the steepest logarithm of luminance (Sobel)."""
    from skimage.filters import sobel

    y = luminance(mean.astype(np.float64))
    return most(sobel(np.log(np.maximum(y, 1e-3 * y.mean() + 1e-12))))


def ratio_within(base: _Map, own: _Map, mask: _Mask) -> Interval:
    """The error of ``base`` over that of ``own``, maps of squared errors, within a mask.

    With its 95 % percentile bootstrap interval over tiles of 16x16 pixels (Efron 1979, doi:10.1214/aos/1176344552).
    """
    return _over_tiles(lambda a, b: a / b, [np.where(mask, base, 0.0), np.where(mask, own, 0.0)], mask)


def share_within(part: _Map, whole: _Map, mask: _Mask) -> Interval:
    """The share of ``part`` in ``whole`` within a mask over that outside of it; interval as of :func:`ratio_within`."""
    maps = [np.where(place, values, 0.0) for place in (mask, ~mask) for values in (part, whole)]
    return _over_tiles(lambda a, b, c, d: (a / b) / (c / d), maps, np.ones_like(mask))


def _over_tiles(of_sums: Callable[..., Any], maps: list[_Map], mask: _Mask) -> Interval:
    """A function of the maps' sums, with its interval over the tiles that the mask has a part in."""
    from scipy.stats import bootstrap

    rows, columns = np.nonzero(mask)
    tile = rows // TILE * mask.shape[1] + columns // TILE
    _, tile = np.unique(tile, return_inverse=True)
    sums = [np.bincount(tile, values[mask]) for values in maps]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = float(of_sums(*(one.sum() for one in sums)))
        if len(sums[0]) < 2:
            return Interval(found, float("-inf"), float("inf"))
        interval = bootstrap(
            sums,
            lambda *drawn, axis: of_sums(*(one.sum(axis=axis) for one in drawn)),
            paired=True,
            vectorized=True,
            n_resamples=2000,
            method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval
    return Interval(found, float(interval.low), float(interval.high))


def order(gains: list[tuple[float, Interval, str]], name: str, seeds: int) -> Claim:
    """Whether the gain falls from scene to scene with the share of the pixels that carries half of the noise.

    It holds where no two intervals overlap, and does not where a harder scene's lies above that of the one before;
    neither is shown by intervals over few seeds.
    """
    ranked = sorted(gains, key=lambda one: one[0])
    figures = ", ".join(f"{scene}: {100 * share:.0f} % and {_spelt(gain)}" for share, gain, scene in ranked)
    steps = list(itertools.pairwise(gain for _, gain, _ in ranked))
    held = None
    if seeds >= ENOUGH and all(easier.low > harder.high for easier, harder in steps):
        held = True
    elif seeds >= ENOUGH and any(easier.high < harder.low for easier, harder in steps):
        held = False
    return Claim(
        "Less gain where much of the image is hard",
        name,
        held,
        f"pixels that carry half of the noise, and gain in tvi error: {figures}",
    )


def _uniform(method: Method) -> bool:
    return bool(method.settings["sampler"] == "uniform")


def _by_place(
    found: Results, scene: Scene, base: Method, method: Method, gains: list[tuple[float, Interval, str]]
) -> list[Claim]:
    """The claims on a scene's images; adds to ``gains``. Empty where a run or an image is missing."""
    budget, path = headline(found, scene), found.reference_path(scene.name)
    files = [] if budget is None else [found.image_path(scene.name, m.name, str(budget)) for m in (base, method)]
    if budget is None or path is None or None in files:
        return []
    reference = images.read(path)
    plain, own = (images.read(file) for file in files if file is not None)
    white, variance = found.suite.white_luminance, reference.layers["luminance_variance"]
    noise = noise_map(variance, reference.rgb, white)
    hard, where = most(noise), f"{scene.name}, {method.name}, {spoken(budget)}"
    if not hard.any():
        return []
    errors = [
        metrics.tvi_error_map(image.rgb, reference.rgb, white_luminance=white, reference_variance=variance)
        for image in (plain, own)
    ]
    within, elsewhere = (ratio_within(errors[0], errors[1], mask) for mask in (hard, ~hard))
    values = np.sort(noise.ravel() ** 2)[::-1].cumsum()
    pairs = found.pairs(scene.name, str(budget), base.name, method.name, "tvi_error")
    if min(pairs[1], default=0.0) > 0.0:
        gains.append(
            (float(np.searchsorted(values, values[-1] / 2) + 1) / values.size, ratio_interval(*pairs), scene.name)
        )
    over = f"tvi error of {base.name} over it"
    said = [
        Claim(
            "Less error in caustics and near the light: in the tenth of the pixels that is hardest",
            where,
            _above(within, 1.0),
            f"{over}: {_spelt(within)}",
        )
    ]
    for crop in named_crops(scene, hard.shape):
        mask = np.zeros_like(hard)
        crop.of(mask)[:] = True
        inside = ratio_within(errors[0], errors[1], mask)
        said.append(Claim(f"Less error there: {crop.why}", where, _above(inside, 1.0), f"{over}: {_spelt(inside)}"))
    less, more = _above(elsewhere, 1.0) is True, _above(elsewhere, _SLIGHTLY) is False
    instead = ": less" if less else ": far more" if more else ""
    said.append(
        Claim(
            "Slightly more error elsewhere: up to a quarter more",
            where,
            between(elsewhere, _SLIGHTLY, 1.0),
            f"{over}: {_spelt(elsewhere)}{instead}",
        )
    )
    radii = own.layers.get("strategy")
    if radii is not None and radii.sum() > 0.0:
        special = hard | edges(reference.rgb)
        small, rest = (float(radii[mask][:, 0].sum() / max(radii[mask].sum(), 1e-12)) for mask in (special, ~special))
        ratio = share_within(radii[..., 0].astype(np.float64), radii.sum(axis=2, dtype=np.float64), special)
        said.append(
            Claim(
                "Small radii at edges and in caustics: a tenth more of them",
                where,
                _above(ratio, _MORE),
                f"share of the smallest radius: {100 * small:.1f} % there, {100 * rest:.1f} % elsewhere, "
                f"{_spelt(ratio)} times as much",
            )
        )
    return said


def between(interval: Interval, low: float, high: float) -> bool | None:
    """Whether what an interval is of lies between two values; None where the interval does not tell."""
    above, below = _above(interval, low), _above(interval, high)
    return False if above is False or below is True else True if above is True and below is False else None


def _above(interval: Interval, value: float) -> bool | None:
    return True if interval.low > value else False if interval.high < value else None


def _spelt(interval: Interval) -> str:
    return f"{rounded(interval.median)} ({rounded(interval.low)} to {rounded(interval.high)})"
