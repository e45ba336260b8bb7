"""The benchmark: methods against each other on scenes, at equal samples and equal time, seed by seed.

Runs are independent and each leaves one row (:mod:`pmc_sampler.eval.results`): an interrupted benchmark goes on where
it stopped and repeats nothing. A row is found again by everything that determines it: scene, renderer, settings, size,
budget, seed, reference and the code of the sampler.
"""

import contextlib
import hashlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pmc_sampler
from pmc_sampler import Budget, _core, render
from pmc_sampler.deadline import Deadline
from pmc_sampler.sampler import config_for

from . import baselines, measures, metrics, references, results
from .clock import Clock
from .executors import Executor, in_process
from .metrics.encoded import SSIM_WINDOW
from .recorded import Recording, record
from .references import Reference, key
from .suite import BadSuiteError, Run, Scene, Suite

Load = Callable[..., Any]
Log = Callable[[str], None]
Progress = Callable[[float, str], None]

WARM_UP_SEED = 0x5EED_FFFF
"""Of the sample a pixel that each renderer makes before it is timed."""


WEIGHING = ("pmc", "greedy", "neyman")
"""Samplers that weigh noise by what can be seen: their `white_luminance` is the suite's unless they have their own."""


@dataclass(frozen=True)
class Renderers:
    """How renderers are found, handed in by who knows them; both must be importable where runs are done.

    ``load(renderer, scene, sampler=..., size=..., **options)`` gives the renderer of a scene,
    ``version(renderer)`` what its images depend on besides scene and options.
    """

    load: Load
    version: Callable[[str], str]


@dataclass(frozen=True)
class Job:
    """All that the runs on one scene share."""

    suite: Suite
    scene: Scene
    renderers: Renderers
    versions: Mapping[str, str]
    reference: Reference
    recording: str | None
    timeout: float | None = None


@dataclass(frozen=True)
class Outcome:
    """What a run gave: its row, and the image with its layers where it is one to be kept."""

    row: results.Row
    image: NDArray[np.float32] | None = None
    layers: Mapping[str, NDArray[Any]] = field(default_factory=dict)


def run(
    suite: Suite,
    folder: results.Folder,
    renderers: Renderers,
    *,
    cache: str | os.PathLike[str] | None = None,
    execute: Executor[tuple[str, Run], Outcome] = in_process,
    timeout: float | None = None,
    log: Log = lambda line: None,
    progress: Progress = lambda fraction, note: None,
) -> None:
    """Do the runs of a suite that ``folder`` does not have, and those that failed in it.

    References and recordings go to ``cache`` (see :func:`pmc_sampler.eval.references.obtain`); each renderer is warmed
    up before it is timed. A run that fails leaves a row with its `error`, and the others go on; so does one with a
    batch of more than ``timeout`` seconds. ``log`` gets a line for
    each step, ``progress`` the share of the time that is expected in all. Raises
    :class:`pmc_sampler.eval.suite.BadSuiteError` for what can be known to fail before anything is rendered.
    """
    check(suite)
    code = fingerprint()
    versions = {scene.name: _versions(scene, renderers, code) for scene in suite.scenes}
    plan = {
        scene.name: [(_identity(suite, run, versions[scene.name]), run) for run in suite.runs(scene)]
        for scene in suite.scenes
    }
    folder.begin(suite, [run_id for runs in plan.values() for run_id, _ in runs])
    clock = Clock([run for runs in plan.values() for _, run in runs])
    kept = Path(cache) if cache is not None else references.cache_folder()
    missing: dict[str, list[tuple[str, Run]]] = {}
    for scene in suite.scenes:
        missing[scene.name] = []
        for run_id, one in plan[scene.name]:
            row = _found(folder, run_id, one, log)
            if row is not None:
                clock.ended(one, row)
            else:
                missing[scene.name].append((run_id, one))
        if missing[scene.name]:
            clock.awaits(scene.name, _unprepared(scene, versions[scene.name], kept))
    for scene in suite.scenes:
        todo = missing[scene.name]
        if not todo:
            continue
        try:
            job = _prepare(suite, scene, renderers, versions[scene.name], kept, timeout, progress, clock)
        except Exception as error:  # whatever a renderer raises: the other scenes can still be measured
            for run_id, one in todo:
                row = _failure(suite, run_id, one, versions[scene.name], error)
                folder.store(row)
                clock.ended(one, row)
            log(f"{scene.name} cannot be measured: {_sentence(error)}")
            continue
        folder.store_image(results.reference_name(scene.name), *results.reference_image(job.reference, scene))
        for place, outcome in execute(measure, job, todo):
            run_id, one = todo[place]
            if isinstance(outcome, Exception):  # a worker that died, more than once
                outcome = Outcome(_failure(suite, run_id, one, versions[scene.name], outcome))
            if outcome.image is not None:
                name = results.image_name(scene.name, one.method.name, str(one.budget))
                metadata = {
                    f"pmc:{name}": "" if value is None else value
                    for name, value in outcome.row.items()
                    if name != "tiles"
                }
                folder.store_image(name, outcome.image, outcome.layers, metadata)
            folder.store(outcome.row)
            clock.ended(one, outcome.row)
            line = _line(one, outcome.row)
            progress(clock.fraction, line)
            log(f"{clock.fraction:.0%}: {line}")


