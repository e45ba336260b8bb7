"""The benchmark of samplers: methods against each other on scenes, at equal sample counts, seed by seed.

Runs are independent rows of a file of JSON lines, appended one by one: an interrupted benchmark goes on
where it stopped and repeats nothing. A row is found again by everything that determines it: scene,
renderer, settings, size, samples, seed, reference and the code of the sampler.
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pmc_sampler
from pmc_sampler import Budget, Config, _core, render

from . import metrics
from .references import Reference, key, obtain

Renderer = Callable[..., Any]
Log = Callable[[str], None]


@dataclass(frozen=True)
class Method:
    """A way to spend samples: a name for the table, settings for a width and height, random numbers."""

    name: str
    config: Callable[[int, int], Config]
    sampler: str


BASELINE = Method("PT, independent", lambda w, h: Config.uniform(), "independent")
STRATIFIED = Method("PT, Sobol", lambda w, h: Config.uniform(), "sobol")
METHODS = (
    BASELINE,
    STRATIFIED,
    Method("paper, independent", Config.paper, "independent"),
    Method("paper, Sobol", Config.paper, "sobol"),
    # Not scaled to the image: at a quarter of the pixels its iterations are so few that beta is never adapted.
    Method("paper, all 5000 members, independent", lambda w, h: Config.paper(), "independent"),
    Method("default, Sobol", lambda w, h: Config(), "sobol"),
)


@dataclass(frozen=True)
class Plan:
    """What to run."""

    scenes: tuple[str, ...]
    width: int = 320
    height: int = 240
    spp: int = 64
    seeds: int = 10
    reference_spp: int = 4096
    methods: tuple[Method, ...] = METHODS
    identities: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """For each scene what identifies it and its renderer (:func:`pmc_sampler.eval.references.identify`)."""
    code: str = ""
    """Names the code that makes the images; rows of other code are not taken for this one's."""


class Rows:
    """The file of results: read once, appended to row by row."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.by_id: dict[str, dict[str, Any]] = {}
        if self.path.is_file():
            text = self.path.read_text(encoding="utf-8")
            whole, newline, torn = text.rpartition("\n")
            if torn:
                # An interruption in the middle of a write left half a row: cut it off before appending.
                with self.path.open("r+b") as stream:
                    stream.truncate(len((whole + newline).encode()))
            for line in whole.splitlines():
                row = json.loads(line)
                self.by_id[row["id"]] = row

    def append(self, row: dict[str, Any]) -> None:
        """Add one row, on disk before this returns."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row, sort_keys=True) + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        self.by_id[row["id"]] = row


def run(
    plan: Plan,
    load: Callable[[str, str], Renderer],
    rows: Rows,
    *,
    cache: str | os.PathLike[str] | None = None,
    log: Log = lambda line: None,
) -> list[dict[str, Any]]:
    """Run what is missing in ``rows`` and return the rows of the plan, in its order.

    ``load(scene, sampler)`` gives the renderer of a scene, at the plan's size, with ``"sobol"`` or
    ``"independent"`` random numbers. References go to ``cache`` (see
    :func:`pmc_sampler.eval.references.obtain`). Methods are interleaved within each seed, so that a
    machine's drift hits all alike; each renderer is warmed up before it is timed. ``log`` gets a line for
    each step.
    """
    wanted: list[dict[str, Any]] = []
    for scene in plan.scenes:
        renderers: dict[str, Renderer] = {}
        reference: Reference | None = None
        for seed, method in _order(plan):
            identity = _identity(plan, scene, method, seed)
            found = rows.by_id.get(identity["id"])
            if found is None:
                reference = reference or _reference(plan, scene, load, cache, log)
                if method.sampler not in renderers:
                    renderers[method.sampler] = load(scene, method.sampler)
                    render(renderers[method.sampler], plan.width, plan.height, Budget(spp=1), Config.uniform())
                found = identity | _measure(plan, method, seed, renderers[method.sampler], reference)
                rows.append(found)
                log(
                    f"{scene}, seed {seed}, {method.name}: {found['seconds']['total']:.1f} s, "
                    f"tvi error {found['tvi_error']:.4g}, MSE {found['mse']:.4g}"
                )
            wanted.append(found)
    return wanted


