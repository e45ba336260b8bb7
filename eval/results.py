"""The benchmark's rows as a Markdown page: factors over path tracing, bias and time, over seeds."""

import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .statistics import Interval, mean_error, median_interval, ratio_interval

Row = Mapping[str, Any]

HEAD = (
    "| method | MSE | MSE factor | tvi error | tvi factor | over PT Sobol: MSE | tvi | bias % | bias before "
    "correction % | seconds | renderer | sampler |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def page(
    rows: Sequence[Row],
    methods: Sequence[str],
    baseline: str,
    stratified: str,
    *,
    command: str,
    versions: Mapping[str, str],
) -> str:
    """The page for the rows of :func:`pmc_sampler.eval.benchmark.run`.

    ``methods`` gives the order; ``baseline`` and ``stratified`` name those that factors are taken over.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    parts = [_preamble(rows, baseline, stratified, command, versions)]
    for scene in scenes:
        of_scene = {
            name: sorted(
                (row for row in rows if row["scene"] == scene and row["method"] == name),
                key=lambda row: row["seed"],
            )
            for name in methods
        }
        reference = of_scene[baseline][0]["reference"]
        body = "\n".join(
            _line(name, of_scene[name], of_scene[baseline], of_scene.get(stratified, [])) for name in methods
        )
        parts.append(
            f"## {scene}\n\n{HEAD}\n{body}\n\n"
            f"Subtracted for the reference's own noise: MSE {reference['mse']:.3g}, tvi error "
            f"{reference['tvi_error']:.3g}. Standard error of the reference's mean luminance: "
            f"{100 * reference['bias_error']:.3f} %, not part of the biases' errors."
        )
    return "\n\n".join(parts) + "\n"


def write(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file beside its place and rename it into it."""
    target = Path(path)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, target)


def machine() -> str:
    """The processor, the number of cores this process may use, and the system."""
    cpu = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{cpu}, {cores} cores, {platform.system()} {platform.release()}, Python {platform.python_version()}"


def _preamble(rows: Sequence[Row], baseline: str, stratified: str, command: str, versions: Mapping[str, str]) -> str:
    first = rows[0]
    seeds = len({row["seed"] for row in rows})
    named = ", ".join(f"{name} {version}" for name, version in versions.items())
    rejected = sum(row["rejected"] for row in rows)
    return (
        "# Samplers at equal sample counts\n\n"
        f"`{command}`\n\n"
        f"{first['width']}x{first['height']} pixels, {first['spp']} samples per pixel, {seeds} seeds, "
        f"references of {first['reference_spp']} samples per pixel. {named}. {machine()}. "
        f"Sampler code `{first['code']}`. {rejected} samples were rejected as not finite or negative.\n\n"
        f"Factors are the error of *{baseline}* (and of *{stratified}*) over the method's, taken seed by "
        "seed: median and 95 % bootstrap interval. The reference's noise is subtracted from errors. "
        f"Luminance 1 is {first['config']['white_luminance']:g} cd/m2. "
        "MSE is of linear RGB; tvi error is `mean((dY / tvi(Y))^2)`. Bias is of mean luminance, with its "
        "standard error over seeds; before correction: of the plain mean of all samples. Seconds are "
        "medians; renderer and sampler (ask and tell) are shares of the total."
    )


def _line(name: str, own: Sequence[Row], baseline: Sequence[Row], stratified: Sequence[Row]) -> str:
    def factor(metric: str, base: Sequence[Row]) -> str:
        if not base or base is own:
            return "1" if base is own else ""
        return _interval(ratio_interval([row[metric] for row in base], [row[metric] for row in own]))

    seconds = {part: [row["seconds"][part] for row in own] for part in ("total", "renderer", "sampler")}
    share = {
        part: median_interval([100 * a / b for a, b in zip(seconds[part], seconds["total"], strict=True)]).median
        for part in ("renderer", "sampler")
    }
    cells = [
        name,
        f"{median_interval([row['mse'] for row in own]).median:.3g}",
        factor("mse", baseline),
        f"{median_interval([row['tvi_error'] for row in own]).median:.3g}",
        factor("tvi_error", baseline),
        factor("mse", stratified),
        factor("tvi_error", stratified),
        _bias([row["bias"] for row in own]),
        _bias([row["plain_bias"] for row in own]),
        f"{median_interval(seconds['total']).median:.2f}",
        f"{share['renderer']:.1f} %",
        f"{share['sampler']:.1f} %",
    ]
    return "| " + " | ".join(cells) + " |"


def _interval(value: Interval) -> str:
    return f"{value.median:.2f} ({value.low:.2f} to {value.high:.2f})"


def _bias(values: Sequence[float]) -> str:
    mean, error = mean_error(values)
    return f"{100 * mean:+.3f} ± {100 * error:.3f}"
