"""Parts that come with an extra, found by name at run time."""

import importlib
from types import ModuleType

from .errors import CommandError


def load(module: str, purpose: str, extra: str) -> ModuleType:
    """Import a module of the project, or say in one sentence which extra to install."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise CommandError(
            f"{purpose} needs a package that cannot be imported ({error}): pip install 'pmc-sampler[{extra}]'."
        ) from error