def _order(plan: Plan) -> Iterator[tuple[int, Method]]:
    for seed in range(1, plan.seeds + 1):
        # The order within a seed turns, so that no method always runs first.
        turn = seed % len(plan.methods)
        for method in plan.methods[turn:] + plan.methods[:turn]:
            yield seed, method


def _reference(
    plan: Plan,
    scene: str,
    load: Callable[[str, str], Renderer],
    cache: str | os.PathLike[str] | None,
    log: Log,
) -> Reference:
    began, shown = time.perf_counter(), 0.0

    def progress(fraction: float) -> None:
        nonlocal shown
        if fraction - shown >= 0.1:
            shown = fraction
            log(f"{scene}: reference {fraction:.0%}, {time.perf_counter() - began:.0f} s")

    return obtain(
        load(scene, "sobol"),
        plan.width,
        plan.height,
        plan.reference_spp,
        _settings(plan, scene),
        cache=cache,
        progress=progress,
    )


def _settings(plan: Plan, scene: str) -> dict[str, Any]:
    return {"scene": scene, **plan.identities.get(scene, {})}


def _identity(plan: Plan, scene: str, method: Method, seed: int) -> dict[str, Any]:
    identity = {
        **_settings(plan, scene),
        "method": method.name,
        "sampler": method.sampler,
        "config": method.config(plan.width, plan.height).to_dict(),
        "width": plan.width,
        "height": plan.height,
        "spp": plan.spp,
        "reference_spp": plan.reference_spp,
        "seed": seed,
        "code": plan.code,
    }
    return {"id": key(identity), **identity}


def _measure(plan: Plan, method: Method, seed: int, renderer: Renderer, reference: Reference) -> dict[str, Any]:
    config = method.config(plan.width, plan.height)
    result = render(renderer, plan.width, plan.height, Budget(spp=plan.spp), config, seed=seed)
    image, r = result.film.mean, reference.mean
    white = config.white_luminance
    return {
        "samples": result.samples,
        "rejected": result.rejected,
        "seconds": dict(result.seconds),
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "mse": metrics.mse(image, r, reference_variance=reference.variance),
        "tvi_error": metrics.tvi_error(
            image, r, white_luminance=white, reference_variance=reference.luminance_variance
        ),
        "relmse": metrics.relmse(image, r, reference_variance=reference.variance),
        "visible_pixels": metrics.visible_pixels(image, r, white_luminance=white),
        "ssim": metrics.ssim(image, r),
        "flip": metrics.flip(image, r, exposures=metrics.flip_exposures(r)),
        "bias": metrics.bias(image, r),
        "plain_bias": metrics.bias(result.film.plain_mean, r),
        "reference": {
            "mse": float(reference.variance.mean()),
            "tvi_error": float(reference_tvi(reference, white)),
            "bias_error": reference.bias_error,
        },
    }


def reference_tvi(reference: Reference, white_luminance: float) -> float:
    """The reference's own part of a tvi error measured against it, which is what the metric subtracts."""
    same = metrics.tvi_error(
        reference.mean,
        reference.mean,
        white_luminance=white_luminance,
        reference_variance=reference.luminance_variance,
    )
    return -same


def fingerprint(files: Iterable[Path] = ()) -> str:
    """A hash of the sampler's code and of further ``files``, such as an adapter's."""
    package = Path(pmc_sampler.__file__).parent
    parts = [Path(_core.__file__), *package.glob("*.py"), *files]
    digest = hashlib.sha256()
    for part in sorted(parts):
        digest.update(part.name.encode() + b"\0" + part.read_bytes())
    return digest.hexdigest()[:12]
