"""What every renderer of the project is given, checked in one place."""

from __future__ import annotations

from typing import Any

__all__ = ["check_size", "samples_of"]


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
