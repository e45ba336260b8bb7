"""``pmc-sampler render``: what can be refused is refused before the first sample."""

import argparse
import importlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

from pmc_sampler import Sampler
from pmc_sampler.deadline import Deadline
from pmc_sampler.sampler import sampler_for, threads_of

from . import settings
from .arguments import NATIVE, renderer_for, scene_path
from .checkpoint import Checkpoint
from .errors import CommandError
from .native import native
from .output import Output, report
from .progress import Report, progress
from .renderer import load_renderer

INTERRUPTED = 130
NOT_YET = {"setup": 0.0, "total": 0.0, "renderer": 0.0, "sampler": 0.0}


@dataclass
class Job:
    """A render under way: who traces, who samples, where the state is kept and the time that was spent.

    trace: calls ``radiance``, or gives it up where it takes too long.
    seconds: "setup", until the first sample could be drawn; "total", from then on, and of that in the "renderer" and in
    the "sampler".
    """

    radiance: Any
    trace: Callable[[Any], Any]
    sampler: Sampler
    checkpoint: Checkpoint
    seconds: dict[str, float] = field(default_factory=lambda: dict(NOT_YET))

    def save(self) -> None:
        """Save the state."""
        self.checkpoint.save(self.sampler, self.seconds)


def render(options: argparse.Namespace) -> int:
    """Render, write and report; returns the exit status."""
    began = time.perf_counter()
    with ExitStack() as resources:
        return _render(options, resources, began)


def _render(options: argparse.Namespace, resources: ExitStack, began: float) -> int:
    options.renderer = options.renderer or renderer_for(options.scene)
    if options.method == NATIVE:
        return native(options)
    output = Output(options)
    failure: CommandError | None = None
    with progress(f"{options.scene}, {options.method}") as shown:
        # An interrupt in the middle of a renderer's import would end in that renderer's traceback.
        with _stop_asked("stopping before the first batch") as asked:
            job = _job(options, output, resources)
        if asked():
            raise CommandError("interrupted before the first sample, so no image was written.", INTERRUPTED)
        if remark := getattr(job.radiance, "remark", ""):
            print(f"pmc-sampler render: note: {remark}.", file=sys.stderr)
        setup = time.perf_counter() - began
        job.seconds["setup"] += setup
        job.sampler.add_elapsed(setup)
        try:
            finished = _run(job, shown)
        except Exception as error:  # whatever a renderer raises: what was sampled is worth keeping
            text = " ".join(str(error).split()) or type(error).__name__
            finished, failure = False, CommandError(f"rendering failed: {text.rstrip('.')}.", status=1)
    if not job.sampler.samples:
        raise failure or CommandError("interrupted before the first sample, so no image was written.", INTERRUPTED)
    with _stop_asked("what there is is being written"):
        kept = "" if finished else _keep(job)
        ended = job.sampler.done if finished else "interrupted" if failure is None else "failed"
        try:
            summary = output.write(job.sampler, job.radiance, job.seconds, ended)
        except CommandError as error:
            kept = kept or _keep(job, whatever=True)
            raise CommandError(f"{str(error).rstrip('.')}{kept}.", error.status) from error
        if finished:
            job.checkpoint.remove()
    report(summary, options.json)
    if finished:
        return 0
    why = "interrupted." if failure is None else str(failure)
    raise CommandError(
        f"{why} {output.exr} holds the {job.sampler.spp:.3g} samples per pixel until then{kept}.",
        INTERRUPTED if failure is None else failure.status,
    )


def _keep(job: Job, whatever: bool = False) -> str:
    """Save the state of what was not finished, and say what the user can do with it.

    What took a moment and is kept nowhere yet is not, unless the user or `whatever` wants it.
    """
    point = job.checkpoint
    if not (whatever or point.chosen or point.path.exists() or job.seconds["total"] > point.every):
        return ""
    try:
        job.save()
    except CommandError as error:
        return f"; {str(error).rstrip('.')}"
    return f"; the same command goes on from {point.path}"


def _job(options: argparse.Namespace, output: Output, resources: ExitStack) -> Job:
    budget = settings.budget(options)
    settings.config(options.method, options.config)  # a mistake in it shows before the scene is loaded
    radiance = trace = load_renderer(options, dict(options.settings))
    if options.scheduler is not None:
        resources.enter_context(radiance)
    if options.timeout is not None:
        trace = resources.enter_context(closing(Deadline(radiance, options.timeout)))
    config = settings.config(options.method, options.config, radiance)
    identity = {
        **{name: getattr(options, name) for name in ("scene", "renderer", "sampler", "seed")},
        "contents of the scene": _contents(options.scene),
        "version of the renderer": importlib.import_module("pmc_sampler.adapters").version(options.renderer),
        "settings of the renderer": [options.device, options.settings, options.own_options],
        "size": [radiance.width, radiance.height],
        "budget": vars(budget),
        "config": config.to_dict(),
    }
    chosen = options.checkpoint is not None
    path = options.checkpoint if chosen else output.exr.with_name(f"{output.exr.name}.checkpoint")
    checkpoint = Checkpoint(path, identity, chosen, options.checkpoint_every)
    checkpoint.check_writable()
    resumed = checkpoint.resume(threads_of(radiance))
    if resumed is not None:
        return Job(radiance, trace, resumed, checkpoint, NOT_YET | checkpoint.seconds)
    try:
        sampler = sampler_for(radiance, radiance.width, radiance.height, budget, config, options.seed)
    except (ValueError, TypeError, MemoryError) as error:
        raise CommandError(str(error)) from error
    return Job(radiance, trace, sampler, checkpoint)


def _contents(scene: str) -> str:
    file = scene_path(scene)
    return str(importlib.import_module("pmc_sampler.scenes").digest(file)) if file.is_file() else ""


def _run(job: Job, shown: Report) -> bool:
    """Sample until the budget is met, or until it is interrupted: whether it was finished."""
    sampler, seconds, before = job.sampler, job.seconds, job.seconds["total"]
    began = saved = time.perf_counter()
    try:
        with _stop_asked("stopping after this batch") as asked:
            while not sampler.done:
                start = time.perf_counter()
                batch = sampler.ask()
                drawn = time.perf_counter()
                values = job.trace(batch)
                rendered = time.perf_counter()
                sampler.tell(batch, values)
                told = time.perf_counter()
                seconds["renderer"] += rendered - drawn
                seconds["sampler"] += drawn - start + told - rendered
                seconds["total"] = before + told - began
                shown(sampler.fraction, f"{sampler.spp:.3g} spp")
                if asked():
                    return bool(sampler.done)
                if told - saved > job.checkpoint.every:
                    _save_meanwhile(job)
                    saved = time.perf_counter()
    except KeyboardInterrupt:
        return False
    return True


def _save_meanwhile(job: Job) -> None:
    """Save the state; where that fails, the older one stays, and the render is worth more than a newer one."""
    try:
        job.save()
    except CommandError as error:
        again = f"rendering goes on, and tries again in {job.checkpoint.every:g} s"
        print(f"pmc-sampler render: warning: {str(error).rstrip('.')}; {again}.", file=sys.stderr)


@contextmanager
def _stop_asked(answer: str) -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or a termination signal came; what is under way is finished first, as `answer` tells the user.

    A second signal does not wait: it raises KeyboardInterrupt wherever the program is.
    """
    came = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True
        print(f"\n{answer}; once more stops now.", file=sys.stderr)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
