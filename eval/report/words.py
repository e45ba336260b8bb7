"""The report's sentences and tables, made from the numbers."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from ..measures import ERRORS
from ..results import Results, Row
from ..statistics import Interval, mean_error, median_interval, ratio_interval
from ..suite import OWN, Budget, Scene
from .figures import common_exponent, number, power, rounded
from .plots import HIGHER_IS_BETTER, label


@dataclass(frozen=True)
class Cell:
    """A number and its interval as text; ``best`` of its column."""

    text: str
    interval: str = ""
    best: bool = False


@dataclass(frozen=True)
class Table:
    """A title, the heads of the columns and, for each method, its cells."""

    title: str
    heads: list[str]
    rows: list[tuple[str, list[Cell]]]


def summary(found: Results) -> list[str]:
    """What the numbers say: the state of the runs, then for each scene who is best, by how much and at what bias."""
    suite = found.suite
    seeds = f"{suite.seeds} seeds" if suite.seeds > 1 else "one seed, so that nothing is known of the spread"
    state = f"{len(found.done)} runs are done with {seeds}"
    state += f"; {len(found.failed)} failed" if found.failed else ""
    state += f"; {found.missing} have not been run" if found.missing else ""
    said = [state + "."]
    for scene in suite.scenes:
        budget = headline(found, scene)
        if budget is None:
            said.append(f"{scene.name}: no run is done.")
            continue
        gains: dict[str, list[str]] = {}
        for metric in main_metrics(found):
            best, gain = _comparison(found, scene, budget, metric)
            gains.setdefault(best, []).append(gain)
        for best, sentences in gains.items():
            said.append(
                f"{scene.name}, {spoken(budget)}: {best} has {' and '.join(sentences)}. "
                f"{_bias(found, scene, budget, best)}"
            )
    return said


def main_metrics(found: Results) -> list[str]:
    """Those that the summary speaks of: MSE and tvi error where they are measured, else the first."""
    return [metric for metric in found.suite.metrics if metric in ERRORS] or [found.suite.metrics[0]]


def headline(found: Results, scene: Scene) -> Budget | None:
    """The budget that a scene's pictures are of: its largest in samples, else in seconds, that has a run; or None."""
    done = [
        budget
        for budget in found.suite.budgets(scene)
        if any(found.select(scene.name, method.name, str(budget)) for method in found.suite.methods)
    ]
    return max(done, key=lambda budget: (budget.kind == "spp", budget != OWN, budget.value), default=None)


def spoken(budget: Budget) -> str:
    """A budget in words."""
    if budget == OWN:
        return "the renderer's own end"
    return f"{budget.value:g} " + ("samples per pixel" if budget.kind == "spp" else "s")


def table(found: Results, scene: Scene, budget: Budget, metrics: Sequence[str], title: str) -> Table | None:
    """The methods' ``metrics``, factors over the baseline, bias and time at a budget; None without runs.

    The best of a column is of its medians, the smallest bias of its magnitude.
    """
    suite = found.suite
    of_methods = {method.name: found.select(scene.name, method.name, str(budget)) for method in suite.methods}
    of_methods = {name: rows for name, rows in of_methods.items() if rows}
    if not of_methods:
        return None
    columns: list[tuple[str, list[Cell]]] = []
    for metric in metrics:
        intervals = [median_interval([row[metric] for row in rows]) for rows in of_methods.values()]
        columns.append(_column(label(metric), intervals, higher=metric in HIGHER_IS_BETTER))
        if metric in ERRORS and suite.baseline in of_methods:
            ratios = [_ratio(found, scene, budget, name, metric) for name in of_methods]
            columns.append(_column(f"{label(metric)} factor", ratios, higher=True))
        limit = f"limit.{metric}"
        if metric in ERRORS and all(row[limit] is not None for rows in of_methods.values() for row in rows):
            reached = [
                median_interval([100 * r[limit] / r[metric] for r in rows])
                if all(r[metric] > 0.0 for r in rows)
                else None
                for rows in of_methods.values()
            ]
            columns.append(_column(f"{label(metric)}, limit reached, %", reached, higher=True))
    biases = [mean_error([row["bias"] for row in rows]) for rows in of_methods.values()]
    least = min(abs(mean) for mean, _ in biases)
    columns.append(
        ("bias, %", [Cell(f"{100 * m:+.3f}", "" if e != e else f"± {100 * e:.3f}", abs(m) == least) for m, e in biases])
    )
    columns.append(("samples per pixel", [Cell(f"{_median(rows, 'spp'):.4g}") for rows in of_methods.values()]))
    times = [median_interval([row["seconds.total"] for row in rows]) for rows in of_methods.values()]
    columns.append(_column("seconds", times, higher=False, marked=budget.kind != "seconds"))
    rows = [(name, [cells[i] for _, cells in columns]) for i, name in enumerate(of_methods)]
    return Table(title, [head for head, _ in columns], rows)


def slopes(found: Results, scene: Scene) -> str:
    """How fast the MSE falls, a sentence; empty where nothing is known of it."""
    if "mse" not in found.suite.metrics:
        return ""
    known = [(m.name, slope) for m in found.suite.methods if (slope := found.slope(scene.name, m.name, "mse"))]
    listed = "; ".join(f"{name} {s.median:.2f} ({s.low:.2f} to {s.high:.2f})" for name, s in known)
    return f"Slope of log MSE against log samples per pixel: {listed}." if known else ""


