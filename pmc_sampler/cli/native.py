"""``pmc-sampler render --method native``: a renderer's own way to choose samples, for comparison."""

import argparse
import importlib
import time

from .errors import CommandError
from .output import Output, report
from .progress import progress
from .renderer import load_renderer

_NOT_FOR_IT = {
    "spp": None,
    "seconds": None,
    "visible_noise": None,
    "config": None,
    "checkpoint": None,
    "checkpoint_every": 60.0,
    "timeout": None,
    "scheduler": None,
    "seed": 0,
}  # options with their defaults: the renderer chooses its samples by itself


def native(options: argparse.Namespace) -> int:
    """Render, write and report; returns the exit status."""
    try:
        own = importlib.import_module("pmc_sampler.adapters").native_settings(options.renderer)
    except (ValueError, RuntimeError) as error:
        raise CommandError(f"--method native: {error}.") from error
    for name, default in _NOT_FOR_IT.items():
        if getattr(options, name) != default:
            raise CommandError(
                f"--method native takes no --{name.replace('_', '-')}: {options.renderer} chooses its samples by "
                f"itself; what can be set, by --set, is {', '.join(own)}."
            )
    output = Output(options)
    given = dict(options.settings)
    settings = {name: given.pop(name) for name in own if name in given}
    with progress(f"{options.scene}, {options.method}") as shown:
        began = time.perf_counter()
        radiance = load_renderer(options, given)
        setup = time.perf_counter() - began
        shown(0.0, "in one go")
        try:
            made = radiance.native(**settings)
        except (ValueError, TypeError) as error:
            raise CommandError(" ".join(str(error).split())) from error
        except (OSError, RuntimeError) as error:
            raise CommandError(f"rendering failed: {error}.", status=1) from error
    report(output.write_native(made, settings, setup), options.json)
    return 0
