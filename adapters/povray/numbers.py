"""What is random in a batch for POV-Ray: the order of its samples, and where each meets the lens.

POV-Ray 3.7 has no seed. It draws from one fixed table, in the order of the pixels, and so the order is what makes the
noise of one batch independent of the next one's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SAMPLERS", "lens", "order"]

SAMPLERS = ("independent", "sobol")
# The mask of each step in which the second Sobol generator matrix acts on a whole word.
_SECOND = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF))
_REVERSALS = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF))

_Words = NDArray[np.uint32]


def order(scramble: _Words, index: _Words, number: int) -> NDArray[np.intp]:
    """A permutation of the samples, as random as a hash: a function of the samples and the batch's number alone.

    scramble, index: those of the batch, shape (n,).
    """
    # Of the sum over all samples, too: where a batch's numbers repeat, its samples are others.
    salt = (int(scramble.sum(dtype=np.uint64)) ^ int(index.sum(dtype=np.uint64)) ^ number * 0x9E3779B9) & 0xFFFFFFFF
    high = _mix(scramble ^ np.uint32(salt), index)
    low = _mix(high ^ np.uint32(0x68BC21EB), index)
    return np.argsort(high.astype(np.uint64) << np.uint64(32) | low, kind="stable")


def lens(sampler: str, scramble: _Words, index: _Words) -> NDArray[np.float64]:
    """Two numbers in [0, 1) for each sample, shape (n, 2).

    "independent": hashes. "sobol": the second pair of dimensions of the Owen-scrambled Sobol points whose first pair
    are the places in the pixel, by hashes (Burley 2020, "Practical hash-based Owen scrambling", JCGT 9(4); Laine and
    Karras 2011, doi:10.1111/j.1467-8659.2010.01793.x).
    """
    if sampler == "independent":
        first = _mix(_mix(scramble, index), np.uint32(1))
        second = _mix(first, index)
    else:
        key = _mix(scramble, np.uint32(1))
        place = _owen(_reversed(index), key)  # its bits in reverse: the first Sobol coordinate of the shuffled index
        shuffled = _reversed(place)
        first = _reversed(_owen(shuffled, _hash(key ^ np.uint32(0x68BC21EB))))
        for shift, mask in _SECOND:
            shuffled = shuffled ^ (shuffled >> np.uint32(shift)) & np.uint32(mask)
        second = _reversed(_owen(shuffled, _hash(key ^ np.uint32(0x02E5BE93))))
    return np.stack([first, second], axis=-1) / 2.0**32


def _hash(x: Any) -> Any:
    """A bijective hash of 32-bit words (Wellons' lowbias32)."""
    x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
    return x ^ (x >> np.uint32(16))


def _mix(a: Any, b: Any) -> Any:
    """A hash of two 32-bit words, of which one is an array."""
    with np.errstate(over="ignore"):  # of a NumPy scalar's overflow, which is wanted
        return _hash(a ^ _hash(b + np.uint32(0x9E3779B9)))


def _owen(x: _Words, key: _Words) -> _Words:
    """Owen scrambling of a bit-reversed word: each bit is flipped by a hash of the bits below it (Burley, 3)."""
    x = (x ^ (x * np.uint32(0x3D20ADEA))) + key
    x = x * ((key >> np.uint32(16)) | np.uint32(1))
    x = x ^ (x * np.uint32(0x05526C56))
    return x ^ (x * np.uint32(0x53A22864))


def _reversed(x: _Words) -> _Words:
    """The bits in reverse order."""
    for shift, mask in _REVERSALS:
        x = (x >> np.uint32(shift)) & np.uint32(mask) | (x & np.uint32(mask)) << np.uint32(shift)
    return x >> np.uint32(16) | x << np.uint32(16)
