"""The renderer that was asked for, with its options."""

import argparse
import importlib
import os
from collections.abc import Mapping
from typing import Any

from .arguments import scene_path
from .errors import CommandError


def load_renderer(options: argparse.Namespace, settings: Mapping[str, Any]) -> Any:
    """The renderer of the scene; raises :class:`CommandError` with what it says of the scene or of an option.

    settings: those of the command line that are the renderer's own. With a `scheduler` it is one on the workers of that
    cluster, to be closed by the caller.
    """
    chosen = dict(settings)
    for name, value in (("device", options.device), ("options", options.own_options or None)):
        if value is not None:
            chosen[name] = value
    chosen = {"sampler": options.sampler, "size": options.size} | chosen
    try:
        adapters, scene = importlib.import_module("pmc_sampler.adapters"), options.scene
        adapters.inputs.check_regular(scene_path(scene))  # of an INI file's section, too
        if options.own_options and not adapters.takes(options.renderer, "options"):
            raise TypeError(f"the renderer {options.renderer!r} takes no options after --: {options.own_options[0]!r}")
        if options.scheduler is None:
            return adapters.load(options.renderer, scene, **chosen)
        scene = os.path.abspath(scene) if scene_path(scene).is_file() else scene
        cluster = importlib.import_module("pmc_sampler.adapters.cluster")
        return cluster.ClusterRenderer(options.scheduler, adapters.load, options.renderer, scene, **chosen)
    except (ValueError, TypeError, OSError, ImportError, RuntimeError, MemoryError) as error:
        raise CommandError(" ".join(str(error).split())) from error
