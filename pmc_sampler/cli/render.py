"""``pmc-sampler render``: what can be refused is refused before the first sample."""

import argparse
import hashlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from pmc_sampler import Sampler
from pmc_sampler.sampler import sampler_for

from . import settings
from .arguments import NATIVE, renderer_for
from .checkpoint import Checkpoint
from .errors import CommandError
from .native import native
from .output import Output, report
from .progress import Report, progress
from .renderer import load_renderer

CHECKPOINT_SECONDS = 60.0
INTERRUPTED = 130
NOT_YET = {"setup": 0.0, "total": 0.0, "renderer": 0.0, "sampler": 0.0}


@dataclass
class Job:
    """A render under way: who traces, who samples, where the state is kept and the time that was spent.

    seconds: "setup", until the first sample could be drawn; "total", from then on, and of that in the "renderer" and in
    the "sampler".
    """

    radiance: Any
    sampler: Sampler
    checkpoint: Checkpoint | None
    seconds: dict[str, float] = field(default_factory=lambda: dict(NOT_YET))

    def save(self) -> None:
        """Save the state, if the user wants it saved."""
        if self.checkpoint is not None:
            self.checkpoint.save(self.sampler, self.seconds)


def render(options: argparse.Namespace) -> int:
    """Render, write and report; returns the exit status."""
    with ExitStack() as resources:
        return _render(options, resources)


def _render(options: argparse.Namespace, resources: ExitStack) -> int:
    options.renderer = options.renderer or renderer_for(options.scene)
    if options.method == NATIVE:
        return native(options)
    output = Output(options)
    failure: CommandError | None = None
    with progress(f"{options.scene}, {options.method}") as shown:
        began = time.perf_counter()
        with (
            _stop_asked() as asked
        ):  # an interrupt in the middle of a renderer's import would end in that renderer's traceback
            job = _job(options, resources)
        if asked():
            raise CommandError("interrupted before the first sample, so no image was written.", INTERRUPTED)
        job.seconds["setup"] += time.perf_counter() - began
        try:
            finished = _run(job, shown)
        except Exception as error:  # whatever a renderer raises: what was sampled is worth keeping
            text = " ".join(str(error).split()) or type(error).__name__
            finished, failure = False, CommandError(f"rendering failed: {text.rstrip('.')}.", status=1)
    if not job.sampler.samples:
        raise failure or CommandError("interrupted before the first sample, so no image was written.", INTERRUPTED)
    kept = "" if finished else _keep(job)
    ended = job.sampler.done if finished else "interrupted" if failure is None else "failed"
    report(output.write(job.sampler, job.radiance, job.seconds, ended), options.json)
    if finished:
        if job.checkpoint is not None:
            job.checkpoint.remove()
        return 0
    why = "interrupted." if failure is None else str(failure)
    raise CommandError(
        f"{why} {output.exr} holds the {job.sampler.spp:.3g} samples per pixel until then{kept}.",
        INTERRUPTED if failure is None else failure.status,
    )


def _keep(job: Job) -> str:
    """Save the state of what was not finished, and say what the user can do with it."""
    if job.checkpoint is None:
        return ""
    try:
        job.save()
    except CommandError as error:
        return f"; {str(error).rstrip('.')}"
    return f"; the same command goes on from {job.checkpoint.path}"


def _job(options: argparse.Namespace, resources: ExitStack) -> Job:
    budget = settings.budget(options)
    settings.config(options.method, options.config)  # a mistake in it shows before the scene is loaded
    radiance = load_renderer(options, dict(options.settings))
    if options.scheduler is not None:
        resources.enter_context(radiance)
    config = settings.config(options.method, options.config, radiance)
    checkpoint = None
    if options.checkpoint is not None:
        identity = {
            **{name: getattr(options, name) for name in ("scene", "renderer", "sampler", "seed")},
            "contents of the scene": _contents(options.scene),
            "settings of the renderer": [options.device, options.settings, options.own_options],
            "size": [radiance.width, radiance.height],
            "budget": vars(budget),
            "config": config.to_dict(),
        }
        checkpoint = Checkpoint(options.checkpoint, identity)
        checkpoint.check_writable()
        resumed = checkpoint.resume()
        if resumed is not None:
            return Job(radiance, resumed, checkpoint, NOT_YET | checkpoint.seconds)
    try:
        sampler = sampler_for(radiance, radiance.width, radiance.height, budget, config, options.seed)
    except (ValueError, TypeError, MemoryError) as error:
        raise CommandError(str(error)) from error
    return Job(radiance, sampler, checkpoint)


def _contents(scene: str) -> str:
    file = Path(scene)
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""


def _run(job: Job, shown: Report) -> bool:
    """Sample until the budget is met, or until it is interrupted: whether it was finished."""
    sampler, seconds, before = job.sampler, job.seconds, job.seconds["total"]
    began = saved = time.perf_counter()
    try:
        with _stop_asked() as asked:
            while not sampler.done:
                start = time.perf_counter()
                batch = sampler.ask()
                drawn = time.perf_counter()
                values = job.radiance(batch)
                rendered = time.perf_counter()
                sampler.tell(batch, values)
                told = time.perf_counter()
                seconds["renderer"] += rendered - drawn
                seconds["sampler"] += drawn - start + told - rendered
                seconds["total"] = before + told - began
                shown(sampler.fraction, f"{sampler.spp:.3g} spp")
                if asked():
                    return bool(sampler.done)
                if told - saved > CHECKPOINT_SECONDS:
                    job.save()
                    saved = time.perf_counter()
    except KeyboardInterrupt:
        return False
    return True


@contextmanager
def _stop_asked() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or a termination signal came; the batch in work is finished first.

    A second signal does not wait: it raises KeyboardInterrupt wherever the program is.
    """
    came = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True
        print("\nstopping after this batch; once more stops now.", file=sys.stderr)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
