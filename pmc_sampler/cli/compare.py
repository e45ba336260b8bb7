"""``pmc-sampler compare``: all metrics of one image against another."""

import argparse
import json
import math

from .errors import CommandError
from .optional import load


def compare(options: argparse.Namespace) -> int:
    """Print every metric with the constants that shaped it, as a table or as one JSON object."""
    images = load("pmc_sampler.eval.images", "comparing images", "eval")
    comparison = load("pmc_sampler.eval.compare", "comparing images", "eval")
    try:
        measures = comparison.compare(
            images.read(options.test).rgb,
            images.read(options.reference).rgb,
            white_luminance=options.white_luminance,
            exposure=options.exposure,
        )
    except ImportError as error:
        raise CommandError(
            f"a metric needs a package that cannot be imported ({error}): pip install 'pmc-sampler[eval]'."
        ) from error
    except ValueError as error:
        raise CommandError(str(error)) from error
    if options.json:
        rows = [measure.as_dict() for measure in measures]
        for row in rows:
            if not math.isfinite(row["value"]):
                row["value"] = None
        print(json.dumps({"test": str(options.test), "reference": str(options.reference), "metrics": rows}, indent=2))
        return 0
    for measure in measures:
        constants = ", ".join(f"{name} {value:g}" for name, value in measure.constants.items())
        print(f"{measure.name:22}{measure.value:>14.6g} {measure.unit:14}{constants}".rstrip())
    return 0