def check(suite: Suite) -> None:
    """Raise :class:`BadSuiteError` for a missing file, a size a metric cannot take, settings that no sampler takes."""
    for scene in suite.scenes:
        if scene.source != scene.name and not Path(scene.source).is_file():
            raise BadSuiteError(f"scene {scene.name!r}: there is no file {scene.source!r}.")
        width, height = scene.size or (64, 64)
        of_windows = [name for name in suite.metrics if name in ("ssim", "pu21_ssim")]
        if of_windows and min(width, height) < SSIM_WINDOW:
            raise BadSuiteError(
                f"scene {scene.name!r} is {width}x{height} pixels, and {of_windows[0]} needs {SSIM_WINDOW}x"
                f"{SSIM_WINDOW}: give a larger size, or `metrics` without it."
            )
        known = scene.renderer is None or scene.recorded_spp is not None
        ones = np.ones((height, width))
        knowledge = {
            "mean": np.ones((height, width, 3)),
            "variance": np.ones((height, width, 3)),
            "luminance_variance": ones,
        }
        stand_in = SimpleNamespace(width=width, height=height, **(knowledge if known else {}))
        for method in suite.methods:
            if method.scenes is None or scene.name in method.scenes:
                if method.native:
                    if known:
                        raise BadSuiteError(
                            f"method {method.name!r} is the renderer's own: {scene.name!r} is a recording."
                        )
                    continue  # the renderer says what is wrong with its settings
                try:
                    _sampler(suite, Run(scene, method, scene.budgets[0], 1), stand_in)
                except (ValueError, TypeError) as error:
                    raise BadSuiteError(f"method {method.name!r} on scene {scene.name!r}: {error}") from error


def measure(job: Job, todo: tuple[str, Run]) -> Outcome:
    """Do one run; what goes wrong becomes its row's `error`."""
    run_id, one = todo
    try:
        if _own_code() != job.versions["code"]:
            raise RuntimeError("a worker has other code than the process that began: install the same on both")
        return _measured(job, run_id, one)
    except Exception as error:  # whatever a renderer or a sampler raises is this run's alone
        return Outcome(_failure(job.suite, run_id, one, job.versions, error))


