"""Tables from which a discrete distribution is drawn in constant time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["alias_table"]


def alias_table(weights: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Thresholds and aliases, each of the shape of `weights` (n,): draw i uniformly, keep it with probability
    threshold[i], else take alias[i] (Walker 1977, doi:10.1145/355744.355749; built as by Vose 1991).

    Raises ValueError where no weight is above 0.
    """
    total = float(weights.sum())
    if not (total > 0.0 and np.isfinite(total)) or float(weights.min()) < 0.0:
        raise ValueError("weights of a distribution: expected finite ones, none below 0 and some above")
    scaled = (weights * (len(weights) / total)).tolist()
    thresholds = [1.0] * len(scaled)
    aliases = list(range(len(scaled)))
    small = [i for i, value in enumerate(scaled) if value < 1.0]
    large = [i for i, value in enumerate(scaled) if value >= 1.0]
    while small and large:
        low, high = small.pop(), large[-1]
        thresholds[low], aliases[low] = scaled[low], high
        scaled[high] -= 1.0 - scaled[low]
        if scaled[high] < 1.0:
            small.append(large.pop())
    return np.array(thresholds, np.float32), np.array(aliases, np.int32)