def provenance(found: Results) -> list[tuple[str, str]]:
    """What was run, by what, where and when."""
    rows = found.rows
    started = sorted(row["started"] for row in rows)
    versions = sorted({row["versions"] for row in rows})
    named = ["; ".join(f"{name} {version}" for name, version in json.loads(v).items()) for v in versions]
    return [
        ("suite", f"{found.suite.name}: {found.suite.about}"),
        ("runs", f"{len(found.done)} done, {len(found.failed)} failed, {found.missing} missing"),
        ("first and last run", f"{started[0]} to {started[-1]}" if started else "none"),
        ("versions", " | ".join(named) or "unknown"),
        ("machine", " | ".join(sorted({row["machine"] for row in found.done})) or "unknown"),
        ("rejected samples", f"{sum(row['rejected'] for row in found.done)} (not finite or negative)"),
        ("luminance of 1", f"{found.suite.white_luminance:g} cd/m2"),
        ("baseline", found.suite.baseline),
    ]


Value = float | tuple[float, ...]


def sweeps(found: Results) -> list[tuple[str, dict[Value, str]]]:
    """Settings with three values or more among methods that are the same otherwise: (setting, method by value).

    Values are numbers, or lists of numbers such as radii, of which a setting has one kind.
    """
    groups: dict[tuple[str, str], dict[Value, str]] = {}
    for method in found.suite.methods:
        for name, given in method.settings.items():
            listed = isinstance(given, list | tuple)
            values = given if listed else [given]
            if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
                continue
            rest = {key: other for key, other in method.settings.items() if key != name}
            identity = json.dumps(
                [rest, method.numbers, dict(method.on), method.scenes, listed], sort_keys=True, default=str
            )
            value = tuple(float(one) for one in values) if listed else float(given)
            groups.setdefault((name, identity), {})[value] = method.name
    return [(name, methods) for (name, _), methods in groups.items() if len(methods) > 2]


def _comparison(found: Results, scene: Scene, budget: Budget, metric: str) -> tuple[str, str]:
    """The best method in a metric, and what it has."""
    base = found.suite.baseline
    values = {
        method.name: _median(rows, metric)
        for method in found.suite.methods
        if (rows := found.select(scene.name, method.name, str(budget)))
    }
    higher = metric in HIGHER_IS_BETTER
    best = (max if higher else min)(values, key=lambda name: values[name])
    value = number(values[best]) if higher or values[best] > 0.0 else "no more than the reference's own noise"
    start = f"the {'highest' if higher else 'least'} {label(metric)}, {value}"
    ratio = _ratio(found, scene, budget, best, metric) if base in values and not higher else None
    if best == base or ratio is None:
        return best, start
    start += f" ({base}: {rounded(ratio.median)} times as large"
    if len(found.select(scene.name, best, str(budget))) < 2:
        return best, f"{start}, with the one seed there is)"
    sure = "" if ratio.low > 1.0 else ": no difference is shown"
    return best, f"{start}, 95 % interval {rounded(ratio.low)} to {rounded(ratio.high)}{sure})"


def _bias(found: Results, scene: Scene, budget: Budget, name: str) -> str:
    mean, error = mean_error([row["bias"] for row in found.select(scene.name, name, str(budget))])
    spread = "" if error != error else f" ± {100 * error:.3f}"
    said = f"Its bias: {100 * mean:+.3f}{spread} % of the mean luminance"
    test = found.welch(scene.name, name, str(budget))
    if test is None:
        return f"{said}."
    found_biased = f"{int(test.biased.sum())} of {test.p.size} tiles are found biased"
    return f"{said}; {found_biased} at a false-alarm rate of {test.alpha:g} over all."


def _ratio(found: Results, scene: Scene, budget: Budget, name: str, metric: str) -> Interval | None:
    base, own = found.pairs(scene.name, str(budget), found.suite.baseline, name, metric)
    if not own or min(*base, *own) <= 0.0:
        return None
    return ratio_interval(base, own)


def _median(rows: Sequence[Row], name: str) -> float:
    return median_interval([row[name] for row in rows]).median


def _column(
    name: str, intervals: Sequence[Interval | None], higher: bool, marked: bool = True
) -> tuple[str, list[Cell]]:
    """Head and cells, in a power of ten that stands once; None is unknown. The best are ``marked``."""
    medians = [interval.median for interval in intervals if interval is not None]
    best = (max if higher else min)(medians) if medians and marked else None
    exponent = common_exponent(medians)
    scale = 10.0**exponent
    cells = []
    for interval in intervals:
        if interval is None:
            cells.append(Cell("–"))
            continue
        median, low, high = (rounded(value / scale) for value in (interval.median, interval.low, interval.high))
        cells.append(Cell(median, "" if low == high else f"{low} to {high}", interval.median == best))
    times = f" in {power(exponent)}" if exponent else ""
    return f"{name}{times} {'↑' if higher else '↓'}" if marked else f"{name}{times}", cells