def _measured(job: Job, run_id: str, one: Run) -> Outcome:
    identity = key(_settings(job.scene, job.versions))
    radiance, setup = _radiance(identity, job.renderers, job.scene, job.recording, one.method.numbers)
    started = _now()
    if one.method.native:
        made, resolved = _native(one, radiance), one.method.settings_on(one.scene.name)
    else:
        spent = setup if job.suite.counts_setup(job.scene) else 0.0
        sampler = _sampler(job.suite, one, radiance, spent)
        with _in_time(radiance, job.timeout) as call:
            made, resolved = _sampled(sampler, call, spent), baselines.settings_of(sampler)
    white, reference = job.suite.white_luminance, job.reference
    limit = measures.neyman(radiance, reference, white, made.spp)
    noise = measures.reference_noise(reference, white)
    height, width = made.image.shape[:2]
    row = {
        **_described(job.suite, run_id, one, job.versions, started),
        "error": None,
        "resolved": json.dumps(resolved, sort_keys=True),
        **{"width": width, "height": height, "samples": made.samples},
        **{"spp": made.spp, "rejected": made.rejected, "done": made.done},
        **{f"seconds.{part}": spent for part, spent in made.seconds.items()},
        **measures.measure(made.image, reference, white, job.suite.metrics),
        "bias": metrics.bias(made.image, reference.mean),
        "plain_bias": metrics.bias(made.layers.get("plain", made.image), reference.mean),
        "reference.spp": reference.spp,
        **{f"reference.{name}": value for name, value in noise.items()},
        **{f"limit.{name}": value for name, value in limit.items()},
        "tiles": measures.tiles(made.image).tolist(),
    }
    return Outcome(row, made.image, made.layers) if one.seed == 1 else Outcome(row)


@dataclass(frozen=True)
class _Made:
    """An image, and what it took; ``seconds`` in all ("total") and in each part."""

    image: NDArray[np.float32]
    samples: int
    seconds: Mapping[str, float]
    done: str
    rejected: int = 0
    layers: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def spp(self) -> float:
        """Samples over pixels."""
        height, width, _ = self.image.shape
        return float(self.samples / (height * width))


def _native(one: Run, radiance: Any) -> _Made:
    """The image by the renderer's own way to choose samples."""
    settings = one.method.settings_on(one.scene.name)
    del settings["sampler"]
    if not hasattr(radiance, "native"):
        raise ValueError(f"the renderer {one.scene.renderer!r} has no sampling of its own")
    made = radiance.native(**settings)
    return _Made(
        made.mean,
        made.samples,
        {"setup": 0.0, "total": made.seconds, "renderer": made.seconds, "sampler": 0.0},
        one.budget.kind,
    )


def _sampled(sampler: Any, radiance: Any, setup: float) -> _Made:
    """The image by a sampler, which samples until its budget is met; ``setup`` are seconds to count beside its own.

    The image's making counts as the sampler's: it is where PMC corrects its energy.
    """
    in_renderer = in_sampler = 0.0
    began = time.perf_counter()
    while not sampler.done:
        start = time.perf_counter()
        batch = sampler.ask()
        drawn = time.perf_counter()
        values = radiance(batch)
        rendered = time.perf_counter()
        sampler.tell(batch, values)
        in_renderer += rendered - drawn
        in_sampler += drawn - start + time.perf_counter() - rendered
    start = time.perf_counter()
    image = sampler.film.mean
    ended = time.perf_counter()
    seconds = {
        "setup": setup,
        "total": setup + ended - began,
        "renderer": in_renderer,
        "sampler": in_sampler + ended - start,
    }
    return _Made(image, int(sampler.samples), seconds, str(sampler.done), int(sampler.rejected), _layers(sampler.film))


def _layers(film: Any) -> dict[str, NDArray[Any]]:
    """The pictures beside the mean that a film has; alpha where it was adapted."""
    layers = {"samples": film.samples, "error": film.standard_error, "plain": film.plain_mean}
    if hasattr(film, "strategy"):
        layers["strategy"] = film.strategy
    alpha = getattr(film, "alpha", None)
    if alpha is not None and np.ptp(alpha.reshape(-1, alpha.shape[2]), axis=0).any():
        padded = np.zeros((*alpha.shape[:2], 3), np.float32)
        padded[..., : alpha.shape[2]] = alpha
        layers["alpha"] = padded
    return layers


def _sampler(suite: Suite, one: Run, radiance: Any, spent: float = 0.0) -> Any:
    """The sampler of a run; ``spent`` of the seconds of its budget are gone, though for one batch there is time."""
    value = one.budget.value if one.budget.kind == "spp" else max(one.budget.value - spent, 1e-9)
    settings = one.method.settings_on(one.scene.name)
    if settings["sampler"] in WEIGHING:
        settings = {"white_luminance": suite.white_luminance, **settings}
    return baselines.make(settings, radiance, Budget(**{one.budget.kind: value}), one.seed)


