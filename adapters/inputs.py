"""What every renderer of the project is given, checked in one place."""

from __future__ import annotations

import math
import os
from typing import Any

__all__ = ["check_positive", "check_regular", "check_size", "check_whole", "samples_of"]


def check_whole(name: str, value: Any, low: int, high: int) -> None:
    """Raises ValueError for what is no whole number from `low` to `high`."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {value!r}: expected a whole number from {low} to {high}")


def check_positive(name: str, value: Any) -> None:
    """Raises ValueError for what is no finite number above 0."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not (value > 0 and math.isfinite(value)):
        raise ValueError(f"{name} is {value!r}: expected a number above 0")


def check_regular(file: Any) -> None:
    """Raises ValueError for a pipe, a device or a socket, where reading might wait for ever; what is no path passes."""
    if not isinstance(file, str | os.PathLike) or not os.path.exists(file):
        return
    if not os.path.isfile(file) and not os.path.isdir(file):
        raise ValueError(f"{os.fspath(file)!r} is no regular file: copy what it gives into one, and name that")


def check_size(size: Any) -> None:
    """Raises ValueError for what is no (width, height) in whole pixels."""
    try:
        good = len(size) == 2 and all(side == int(side) and side >= 1 for side in size)
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ValueError(f"a size is (width, height) in whole pixels, at least 1 by 1, not {size!r}")


def samples_of(batch: Any, renderer: str) -> tuple[Any, Any, Any]:
    """Positions, scramble and index of a batch's samples; raises TypeError, naming `renderer`, for what is no batch."""
    try:
        return batch.positions, batch.scramble, batch.index
    except AttributeError:
        raise TypeError(
            f"{renderer} is called with a Batch (positions, scramble and index of each sample), "
            f"not with {type(batch).__name__}"
        ) from None
