"""The report's page: what each scene has to show, put into the template by Jinja."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from .. import images, measures, metrics
from ..results import Results, write_text
from ..suite import OWN, Budget, Scene, slug
from . import pictures, plots, words

_HERE = Path(__file__).parent
_PEAK = 64.0  # brighter radiance is white at every exposure the page offers


def write(found: Results) -> Path:
    """Write ``report.html`` into the folder of the results, beside its place and then renamed; returns its path."""
    path = found.path / "report.html"
    write_text(path, page(found))
    return path


def page(found: Results) -> str:
    """The page for what :func:`pmc_sampler.eval.results.load` found, finished or not: HTML that needs no other file."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    return environment.get_template("template.html").render(
        suite=found.suite,
        summary=words.summary(found),
        provenance=words.provenance(found),
        commands=[f"pmc-sampler bench {found.path}/suite.toml -o {found.path}", f"pmc-sampler report {found.path}"],
        scenes=[_scene(found, scene) for scene in found.suite.scenes],
        settings=[(m.name, m.numbers, json.dumps(m.settings), json.dumps(m.on)) for m in found.suite.methods],
        failed=found.failed,
        toml=(found.path / "suite.toml").read_text(encoding="utf-8"),
        tile=measures.TILE,
        css=(_HERE / "report.css").read_text(encoding="utf-8"),
        js=(_HERE / "report.js").read_text(encoding="utf-8"),
    )


def _scene(found: Results, scene: Scene) -> dict[str, Any]:
    budgets = found.suite.budgets(scene)
    budget = words.headline(found, scene)
    rows = [row for row in found.done if row["scene"] == scene.name]
    errors = [
        plots.error_plot(found, scene, metric, x) for metric in found.suite.metrics for x in ("spp", "seconds.total")
    ]
    main = sum(2 for metric in found.suite.metrics if metric in ("mse", "tvi_error"))
    errors_by_use = sorted(
        zip([m for m in found.suite.metrics for _ in "xx"], errors, strict=True),
        key=lambda pair: pair[0] not in ("mse", "tvi_error"),
    )
    return {
        "name": scene.name,
        "slug": slug(scene.name),
        "about": _about(scene, rows),
        "tables": [table for one in budgets if (table := words.table(found, scene, one)) is not None],
        "errors": [plot for _, plot in errors_by_use[:main] if plot],
        "more_errors": [plot for _, plot in errors_by_use[main:] if plot],
        "sweeps": [
            plot
            for name, methods in words.sweeps(found)
            for metric in found.suite.metrics
            if metric in ("mse", "tvi_error")
            if (plot := plots.sweep_plot(found, scene, metric, name, methods)) is not None
        ],
        "time": plots.time_plot(found, scene, str(budget)) if budget else None,
        **_pictures(found, scene, budget),
    }


def _about(scene: Scene, rows: list[dict[str, Any]]) -> str:
    if not rows:
        return "No run is done."
    row = rows[0]
    return (
        f"{row['width']}x{row['height']} pixels, {row['renderer']}, reference of {row['reference.spp']} samples "
        f"per pixel. Subtracted for the reference's own noise: MSE {row['reference.mse']:.3g}, tvi error "
        f"{row['reference.tvi_error']:.3g}. Standard error of the reference's mean luminance: "
        f"{100 * row['reference.bias']:.3f} %."
    )


def _pictures(found: Results, scene: Scene, budget: Budget | None) -> dict[str, Any]:
    """The flip-book, crops, maps and bias maps of a scene; empty where an image is missing."""
    nothing: dict[str, Any] = {"book": None, "crops": [], "maps": [], "bias": [], "budget": ""}
    path = found.reference_path(scene.name)
    if budget is None or path is None:
        return nothing
    reference = images.read(path).rgb
    made = {}
    for method in found.suite.methods:
        own = OWN if method.native else budget
        file = found.image_path(scene.name, method.name, str(own))
        if file is not None:
            made[method.name] = images.read(file)
    if not made:
        return nothing
    white = found.suite.white_luminance
    errors = {name: metrics.tvi_error_map(image.rgb, reference, white_luminance=white) for name, image in made.items()}
    reach = max(float(np.quantile(np.stack(list(errors.values())), 0.995)), 1e-12)
    peak = float(np.clip(max(reference.max(), 1.0), 1.0, _PEAK))
    height, width = reference.shape[:2]
    book = {
        "width": width,
        "height": height,
        "peak": peak,
        "dark": pictures.DARK,
        "images": [
            {"name": "reference", "kind": "radiance", "uri": pictures.encode(reference, peak)},
            *({"name": n, "kind": "radiance", "uri": pictures.encode(i.rgb, peak)} for n, i in made.items()),
            *(
                {"name": f"tvi error of {n}", "kind": "map", "uri": pictures.error_map(e, reach)}
                for n, e in errors.items()
            ),
        ],
    }
    rgb = {name: image.rgb for name, image in made.items()}
    return {
        "book": book,
        "reach": reach,
        "budget": words.spoken(budget),
        "crops": [
            _crop(crop, rgb, reference, white)
            for crop in pictures.choose_crops(rgb, found.suite.baseline, reference, white)
        ],
        "maps": [plot for name, image in made.items() for plot in _maps(name, image.layers)],
        "bias": _bias(found, scene, budget, reference),
    }


def _crop(crop: pictures.Crop, rgb: dict[str, Any], reference: Any, white: float) -> dict[str, Any]:
    inside = crop.of(reference)
    shown = [{"name": "reference", "uri": pictures.shown(inside), "figures": ""}]
    for name, image in rgb.items():
        part = crop.of(image)
        tvi = metrics.tvi_error(part, inside, white_luminance=white)
        figures = f"tvi error {tvi:.3g}, MSE {metrics.mse(part, inside):.3g}"
        shown.append({"name": name, "uri": pictures.shown(part), "figures": figures})
    where = f"{crop.width}x{crop.height} pixels from ({crop.left}, {crop.top}), where {crop.why}"
    return {"where": where, "images": shown}


def _maps(name: str, layers: dict[str, Any]) -> list[plots.Plot]:
    found = []
    if "samples" in layers:
        found.append(plots.map_plot(layers["samples"], f"{name}: sample density", "samples in the pixel", log=True))
    if "strategy" in layers:
        alt = f"{name}: strategy image, red, green and blue for the first, second and third radius"
        found.append(plots.Plot(pictures.png(layers["strategy"]), alt, f"{alt}; brightness is sample density"))
    if "alpha" in layers:
        for radius in range(3):
            title = f"{name}: alpha, weight of the {('first', 'second', 'third')[radius]} radius"
            found.append(plots.map_plot(layers["alpha"][..., radius], title, "weight"))
    return found


def _bias(found: Results, scene: Scene, budget: Budget, reference: Any) -> list[plots.Plot]:
    mean = measures.tiles(reference)
    tests = [(m.name, found.welch(scene.name, m.name, str(OWN if m.native else budget))) for m in found.suite.methods]
    return [plots.bias_plot(test, mean, name) for name, test in tests if test is not None]