def _prepare(
    suite: Suite,
    scene: Scene,
    renderers: Renderers,
    versions: Mapping[str, str],
    folder: Path,
    timeout: float | None,
    progress: Progress,
    clock: Clock,
) -> Job:
    """The reference of a scene, rendered where the cache, ``folder``, has none; a recording likewise."""

    def shown(what: str) -> Callable[[float], None]:
        def show(share: float) -> None:
            clock.prepared(scene.name, share)
            progress(clock.fraction, f"{scene.name}: {what} {share:.0%}")

        clock.prepared(scene.name, 0.0)
        return show

    if scene.renderer is None:
        recording: Path | None = Path(scene.source)
    elif scene.recorded_spp is not None:
        recording = _record(scene, renderers, versions, folder, shown("recording"))
    else:
        recording = None
    if recording is not None:
        return Job(suite, scene, renderers, versions, Recording(recording).reference, str(recording), timeout)
    radiance = _load(scene, renderers, "sobol")
    with _in_time(radiance, timeout) as call:
        reference = references.obtain(
            call,
            radiance.width,
            radiance.height,
            scene.reference_spp,
            _settings(scene, versions),
            cache=folder,
            noise=scene.reference_noise,
            progress=shown("reference"),
        )
    return Job(suite, scene, renderers, versions, reference, None, timeout)


@contextlib.contextmanager
def _in_time(radiance: Any, timeout: float | None) -> Iterator[Any]:
    """The renderer, whose batches are given up after ``timeout`` seconds, if there is one."""
    if timeout is None:
        yield radiance
    else:
        with contextlib.closing(Deadline(radiance, timeout)) as call:
            yield _Timed(radiance, call)


class _Timed:
    """A renderer in all but its call."""

    def __init__(self, radiance: Any, call: Deadline) -> None:
        self._radiance, self._call = radiance, call

    def __call__(self, batch: Any) -> Any:
        return self._call(batch)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._radiance, name)


def _unprepared(scene: Scene, versions: Mapping[str, str], folder: Path) -> int:
    """Samples a pixel that :func:`_prepare` has to render."""
    if scene.renderer is None or scene.size is None:
        return 0
    if scene.recorded_spp is not None:
        return 0 if _recording(scene, versions, folder).is_file() else scene.recorded_spp
    spp, noise = scene.reference_spp, scene.reference_noise
    found = references.is_cached(folder, *scene.size, spp, _settings(scene, versions), noise)
    return 0 if found else spp


def _recording(scene: Scene, versions: Mapping[str, str], folder: Path) -> Path:
    settings = {**_settings(scene, versions), "size": scene.size, "spp": scene.recorded_spp}
    return folder / f"{key(settings)}.h5"


def _record(
    scene: Scene, renderers: Renderers, versions: Mapping[str, str], folder: Path, progress: Callable[[float], None]
) -> Path:
    path = _recording(scene, versions, folder)
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        radiance = _load(scene, renderers, "sobol")
        record(
            radiance,
            radiance.width,
            radiance.height,
            scene.recorded_spp or 0,
            path,
            seed=references.SEED,
            settings={**_settings(scene, versions), "size": scene.size, "spp": scene.recorded_spp},
            progress=progress,
        )
    return path


def _load(scene: Scene, renderers: Renderers, numbers: str) -> Any:
    return renderers.load(scene.renderer, scene.source, sampler=numbers, size=scene.size, **dict(scene.options))


@lru_cache(maxsize=2)  # a scene's with Sobol points and with independent numbers
def _radiance(
    identity: str, renderers: Renderers, scene: Scene, recording: str | None, numbers: str
) -> tuple[Any, float]:
    """The renderer of a scene, warm, and the seconds of its set-up.

    Kept for the runs to come, as long as ``identity`` is the same.
    """
    if recording is not None:
        return Recording(recording, sampler=numbers), 0.0
    began = time.perf_counter()
    radiance = _load(scene, renderers, numbers)
    setup = time.perf_counter() - began
    uniform = config_for(radiance, {"preset": "uniform"})
    render(radiance, radiance.width, radiance.height, Budget(spp=1), uniform, seed=WARM_UP_SEED)
    return radiance, setup


