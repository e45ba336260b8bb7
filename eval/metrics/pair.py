"""What every metric takes: two finite images of one size, and perhaps the variance of the second."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmc_sampler import luminance

Pixels = NDArray[np.float64]


def pair(test: ArrayLike, reference: ArrayLike) -> tuple[Pixels, Pixels]:
    """Both images as float64; raises ``ValueError`` where they cannot be compared."""
    x, r = np.asarray(test, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    for name, image in (("test", x), ("reference", r)):
        if image.ndim != 3 or image.shape[2] != 3 or not image.size:
            raise ValueError(f"the {name} image must be linear RGB of shape (height, width, 3), not {image.shape}.")
    if x.shape != r.shape:
        raise ValueError(
            f"test and reference must have one size; the test is {x.shape[1]}x{x.shape[0]} pixels, "
            f"the reference {r.shape[1]}x{r.shape[0]}."
        )
    for name, image in (("test", x), ("reference", r)):
        bad = image.size - int(np.isfinite(image).sum())
        if bad:
            raise ValueError(f"the {name} image holds {bad} values that are not finite; no error of it can be given.")
    return x, r


def luminance_of(rgb: Pixels) -> Pixels:
    """Luminance in float64, shape (height, width)."""
    return np.asarray(luminance(rgb), dtype=np.float64)


def variance_of(variance: ArrayLike | None, shape: tuple[int, ...]) -> Pixels:
    """The reference's variance in float64, zeros where none is given; raises ``ValueError`` for no variance."""
    if variance is None:
        return np.zeros(shape)
    v = np.asarray(variance, dtype=np.float64)
    if v.shape != shape:
        raise ValueError(
            f"reference_variance must have the shape {shape} of what is compared, luminance or RGB; "
            f"its shape is {v.shape}."
        )
    if not np.isfinite(v).all() or v.min() < 0.0:
        raise ValueError("reference_variance must be finite and not negative.")
    return v
