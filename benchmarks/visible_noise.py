"""Whether `--visible-noise` keeps its word: of the pixels called settled, how many differ from a reference by less than
one threshold.

    python benchmarks/visible_noise.py [--reference-spp N] [--spp N] [--size W H] [--cache DIR]
        [--seeds N] [--window PIXELS] [--margin ERRORS] [SCENE ...]

Each scene is rendered by the OpenCL tracer, at 96x72 by default, adaptively and uniformly, up to `--spp` samples a
pixel. After every batch past each eighth more samples the settled pixels are found by the definition
(`Sampler.visible_noise`), from sums of its own in float64, and held against a reference. For a row of budgets it says
when a render would have ended, and the share of its settled pixels that were within one tvi; and the lowest share at
any time, from where a tenth of the pixels were settled; each for the first seed, and the lowest of all seeds. Exits
with status 1 where any is below 90 %.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pmc_sampler.adapters import load, version
from pmc_sampler.eval import references
from scipy.ndimage import uniform_filter

from pmc_sampler import Budget, luminance, scenes, tvi
from pmc_sampler.sampler import config_for, sampler_for

WHITE = 100.0
BUDGETS = (0.5, 0.3, 0.2, 0.1, 0.05, 0.02)
PROMISED = 0.9
RULE = 7, 1.645  # pixels around, standard errors


class Moments:
    """Count, mean and sum of squared deviations of luminance in each pixel, by batches (Chan et al. 1983)."""

    def __init__(self, height: int, width: int) -> None:
        self.shape = height, width
        self.count, self.mean, self.squares = (np.zeros(height * width) for _ in range(3))

    def add(self, pixel: NDArray[Any], values: NDArray[np.float64]) -> None:
        """A batch."""
        count = np.bincount(pixel, minlength=len(self.count))
        mean = np.bincount(pixel, values, len(count)) / np.maximum(count, 1)
        squares = np.bincount(pixel, (values - mean[pixel]) ** 2, len(count))
        total, apart = np.maximum(self.count + count, 1), mean - self.mean
        self.squares += squares + apart**2 * self.count * count / total
        self.mean += apart * count / total
        self.count += count

    def settled(self, window: int, margin: float) -> NDArray[np.bool_]:
        """The pixels that `Sampler.visible_noise` does not count, (height, width), by its own window and margin."""
        count, mean, squares = (a.reshape(self.shape) for a in (self.count, self.mean, self.squares))
        squares = squares * (margin * WHITE / tvi(WHITE * mean)) ** 2
        freedom = np.maximum(count - 1, 0)
        around = uniform_filter(squares, window, mode="constant") / np.maximum(
            uniform_filter(freedom, window, mode="constant"), 1e-9
        )
        own = squares / np.maximum(freedom, 1)
        return np.asarray((count > 1) & (np.maximum(own, around) <= count))


@dataclass
class Outcome:
    """Of one render: where each budget would have ended it, in samples a pixel, and the share of its settled pixels
    that were right then; the lowest such share; the shares of all pixels that were unsettled and wrong at the end.
    """

    ended: dict[float, tuple[float, float]]
    lowest: float
    unsettled: float
    wrong: float


def measure(
    method: str, radiance: Any, reference: references.Reference, spp: float, rule: tuple[int, float], seed: int
) -> Outcome:
    """Renders once."""
    true = luminance(reference.mean.astype(np.float64))
    threshold = tvi(WHITE * true) / WHITE
    config = config_for(radiance, {"preset": method})
    sampler = sampler_for(radiance, *true.shape[::-1], Budget(spp=spp), config, seed=seed)
    moments, after, outcome = Moments(*true.shape), 4.0, Outcome({}, 1.0, 1.0, 1.0)
    right = np.zeros(true.shape, bool)
    while not sampler.done:
        batch = sampler.ask()
        values = radiance(batch)
        sampler.tell(batch, values)
        moments.add(batch.pixel, luminance(values.astype(np.float64)))
        if sampler.spp < after and sampler.done is None:
            continue
        after = 1.125 * sampler.spp
        settled = moments.settled(*rule)
        right = np.abs(luminance(sampler.film.mean.astype(np.float64)) - true) < threshold
        if settled.mean() < 0.1:
            continue
        share = float(right[settled].mean())
        outcome.lowest = min(outcome.lowest, share)
        for budget in BUDGETS:
            if 1.0 - settled.mean() <= budget:
                outcome.ended.setdefault(budget, (sampler.spp, share))
    outcome.unsettled, outcome.wrong = 1.0 - moments.settled(*rule).mean(), 1.0 - right.mean()
    if rule == RULE:
        assert abs(outcome.unsettled - sampler.visible_noise) < 0.005  # the core's, in float32
    return outcome


def line(outcomes: list[Outcome], spp: float) -> str:
    """The first seed's, and the lowest share of all."""
    first, lowest = outcomes[0], min(outcome.lowest for outcome in outcomes)
    ends = ", ".join(f"{b:g} at {at:.0f} spp {share:.1%}" for b, (at, share) in first.ended.items()) or "none"
    return (
        f"ended {ends}; at {spp:g} spp {first.unsettled:.1%} are unsettled, and {first.wrong:.1%} of all pixels are "
        f"off by a threshold or more; lowest {first.lowest:.1%}, of {len(outcomes)} seeds {lowest:.1%}"
    )


def main() -> int:
    """Measures all and returns the exit status."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=scenes.names())
    parser.add_argument("--reference-spp", type=int, default=16384)
    parser.add_argument("--spp", type=float, default=300.0)
    parser.add_argument("--size", type=int, nargs=2, default=(96, 72))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--window", type=int, default=RULE[0], help="pixels around; 1 for none")
    parser.add_argument("--margin", type=float, default=RULE[1], help="standard errors")
    parser.add_argument("--cache")
    options = parser.parse_args()
    lowest = []
    for scene in options.scenes:
        began = time.perf_counter()
        radiance = load("opencl", scene, size=tuple(options.size))
        settings = references.identify(scene, "opencl", version("opencl"))
        reference = references.obtain(radiance, *options.size, options.reference_spp, settings, cache=options.cache)
        rule = (options.window, options.margin)
        for method in ("default", "uniform"):
            outcomes = [
                measure(method, radiance, reference, options.spp, rule, seed) for seed in range(1, options.seeds + 1)
            ]
            print(f"{scene}, {method}: {line(outcomes, options.spp)}", flush=True)
            lowest += [outcome.lowest for outcome in outcomes]
        print(f"{scene}: {time.perf_counter() - began:.0f} s", flush=True)
    return int(min(lowest) < PROMISED)


if __name__ == "__main__":
    sys.exit(main())
