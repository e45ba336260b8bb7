"""Values that callers give, checked: each refusal is a sentence that says what came and what was expected."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def flag(name: str, value: Any) -> bool:
    """The value, which must be True or False. Raises TypeError."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} is {value!r}: expected True or False")
    return bool(value)


def number(name: str, value: Any, allow_infinity: bool = True) -> float:
    """The value as a float; not of text, and no NaN. Raises TypeError or ValueError."""
    if isinstance(value, (bool, np.bool_, str, bytes)):
        raise TypeError(f"{name} is {value!r}: expected a number")
    try:
        converted = float(value)
    except OverflowError:
        raise ValueError(f"{name} is too large: expected a number that a float can hold") from None
    except (TypeError, ValueError):
        raise TypeError(f"{name} is {value!r}: expected a number") from None
    if math.isnan(converted) or (math.isinf(converted) and not allow_infinity):
        raise ValueError(f"{name} is {value!r}: expected a finite number")
    return converted


def side(name: str, value: Any) -> int:
    """The width or height of an image in pixels, 1 to 65535. Raises as `whole`."""
    return whole(name, value, 1, 65535)


def whole(name: str, value: Any, low: int, high: int) -> int:
    """The value as an int; nothing is rounded. Raises TypeError, or ValueError where it is not from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} is {value!r}: expected a whole number")
    if not low <= value <= high:
        raise ValueError(f"{name} is {value}: expected {low} to {high}")
    return int(value)
