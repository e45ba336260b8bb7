"""What is random in a batch for POV-Ray: the order of its samples, and where each meets the lens.

POV-Ray 3.7 has no seed. It draws from one fixed table, in the order of the pixels, and so the order is what makes the
noise of one batch independent of the next one's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import _core

__all__ = ["SAMPLERS", "lens", "order"]

SAMPLERS = ("independent", "sobol")

_Words = NDArray[np.uint32]


def order(scramble: _Words, index: _Words, number: int) -> NDArray[np.intp]:
    """A permutation of the samples, as random as a hash: a function of the samples and the batch's number alone.

    scramble, index: those of the batch, shape (n,).
    """
    # Of the sum over all samples, too: where a batch's numbers repeat, its samples are others.
    salt = (int(scramble.sum(dtype=np.uint64)) ^ int(index.sum(dtype=np.uint64)) ^ number * 0x9E3779B9) & 0xFFFFFFFF
    high = _core.mix(scramble ^ np.uint32(salt), index)
    low = _core.mix(high ^ np.uint32(0x68BC21EB), index)
    return np.argsort(high.astype(np.uint64) << np.uint64(32) | low, kind="stable")


def lens(sampler: str, scramble: _Words, index: _Words) -> NDArray[np.float64]:
    """Two numbers in [0, 1) for each sample, shape (n, 2).

    "independent": hashes. "sobol": the second pair of dimensions of the Owen-scrambled Sobol points whose first pair
    are the places in the pixel.
    """
    if sampler == "sobol":
        return np.asarray(_core.sobol_points(scramble, index, 1), np.float64)
    first = _core.mix(_core.mix(scramble, index), np.ones_like(index))
    return np.stack([first, _core.mix(first, index)], axis=-1) / 2.0**32
