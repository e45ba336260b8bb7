"""``pmc-sampler report``: a folder of results as one HTML file."""

import argparse
import time

from .errors import CommandError
from .optional import load


def report(options: argparse.Namespace) -> int:
    """Write ``report.html`` into the folder and say what it took; returns the exit status."""
    results = load("pmc_sampler.eval.results", "reports", "eval")
    page = load("pmc_sampler.eval.report", "reports", "eval")
    images = load("pmc_sampler.eval.images", "reports", "eval")
    for module in ("pyarrow", "tomli_w", "matplotlib", "jinja2", "PIL", "scipy"):
        load(module, "reports", "eval")
    began = time.perf_counter()
    try:
        path = page.write(results.load(options.results))
    except (results.BadResultsError, images.ImageError) as error:
        raise CommandError(str(error)) from error
    print(f"{path} is written: {path.stat().st_size / 1e6:.1f} MB, {time.perf_counter() - began:.1f} s.")
    return 0
