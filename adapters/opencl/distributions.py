"""Tables from which a discrete distribution is drawn in constant time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["alias_table"]


def alias_table(weights: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Thresholds and aliases, each of the shape of `weights` (n,): draw i uniformly, keep it with probability
    threshold[i], else take alias[i] (Walker 1977, doi:10.1145/355744.355749).

    What light entries lack and heavy ones have too much is summed in order; each light entry takes from the heavy one
    that its place in the sum falls to, and so does a heavy one that has given too much from the next
    (Huebschle-Schneider and Sanders 2019, doi:10.4230/LIPIcs.ESA.2019.59, section 4).

    Raises ValueError for weights that are negative or not finite, and where none is above 0.
    """
    total = float(weights.sum())
    if not (total > 0.0 and np.isfinite(total)) or float(weights.min()) < 0.0:
        raise ValueError("weights of a distribution: expected finite ones, none below 0 and some above")
    scaled = weights * (len(weights) / total)
    thresholds, aliases = np.ones(len(scaled)), np.arange(len(scaled))
    light, heavy = np.flatnonzero(scaled < 1.0), np.flatnonzero(scaled >= 1.0)
    if len(light) and len(heavy):
        lacking, spare = np.cumsum(1.0 - scaled[light]), np.cumsum(scaled[heavy] - 1.0)
        before = np.concatenate([[0.0], lacking[:-1]])
        taken = np.minimum(np.searchsorted(spare, before, side="right"), len(heavy) - 1)
        thresholds[light], aliases[light] = scaled[light], heavy[taken]
        last = np.searchsorted(lacking, spare[:-1], side="left")  # the light entry with which each heavy one runs out
        short = np.flatnonzero(last < len(light))
        thresholds[heavy[short]] = np.clip(1.0 - (lacking[last[short]] - spare[short]), 0.0, 1.0)
        aliases[heavy[short]] = heavy[short + 1]
    return thresholds.astype(np.float32), aliases.astype(np.int32)
