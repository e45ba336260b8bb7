"""``pmc-sampler record``: a renderer's samples in a file, to be replayed for studies of samplers."""

import argparse
import importlib
import time
from pathlib import Path

from .arguments import renderer_for
from .errors import CommandError
from .optional import load
from .progress import progress
from .renderer import load_renderer


def record(options: argparse.Namespace) -> int:
    """Record, or go on with what an interruption left, and say what it cost."""
    options.renderer = options.renderer or renderer_for(options.scene)
    recorded = load("pmc_sampler.eval.recorded", "recording", "eval")
    references = load("pmc_sampler.eval.references", "recording", "eval")
    radiance = load_renderer(options, {})
    version = importlib.import_module("pmc_sampler.adapters").version(options.renderer)
    partial = Path(f"{options.output}.part")
    began, rendered = time.perf_counter(), 0
    with progress(f"{options.scene}, {options.per_pixel} samples a pixel") as shown:

        def note(fraction: float) -> None:
            nonlocal rendered
            rendered += 1
            shown(fraction, f"{fraction * options.per_pixel:.0f} a pixel")

        try:
            recorded.record(
                radiance,
                radiance.width,
                radiance.height,
                options.per_pixel,
                options.output,
                seed=options.seed,
                settings={**references.identify(options.scene, options.renderer, version), "sampler": options.sampler},
                progress=note,
            )
        except recorded.BadRecordingError as error:
            raise CommandError(str(error)) from error
        except (Exception, KeyboardInterrupt) as error:  # whatever a renderer raises: what it gave before is kept
            interrupted = isinstance(error, KeyboardInterrupt)
            what = "interrupted" if interrupted else f"recording failed: {' '.join(str(error).split()).rstrip('.')}"
            kept = f"; the same command goes on from {partial}" if partial.exists() else ""
            raise CommandError(f"{what}{kept}.", 130 if interrupted else 1) from error
    seconds = time.perf_counter() - began
    size = f"{radiance.width}x{radiance.height}, {options.per_pixel} samples a pixel"
    before = options.per_pixel - rendered
    print(
        f"{options.scene} at {size}: {rendered * radiance.width * radiance.height} samples in {seconds:.1f} s"
        + (f" ({before} a pixel were there before)." if before else ".")
    )
    print(f"{options.output} holds {options.output.stat().st_size / 2**20:.2f} MiB.")
    return 0
