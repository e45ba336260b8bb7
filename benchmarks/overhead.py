"""Measures what the sampler itself costs: time per sample of ask and tell, memory, its share of a render.

Writes ``overhead.md`` into the output folder. The radiance of the first part is random numbers that were
drawn before the clock started, so that nothing but the sampler is timed.
"""

import argparse
import math
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from pmc_sampler.eval import benchmark, results

from pmc_sampler import Budget, Config, Sampler, _core, adapters, render
from pmc_sampler.cli.arguments import size

SIZES = ((640, 480), (7680, 4320))
CONFIGS = {"default": Config(), "uniform": Config.uniform()}
SCENE = "cornell-box"


@dataclass(frozen=True)
class Cost:
    """Nanoseconds per sample: in ask, in tell, and in both once the sampler adapts."""

    ask: float
    tell: float
    adaptive: float

    @property
    def total(self) -> float:
        return self.ask + self.tell


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    lines = [
        "# What the sampler costs",
        "",
        f"`python benchmarks/overhead.py -o benchmarks/`, {benchmark.machine()}, {options.threads} threads.",
        "",
        "Nanoseconds per sample, the radiance being random numbers at hand: median of "
        f"{options.repeats} interleaved runs, and the extremes of the sum. With few samples a pixel the first touch "
        "of the memory is a part of it. *Adapting*: batches after the initial pool samples alone.",
        "",
        "| size | spp | method | ask | tell | ask + tell | adapting |",
        "|---|---|---|---|---|---|---|",
    ]
    for (width, height), spp in product(options.sizes, options.spp):
        costs: dict[str, list[Cost]] = {name: [] for name in CONFIGS}
        for repeat in range(options.repeats):
            for name, config in CONFIGS.items():
                costs[name].append(measure(width, height, config, spp, options.threads, repeat))
                print(f"{width}x{height}, {spp} spp, {name}: {costs[name][-1].total:.1f} ns a sample", file=sys.stderr)
        lines += [row(f"{width}x{height}", spp, name, found) for name, found in costs.items()]
    lines += ["", f"The film takes {_core.film_bytes_per_pixel} bytes a pixel."]
    if options.renderer:
        lines += ["", share_of_render(options.renderer, options.repeats)]
    results.write_text(options.output / "overhead.md", "\n".join(lines) + "\n")
    print("\n".join(lines))
    return 0


def measure(width: int, height: int, config: Config, spp: int, threads: int, seed: int) -> Cost:
    """One whole run on prepared radiance."""
    sampler = Sampler(width, height, Budget(spp=spp), config, seed=seed, threads=threads)
    radiance = prepared(width * height, seed)
    ask = tell = late = 0.0
    late_samples = 0
    while not sampler.done:
        start = time.perf_counter()
        batch = sampler.ask()
        asked = time.perf_counter()
        values = next(radiance)[: len(batch)]
        ready = time.perf_counter()
        sampler.tell(batch, values)
        told = time.perf_counter()
        ask += asked - start
        tell += told - ready
        samples = len(batch)
        del batch  # as `Sampler.run` does: its memory serves for the next
        if sampler.spp > initial(spp):
            late += asked - start + told - ready
            late_samples += samples
    adaptive = 1e9 * late / late_samples if late_samples else math.nan
    return Cost(1e9 * ask / sampler.samples, 1e9 * tell / sampler.samples, adaptive)


def initial(spp: int) -> float:
    """Samples a pixel before anything adapts, by default."""
    return min(max(round(spp / 16), 4), 16)


def prepared(largest: int, seed: int) -> Iterator[np.ndarray]:
    """Radiance with bright specks, a new array for each batch in turn."""
    generator = np.random.default_rng(seed)
    arrays = []
    for _ in range(2):
        values = generator.random((max(largest, 4096), 3), dtype=np.float32)
        values[generator.random(len(values), dtype=np.float32) < 0.01] *= 50.0
        arrays.append(values)
    while True:
        yield from arrays


def row(image: str, spp: int, name: str, costs: list[Cost]) -> str:
    """A line of the table."""
    totals = [cost.total for cost in costs]
    cells = [
        image,
        str(spp),
        name,
        *(f"{statistics.median(getattr(cost, part) for cost in costs):.1f}" for part in ("ask", "tell")),
        f"{statistics.median(totals):.1f} ({min(totals):.1f} to {max(totals):.1f})",
        f"{statistics.median(cost.adaptive for cost in costs):.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def share_of_render(renderer: str, repeats: int) -> str:
    """The sampler's share of whole renders of the Cornell box, compilation excluded."""
    radiance = adapters.load(renderer, SCENE)
    width, height = radiance.width, radiance.height
    render(radiance, width, height, Budget(spp=1), Config.uniform())
    shares = []
    for seed in range(repeats):
        result = render(radiance, width, height, Budget(spp=64), seed=seed)
        shares.append(100 * result.seconds["sampler"] / result.seconds["total"])
        print(f"{SCENE}: {shares[-1]:.1f} % of {result.seconds['total']:.1f} s", file=sys.stderr)
    return (
        f"Of a render of `{SCENE}` by {renderer}, {width}x{height} at 64 samples per pixel, ask and tell "
        f"take {statistics.median(shares):.1f} % ({min(shares):.1f} to {max(shares):.1f})."
    )


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of overhead.md")
    parser.add_argument("--sizes", nargs="+", type=size, default=SIZES, metavar="WxH")
    parser.add_argument("--spp", nargs="+", type=int, default=(16, 64), metavar="N")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--renderer", default="mitsuba", help="for the share of a render; empty for none")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
