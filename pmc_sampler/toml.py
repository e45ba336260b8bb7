"""TOML files: settings of the sampler, suites of the benchmark."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any


def read(path: str | Path) -> dict[str, Any]:
    """What a TOML file holds.

    Raises ValueError for a file that is missing or no TOML, and ImportError where Python 3.10 lacks tomli, each with a
    sentence that names the file or what to install.
    """
    toml, file = _reader(), Path(path)
    try:
        if file.exists() and not file.is_file():  # a pipe could be waited for, and can be read only once
            raise ValueError(f"the file {str(path)!r} cannot be read: it is no regular file.")
        contents: dict[str, Any] = toml.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"the file {str(path)!r} cannot be read: {error.strerror}.") from error
    except (UnicodeDecodeError, toml.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"the file {str(path)!r} is no TOML: {error}.") from error
    return contents


def value(text: str) -> Any:
    """One value as TOML writes it; the text itself where it is none, such as a bare word. Raises ImportError."""
    toml = _reader()
    try:
        return toml.loads(f"value = {text}")["value"]
    except (toml.TOMLDecodeError, RecursionError):
        return text


def _reader() -> ModuleType:
    try:
        return importlib.import_module("tomllib")
    except ModuleNotFoundError:  # Python 3.10
        try:
            return importlib.import_module("tomli")
        except ImportError as error:
            raise ImportError("TOML files need tomli on Python 3.10: pip install 'pmc-sampler[cli]'.") from error
