"""The report's pictures: PNG data URIs, and linear radiance in eight bits for the flip-book."""

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import measures, metrics
from ..display import display
from ..suite import Scene

DARK = 0.01
"""Radiance at which :func:`encode` turns from linear to logarithmic."""

Pixels = NDArray[np.float32]


_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True)
class Crop:
    """A rectangle of an image in pixels: left, top, width, height; ``why`` it was chosen, or what is there."""

    left: int
    top: int
    width: int
    height: int
    why: str

    def of(self, image: NDArray[_T]) -> NDArray[_T]:
        """The crop of an image (height, width, ...), a view."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def encode(rgb: Pixels, peak: float) -> str:
    """Linear RGB (height, width, 3) as a PNG of ``255 log(1 + x / DARK) / log(1 + peak / DARK)``, clipped to [0, peak].

    Steps are 3 % of a bright value where ``peak`` is 20: enough to be shown at any exposure, not to be measured.
    """
    x = np.clip(np.nan_to_num(rgb), 0.0, peak)
    return png(np.log1p(x / DARK) / np.log1p(peak / DARK))


def shown(rgb: Pixels) -> str:
    """Linear RGB (height, width, 3), tone-mapped, as a PNG."""
    return png(display(rgb))


def error_map(values: NDArray[np.floating], reach: float) -> str:
    """Values (height, width) as a grey PNG of ``255 sqrt(x / reach)``, clipped to [0, reach]; the page colours it."""
    return png(np.sqrt(np.clip(values / reach, 0.0, 1.0)))


def colours() -> list[tuple[int, int, int]]:
    """The 256 colours of an error map: a colour map of even steps, as bytes of sRGB."""
    from matplotlib import colormaps

    return [(int(r), int(g), int(b)) for r, g, b, _ in colormaps["viridis"](range(256), bytes=True)]


def strategy(shares: Pixels) -> str:
    """Density of samples (height, width, 3) of three radii as a PNG: hue is the radius, brightness the density.

    The 99th percentile of the density is full brightness, and it goes by the square root, so that the most of an image
    is seen where a few pixels have most of the samples.
    """
    full = max(float(np.quantile(shares.max(axis=-1), 0.99)), 1e-12)
    return png(np.sqrt(np.clip(shares / full, 0.0, 1.0)))


def png(values: NDArray[np.floating]) -> str:
    """Values in [0, 1], (height, width) or (height, width, 3), as the data URI of an 8-bit PNG."""
    from PIL import Image

    pixels = (np.clip(values, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG", optimize=False)
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def choose_crops(images: Mapping[str, Pixels], baseline: str, reference: Pixels, white_luminance: float) -> list[Crop]:
    """Where errors differ most, where the baseline's are greatest, and where the best method loses most.

    ``images`` are (height, width, 3) by method. The baseline is any method where it has no image. Errors are
    ``|dY| / tvi(Y)``, not squared, so that a few bright pixels do not decide. The best is the method of the least
    mean; it loses where its errors are over the baseline's by most. Places that say nothing are left out.
    """
    height, width = reference.shape[:2]
    side = max(min(max(min(height, width) // 3, 2 * measures.TILE), height, width), 1)
    errors = {
        name: _window_means(np.sqrt(metrics.tvi_error_map(image, reference, white_luminance=white_luminance)), side)
        for name, image in images.items()
    }
    base = errors.get(baseline, next(iter(errors.values())))
    best = min(errors, key=lambda name: float(errors[name].mean()))
    wanted = [
        (np.ptp(np.stack(list(errors.values())), axis=0), "where the methods differ most in thresholds"),
        (base, "where the baseline's error in thresholds is greatest"),
        (errors[best] - base, f"where {best} is farthest behind the baseline in thresholds"),
    ]
    crops: list[Crop] = []
    for values, why in wanted:
        free = values.copy()
        for crop in crops:
            rows, columns = np.ogrid[: free.shape[0], : free.shape[1]]
            free[(abs(rows - crop.top) < side) & (abs(columns - crop.left) < side)] = 0.0
        if free.max() > 0.0:
            top, left = np.unravel_index(int(free.argmax()), free.shape)
            why = why if not crops else f"{why}, apart from those above"
            crops.append(Crop(int(left), int(top), side, side, why))
    return crops


def named_crops(scene: Scene, shape: tuple[int, ...]) -> list[Crop]:
    """The crops that a suite asks for, of an image (height, width, ...); of a pixel at least."""
    height, width = shape[:2]
    crops = []
    for name, (left, top, right, bottom) in scene.crops:
        x, y = min(int(left * width), width - 1), min(int(top * height), height - 1)
        crops.append(Crop(x, y, max(round(right * width) - x, 1), max(round(bottom * height) - y, 1), name))
    return crops


def _window_means(values: NDArray[np.floating], side: int) -> NDArray[np.float64]:
    """Means of (height, width) values over the squares of ``side`` pixels, by their upper left corner."""
    from scipy.ndimage import uniform_filter

    means = uniform_filter(np.asarray(values, dtype=np.float64), size=side)
    rows, columns = (slice(side // 2, side // 2 + n - side + 1) for n in values.shape)
    return np.asarray(means[rows, columns])
