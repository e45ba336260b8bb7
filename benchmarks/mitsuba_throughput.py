"""Samples per second through the Mitsuba adapter, against `mi.render` on the same scene with the same kind of sampler.

    python benchmarks/mitsuba_throughput.py [--scene cornell-box] [--sizes 320x240 640x480] [--spp 16] [--rounds 15]
    -o DIR

Into the folder goes `mitsuba_throughput.md`. All samples are taken at once, as `mi.render` takes them; in batches of
one sample a pixel, as the sampler begins; and in batches of an eighth, the smallest that it draws by default once it
adapts. All are uniform, so that the paths are as long as those of `mi.render`. Runs are interleaved, for the machine
may be shared and its clock may drift: in each round every contender renders the same number of samples, in an order
that rotates, and a ratio is that of one round's rates. The opponent of our `sobol` is Mitsuba's low-discrepancy
`multijitter`. The first, uncounted round compiles.
"""

from __future__ import annotations

import argparse
import shlex
import statistics
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pmc_sampler.adapters.mitsuba import MitsubaRenderer
from pmc_sampler.eval import benchmark, results

from pmc_sampler import Batch, Budget, Config, Sampler, scenes
from pmc_sampler.cli.arguments import size

KINDS = {"sobol": "multijitter", "independent": "independent"}  # ours, and its opponent
SHARES = {"all": None, "1": 1.0, "1/8": 0.125}  # samples a pixel in a batch


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    command = shlex.join(arguments if arguments is not None else sys.argv[1:])
    lines = [
        "# Throughput of the Mitsuba adapter",
        "",
        f"`python benchmarks/mitsuba_throughput.py {command}`, {benchmark.machine()}, "
        f"Mitsuba {MitsubaRenderer.version()}, `{options.scene}` at {options.spp} samples a pixel. What is "
        "measured is in the head of `benchmarks/mitsuba_throughput.py`.",
        "",
        "| size | sampler | samples a pixel in a batch | million samples/s | over `mi.render` (quartiles) |",
        "|---|---|---|---|---|",
    ]
    for width, height in options.sizes:
        rates, host = measure(options.scene, (width, height), options.spp, options.rounds)
        lines += [row(f"{width}x{height}", kind, batch, rates) for kind in KINDS for batch in SHARES]
    lines += ["", f"A batch of two samples takes {1e3 * host:.2f} ms: what each costs besides its samples."]
    results.write_text(options.output / "mitsuba_throughput.md", "\n".join(lines) + "\n")
    print("\n".join(lines))
    return 0


def measure(scene: str, image: tuple[int, int], spp: int, rounds: int) -> tuple[dict[Any, list[float]], float]:
    """Samples per second in each round: of ours by (kind, batch), of `mi.render` by kind; seconds of a tiny batch."""
    ours = {kind: MitsubaRenderer(scene, sampler=kind, size=image) for kind in KINDS}
    batches = {batch: drawn(*image, spp, share) for batch, share in SHARES.items()}
    contenders: dict[Any, Callable[[int], None]] = {}
    for kind, opponent in KINDS.items():
        contenders[kind] = _mitsuba(scene, image, spp, opponent)
        contenders |= {(kind, batch): _ours(ours[kind], some) for batch, some in batches.items()}
    rates: dict[Any, list[float]] = {name: [] for name in contenders}
    names = list(contenders)
    for turn in range(rounds + 1):
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            start = time.perf_counter()
            contenders[name](turn)
            if turn:
                rates[name].append(image[0] * image[1] * spp / (time.perf_counter() - start))
        print(f"{image[0]}x{image[1]}: round {turn} of {rounds}", file=sys.stderr)
    return rates, _host(ours["sobol"], batches["1"][0])


def drawn(width: int, height: int, spp: int, share: float | None) -> list[Batch]:
    """The batches of a uniform render, of `share` samples a pixel each or, without one, all in one."""
    config = Config.uniform(batch=max(1, round(width * height * (spp if share is None else share))))
    sampler = Sampler(width, height, Budget(spp=spp), config, seed=1)
    batches = []
    while not sampler.done:
        batches.append(sampler.ask())
        sampler.tell(batches[-1], np.full((len(batches[-1]), 3), 0.5, np.float32))
    return batches


def _ours(renderer: MitsubaRenderer, batches: list[Batch]) -> Callable[[int], None]:
    def render(turn: int) -> None:
        for batch in batches:
            renderer(batch)

    return render


def _mitsuba(scene: str, image: tuple[int, int], spp: int, sampler: str) -> Callable[[int], None]:
    """`mi.render` of the built-in scene with one of Mitsuba's samplers."""
    import mitsuba as mi

    text = scenes.path(scene).read_text(encoding="utf-8")
    changed = text.replace('<sampler type="independent">', f'<sampler type="{sampler}">')
    loaded = mi.load_string(changed, width=str(image[0]), height=str(image[1]), spp=str(spp))

    def render(turn: int) -> None:
        np.asarray(mi.render(loaded, spp=spp, seed=turn))

    return render


def _host(renderer: MitsubaRenderer, batch: Batch) -> float:
    """Seconds of a batch of two samples, the median of 50."""
    little = SimpleNamespace(positions=batch.positions[:2], scramble=batch.scramble[:2], index=batch.index[:2])
    clock = [time.perf_counter()]
    for _ in range(50):
        renderer(little)
        clock.append(time.perf_counter())
    return statistics.median(end - start for start, end in pairwise(clock))


def row(image: str, kind: str, batch: str, rates: dict[Any, list[float]]) -> str:
    """A line of the table."""
    own = np.array(rates[kind, batch])
    low, middle, high = np.percentile(own / np.array(rates[kind]), (25, 50, 75))
    return f"| {image} | {kind} | {batch} | {np.median(own) / 1e6:.2f} | {middle:.3f} ({low:.3f} to {high:.3f}) |"


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="of mitsuba_throughput.md")
    parser.add_argument("--scene", default="cornell-box", choices=scenes.names())
    parser.add_argument("--sizes", nargs="+", type=size, default=((320, 240), (640, 480)), metavar="WxH")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=15)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
