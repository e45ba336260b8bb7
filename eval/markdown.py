"""A benchmark's results as a Markdown page: factors over the baseline, bias and time, over seeds."""

import json
from collections.abc import Mapping, Sequence

from . import statistics
from .measures import ERRORS
from .results import Results, Row, known, noise_left
from .suite import OWN, shipped


def page(found: Results) -> str:
    """The page for what :func:`pmc_sampler.eval.results.load` found, finished or not."""
    parts = [_preamble(found)]
    for scene in found.suite.scenes:
        rows = [row for row in found.done if row["scene"] == scene.name]
        parts.append(f"## {scene.name}")
        for budget in scene.budgets:
            parts.append(_table(found, scene.name, str(budget)))
        if OWN in found.suite.budgets(scene):
            parts.append(_native_table(found, scene.name))
        if rows:
            parts.append(_notes(found, rows))
    if found.failed:
        failed = "\n".join(
            f"* {row['scene']}, {row['budget']}, seed {row['seed']}, {row['method']}: {row['error']}"
            for row in found.failed
        )
        parts.append(f"## Runs that failed\n\n{failed}")
    return "\n\n".join(parts) + "\n"


def _preamble(found: Results) -> str:
    suite = found.suite
    incomplete = f" {found.missing} runs are missing." if found.missing else ""
    versions = sorted({row["versions"] for row in found.done})
    named = "; ".join(", ".join(f"{name} {version}" for name, version in json.loads(v).items()) for v in versions)
    machines = "; ".join(sorted({row["machine"] for row in found.done}))
    rejected = sum(row["rejected"] for row in found.done)
    folder = found.path.name if found.path.is_absolute() else found.path.as_posix()
    again = suite.name if suite.name in shipped() else f"{folder}/suite.toml"
    return (
        f"# Suite {suite.name}\n\n{suite.about}\n\n"
        f"`pmc-sampler bench {again} -o {folder}`\n\n"
        f"{suite.seeds} seeds.{incomplete} {named}. {machines}. "
        f"{rejected} samples were rejected as not finite or negative.\n\n"
        f"Factors are the error of *{suite.baseline}* over the method's, taken seed by seed: median and 95 % bootstrap "
        f"interval{statistics.few(suite.seeds)}. A reference's noise is subtracted from "
        f"errors; one within three standard deviations of what that leaves makes no factor but a dash. Luminance 1 "
        f"is {suite.white_luminance:g} cd/m2. MSE "
        "is of linear RGB; tvi error is `mean((dY / tvi(Y))^2)`. Bias is of mean luminance, with its standard error "
        "over seeds; before correction: of the plain mean of all samples. Seconds are medians; renderer and sampler "
        "(ask, tell and the image) are shares of the total. Limit reached: the least error that independent samples "
        "can have (Neyman's allocation by known variances), over the method's."
    )


def _table(found: Results, scene: str, budget: str) -> str:
    suite = found.suite
    errors = {name: title for name, title in ERRORS.items() if name in suite.metrics}
    limits = {
        name: title
        for name, title in errors.items()
        if any(row[f"limit.{name}"] is not None for row in found.done if row["scene"] == scene)
    }
    head = ["method"]
    for title in errors.values():
        head += [title, f"{title} factor"]
    head += [f"limit reached: {title}" for title in limits.values()]
    head += ["bias %", "before correction %", "spp", "seconds", "renderer", "sampler"]
    lines = []
    for method in suite.methods:
        own = found.select(scene, method.name, budget)
        if not own:
            continue
        cells = [method.name]
        for name in errors:
            cells += [f"{_median(own, name):.3g}", _factor(found, scene, budget, method.name, name)]
        for name in limits:
            cells.append(_reached(own, name))
        cells += [_bias([row["bias"] for row in own]), _bias([row["plain_bias"] for row in own])]
        cells += [f"{_median(own, 'spp'):.4g}", f"{_median(own, 'seconds.total'):.2f}"]
        cells += [_share(own, "renderer"), _share(own, "sampler")]
        lines.append(cells)
    title = f"### {budget.removesuffix('spp')} samples per pixel" if budget.endswith("spp") else f"### {budget[:-1]} s"
    if not lines:
        return f"{title}\n\nNo run has finished."
    return "\n\n".join((title, _grid(head, lines), *_least(found, scene, budget, errors)))


def _least(found: Results, scene: str, budget: str, errors: Mapping[str, str]) -> list[str]:
    """A line on who has the least error and how much more the next has, seed by seed."""
    parts = []
    for name, title in errors.items():
        of = {method.name: found.select(scene, method.name, budget) for method in found.suite.methods}
        ranked = sorted((_median(rows, name), method) for method, rows in of.items() if rows)
        if len(ranked) < 2:
            continue
        (_, best), (_, second) = ranked[:2]
        more, least = found.pairs(scene, budget, second, best, name)
        if least and min(least) > 0.0:
            factor = _interval(statistics.ratio_interval(more, least))
            parts.append(f"{title} *{best}*, and *{second}*, the next, {factor} times as much")
    return [f"Least: {'; '.join(parts)}, seed by seed."] if parts else []


