"""The renderer that was asked for, with its options."""

import argparse
import importlib
from collections.abc import Mapping
from typing import Any

from .errors import CommandError


def load_renderer(options: argparse.Namespace, settings: Mapping[str, Any]) -> Any:
    """The renderer of the scene; raises :class:`CommandError` with what it says of the scene or of an option.

    settings: those of the command line that are the renderer's own.
    """
    chosen = dict(settings)
    for name, value in (("device", options.device), ("options", options.own_options or None)):
        if value is not None:
            chosen[name] = value
    chosen = {"sampler": options.sampler, "size": options.size} | chosen
    try:
        return importlib.import_module("pmc_sampler.adapters").load(options.renderer, options.scene, **chosen)
    except (ValueError, TypeError, OSError, ImportError, RuntimeError, MemoryError) as error:
        raise CommandError(" ".join(str(error).split())) from error
