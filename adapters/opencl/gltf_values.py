"""Values of a glTF file's JSON, taken only where they are what they should be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["extension", "numbers", "pick", "title", "whole"]


def whole(value: Any, what: str, low: int = 0) -> int:
    """`value`, if it is a whole number of at least `low`; raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        raise ValueError(f"{what} is {value!r}: expected a whole number of {low} or more")
    return value


def numbers(values: Any, count: int, what: str, low: float = -np.inf, high: float = np.inf) -> tuple[float, ...]:
    """`count` finite numbers from `low` to `high`, a list of them or one alone; raises ValueError otherwise."""
    given = values if isinstance(values, list | tuple) else [values]
    good = len(given) == count and all(isinstance(v, int | float) and not isinstance(v, bool) for v in given)
    if not good or not all(abs(v) <= 1e300 and low <= v <= high for v in given):
        within = f" from {low:g} to {high:g}" if high < np.inf else f" of {low:g} or more" if low > -np.inf else ""
        raise ValueError(
            f"{what} is {values!r}: expected {'a finite number' if count == 1 else f'{count} finite numbers'}{within}"
        )
    return tuple(float(v) for v in given)


def pick(items: Sequence[Any], index: Any, what: str) -> Any:
    """`items[index]`; raises ValueError where there is no such item."""
    if not isinstance(items, list) or isinstance(index, bool) or not isinstance(index, int):
        raise ValueError(f"{what} is {index!r}: expected the number of one in the file")
    if not 0 <= index < len(items):
        raise ValueError(f"{what} is number {index}, and there are {len(items)}")
    if items[index] is None:
        raise ValueError(f"{what} is number {index}, which is null: expected an object")
    return items[index]


def extension(holder: Any, name: str) -> dict[str, Any] | None:
    """The extension `name` of an object; raises ValueError where it is no object itself."""
    found = (holder.extensions or {}).get(name)
    if found is not None and not isinstance(found, dict):
        raise ValueError(f"an extension {name} is {found!r}: expected an object")
    return found


def title(kind: str, index: Any, name: Any) -> str:
    """How messages call an object of a file: its kind, number and name."""
    return f"{kind} {index} ({name!r})" if name else f"{kind} {index}"
