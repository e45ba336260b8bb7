"""Numbers as the page writes them: three figures, and powers of ten that stand once for many."""

import math
from collections.abc import Iterable, Sequence

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def rounded(value: float, digits: int = 3) -> str:
    """A number to so many significant digits, never with an exponent: 0.0120, 12.0, 1200."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    return f"{value:.{min(max(digits - 1 - _exponent(value), 0), 12)}f}"


def power(exponent: int) -> str:
    """A power of ten, raised."""
    return f"10{str(exponent).translate(_RAISED)}"


def common_exponent(values: Iterable[float]) -> int:
    """The power of ten that a column of values is best written in: that of the largest; 0 where plain numbers do."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    exponent = _exponent(largest) if largest else 0
    return 0 if -2 <= exponent < 4 else exponent


def number(value: float) -> str:
    """A number to three figures, in a power of ten where it has many noughts: 0.0120, 9.80·10⁻⁵."""
    exponent = common_exponent([value])
    return f"{rounded(value / 10.0**exponent)}·{power(exponent)}" if exponent else rounded(value)


def tick_labels(values: Sequence[float]) -> list[str]:
    """The numbers at an axis, all of one form: 0.05 and 200, or 2·10⁻⁵ and 10⁻²."""
    exponents = [_exponent(value) for value in values]
    if all(-4 <= exponent < 5 for exponent in exponents):
        return [f"{value:.4g}" if value < 1e4 else f"{value:.0f}" for value in values]
    mantissas = [f"{value / 10.0**exponent:.2g}" for value, exponent in zip(values, exponents, strict=True)]
    return [("" if m == "1" else f"{m}·") + power(e) for m, e in zip(mantissas, exponents, strict=True)]


def ticks(low: float, high: float) -> list[float]:
    """Numbers 1, 2 and 5 times powers of ten for a logarithmic axis, of which two at least are in a range [low, high].

    Where the range is too narrow for two, the next outside are among them; where it is wide there are powers alone,
    eight at most.
    """
    first, last = _exponent(low) - 1, _exponent(high) + 1
    fine = [float(f"{m}e{e}") for e in range(first, last + 1) for m in (1, 2, 5)]
    inside = [value for value in fine if low <= value <= high]
    if len(inside) < 2:
        return sorted({max(v for v in fine if v <= low), *inside, min(v for v in fine if v >= high)})
    if len(inside) <= 7:
        return inside
    powers = [float(f"1e{e}") for e in range(first, last + 1) if low <= float(f"1e{e}") <= high]
    return powers[:: -(-len(powers) // 8)]


def _exponent(value: float) -> int:
    """The power of ten of a number as it is printed: 9.999 to three figures is 10.0."""
    return int(f"{value:.2e}".split("e")[1])