_COSTS = {"time": ("seconds.total", "{:.2f} s"), "samples": ("spp", "{:.4g} spp")}


def _native_table(found: Results, scene: str) -> str:
    """What the renderer makes by its own way to choose samples, and the other methods' errors at no more cost."""
    errors = {name: title for name, title in ERRORS.items() if name in found.suite.metrics}
    natives = [
        (method.name, found.select(scene, method.name, str(OWN))) for method in found.suite.methods if method.native
    ]
    natives = [(name, own) for name, own in natives if own]
    title = "### The renderer's own"
    if not natives:
        return f"{title}\n\nNo run has finished."
    lines = []
    for name, own in natives:
        cells = [name, *(f"{_median(own, error):.3g}" for error in errors), _bias([row["bias"] for row in own])]
        lines.append([*cells, f"{_median(own, 'spp'):.4g}", f"{_median(own, 'seconds.total'):.2f}"])
    tables = [_grid(["the renderer's own", *errors.values(), "bias %", "spp", "seconds"], lines)]
    others = [method.name for method in found.suite.methods if not method.native]
    for cost in _COSTS:
        head = [f"over {other} in no more {cost}: {title}" for other in others for title in errors.values()]
        lines = [
            [name, *(_no_dearer(found, scene, own, other, error, cost) for other in others for error in errors)]
            for name, own in natives
        ]
        tables.append(_grid(["the renderer's own", *head], lines))
    return "\n\n".join([title, *tables])


def _no_dearer(found: Results, scene: str, own: Sequence[Row], other: str, error: str, cost: str) -> str:
    """A renderer's own error over the least that a method has at no more cost, and what that costs."""
    column, spelt = _COSTS[cost]
    rows = found.within(scene, other, _median(own, column), error, column)
    if not rows:
        return "none costs as little"
    over, under = (statistics.median_interval([known(row, error) for row in group]).median for group in (own, rows))
    factor = f"{over / under:.2f}" if min(over, under) > 0.0 else "–"
    return f"{factor} at {rows[0]['budget']}, {spelt.format(_median(rows, column))}"


def _grid(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [f"| {' | '.join(row)} |" for row in (head, *lines)]
    return "\n".join([rows[0], "|---" * len(head) + "|", *rows[1:]])


def _notes(found: Results, rows: Sequence[Row]) -> str:
    first = rows[0]
    scene = next(scene for scene in found.suite.scenes if scene.name == first["scene"])
    budgets = [budget for budget in scene.budgets if budget.kind == "spp"]
    slopes = []
    if len(budgets) > 1:
        for method in found.suite.methods:
            interval = found.slope(scene.name, method.name, "mse") if "mse" in found.suite.metrics else None
            if interval is not None:
                slopes.append(f"{method.name} {_interval(interval)}")
    slope = f"\n\nSlope of log MSE against log samples: {'; '.join(slopes)}." if slopes else ""
    return (
        f"{first['width']}x{first['height']} pixels, {first['renderer']}, reference of "
        f"{first['reference.spp']} samples per pixel. Subtracted for its own noise: MSE {first['reference.mse']:.3g}, "
        f"tvi error {first['reference.tvi_error']:.3g}{noise_left(first)}. Standard error of its mean luminance: "
        f"{100 * first['reference.bias']:.3f} %, not part of the biases' errors.{slope}"
    )


def _median(rows: Sequence[Row], name: str) -> float:
    return statistics.median_interval([row[name] for row in rows]).median


def _factor(found: Results, scene: str, budget: str, method: str, name: str) -> str:
    if method == found.suite.baseline:
        return "1"
    base, own = found.pairs(scene, budget, found.suite.baseline, method, name)
    if not own:
        return ""
    return _interval(statistics.ratio_interval(base, own)) if min(*base, *own) > 0.0 else "–"


def _reached(rows: Sequence[Row], name: str) -> str:
    """The least error over the rows', in per cent; a dash where one of them has no more error than the reference."""
    if not all(row[name] > 0.0 for row in rows):
        return "–"
    return f"{statistics.median_interval([row[f'limit.{name}'] / row[name] for row in rows]).median:.0%}"


def _share(rows: Sequence[Row], part: str) -> str:
    shares = [100 * row[f"seconds.{part}"] / row["seconds.total"] for row in rows]
    return f"{statistics.median_interval(shares).median:.1f} %"


def _interval(value: statistics.Interval) -> str:
    return f"{value.median:.2f} ({value.low:.2f} to {value.high:.2f})"


def _bias(values: Sequence[float]) -> str:
    mean, error = statistics.mean_error(values)
    return f"{100 * mean:+.3f} ± {100 * error:.3f}"
