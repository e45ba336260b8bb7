"""Luminance and the threshold-versus-intensity function."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pmc_sampler import _core

#: Weights of linear Rec. 709 red, green and blue (ITU-R BT.709-6).
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)


def luminance(rgb: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """Rec. 709 luminance of linear RGB: shape (..., 3) to (...), in the units of the input.

    Raises ValueError where the last axis does not hold three channels.
    """
    array = np.asarray(rgb)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"luminance: got an array of shape {array.shape}, expected (..., 3) for red, green and blue")
    dtype = array.dtype if np.issubdtype(array.dtype, np.floating) else np.dtype(np.float64)
    result: npt.NDArray[np.floating] = array @ np.asarray(LUMINANCE_WEIGHTS, dtype)
    return result


def tvi(luminance_cd_m2: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The just noticeable luminance difference in cd/m2 at an adaptation luminance in cd/m2; same shape, float64.

    Rod and cone curves of Ferwerda et al. 1996 (doi:10.1145/237170.237262), joined as in Ward Larson et al. 1997
    (doi:10.1109/2945.646233). At and below 10^-3.94 cd/m2, zero and negative values included, it is 10^-2.86; infinity
    gives infinity and NaN gives NaN.
    """
    array = np.asarray(luminance_cd_m2, dtype=np.float64)
    return np.asarray(_core.tvi(np.ascontiguousarray(array.ravel()))).reshape(array.shape)
