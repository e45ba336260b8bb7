"""What the adaptive sampling of Blender's Cycles and of LuxCore gains over their own uniform one, beside PMC's gain.

    python benchmarks/peers.py [--peers cycles luxcore] [--python PYTHON] [--spp 64] [--seeds 40] [--own-seeds 400]
        -o benchmarks/

Cycles needs the package bpy, LuxCore pyluxcore, in this Python or in that of --python:
`python3.11 -m venv peers && peers/bin/pip install bpy pyluxcore`. All render the same scene; each is measured against
a reference of its own making. Ours is measured on a recording of its samples, too, whose mean is known exactly. Runs
are kept in peers.jsonl as they end; the same command goes on after an interruption. Without any peer (`--peers` alone)
ours is measured, and of the peers what is there is shown again.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pmc_sampler.adapters import load, version
from pmc_sampler.adapters.opencl.load import scene_of
from pmc_sampler.eval import measures, references, statistics
from pmc_sampler.eval.benchmark import fingerprint
from pmc_sampler.eval.metrics import WHITE_LUMINANCE
from pmc_sampler.eval.peers import study
from pmc_sampler.eval.peers.process import PACKAGES, Peer, PeerError, Picture
from pmc_sampler.eval.peers.scene import describe
from pmc_sampler.eval.recorded import Recording, record
from pmc_sampler.eval.references import Reference
from pmc_sampler.eval.report.plots import label

from pmc_sampler import Budget, Config, render
from pmc_sampler.cli.arguments import size

OURS, RECORDED = "opencl", "recorded"
TITLES = {"cycles": "Cycles", "luxcore": "LuxCore", OURS: "our OpenCL tracer", RECORDED: "our tracer, recorded"}
UNIFORM: dict[str, Any] = {}
# Of each renderer, what is compared with its uniform sampling. Cycles stops pixels one by one: `most` is the largest
# count of a pixel as a multiple of the budget, `min_samples` the least, and the noise threshold is sought that meets
# the budget. LuxCore's first are its defaults.
ADAPTIVE: dict[str, tuple[dict[str, Any], ...]] = {
    "cycles": (
        {"most": 16, "min_samples": 4},
        {"most": 16, "min_samples": 16},
    ),
    "luxcore": (
        {"strength": 0.95, "warmup": 32, "step": 32},
        {"strength": 0.95, "warmup": 16, "step": 16},
        {"strength": 0.95, "warmup": 8, "step": 8},
        {"strength": 0.95, "warmup": 4, "step": 4},
        {"strength": 0.95, "warmup": 16, "step": 16, "gamma": 2.2},
    ),
    OURS: ({"sampler": "PMC"},),
    RECORDED: ({"sampler": "PMC"},),
}
_PER_PIXEL = 4096  # recorded samples: more than a pixel gets, so that none is taken twice
COLUMNS = ("renderer", "sampling", "spp", "MSE", "MSE factor", "tvi error", "tvi factor", "bias %")
COLUMNS += ("reference's error %", "seconds")
Rendered = Callable[[int, int, Mapping[str, Any]], Picture]  # samples a pixel, seed, settings


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    description = describe(scene_of(options.scene, options.size))
    log = Log(options.output / "peers.jsonl")
    found: dict[str, Reference] = {}
    try:
        release = version(OURS)
        live = _ours(load(OURS, options.scene, size=options.size))
        found[OURS] = _study(OURS, release, live, _reference(OURS, release, live, options), options, log)
        recording = _recording(release, options)
        found[RECORDED] = _study(RECORDED, release, _ours(recording), recording.reference, options, log)
        for name in options.peers:
            with Peer(name, description, options.python) as peer:
                reference = _reference(name, peer.version, peer.render, options)
                found[name] = _study(name, peer.version, peer.render, reference, options, log)
        for name in PACKAGES if not options.peers else ():
            if (kept := _kept(name, options, log)) is not None:
                found[name] = kept
    except (PeerError, ValueError) as error:
        print(f"peers.py: {error}", file=sys.stderr)
        return 2
    keys = {reference.key for reference in found.values()}
    rows = [row for row in log.rows if "seed" in row and row["reference"] in keys and row["budget"] == options.spp]
    rows = [row for row in rows if row["seed"] <= _seeds(options, row["renderer"])]
    ours = {None, fingerprint()}
    rows = [row for row in rows if row.get("code") in ours and "metrics" in row]
    text = page(options, rows, list(found))
    (options.output / "peers.md").write_text(text, encoding="utf-8")
    figure(options.output / "peers.png", rows, found)
    print(text)
    return 0


def _kept(name: str, options: argparse.Namespace, log: Log) -> Reference | None:
    """The reference of a peer's latest runs in the log, if it is still in the cache."""
    rows = [row for row in log.rows if row["renderer"] == name and row["budget"] == options.spp and "seed" in row]
    path = references.cache_folder() / f"{rows[-1]['reference']}.npz" if rows else None
    return references.load(path) if path is not None and path.is_file() else None