def _found(folder: results.Folder, run_id: str, one: Run, log: Log) -> results.Row | None:
    """The row of a run that is not to be done again; it is where the image is that of another run."""
    try:
        row = folder.row(run_id)
    except results.BadResultsError as error:
        log(f"{error} It is done again now.")
        return None
    if row is None or row["error"] is not None:
        return None
    name = results.image_name(one.scene.name, one.method.name, str(one.budget))
    return row if one.seed != 1 or folder.image_id(name) == run_id else None


def _settings(scene: Scene, versions: Mapping[str, str]) -> dict[str, Any]:
    """What an image of a scene depends on besides size, samples and sampler."""
    if scene.renderer is None:
        return {"recording": references.digest(Path(scene.source))}
    identity = references.identify(scene.source, scene.renderer, versions[scene.renderer])
    return {**identity, "scene": scene.name, "options": dict(scene.options)}


def _identity(suite: Suite, one: Run, versions: Mapping[str, str]) -> str:
    scene = one.scene
    return key(
        {
            **_settings(scene, versions),
            "method": one.method.name,
            "numbers": one.method.numbers,
            "settings": one.method.settings_on(scene.name),
            "size": scene.size,
            "budget": str(one.budget),
            "reference": [scene.reference_spp, scene.reference_noise, scene.recorded_spp],
            "metrics": suite.metrics,
            "counts_setup": suite.counts_setup(scene),
            "white_luminance": suite.white_luminance,
            "seed": one.seed,
            "code": versions["code"],
        }
    )


def _described(suite: Suite, run_id: str, one: Run, versions: Mapping[str, str], started: str) -> results.Row:
    """The part of a row that is known before the run."""
    return {
        **{"id": run_id, "suite": suite.name, "scene": one.scene.name, "renderer": one.scene.renderer or "recording"},
        **{"method": one.method.name, "numbers": one.method.numbers},
        "settings": json.dumps(one.method.settings_on(one.scene.name), sort_keys=True),
        **{"budget": str(one.budget), "budget_kind": one.budget.kind, "budget_value": one.budget.value},
        **{"seed": one.seed, "white_luminance": suite.white_luminance, "started": started},
        **{"versions": json.dumps(versions), "machine": machine()},
    }


def _failure(suite: Suite, run_id: str, one: Run, versions: Mapping[str, str], error: Exception) -> results.Row:
    return {**_described(suite, run_id, one, versions, _now()), "error": _sentence(error)}


def _sentence(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")


def _line(one: Run, row: results.Row) -> str:
    what = f"{one.scene.name}, {one.budget}, seed {one.seed}, {one.method.name}"
    return f"{what}: failed: {row['error']}" if row["error"] else f"{what}: {row['seconds.total']:.2f} s"


def _versions(scene: Scene, renderers: Renderers, code: str) -> dict[str, str]:
    """What a row's numbers depend on, by name."""
    own = {}
    if scene.renderer is not None:
        try:
            own[scene.renderer] = renderers.version(scene.renderer)
        except RuntimeError:  # it cannot run here, which its runs will say
            own[scene.renderer] = ""
    return {
        **{"pmc_sampler": pmc_sampler.__version__, "code": code, "numpy": np.__version__},
        **{"python": platform.python_version(), **own},
    }


def fingerprint(files: Iterable[Path] = ()) -> str:
    """A hash of the code that makes, times and measures images: the sampler's, the baselines' and the metrics'."""
    package = Path(pmc_sampler.__file__).parent
    here = Path(__file__).parent
    own = [here / f"{name}.py" for name in ("benchmark", "measures", "display", "recorded", "references")]
    parts = [
        Path(_core.__file__),
        *package.glob("*.py"),
        *own,
        *(here / "baselines").glob("*.py"),
        *(here / "metrics").glob("*.py"),
        *files,
    ]
    digest = hashlib.sha256()
    for part in sorted(parts):
        digest.update(part.name.encode() + b"\0" + part.read_bytes())
    return digest.hexdigest()[:12]


_own_code = lru_cache(fingerprint)


@lru_cache
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
