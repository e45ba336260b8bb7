"""Samples per second through the Mitsuba adapter, against `mi.render` on the same scene with the same kind of
sampler.

    python benchmarks/mitsuba_throughput.py [--scene cornell-box] [--size 320x240] [--spp 16] [--rounds 15]
    [-o FILE.json]

Runs are interleaved, for the machine may be shared and its clock may drift: each round renders the same
number of samples once by every contender, in an order that rotates, and a contender's figure is the median
over rounds of its rate over that of its opponent in the same round. Mitsuba's low-discrepancy `multijitter`
is the opponent of our `sobol`, its `independent` that of ours. The first, uncounted round compiles the
kernels.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pmc_sampler.adapters.mitsuba import MitsubaRenderer

from pmc_sampler import scenes

Rates = dict[str, list[float]]
PAIRS = (
    ("ours sobol", "mi multijitter"),
    ("ours independent", "mi independent"),
    ("ours sobol", "ours independent"),
)


def batches(width: int, height: int, spp: int, rng: np.random.Generator, tile: int = 16) -> Any:
    """A batch of `spp` samples in each pixel, tile by tile as the sampler orders its own."""
    y, x = np.divmod(np.arange(width * height, dtype=np.uint32), width)
    order = np.lexsort((x, y, x // tile, y // tile))
    pixel = np.repeat((y * width + x)[order], spp)
    positions = np.empty((len(pixel), 2), np.float32)
    positions[:, 0] = pixel % width + rng.random(len(pixel), np.float32) * np.float32(0.999)
    positions[:, 1] = pixel // width + rng.random(len(pixel), np.float32) * np.float32(0.999)
    scramble = rng.integers(0, 1 << 32, width * height, np.uint32)
    index = np.tile(np.arange(spp, dtype=np.uint32), width * height)
    return SimpleNamespace(positions=positions, pixel=pixel, scramble=scramble[pixel], index=index, number=0)


def measure(scene: str, size: tuple[int, int], spp: int, rounds: int) -> tuple[Rates, dict[str, float]]:
    """Samples per second of each contender in each round, and the host's seconds per batch of either kind of
    ours."""
    import mitsuba as mi

    ours = {kind: MitsubaRenderer(scene, sampler=kind, size=size) for kind in ("sobol", "independent")}
    theirs = {kind: _loaded(mi, scene, size, spp, kind) for kind in ("multijitter", "independent")}
    given = batches(*size, spp, np.random.default_rng(1))
    contenders = {f"ours {kind}": (lambda seed, kind=kind: ours[kind](given)) for kind in ours}
    contenders |= {
        f"mi {kind}": (lambda seed, kind=kind: np.asarray(mi.render(theirs[kind], spp=spp, seed=seed)))
        for kind in theirs
    }
    rates: Rates = {name: [] for name in contenders}
    for turn in range(rounds + 1):
        names = list(contenders)
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            start = time.perf_counter()
            contenders[name](turn)
            if turn:
                rates[name].append(len(given.index) / (time.perf_counter() - start))
    return rates, {kind: _host_seconds(renderer, given) for kind, renderer in ours.items()}


def _loaded(mi: Any, scene: str, size: tuple[int, int], spp: int, sampler: str) -> Any:
    """The built-in scene for `mi.render`, with the named sampler."""
    text = scenes.path(scene).read_text(encoding="utf-8")
    changed = text.replace('<sampler type="independent">', f'<sampler type="{sampler}">')
    return mi.load_string(changed, width=str(size[0]), height=str(size[1]), spp=str(spp))


def _host_seconds(renderer: MitsubaRenderer, given: Any) -> float:
    little = SimpleNamespace(**{key: value[:2] for key, value in vars(given).items() if key != "number"})
    times = []
    for _ in range(50):
        start = time.perf_counter()
        renderer(little)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _report(rates: Rates, host: dict[str, float]) -> dict[str, Any]:
    """The figures as printed and stored: rates in samples a second, ratios as median and quartiles over
    rounds."""
    ratios = {}
    for one, other in PAIRS:
        low, middle, high = np.percentile(np.array(rates[one]) / np.array(rates[other]), (25, 50, 75))
        ratios[f"{one} / {other}"] = {"median": float(middle), "quartiles": [float(low), float(high)]}
    return {
        "samples_per_second": {name: float(np.median(values)) for name, values in rates.items()},
        "ratio": ratios,
        "host_seconds_per_batch": host,
    }


def main(arguments: list[str] | None = None) -> int:
    """Measures, prints a table and writes the figures where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--scene", default="cornell-box", choices=scenes.names())
    parser.add_argument("--size", default="320x240", help="width x height in pixels")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("-o", "--output", type=Path, help="a JSON file for the figures")
    options = parser.parse_args(arguments)
    width, height = (int(side) for side in options.size.split("x"))
    figures = _report(*measure(options.scene, (width, height), options.spp, options.rounds))
    figures = {"command": "python " + " ".join(sys.argv), **figures}
    for name, rate in figures["samples_per_second"].items():
        print(f"{name:20s} {rate / 1e6:8.3f} M samples/s")
    for name, ratio in figures["ratio"].items():
        low, high = ratio["quartiles"]
        print(f"{name:40s} {ratio['median']:.3f}  (quartiles {low:.3f} to {high:.3f})")
    for kind, seconds in figures["host_seconds_per_batch"].items():
        print(f"host time per batch, {kind:20s} {seconds * 1e3:.2f} ms")
    if options.output:
        options.output.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