@dataclass
class Log:
    """Rows of a JSON Lines file, renewed as each run ends."""

    path: Path

    def __post_init__(self) -> None:
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.is_file() else []
        self.rows: list[dict[str, Any]] = [json.loads(line) for line in lines]

    def once(self, what: Mapping[str, Any], measure: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """The row of the run that `what` describes in full; measured where there is none."""
        for row in self.rows:
            if all(row.get(key) == value for key, value in what.items()):
                return row
        row = {**what, **measure()}
        self.rows.append(row)
        partial = self.path.with_name(f".{self.path.name}.part")
        partial.write_text("".join(json.dumps(row) + "\n" for row in self.rows), encoding="utf-8")
        partial.replace(self.path)
        return row


def _ours(radiance: Any) -> Rendered:
    """Our samplers on a renderer."""

    def rendered(samples: int, seed: int, settings: Mapping[str, Any]) -> Picture:
        config = Config() if settings else Config.uniform()
        made = render(radiance, radiance.width, radiance.height, Budget(spp=samples), config, seed=seed)
        return Picture(made.film.mean, made.film.samples, made.seconds["total"])

    return rendered


def _recording(release: str, options: argparse.Namespace) -> Recording:
    """The samples of our tracer, recorded where the cache has none."""
    own = {**references.identify(options.scene, OURS, release), "size": options.size, "spp": _PER_PIXEL}
    path = references.cache_folder() / f"{references.key(own)}.h5"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        _say(f"{TITLES[OURS]}: recording of {_PER_PIXEL} samples a pixel")
        radiance = load(OURS, options.scene, size=options.size)
        record(radiance, *options.size, _PER_PIXEL, path, seed=references.SEED, settings=own)
    return Recording(path)


def _reference(name: str, release: str, rendered: Rendered, options: argparse.Namespace) -> Reference:
    """A uniform reference of a renderer's own making."""
    width, height = options.size
    spp = options.reference_spp

    def replicate(seed: int, each: int, state: Path, share: Callable[[float], None]) -> tuple[Any, int]:
        return rendered(each, seed, UNIFORM).rgb, 0

    return references.replicated(
        replicate,
        width,
        height,
        spp,
        references.identify(options.scene, name, release),
        replicates=spp // options.spp,
        progress=lambda share: _say(f"{TITLES[name]}: reference, {share:.0%}"),
    )


def _study(
    name: str, release: str, rendered: Rendered, reference: Reference, options: argparse.Namespace, log: Log
) -> Reference:
    """Do what is missing of a renderer's runs; its reference."""
    shared = {"renderer": name, "version": release, "scene": options.scene, "reference": reference.key}
    methods = [UNIFORM, *ADAPTIVE[name]]
    known = {**shared, "budget": options.spp}
    if name in (OURS, RECORDED):
        known["code"] = fingerprint()
    asked = [_asked(known, settings, rendered, log) for settings in methods]
    for seed in range(1, _seeds(options, name) + 1):
        for settings, (samples, given) in zip(methods, asked, strict=True):
            _say(f"{TITLES[name]}: seed {seed}, {_settings(settings)}")
            # The further seeds are for the bias: other metrics take longer than these renders.
            kind, names = ("all", measures.DEFAULT) if seed <= options.seeds else ("errors", tuple(measures.ERRORS))
            log.once(
                {**known, "method": settings, "samples": samples, "settings": given, "seed": seed, "metrics": kind},
                lambda: study.row(rendered(samples, seed, given), reference, WHITE_LUMINANCE, names),  # noqa: B023
            )
    return reference


def _seeds(options: argparse.Namespace, name: str) -> int:
    return int(options.own_seeds if name in (OURS, RECORDED) else options.seeds)


def _asked(
    known: Mapping[str, Any], settings: Mapping[str, Any], rendered: Rendered, log: Log
) -> tuple[int, Mapping[str, Any]]:
    """The samples a pixel that meet the budget, and the settings to go with them."""
    budget = known["budget"]
    if "most" not in settings:
        return budget, settings
    most = settings["most"] * budget
    given = {"min_samples": settings["min_samples"]}

    def achieved(threshold: float) -> float:
        _say(f"{TITLES[known['renderer']]}: {_settings(settings)}, looking for a threshold: {threshold:.4g}")
        pilot = {**known, "pilot": settings, "settings": {**given, "threshold": threshold}}
        return float(log.once(pilot, lambda: {"spp": rendered(most, study.PILOT_SEED, pilot["settings"]).spp})["spp"])

    return most, {**given, "threshold": study.threshold_for(budget, achieved)}


def page(options: argparse.Namespace, rows: Sequence[study.Row], renderers: Sequence[str]) -> str:
    """The Markdown page."""
    peers = options.peers or [name for name in renderers if name in PACKAGES]
    command = (
        f"python benchmarks/peers.py --peers {' '.join(peers)} --spp {options.spp} --seeds {options.seeds} "
        f"--own-seeds {options.own_seeds}"
    )
    releases = sorted({row["version"] for row in rows if row["renderer"] in PACKAGES})
    lines = [
        "# Adaptive sampling of production renderers, beside PMC",
        "",
        f"`{command} -o benchmarks/`",
        "",
        f"`{options.scene}`, {options.size[0]}x{options.size[1]} pixels, {options.spp} samples a pixel, seeds 1 to "
        f"{options.seeds}, of ours to {options.own_seeds}, for its bias is the smallest. {'; '.join(releases)}. "
        f"{platform.system()}, Python {platform.python_version()}.",
        "",
        "Factors are the error of the renderer's own uniform sampling over that of its adaptive sampling, seed by",
        "seed: median and 95 % bootstrap interval. Samples per pixel are as the renderer counted them, and differ a",
        "little; errors count as falling in proportion to them. Each renderer is measured against a uniform reference",
        f"of its own of {options.reference_spp} samples a pixel, of other seeds,",
        "whose noise is subtracted from the errors; the recording of our tracer, of "
        f"{_PER_PIXEL} samples a pixel, has an exact mean. MSE is of linear RGB; tvi error is",
        f"`mean((dY / tvi(Y))^2)`, white is {WHITE_LUMINANCE:g} cd/m2.",
        "Bias is of mean luminance, with its standard error over seeds; the reference's own is in the next column.",
        "Seconds are medians, on a machine that did other things too.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|" + "---|" * len(COLUMNS),
    ]
    for name in renderers:
        for settings in (UNIFORM, *ADAPTIVE[name]):
            lines.append(_line(rows, name, settings))
    return "\n".join([*lines, "", *_others(rows, renderers), "", *_verdict(rows, renderers)]) + "\n"


def _others(rows: Sequence[study.Row], renderers: Sequence[str]) -> list[str]:
    """A table of the other metrics: medians over seeds, of uniform sampling and, after it, of each adaptive setting."""
    names = [name for name in measures.DEFAULT if name not in measures.ERRORS]
    lines = [
        "All other metrics: medians over the seeds that all have, at the samples that were taken, with the noise of "
        "each one's reference.",
        "",
        f"| renderer | sampling | {' | '.join(label(name) for name in names)} |",
        "|" + "---|" * (2 + len(names)),
    ]
    for renderer in renderers:
        for settings in (UNIFORM, *ADAPTIVE[renderer]):
            own = _of(rows, renderer, settings)
            cells = [f"{np.median([row[name] for row in own if name in row]):.3g}" for name in names]
            lines.append(f"| {TITLES[renderer]} | {_settings(settings)} | {' | '.join(cells)} |")
    return lines


def _line(rows: Sequence[study.Row], name: str, settings: Mapping[str, Any]) -> str:
    own, base = (_of(rows, name, which) for which in (settings, UNIFORM))
    cells = [TITLES[name], _settings(settings, own[0]["settings"])]
    cells.append(f"{np.mean([row['spp'] for row in own]):.1f}")
    for error in measures.ERRORS:
        cells.append(f"{np.median([row[error] for row in own]):.3g}")
        cells.append("1" if settings == UNIFORM else _interval(study.gains(own, base, error)))
    cells += [_bias(own), f"{100 * own[0]['reference_bias']:.2f}"]
    cells.append(f"{np.median([row['seconds'] for row in own]):.2f}")
    return f"| {' | '.join(cells)} |"


def _verdict(rows: Sequence[study.Row], renderers: Sequence[str]) -> list[str]:
    """Whether PMC gains more than each peer by the best of its settings, error by error, and at less bias."""
    lines = []
    for name in [name for name in renderers if name in PACKAGES]:
        base = _of(rows, name, UNIFORM)
        for error, title in measures.ERRORS.items():
            groups = [(settings, _of(rows, name, settings)) for settings in ADAPTIVE[name]]
            settings, own = max(groups, key=lambda group: study.gains(group[1], base, error).median)
            theirs = study.gains(own, base, error)
            ours = []
            for which in (OURS, RECORDED):
                pmc = _of(rows, which, ADAPTIVE[which][0])
                gain = study.gains(pmc, _of(rows, which, UNIFORM), error)
                ours.append(f"{_interval(gain)} at a bias of {_bias(pmc)} %")
            lines.append(
                f"* {title}: PMC's factor is {ours[0]}, on the recording {ours[1]}; the best of {TITLES[name]} "
                f"{_interval(theirs)} at {_bias(own)} % ({_settings(settings)})."
            )
    return ["The best setting of a peer is chosen from the same runs, to its advantage.", "", *lines]


def _of(rows: Sequence[study.Row], name: str, settings: Mapping[str, Any]) -> Sequence[study.Row]:
    """A renderer's runs with these settings."""
    return [row for row in rows if row["renderer"] == name and row["method"] == settings]


def figure(path: Path, rows: Sequence[study.Row], found: Mapping[str, Reference]) -> None:
    """Each renderer's reference, and below the factors of all settings with their intervals."""
    import matplotlib.pyplot as plt
    from pmc_sampler.eval.display import display

    drawing = plt.figure(figsize=(3.4 * len(found), 6.8), layout="constrained")
    above, below = drawing.subfigures(2, 1, height_ratios=[1, 1.3])
    for axis, (name, reference) in zip(above.subplots(1, len(found), squeeze=False)[0], found.items(), strict=True):
        axis.imshow(display(reference.mean))
        axis.set_title(f"{TITLES[name]}, {reference.spp} spp", fontsize="small")
        axis.set_axis_off()
    factors = below.subplots()
    labels = [(name, settings) for name in found for settings in ADAPTIVE[name]][::-1]
    for error, mark, shift in (("mse", "o", 0.12), ("tvi_error", "s", -0.12)):
        gains = [study.gains(_of(rows, name, settings), _of(rows, name, UNIFORM), error) for name, settings in labels]
        middle = np.array([gain.median for gain in gains])
        ends = np.array([[gain.median - gain.low, gain.high - gain.median] for gain in gains]).T
        factors.errorbar(
            middle, np.arange(len(labels)) + shift, xerr=ends, fmt=mark, capsize=3, label=measures.ERRORS[error]
        )
    factors.set_yticks(range(len(labels)), [f"{TITLES[name]}: {_settings(one)}" for name, one in labels])
    factors.set_xscale("log")
    factors.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    factors.minorticks_off()
    factors.axvline(1.0, color="grey", linewidth=0.8)
    factors.set_xlabel("error of the renderer's own uniform sampling over the adaptive one's")
    factors.legend()
    drawing.savefig(path, dpi=100)
    plt.close(drawing)


def _settings(settings: Mapping[str, Any], given: Mapping[str, Any] | None = None) -> str:
    if not settings:
        return "uniform"
    shown = {**settings, **{key: value for key, value in (given or {}).items() if key == "threshold"}}
    return ", ".join(str(value) if key == "sampler" else f"{key} {value:.3g}" for key, value in shown.items())


def _bias(rows: Sequence[study.Row]) -> str:
    mean, spread = statistics.mean_error([row["bias"] for row in rows])
    return f"{100 * mean:+.2f} ± {100 * spread:.2f}"


def _interval(value: statistics.Interval) -> str:
    return f"{value.median:.2f} ({value.low:.2f} to {value.high:.2f})"


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--peers", nargs="*", choices=PACKAGES, default=list(PACKAGES), metavar="NAME")
    parser.add_argument("--python", default=sys.executable, help="the Python that has the peers' packages")
    parser.add_argument("--scene", default="cornell-box", metavar="NAME", help="diffuse and glass alone")
    parser.add_argument("--size", type=size, default=(96, 72), metavar="WxH")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--own-seeds", type=int, default=400, help="of our tracer; default: %(default)s")
    parser.add_argument("--reference-spp", type=int, default=16384, help="a multiple of --spp")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
