"""The figure of the suite benchmarks/povray.toml: errors against seconds, and the images.

pmc-sampler bench benchmarks/povray.toml -o DIR
python benchmarks/povray_figure.py DIR -o benchmarks/povray.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from pmc_sampler.eval import images, results
from pmc_sampler.eval.display import display
from pmc_sampler.eval.suite import OWN

STYLES = {"uniform": ("tab:orange", "s"), "PMC": ("tab:blue", "o")}
NATIVE = ("0.35", "^")
SHOWN = ("reference", "PMC", "uniform", "+AM2 +R4 +A0.01")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("results", type=Path, metavar="DIR", help="what pmc-sampler bench wrote")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.png")
    options = parser.parse_args(arguments)
    draw(results.load(options.results), options.output)
    return 0


def draw(found: results.Results, path: Path) -> None:
    """A row for each scene: tvi error against seconds, then the images of the first seed."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scenes = found.suite.scenes
    size, widths = (15, 2.4 * len(scenes)), [1.5, *[1] * len(SHOWN)]
    figure, axes = pyplot.subplots(len(scenes), len(widths), figsize=size, squeeze=False, width_ratios=widths)
    for scene, row in zip(scenes, axes, strict=True):
        plot(row[0], found, scene)
        for axis, name in zip(row[1:], SHOWN, strict=True):
            picture(axis, found, scene.name, name)
    axes[0, 0].legend(fontsize=8)
    axes[-1, 0].set_xlabel("seconds")
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def plot(axis: Any, found: results.Results, scene: Any) -> None:
    """Medians over the seeds."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for method in found.suite.methods:
        colour, marker = NATIVE if method.native else STYLES[method.name]
        points = []
        for budget in found.suite.budgets(scene):
            rows = found.select(scene.name, method.name, str(budget))
            if rows:
                points.append([np.median([row[name] for row in rows]) for name in ("seconds.total", "tvi_error")])
        if not points:  # a method of other scenes
            continue
        x, y = np.array(sorted(points)).T
        label = "POV-Ray's own" if method.native else method.name
        shown = axis.get_legend_handles_labels()[1]
        axis.plot(x, y, color=colour, marker=marker, label=None if label in shown else label)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_ylabel(f"{scene.name}\ntvi error")
    axis.grid(alpha=0.3, which="both")


def picture(axis: Any, found: results.Results, scene: str, name: str) -> None:
    """The reference, or a method's image at its last budget, with its figures."""
    axis.set_axis_off()
    if name == "reference":
        path, title = found.reference_path(scene), name
    else:
        entry = next(one for one in found.suite.scenes if one.name == scene)
        budgets = [str(b) for b in found.suite.budgets(entry) if found.select(scene, name, str(b))]
        budget = str(OWN) if str(OWN) in budgets else budgets[-1]
        row = found.select(scene, name, budget)[0]
        path = found.image_path(scene, name, budget)
        title = f"{name}\n{row['seconds.total']:.1f} s, {row['spp']:.3g} spp, tvi error {row['tvi_error']:.3g}"
    if path is not None:
        axis.imshow(display(images.read(path).rgb), interpolation="nearest")
    axis.set_title(title, fontsize=8)


if __name__ == "__main__":
    sys.exit(main())
