"""``pmc-sampler compare``: all metrics of one image against another."""

import argparse
import json
import math
import sys
from typing import Any

from .errors import CommandError
from .optional import load


def compare(options: argparse.Namespace) -> int:
    """Print every metric with the constants that shaped it, as a table or as one JSON object; write maps."""
    images = load("pmc_sampler.eval.images", "comparing images", "eval")
    comparison = load("pmc_sampler.eval.compare", "comparing images", "eval")
    settings = {"white_luminance": options.white_luminance, "exposure": options.exposure}
    if options.pixels_per_degree is not None:
        settings["pixels_per_degree"] = options.pixels_per_degree
    try:
        pictures = {path: images.read(path) for path in (options.test, options.reference)}
        pair = (pictures[options.test].rgb, pictures[options.reference].rgb)
        layers = pictures[options.reference].layers
        known = {"variance", "luminance_variance"} <= layers.keys()  # as those that bench writes
        noise = comparison.Noise(layers["variance"], layers["luminance_variance"]) if known else None
        settings["noise"] = noise
        measures = comparison.compare(*pair, **settings)
        files = []
        if options.maps is not None:
            maps = load("pmc_sampler.eval.maps", "drawing maps", "eval")
            files = maps.write(options.maps, comparison.error_maps(*pair, **settings))
    except ImportError as error:
        raise CommandError(
            f"a metric needs a package that cannot be imported ({error}): pip install 'pmc-sampler[eval]'."
        ) from error
    except ValueError as error:
        raise CommandError(str(error)) from error
    subtracted = {} if noise is None else noise.added(pair[1], options.white_luminance)
    decoded = [str(path) for path, picture in pictures.items() if picture.encoded]
    if options.json:
        rows = [measure.as_dict() for measure in measures]
        for row in rows:
            if not math.isfinite(row["value"]):
                row["value"] = None
        summary: dict[str, Any] = {
            "test": str(options.test),
            "reference": str(options.reference),
            "decoded_from_srgb": decoded,
            "subtracted": subtracted,
        }
        print(json.dumps({**summary, "metrics": rows, "maps": [str(file) for file in files]}, indent=2))
        return 0
    _print(measures)
    if subtracted:
        said = ", ".join(f"{value:.6g} of the {name}" for name, value in subtracted.items())
        print(f"The reference's own noise is subtracted: {said}, and so of what is made of the same squares.")
    for name in decoded:
        print(f"{name} holds display-encoded values: they were decoded as sRGB, brighter light than white is lost.")
    if files:
        print(f"{len(files) // 2} maps, each as EXR and PNG, are written in {str(options.maps)!r}.")
    return 0


def _print(measures: list[Any]) -> None:
    load("rich", "printing a table", "cli")
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading, justify in (("metric", "left"), ("value", "right"), ("unit", "left"), ("constants", "left")):
        table.add_column(heading, justify=justify, no_wrap=not sys.stdout.isatty())  # type: ignore[arg-type]
    for measure in measures:
        constants = ", ".join(f"{name} {value:g}" for name, value in measure.constants.items())
        table.add_row(measure.name, f"{measure.value:.6g}", measure.unit, constants)
    # Files and pipes have no width: their lines stay whole.
    Console(highlight=False, width=None if sys.stdout.isatty() else 200).print(table)
