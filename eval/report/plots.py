"""The report's plots, by matplotlib, as SVG images. Methods differ by line, marker and hatch as well as by colour."""

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..results import Results
from ..statistics import Interval, Welch, median_interval
from ..suite import OWN, Scene

HIGHER_IS_BETTER = frozenset({"psnr", "ssim", "pu21_psnr", "pu21_ssim"})

# Okabe and Ito's colours, told apart by the colour-blind (https://jfly.uni-koeln.de/color/).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
_LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
_MARKERS = "osD^vPX*<>"
_HATCHES = ("", "////", "....")
_STYLE = {
    "font.size": 9,
    "svg.hashsalt": "pmc_sampler",
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


def error_plot(found: Results, scene: Scene, metric: str, x: str) -> Plot | None:
    """A metric against samples per pixel (``x`` "spp") or seconds ("seconds.total"), medians with bands over seeds.

    None where no run is done. Values that have no logarithm are left out, and the caption says how many.
    """
    left_out = 0
    log = metric not in HIGHER_IS_BETTER
    series: list[tuple[int, str, list[tuple[float, Interval]]]] = []
    for number, method in enumerate(found.suite.methods):
        points = []
        for budget in found.suite.budgets(scene):
            if x == "spp" and budget.kind == "seconds":
                continue
            rows = found.select(scene.name, method.name, str(budget))
            if not rows:
                continue
            interval = median_interval([row[metric] for row in rows])
            if log and interval.low <= 0.0:
                left_out += 1
                continue
            points.append((median_interval([row[x] for row in rows]).median, interval))
        if points:
            series.append((number, method.name, sorted(points, key=lambda point: point[0])))
    if not series:
        return None

    def draw(axes: Any) -> None:
        for number, name, points in series:
            at = [point[0] for point in points]
            median, low, high = zip(*((i.median, i.low, i.high) for _, i in points), strict=True)
            look = {"color": _COLOURS[number % len(_COLOURS)], "marker": _MARKERS[number % len(_MARKERS)]}
            native = found.suite.methods[number].native
            line = "none" if native else _LINES[number % len(_LINES)]
            axes.plot(at, median, linestyle=line, label=name, markersize=5, **look)
            if len(at) > 1 and not native:
                axes.fill_between(at, low, high, color=look["color"], alpha=0.15, linewidth=0)
            else:
                spread = np.maximum([np.subtract(median, low), np.subtract(high, median)], 0.0)
                axes.errorbar(at, median, spread, color=look["color"], linestyle="none", capsize=3)
        axes.set_xscale("log")
        _plain_ticks(axes.xaxis, [point[0] for _, _, points in series for point in points])
        if log:
            axes.set_yscale("log")
        axes.set_xlabel("samples per pixel" if x == "spp" else "seconds")
        axes.set_ylabel(label(metric))
        axes.grid(True, which="major", linewidth=0.4, alpha=0.6)
        axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)

    against = "samples per pixel" if x == "spp" else "seconds"
    missing = f" {left_out} points are not above the reference's noise and have no logarithm." if left_out else ""
    best = "higher" if metric in HIGHER_IS_BETTER else "lower"
    alt = f"{label(metric)} against {against} on {scene.name}: " + "; ".join(
        f"{name} {points[-1][1].median:.3g} at {points[-1][0]:.3g}" for _, name, points in series
    )
    height = 2.9 + 0.2 * -(-len(series) // 2)
    caption = f"{label(metric)} against {against}; {best} is better.{missing}"
    return Plot(_svg(draw, (4.6, height)), alt, caption)


def sweep_plot(found: Results, scene: Scene, metric: str, parameter: str, methods: Mapping[float, str]) -> Plot | None:
    """A metric against the values of a setting, ``methods`` by value; a curve for each budget. None without runs."""
    curves = []
    for budget in scene.budgets:
        points = []
        for value, name in sorted(methods.items()):
            rows = found.select(scene.name, name, str(budget))
            if rows:
                points.append((value, median_interval([row[metric] for row in rows])))
        if points:
            curves.append((str(budget), points))
    if not curves:
        return None

    def draw(axes: Any) -> None:
        for number, (name, points) in enumerate(curves):
            at = [value for value, _ in points]
            colour = _COLOURS[number % len(_COLOURS)]
            axes.plot(
                at,
                [i.median for _, i in points],
                color=colour,
                linestyle=_LINES[number % len(_LINES)],
                marker=_MARKERS[number % len(_MARKERS)],
                label=name,
            )
            axes.fill_between(
                at, [i.low for _, i in points], [i.high for _, i in points], color=colour, alpha=0.15, linewidth=0
            )
        if metric not in HIGHER_IS_BETTER and all(i.low > 0 for _, points in curves for _, i in points):
            axes.set_yscale("log")
        axes.set_xlabel(parameter)
        axes.set_ylabel(label(metric))
        axes.grid(True, which="major", linewidth=0.4, alpha=0.6)
        axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)

    alt = f"{label(metric)} on {scene.name} against {parameter}: " + "; ".join(
        f"at {name} " + ", ".join(f"{i.median:.3g} for {value:g}" for value, i in points) for name, points in curves
    )
    return Plot(_svg(draw, (4.6, 3.2)), alt, f"{label(metric)} against the setting {parameter}.")


