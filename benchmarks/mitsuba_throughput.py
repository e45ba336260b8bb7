"""Samples per second through the Mitsuba adapter, against `mi.render` on the same scene with the same kind of
sampler.

    python benchmarks/mitsuba_throughput.py [--scene cornell-box] [--size 320x240] [--spp 16] [--rounds 15]
    [-o FILE.json]

Once with all samples at once, as `mi.render` takes them, and once in the batches of one sample a pixel that
the sampler draws by default, where neighbouring lanes belong to neighbouring pixels instead of one; Mitsuba's
own counterpart of that is `mi.render` with one sample a pixel, over and over. Runs are interleaved, for the
machine may be shared and its clock may drift: in each round every contender renders the same number of
samples, in an order that rotates, and a ratio is that of one round's rates. The opponent of our `sobol` is
Mitsuba's low-discrepancy `multijitter`. The first, uncounted round compiles.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pmc_sampler.adapters.mitsuba import MitsubaRenderer

from pmc_sampler import Batch, Budget, Config, Sampler, scenes

Rates = dict[str, list[float]]
PAIRS = (
    ("sobol", "mi multijitter"),
    ("independent", "mi independent"),
    ("sobol", "independent"),
    ("sobol by 1 spp", "mi multijitter by 1 spp"),
    ("sobol by 1 spp", "mi multijitter"),
)


def drawn(width: int, height: int, spp: int, per_batch: int) -> list[Batch]:
    """The batches of a uniform render, as the sampler draws them, with so many samples a pixel in each."""
    config = Config.uniform(batch=width * height * per_batch)
    sampler = Sampler(width, height, Budget(spp=spp), config, seed=1)
    batches = []
    while not sampler.done:
        batches.append(sampler.ask())
        sampler.tell(batches[-1], np.full((len(batches[-1]), 3), 0.5, np.float32))
    return batches


def measure(scene: str, size: tuple[int, int], spp: int, rounds: int) -> tuple[Rates, dict[str, float]]:
    """Samples per second of each contender in each round; the host's seconds per batch by kind of sampler."""
    contenders, hosts = _contenders(scene, size, spp)
    rates: Rates = {name: [] for name in contenders}
    for turn in range(rounds + 1):
        names = list(contenders)
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            start = time.perf_counter()
            contenders[name](turn)
            if turn:
                rates[name].append(size[0] * size[1] * spp / (time.perf_counter() - start))
    return rates, {kind: float(np.median([host() for _ in range(50)])) for kind, host in hosts.items()}


def _contenders(
    scene: str, size: tuple[int, int], spp: int
) -> tuple[dict[str, Callable[[int], Any]], dict[str, Callable[[], float]]]:
    """By name, what renders all samples, given the round; by kind of sampler, what times a batch of two
    samples."""
    import mitsuba as mi

    ours = {kind: MitsubaRenderer(scene, sampler=kind, size=size) for kind in ("sobol", "independent")}
    at_once, by_one = drawn(*size, spp, spp), drawn(*size, spp, 1)

    def with_ours(kind: str, batches: list[Batch]) -> Callable[[int], Any]:
        return lambda turn: [ours[kind](batch) for batch in batches]

    def with_mitsuba(kind: str, passes: int) -> Callable[[int], Any]:
        loaded = _loaded(mi, scene, size, spp // passes, kind)

        def render(turn: int) -> None:
            for k in range(passes):
                np.asarray(mi.render(loaded, spp=spp // passes, seed=turn * passes + k))

        return render

    def host(kind: str) -> Callable[[], float]:
        first = by_one[0]
        little = SimpleNamespace(positions=first.positions[:2], scramble=first.scramble[:2], index=first.index[:2])

        def seconds() -> float:
            start = time.perf_counter()
            ours[kind](little)
            return time.perf_counter() - start

        return seconds

    contenders = {
        "sobol": with_ours("sobol", at_once),
        "independent": with_ours("independent", at_once),
        "sobol by 1 spp": with_ours("sobol", by_one),
        "mi multijitter": with_mitsuba("multijitter", 1),
        "mi independent": with_mitsuba("independent", 1),
        "mi multijitter by 1 spp": with_mitsuba("multijitter", spp),
    }
    return contenders, {kind: host(kind) for kind in ours}


def _loaded(mi: Any, scene: str, size: tuple[int, int], spp: int, sampler: str) -> Any:
    """The built-in scene for `mi.render`, with the named sampler."""
    text = scenes.path(scene).read_text(encoding="utf-8")
    changed = text.replace('<sampler type="independent">', f'<sampler type="{sampler}">')
    return mi.load_string(changed, width=str(size[0]), height=str(size[1]), spp=str(spp))


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
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of mitsuba_throughput.json")
    options = parser.parse_args(arguments)
    width, height = (int(side) for side in options.size.split("x"))
    figures = _report(*measure(options.scene, (width, height), options.spp, options.rounds))
    figures = {"command": "python " + " ".join(sys.argv), **figures}
    for name, rate in figures["samples_per_second"].items():
        print(f"{name:26s} {rate / 1e6:8.3f} M samples/s")
    for name, ratio in figures["ratio"].items():
        low, high = ratio["quartiles"]
        print(f"{name:44s} {ratio['median']:.3f}  (quartiles {low:.3f} to {high:.3f})")
    for kind, seconds in figures["host_seconds_per_batch"].items():
        print(f"host time per batch, {kind:20s} {seconds * 1e3:.2f} ms")
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "mitsuba_throughput.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
