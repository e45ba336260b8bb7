"""The report's sentences and tables, made from the numbers."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from ..results import Results, Row
from ..statistics import Interval, mean_error, median_interval, ratio_interval
from ..suite import OWN, Budget, Scene
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
    """What the numbers say: the state of the runs, then a sentence or two for each scene."""
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
        for metric in ("tvi_error", "mse"):
            if metric in suite.metrics:
                said.append(_comparison(found, scene, budget, metric))
    return said


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


def table(found: Results, scene: Scene, budget: Budget) -> Table | None:
    """The methods' metrics, factors over the baseline, bias and time at a budget; None without runs.

    The best of a column is of its medians, the smallest bias of its magnitude.
    """
    suite = found.suite
    of_methods = {method.name: found.select(scene.name, method.name, str(budget)) for method in suite.methods}
    of_methods = {name: rows for name, rows in of_methods.items() if rows}
    if not of_methods:
        return None
    columns: list[tuple[str, list[Cell]]] = []
    for metric in suite.metrics:
        intervals = [median_interval([row[metric] for row in rows]) for rows in of_methods.values()]
        higher = metric in HIGHER_IS_BETTER
        best = (max if higher else min)(interval.median for interval in intervals)
        columns.append((f"{label(metric)} {'↑' if higher else '↓'}", [_cell(i, i.median == best) for i in intervals]))
        if metric in ("mse", "tvi_error") and suite.baseline in of_methods:
            ratios = [_ratio(found, scene, budget, name, metric) for name in of_methods]
            known = [ratio.median for ratio in ratios if ratio is not None]
            cells = [Cell("–") if r is None else _cell(r, r.median == max(known)) for r in ratios]
            columns.append((f"{label(metric)} factor ↑", cells))
    biases = [mean_error([row["bias"] for row in rows]) for rows in of_methods.values()]
    least = min(abs(mean) for mean, _ in biases)
    columns.append(
        ("bias, %", [Cell(f"{100 * m:+.3f}", "" if e != e else f"± {100 * e:.3f}", abs(m) == least) for m, e in biases])
    )
    columns.append(("samples per pixel", [Cell(f"{_median(rows, 'spp'):.4g}") for rows in of_methods.values()]))
    times = [median_interval([row["seconds.total"] for row in rows]) for rows in of_methods.values()]
    quickest = min(time.median for time in times)
    timed = budget.kind == "seconds"
    columns.append(("seconds", [_cell(time, not timed and time.median == quickest) for time in times]))
    rows = [(name, [cells[i] for _, cells in columns]) for i, name in enumerate(of_methods)]
    return Table(spoken(budget), [head for head, _ in columns], rows)


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


def sweeps(found: Results) -> list[tuple[str, dict[float, str]]]:
    """Settings with three numbers or more among methods that are the same otherwise: (setting, method by value)."""
    groups: dict[tuple[str, str], dict[float, str]] = {}
    for method in found.suite.methods:
        for name, value in method.settings.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                rest = {key: other for key, other in method.settings.items() if key != name}
                identity = json.dumps(
                    [rest, method.numbers, dict(method.on), method.scenes], sort_keys=True, default=str
                )
                groups.setdefault((name, identity), {})[float(value)] = method.name
    return [(name, methods) for (name, _), methods in groups.items() if len(methods) > 2]


def _comparison(found: Results, scene: Scene, budget: Budget, metric: str) -> str:
    base = found.suite.baseline
    values = {
        method.name: _median(rows, metric)
        for method in found.suite.methods
        if (rows := found.select(scene.name, method.name, str(budget)))
    }
    best = min(values, key=lambda name: values[name])
    start = f"{scene.name}, {spoken(budget)}: {best} has the least {label(metric)}"
    ratio = _ratio(found, scene, budget, best, metric) if base in values else None
    if best == base or ratio is None:
        return f"{start}, {values[best]:.3g}."
    few = len(found.select(scene.name, best, str(budget))) < 2
    if few:
        return f"{start}; the error of {base} is {ratio.median:.2f} times as large with the one seed there is."
    sure = "" if ratio.low > 1.0 else ", an interval that holds 1: no difference is shown"
    interval = f"{ratio.low:.2f} to {ratio.high:.2f}"
    return f"{start}; the error of {base} is {ratio.median:.2f} times as large ({interval}{sure})."


def _ratio(found: Results, scene: Scene, budget: Budget, name: str, metric: str) -> Interval | None:
    base, own = found.pairs(scene.name, str(budget), found.suite.baseline, name, metric)
    if not own or min(own) <= 0.0:
        return None
    return ratio_interval(base, own)


def _median(rows: Sequence[Row], name: str) -> float:
    return median_interval([row[name] for row in rows]).median


def _cell(value: Interval, best: bool) -> Cell:
    spread = "" if value.low == value.high else f"{value.low:.3g} to {value.high:.3g}"
    return Cell(f"{value.median:.3g}", spread, best)
