"""Error maps as files: an EXR with the values and a PNG in a perceptually uniform colour map with a scale."""

import json
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import images
from .compare import ErrorMap

COLOUR_MAP = "viridis"  # perceptually uniform, and told apart by the colour-blind and in print

_DPI = 100
_MARGINS = (0.25, 1.15, 0.75, 0.25)  # inches: left, right with the scale, top with the title, bottom
_SMALLEST = 360  # pixels: smaller maps are shown enlarged by a whole factor, each pixel a square


def draw(error: ErrorMap) -> NDArray[np.float32]:
    """The map as a picture of shape (height, width, 3), display-encoded in [0, 1]: dark is good, bright is bad.

    The scale runs from the metric's best value to the 99.5th percentile of the distances from it, so that
    single specks do not darken the rest; an arrow says that pixels lie beyond. Nothing is drawn smaller than
    pixel for pixel.
    """
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    values = error.values
    height, width = values.shape
    factor = max(1, -(-_SMALLEST // width))
    left, right, top, bottom = _MARGINS
    w, h = width * factor / _DPI, height * factor / _DPI
    figure = Figure(figsize=(left + w + right, top + h + bottom), dpi=_DPI)
    total_w, total_h = left + w + right, top + h + bottom
    axes = figure.add_axes((left / total_w, bottom / total_h, w / total_w, h / total_h))
    # At least a float's smallest step: the map of equal images has a scale too.
    reach = max(float(np.quantile(np.abs(values - error.best), 0.995)), float(np.finfo(np.float32).eps))
    upwards = error.best < 1.0
    low, high = (error.best, error.best + reach) if upwards else (error.best - reach, error.best)
    colours = colormaps[COLOUR_MAP if upwards else f"{COLOUR_MAP}_r"]
    picture = axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    axes.set_axis_off()
    axes.set_title(_title(error), fontsize=9, loc="left")
    extend = "max" if values.max() > high else "min" if values.min() < low else "neither"
    bar = figure.add_axes(((left + w + 0.12) / total_w, bottom / total_h, 0.16 / total_w, h / total_h))
    scale = figure.colorbar(picture, cax=bar, extend=extend)
    scale.set_label(error.unit or error.name, fontsize=8)
    scale.ax.tick_params(labelsize=8)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba(), dtype=np.float32)  # type: ignore[no-untyped-call]
    return pixels[..., :3] / np.float32(255.0)


def write(folder: str | os.PathLike[str], errors: list[ErrorMap]) -> list[Path]:
    """Write ``METRIC.exr`` and ``METRIC.png`` for each map into a folder, made when missing; returns the files.

    The EXR has one channel, ``Y``, of 32-bit floats, and the metric's constants as an attribute. Raises
    :class:`pmc_sampler.eval.images.ImageError` where the folder cannot be made or a file not written.
    """
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise images.ImageError(f"the folder {str(place)!r} for maps cannot be made: {error.strerror}.") from error
    files = []
    for error_map in errors:
        exr, png = (place / f"{error_map.metric}{suffix}" for suffix in (".exr", ".png"))
        about = {"metric": error_map.name, "unit": error_map.unit, "constants": json.dumps(error_map.constants)}
        images.write_exr_plane(exr, error_map.values, {f"pmc:{name}": value for name, value in about.items()})
        images.write_png_encoded(png, draw(error_map))
        files += [exr, png]
    return files


def _title(error: ErrorMap) -> str:
    constants = ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in error.constants.items())
    return f"{error.name}, mean of the map {error.values.mean():.4g}" + (f"\n{constants}" if constants else "")
