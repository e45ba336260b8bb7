"""From what was typed to the sampler's settings: method, file of settings, budget."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pmc_sampler import Budget, Config, toml
from pmc_sampler.sampler import config_for

from .arguments import DEFAULT_SPP
from .errors import CommandError

_PRESETS = {"pmc": "default", "pmc-paper": "paper", "pt": "uniform"}


def config(method: str, file: Path | None, radiance: Any = None) -> Config:
    """The method's settings; those in the TOML file, a ``preset`` too, take their place.

    radiance: the renderer, once it is there; the settings have to fit its image.
    """
    given = {} if file is None else _read(file)
    try:
        made = config_for(radiance, {"preset": _PRESETS[method], **given})
    except (ValueError, TypeError) as error:
        raise CommandError(str(error) if file is None else f"{str(file)!r}: {error}") from error
    if radiance is not None:
        _check_fits(made, radiance.width, radiance.height)
    return made


def budget(options: argparse.Namespace) -> Budget:
    """The limits that were given; samples per pixel by default."""
    limits = {name: getattr(options, name) for name in ("spp", "seconds", "visible_noise")}
    if all(value is None for value in limits.values()):
        limits["spp"] = DEFAULT_SPP
    try:
        return Budget(**limits)
    except (ValueError, TypeError) as error:
        raise CommandError(str(error)) from error


def _check_fits(made: Config, width: int, height: int) -> None:
    """Raise :class:`CommandError` where the radii or the population, perhaps the method's own, are too large."""
    try:
        made.resolved(width, height)
    except ValueError as error:
        name = str(error).split()[0]
        advice = f"; give a larger image by --size, or {name} by --config" if name in made.to_dict() else ""
        raise CommandError(f"{error}{advice}") from error


def _read(file: Path) -> Mapping[str, Any]:
    try:
        return toml.read(file)
    except (ValueError, ImportError) as error:
        raise CommandError(str(error)) from error
