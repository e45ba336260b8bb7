"""Random numbers for Mitsuba, each a function of (scramble, index, dimension) alone.

A batch says for each sample which sequence it belongs to (`scramble`: a hash of run seed, pixel and stream)
and which place it has in it (`index`). The samplers here turn that into the numbers a path consumes, so that
a sample's value depends neither on the batch it came in nor on its neighbours there, and no two samples of a
run share a number.

`sobol` gives Owen-scrambled Sobol points: per pair of dimensions the index is shuffled, the two-dimensional
Sobol point of the shuffled index taken and each coordinate scrambled, all by hashes (Burley 2020, "Practical
hash-based Owen scrambling", JCGT 9(4); Laine and Karras 2011, doi:10.1111/j.1467-8659.2010.01793.x). Pair 0
is the place in the pixel, which the core has used; a renderer goes on from pair 1. `independent` gives PCG32
streams (O'Neill 2014, HMC-CS-2014-0905) seeded by hashes.

The dimension counter (for `independent` the generator's state) is a Dr.Jit array, for Mitsuba's loops are
symbolic: they are traced once, and whatever changes from bounce to bounce has to be a loop variable.
"""

from __future__ import annotations

import functools
import importlib
from typing import Any

import drjit as dr
import mitsuba

__all__ = ["KINDS", "sampler_class"]

KINDS = ("sobol", "independent")
_FIRST_PAIR = 1
# The mask of each step in which the second Sobol generator matrix acts on a whole word, see `sobol_pair`.
_SECOND = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF))


def hash32(x: Any) -> Any:
    """A bijective hash of 32-bit words (Wellons' lowbias32)."""
    x = (x ^ (x >> 16)) * 0x7FEB352D
    x = (x ^ (x >> 15)) * 0x846CA68B
    return x ^ (x >> 16)


def mix(a: Any, b: Any) -> Any:
    """A hash of two 32-bit words."""
    return hash32(a ^ hash32(b + 0x9E3779B9))


def owen_reversed(x: Any, key: Any) -> Any:
    """Owen scrambling of a bit-reversed word: each bit is flipped by a hash of the bits below it (Burley
    2020, section 3)."""
    x = (x ^ (x * 0x3D20ADEA)) + key
    x = x * ((key >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def _shuffled(reverse: Any, scramble: Any, index: Any, pair: Any) -> tuple[Any, Any]:
    """The key of a pair of dimensions, and the index shuffled by it."""
    key = mix(scramble, pair)
    return key, reverse(owen_reversed(reverse(index), key))


def sobol_first(reverse: Any, scramble: Any, index: Any, pair: Any) -> Any:
    """The first coordinate of a pair, as a 32-bit fraction; `reverse` reverses the bits of a word."""
    key, index = _shuffled(reverse, scramble, index, pair)
    return reverse(owen_reversed(index, hash32(key ^ 0x68BC21EB)))


def sobol_pair(reverse: Any, scramble: Any, index: Any, pair: Any) -> tuple[Any, Any]:
    """Both coordinates of a pair, as 32-bit fractions.

    The first Sobol coordinate is the index with its bits reversed. The second has a closed form: reversed, it
    is the index times the Pascal triangle modulo 2, which factors into five steps on whole words.
    """
    key, index = _shuffled(reverse, scramble, index, pair)
    first = reverse(owen_reversed(index, hash32(key ^ 0x68BC21EB)))
    second = index
    for shift, mask in _SECOND:
        second = second ^ ((second >> shift) & mask)
    return first, reverse(owen_reversed(second, hash32(key ^ 0x02E5BE93)))


@functools.cache
def sampler_class(variant: str, kind: str) -> Any:
    """The subclass of that variant's `mi.Sampler` for `kind`, one of KINDS.

    An instance has a method `start(scramble, index)`, which takes two `mi.UInt32` of the batch's length and
    begins all sequences anew, and Mitsuba's `next_1d` and `next_2d`.
    """
    mi = importlib.import_module(f"mitsuba.{variant}")
    return {"sobol": _sobol_class, "independent": _independent_class}[kind](mi)


def _sobol_class(mi: Any) -> Any:
    def unit(word: Any) -> Any:
        return mi.Float(word >> 8) * 2.0**-24

    class SobolSampler(mi.Sampler):  # type: ignore[misc]
        """Owen-scrambled Sobol points by hash, padded by pairs of dimensions."""

        def __init__(self, props: Any = None) -> None:
            super().__init__(mitsuba.Properties() if props is None else props)
            self.start(mi.UInt32(0), mi.UInt32(0))

        def start(self, scramble: Any, index: Any) -> None:
            self.scramble = scramble
            self.index = index
            self.pair = mi.UInt32(_FIRST_PAIR)

        def next_1d(self, active: Any = True) -> Any:
            word = sobol_first(dr.brev, self.scramble, self.index, self.pair)
            self.pair += 1
            return unit(word)

        def next_2d(self, active: Any = True) -> Any:
            first, second = sobol_pair(dr.brev, self.scramble, self.index, self.pair)
            self.pair += 1
            return mi.Point2f(unit(first), unit(second))

        def to_string(self) -> str:
            return "SobolSampler[]"

    return SobolSampler


def _independent_class(mi: Any) -> Any:
    class IndependentSampler(mi.Sampler):  # type: ignore[misc]
        """A PCG32 stream for each sample."""

        def __init__(self, props: Any = None) -> None:
            super().__init__(mitsuba.Properties() if props is None else props)
            self.start(mi.UInt32(0), mi.UInt32(0))

        def start(self, scramble: Any, index: Any) -> None:
            high = mix(scramble, index)
            low = mix(high ^ 0x68BC21EB, index)
            self.state = (mi.UInt64(high) << 32) | mi.UInt64(low)
            self.stream = (mi.UInt64(mix(scramble, index ^ 0x02E5BE93)) << 1) | 1

        def next_1d(self, active: Any = True) -> Any:
            old = self.state
            self.state = old * 6364136223846793005 + self.stream
            word = mi.UInt32(((old >> 18) ^ old) >> 27)
            turn = mi.UInt32(old >> 59)
            word = (word >> turn) | (word << ((32 - turn) & 31))
            return mi.Float(word >> 8) * 2.0**-24

        def next_2d(self, active: Any = True) -> Any:
            first = self.next_1d(active)
            return mi.Point2f(first, self.next_1d(active))

        def to_string(self) -> str:
            return "IndependentSampler[]"

    return IndependentSampler
