"""The report's plots, by matplotlib, as SVG images. Methods differ by line, marker and hatch as well as by colour."""

import base64
import io
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..results import Results
from ..statistics import Interval, Welch, median_interval
from ..suite import OWN, Scene
from . import figures

HIGHER_IS_BETTER = frozenset({"psnr", "ssim", "pu21_psnr", "pu21_ssim"})

# Okabe and Ito's colours, told apart by the colour-blind (https://jfly.uni-koeln.de/color/).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
_LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
_MARKERS = "osD^vPX*<>"
_HATCHES = ("", "////", "....")
_STYLE: Any = {
    "font.size": 9,
    "svg.hashsalt": "pmc_sampler",
    "svg.fonttype": "none",
    "text.parse_math": False,  # names of methods may hold a dollar
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.linewidth": 0.6,
}


@dataclass(frozen=True)
class Plot:
    """An SVG image as a data URI, with what it shows in words."""

    uri: str
    alt: str
    caption: str = ""


def error_plot(found: Results, scene: Scene, metric: str) -> Plot | None:
    """A metric against samples per pixel, and against seconds below: medians with bands over seeds.

    Against seconds alone where every budget is one of time. None where no run is done. Values that have no logarithm
    are left out, and the caption says how many.
    """
    left_out = 0
    log = metric not in HIGHER_IS_BETTER
    series: list[tuple[int, str, list[_Point]]] = []
    for number, method in enumerate(found.suite.methods):
        points = []
        for budget in found.suite.budgets(scene):
            rows = found.select(scene.name, method.name, str(budget))
            if not rows:
                continue
            interval = median_interval([row[metric] for row in rows])
            if log and not interval.low > 0.0:
                left_out += 1
                continue
            spp, seconds = (float(np.median([row[x] for row in rows])) for x in ("spp", "seconds.total"))
            points.append(_Point(spp, seconds, interval, of_time=budget.kind == "seconds"))
        if points:
            series.append((number, method.name, points))
    if not series:
        return None
    rows_of_legend = -(-len(series) // 2)
    samples = sorted(budget.value for budget in scene.budgets if budget.kind == "spp")
    axes_shown = [("spp", "samples per pixel"), ("seconds", "seconds")]
    if all(point.of_time for _, _, points in series for point in points):
        del axes_shown[0]

    def draw(figure: Any) -> None:
        handles = {}
        for place, (x, title) in enumerate(axes_shown):
            axes = _panel(figure, place, len(axes_shown), rows_of_legend)
            every: list[float] = []
            for number, name, of_method in series:
                points = sorted((p for p in of_method if x == "seconds" or not p.of_time), key=lambda p: getattr(p, x))
                if not points:
                    continue
                at = [getattr(point, x) for point in points]
                every += at
                native = found.suite.methods[number].native
                handles[name] = _curve(axes, at, [p.interval for p in points], number, joined=not native)
            axes.set_xlabel(title)
            axes.set_ylabel(label(metric))
            if every:
                _log_axis(axes, "x", every, samples if x == "spp" and 1 < len(samples) < 7 else None)
            if log:
                _log_axis(axes, "y", [v for _, _, ps in series for p in ps for v in (p.interval.low, p.interval.high)])
        _legend(figure, handles)

    missing = f" {left_out} points are not above the reference's noise and have no logarithm." if left_out else ""
    best = "higher" if metric in HIGHER_IS_BETTER else "lower"
    alt = f"{label(metric)} on {scene.name}: " + "; ".join(
        f"{name} {points[-1].interval.median:.3g} at {points[-1].spp:.3g} samples per pixel, {points[-1].seconds:.3g} s"
        for _, name, points in series
    )
    against = " and ".join(f"against {title}" for _, title in axes_shown)
    caption = f"{label(metric)} {against}; {best} is better.{missing}"
    return Plot(_svg(draw, _panel_size(len(axes_shown), rows_of_legend)), alt, caption)


def sweep_plot(found: Results, scene: Scene, metric: str, parameter: str, methods: Mapping[Any, str]) -> Plot | None:
    """A metric against the values of a setting, ``methods`` by value; a curve for each budget. None without runs.

    Values that are lists of numbers stand side by side, in order.
    """
    curves = []
    ordered = sorted(methods)
    listed = bool(ordered) and isinstance(ordered[0], tuple)
    names = [", ".join(f"{one:g}" for one in value) if listed else f"{value:g}" for value in ordered]
    for budget in scene.budgets:
        points = []
        for place, value in enumerate(ordered):
            name = methods[value]
            rows = found.select(scene.name, name, str(budget))
            if rows:
                points.append((place, median_interval([row[metric] for row in rows])))
        if points:
            curves.append((str(budget), points))
    if not curves:
        return None

    rows_of_legend = -(-len(curves) // 2)

    def draw(figure: Any) -> None:
        axes = _panel(figure, 0, 1, rows_of_legend)
        handles = {}
        for number, (name, points) in enumerate(curves):
            places = [place if listed else ordered[place] for place, _ in points]
            handles[name] = _curve(axes, places, [interval for _, interval in points], number, joined=not listed)
        ends = [end for _, points in curves for _, i in points for end in (i.low, i.high)]
        if metric not in HIGHER_IS_BETTER and min(ends) > 0:
            _log_axis(axes, "y", ends)
        if listed:
            axes.set_xticks(range(len(names)), names)
            axes.set_xmargin(0.1)
        axes.set_xlabel(parameter)
        axes.set_ylabel(label(metric))
        _legend(figure, handles)

    alt = f"{label(metric)} on {scene.name} against {parameter}: " + "; ".join(
        f"at {name} " + ", ".join(f"{i.median:.3g} for {names[place]}" for place, i in points)
        for name, points in curves
    )
    size = _panel_size(1, rows_of_legend)
    return Plot(_svg(draw, size), alt, f"{label(metric)} against the setting {parameter}.")


def time_plot(found: Results, scene: Scene, budget: str, title: str) -> Plot | None:
    """Median seconds of each method in the renderer, the sampler and the rest, at a budget called ``title``.

    None without runs.
    """
    names, parts = [], []
    for method in found.suite.methods:
        rows = found.select(scene.name, method.name, budget) or found.select(scene.name, method.name, str(OWN))
        if not rows:
            continue
        split = [(row["seconds.renderer"], row["seconds.sampler"]) for row in rows]
        rest = [row["seconds.total"] - r - s for row, (r, s) in zip(rows, split, strict=True)]
        names.append(method.name)
        parts.append((*np.median(split, axis=0), max(float(np.median(rest)), 0.0)))
    if not names:
        return None
    kinds = ("renderer", "sampler", "rest")

    inches = 1.0 + 0.45 * len(names)

    def draw(figure: Any) -> None:
        axes = figure.add_axes((0.03, 0.75 / inches, 0.94, 1.0 - 0.85 / inches))
        left = np.zeros(len(names))
        handles = {}
        for kind, (title, values) in enumerate(zip(kinds, np.transpose(parts), strict=True)):
            colour = ("#56B4E9", "#E69F00", "#ffffff")[kind]
            handles[title] = axes.barh(range(len(names)), values, 0.4, left=left, hatch=_HATCHES[kind], color=colour,
                                       edgecolor="black", linewidth=0.6)  # fmt: skip
            left += values
        for place, name in enumerate(names):
            axes.text(0.0, place - 0.3, name, verticalalignment="bottom")
        axes.set_ylim(len(names) - 0.7, -0.85)
        axes.set_yticks([])
        axes.set_xlabel("seconds")
        _legend(figure, handles, 3)

    alt = f"Seconds on {scene.name} at {title}: " + "; ".join(
        f"{name} " + ", ".join(f"{kind} {value:.2f}" for kind, value in zip(kinds, values, strict=True))
        for name, values in zip(names, parts, strict=True)
    )
    return Plot(_svg(draw, (_WIDTH, inches)), alt, f"Where the time went, medians over seeds at {title}.")


def limits(values: ArrayLike, log: bool = False) -> tuple[float, float]:
    """The range in which all but the last half per cent of values at either end are, never empty."""
    data = np.asarray(values, dtype=np.float64)
    shown = data[np.isfinite(data) & (data > 0)] if log else data[np.isfinite(data)]
    low, high = map(float, np.quantile(shown, [0.005, 0.995])) if shown.size else (1.0, 1.0)
    if high > low:
        return low, high
    return (low / 2, low * 2) if log else (low - 0.5, high + 0.5)


def map_plot(values: ArrayLike, within: tuple[float, float], title: str, unit: str, log: bool = False) -> Plot:
    """A picture of (height, width) values with its scale, which goes over ``within``."""
    data = np.asarray(values, dtype=np.float64)
    low, high = within

    def draw(figure: Any) -> None:
        from matplotlib.colors import LogNorm, Normalize

        norm = LogNorm(low, high) if log else Normalize(low, high)
        axes, bar = _picture_axes(figure)
        picture = axes.imshow(np.clip(data, low, high), cmap="viridis", norm=norm, interpolation="nearest")
        scale = figure.colorbar(picture, cax=bar)
        scale.set_label(unit)
        if log:
            at = [value for value in figures.ticks(low, high) if low <= value <= high]
            _ticks(bar.yaxis, at if len(at) > 1 else [low, high])

    mean = data[np.isfinite(data)].mean() if np.isfinite(data).any() else float("nan")
    return Plot(
        _svg(draw, _size_of(data)), f"{title}: mean {mean:.3g}, shown from {low:.3g} to {high:.3g} {unit}", title
    )


def bias_percent(test: Welch, mean: ArrayLike) -> NDArray[np.float64]:
    """Relative bias of each tile in per cent; ``mean`` (rows, columns) is the reference's luminance of the tiles.

    Where the reference is darker than a thousandth of its brightest tile, it is relative to that.
    """
    reference = np.asarray(mean, dtype=np.float64)
    return np.asarray(100.0 * test.difference / np.maximum(reference, max(1e-3 * reference.max(), 1e-12)))


def bias_plot(test: Welch, percent: ArrayLike, reach: float, title: str) -> Plot:
    """``percent`` (rows, columns), :func:`bias_percent`, shown within -``reach`` to ``reach``.

    A plus or a minus, so that it is seen without colour, marks the tiles where the bias is more than chance explains.
    """
    signs = {"+": test.difference > 0.0, "_": test.difference <= 0.0}

    def draw(figure: Any) -> None:
        axes, bar = _picture_axes(figure)
        picture = axes.imshow(percent, cmap="PuOr_r", vmin=-reach, vmax=reach, interpolation="nearest")
        for marker, where in signs.items():
            rows, columns = np.nonzero(test.biased & where)
            axes.plot(columns, rows, linestyle="none", marker=marker, color="black", markersize=6, markeredgewidth=1.5)
        figure.colorbar(picture, cax=bar).set_label("bias of luminance, %")

    count = f"{int(test.biased.sum())} of {test.p.size} tiles"
    marked = f"{count} are biased at a false-alarm rate of {test.alpha:g} over all tiles."
    alt = f"{title}: {marked} Shown within ±{reach:.3g} %"
    return Plot(_svg(draw, _size_of(np.asarray(percent))), alt, f"{title}: {marked}")


def label(metric: str) -> str:
    """A metric's name as the page has it."""
    known = {"mse": "MSE", "rmse": "RMSE", "psnr": "PSNR, dB", "relmse": "relMSE", "relmse_trimmed": "relMSE, trimmed",
             "smape": "SMAPE", "ssim": "SSIM", "flip": "HDR-FLIP", "ldr_flip": "LDR-FLIP", "pu21_psnr": "PU21-PSNR, dB",
             "pu21_ssim": "PU21-SSIM", "delta_e": "delta E 2000", "threshold_ratio": "mean threshold ratio",
             "visible_pixels": "share of visible pixels"}  # fmt: skip
    return known.get(metric, metric.replace("_", " "))


@dataclass(frozen=True)
class _Point:
    spp: float
    seconds: float
    interval: Interval
    of_time: bool


def _curve(axes: Any, at: Sequence[float], values: Sequence[Interval], number: int,
           joined: bool = True) -> Any:  # fmt: skip
    """Medians with a band, or with bars where they are not ``joined``; returns what stands in the legend."""
    look = {"color": _COLOURS[number % len(_COLOURS)], "marker": _MARKERS[number % len(_MARKERS)]}
    median, low, high = np.array([(value.median, value.low, value.high) for value in values]).T
    line = _LINES[number % len(_LINES)] if joined else "none"
    (handle,) = axes.plot(at, median, linestyle=line, markersize=5, **look)
    if len(at) > 1 and joined:
        axes.fill_between(at, low, high, color=look["color"], alpha=0.15, linewidth=0)
    else:
        spread = np.maximum([median - low, high - median], 0.0)
        axes.errorbar(at, median, spread, color=look["color"], linestyle="none", capsize=3)
    axes.grid(True, which="major", linewidth=0.4, alpha=0.6)
    return handle


def _log_axis(axes: Any, which: str, values: Sequence[float], at: Sequence[float] | None = None) -> None:
    """A logarithmic axis that holds the values, with ticks ``at`` some, or else at 1, 2 and 5."""
    low, high = min(values), max(values)
    at = at or figures.ticks(low, high)
    axes.set(**{f"{which}scale": "log", f"{which}lim": (min(low, at[0]) / 1.15, max(high, at[-1]) * 1.15)})
    _ticks(axes.xaxis if which == "x" else axes.yaxis, at)


def _ticks(axis: Any, at: Sequence[float]) -> None:
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    axis.set_major_locator(FixedLocator(at))
    axis.set_major_formatter(FixedFormatter(figures.tick_labels(at)))
    axis.set_minor_locator(NullLocator())


# Places in inches, from what the labels take: to have them computed takes longer than all the rest of a plot.
_WIDTH, _PANEL, _LABELS, _LEGEND_ROW = 4.6, 1.9, 0.55, 0.2


def _panel_size(panels: int, rows_of_legend: int) -> tuple[float, float]:
    return _WIDTH, panels * (_PANEL + _LABELS) + rows_of_legend * _LEGEND_ROW + 0.05


def _panel(figure: Any, place: int, panels: int, rows_of_legend: int) -> Any:
    """Axes of the panel at a place, from the top."""
    width, height = _panel_size(panels, rows_of_legend)
    bottom = height - (place + 1) * _PANEL - place * _LABELS - 0.1
    return figure.add_axes((0.7 / width, bottom / height, (width - 0.8) / width, _PANEL / height))


def _picture_axes(figure: Any) -> tuple[Any, Any]:
    """Axes of a picture, and of its scale."""
    axes = figure.add_axes((0.0, 0.02, 0.77, 0.96))
    axes.set_axis_off()
    axes.set_anchor("W")
    return axes, figure.add_axes((0.79, 0.06, 0.03, 0.88))


def _size_of(data: Any) -> tuple[float, float]:
    height, width = data.shape
    return 4.2, min(max(0.77 * 4.2 * height / width / 0.96, 1.4), 5.0)


def _legend(figure: Any, handles: Mapping[str, Any], columns: int = 2) -> None:
    figure.legend(
        list(handles.values()), list(handles), loc="lower center", ncols=columns, frameon=False, borderaxespad=0.0
    )


def _svg(draw: Callable[[Any], None], size: tuple[float, float]) -> str:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE), warnings.catch_warnings():
        figure = Figure(figsize=size)
        draw(figure)
        out = io.BytesIO()
        # The browser has a font for it.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode("ascii")