def time_plot(found: Results, scene: Scene, budget: str) -> Plot | None:
    """Median seconds of each method in the renderer, the sampler and the rest. None without runs."""
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

    def draw(axes: Any) -> None:
        left = np.zeros(len(names))
        for kind, (title, values) in enumerate(zip(kinds, np.transpose(parts), strict=True)):
            axes.barh(names, values, left=left, label=title, color=("#56B4E9", "#E69F00", "#ffffff")[kind],
                      hatch=_HATCHES[kind], edgecolor="black", linewidth=0.6)  # fmt: skip
            left += values
        axes.invert_yaxis()
        axes.set_xlabel("seconds")
        axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)

    alt = f"Seconds on {scene.name} at {budget}: " + "; ".join(
        f"{name} " + ", ".join(f"{kind} {value:.2f}" for kind, value in zip(kinds, values, strict=True))
        for name, values in zip(names, parts, strict=True)
    )
    return Plot(_svg(draw, (4.6, 1.4 + 0.3 * len(names))), alt, f"Where the time went, medians over seeds at {budget}.")


def map_plot(values: ArrayLike, title: str, unit: str, log: bool = False) -> Plot:
    """A picture of (height, width) values with its scale; the scale ends at the 99.5th percentile."""
    data = np.asarray(values, dtype=np.float64)
    shown = data[np.isfinite(data) & (data > 0)] if log else data[np.isfinite(data)]
    low, high = np.quantile(shown, [0.005, 0.995]) if shown.size else (0.0, 1.0)
    if not high > low:
        low, high = (low / 2, low * 2) if log else (low - 0.5, high + 0.5)

    def draw(axes: Any) -> None:
        from matplotlib.colors import LogNorm, Normalize

        norm = LogNorm(low, high) if log else Normalize(low, high)
        picture = axes.imshow(np.clip(data, low, high), cmap="viridis", norm=norm, interpolation="nearest")
        axes.set_axis_off()
        bar = axes.figure.colorbar(picture, ax=axes, shrink=0.8)
        bar.set_label(unit)
        if log:
            _plain_ticks(bar.ax.yaxis, [low, high])

    mean = data[np.isfinite(data)].mean() if np.isfinite(data).any() else float("nan")
    return Plot(
        _svg(draw, _size_of(data)), f"{title}: mean {mean:.3g}, shown from {low:.3g} to {high:.3g} {unit}", title
    )


def bias_plot(test: Welch, mean: ArrayLike, title: str) -> Plot:
    """Relative bias of each tile in per cent; a cross marks the tiles where it is more than chance explains.

    ``mean`` (rows, columns) is the reference's luminance of the tiles.
    """
    reference = np.asarray(mean, dtype=np.float64)
    percent = 100.0 * test.difference / np.maximum(reference, 1e-3 * reference.max())
    reach = max(float(np.quantile(np.abs(percent), 0.98)), 1e-6)
    rows, columns = np.nonzero(test.biased)

    def draw(axes: Any) -> None:
        picture = axes.imshow(percent, cmap="PuOr_r", vmin=-reach, vmax=reach, interpolation="nearest")
        axes.plot(columns, rows, linestyle="none", marker="x", color="black", markersize=5, markeredgewidth=1.2)
        axes.set_axis_off()
        axes.figure.colorbar(picture, ax=axes, shrink=0.8, extend="both").set_label("bias of luminance, %")

    marked = f"{len(rows)} of {test.p.size} tiles are biased at a false-alarm rate of {test.alpha:g} over all tiles."
    return Plot(_svg(draw, _size_of(percent)), f"{title}: {marked} Shown within ±{reach:.3g} %", f"{title}: {marked}")


def label(metric: str) -> str:
    """A metric's name as the page has it."""
    known = {"mse": "MSE", "rmse": "RMSE", "psnr": "PSNR, dB", "relmse": "relMSE", "relmse_trimmed": "relMSE, trimmed",
             "smape": "SMAPE", "ssim": "SSIM", "flip": "HDR-FLIP", "ldr_flip": "LDR-FLIP", "pu21_psnr": "PU21-PSNR, dB",
             "pu21_ssim": "PU21-SSIM", "delta_e": "delta E 2000", "threshold_ratio": "mean threshold ratio",
             "visible_pixels": "share of visible pixels"}  # fmt: skip
    return known.get(metric, metric.replace("_", " "))


def _size_of(data: Any) -> tuple[float, float]:
    height, width = data.shape
    return 4.2, min(max(3.3 * height / width, 1.4), 5.0)


def _plain_ticks(axis: Any, values: Sequence[float]) -> None:
    """Numbers as 0.5 and 64 on a logarithmic axis, three at least, none on top of another."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    low, high = min(values), max(values)
    count = 5 if high / low > 4 else 3
    axis.set_major_locator(FixedLocator(np.geomspace(low, high, count) if high > low else [low]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.2g}" if value < 100 else f"{value:.0f}"))
    axis.set_minor_locator(NullLocator())


def _svg(draw: Callable[[Any], None], size: tuple[float, float]) -> str:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode("ascii")
