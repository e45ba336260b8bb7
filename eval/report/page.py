"""The report's page: what each scene has to show, put into the template by Jinja."""

import json
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .. import compare, images, measures, metrics, statistics
from ..results import Results, noise_left, write_text
from ..suite import OWN, Budget, Method, Scene, slug
from . import figures, pictures, plots, words
from .claims import claims

_T = TypeVar("_T")
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
        few=statistics.few(found.suite.seeds),
        claims=claims(found),
        provenance=words.provenance(found),
        commands=[
            shlex.join(["pmc-sampler", "bench", str(found.path / "suite.toml"), "-o", str(found.path)]),
            shlex.join(["pmc-sampler", "report", str(found.path)]),
        ],
        scenes=[_scene(found, scene) for scene in found.suite.scenes],
        settings=[(m.name, m.numbers, _resolved(found, m), json.dumps(m.on)) for m in found.suite.methods],
        constants=[
            (name, ", ".join(f"{constant} = {value:g}" for constant, value in values.items()))
            for name, values in compare.constants(found.suite.white_luminance).items()
        ],
        failed=found.failed,
        toml=(found.path / "suite.toml").read_text(encoding="utf-8"),
        tile=measures.TILE,
        css=(_HERE / "report.css").read_text(encoding="utf-8"),
        js=(_HERE / "report.js").read_text(encoding="utf-8"),
    )


def _resolved(found: Results, method: Method) -> str:
    """Every setting of a method, on the first scene that it has run on; what the suite gives, if on none."""
    own = (row["resolved"] for row in found.done if row["method"] == method.name and "resolved" in row)
    return next(own, json.dumps(dict(method.settings)))


def _scene(found: Results, scene: Scene) -> dict[str, Any]:
    budgets = found.suite.budgets(scene)
    budget = words.headline(found, scene)
    rows = [row for row in found.done if row["scene"] == scene.name]
    main = words.main_metrics(found)
    others = [metric for metric in found.suite.metrics if metric not in main]
    return {
        "name": scene.name,
        "slug": slug(scene.name),
        "about": _about(scene, rows),
        "tables": _given(words.table(found, scene, one, main, words.spoken(one)) for one in budgets),
        "other_tables": _given(
            words.table(found, scene, one, others, f"{words.spoken(one)}, other metrics") for one in budgets if others
        ),
        "errors": _given(plots.error_plot(found, scene, metric) for metric in main),
        "other_errors": _given(plots.error_plot(found, scene, metric) for metric in others),
        "slopes": words.slopes(found, scene),
        "sweeps": _given(
            plots.sweep_plot(found, scene, metric, name, methods)
            for name, methods in words.sweeps(found)
            for metric in main
        ),
        "time": plots.time_plot(found, scene, str(budget), words.spoken(budget)) if budget else None,
        **_pictures(found, scene, budget),
    }


def _given(values: Iterable[_T | None]) -> list[_T]:
    return [value for value in values if value is not None]


def _about(scene: Scene, rows: list[dict[str, Any]]) -> str:
    if not rows:
        return "No run is done."
    row = rows[0]
    return (
        f"{row['width']}x{row['height']} pixels, {row['renderer']}, reference of {row['reference.spp']} samples "
        f"per pixel. Subtracted for the reference's own noise: MSE {figures.number(row['reference.mse'])}, tvi error "
        f"{figures.number(row['reference.tvi_error'])}{noise_left(row, figures.number)}. "
        f"Standard error of the reference's mean luminance: {100 * row['reference.bias']:.3f} %."
    )


def _pictures(found: Results, scene: Scene, budget: Budget | None) -> dict[str, Any]:
    """The flip-book, crops, maps and bias maps of a scene; empty where an image is missing."""
    nothing: dict[str, Any] = {"book": None, "crops": [], "maps": [], "even": [], "bias": [], "budget": ""}
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
    peak = float(np.clip(max(i.max() for i in (reference, *(image.rgb for image in made.values()))), 1.0, _PEAK))
    height, width = reference.shape[:2]
    book = {
        "width": width,
        "height": height,
        "peak": peak,
        "dark": pictures.DARK,
        "reach": reach,
        "colours": pictures.colours(),
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
            for crop in (
                *pictures.named_crops(scene, reference.shape),
                *pictures.choose_crops(rgb, found.suite.baseline, reference, white),
            )
        ],
        **_maps({name: image.layers for name, image in made.items()}),
        "bias": _bias(found, scene, budget, reference),
    }


def _crop(crop: pictures.Crop, rgb: dict[str, Any], reference: Any, white: float) -> dict[str, Any]:
    inside = crop.of(reference)
    shown = [{"name": "reference", "uri": pictures.shown(inside), "figures": []}]
    for name, image in rgb.items():
        part = crop.of(image)
        tvi = metrics.tvi_error(part, inside, white_luminance=white)
        thresholds = metrics.threshold_ratio(part, inside, white_luminance=white)
        said = [
            f"{figures.number(thresholds)} thresholds",
            f"tvi error {figures.number(tvi)}",
            f"MSE {figures.number(metrics.mse(part, inside))}",
        ]
        shown.append({"name": name, "uri": pictures.shown(part), "figures": said})
    where = f"{crop.width}x{crop.height} pixels from ({crop.left}, {crop.top}), {crop.why}"
    return {"where": where, "images": shown}


def _maps(layers: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Where each method's samples went: ``maps``, and sentences on those that spread them evenly, ``even``."""
    maps: list[plots.Plot] = []
    even = []
    alphas = [of_method["alpha"] for of_method in layers.values() if "alpha" in of_method]
    within = plots.limits(np.concatenate([alpha.ravel() for alpha in alphas])) if alphas else (0.0, 1.0)
    for name, of_method in layers.items():
        if "samples" in of_method:
            samples = of_method["samples"]
            if np.ptp(samples) == 0:
                even.append(f"{name}: {samples.flat[0]:g} samples in every pixel.")
            else:
                title = f"{name}: sample density"
                maps.append(plots.map_plot(samples, plots.limits(samples, log=True), title, "samples", log=True))
        # A sampler without radii has the same for all three.
        if "strategy" in of_method and np.ptp(of_method["strategy"], axis=-1).any():
            alt = f"{name}: strategy image, red, green and blue for the first, second and third radius"
            maps.append(plots.Plot(pictures.strategy(of_method["strategy"]), alt, f"{alt}; the brighter the denser"))
            shares = of_method["strategy"] / np.maximum(of_method["strategy"].sum(axis=-1, keepdims=True), 1e-12)
            maps.append(plots.map_plot(shares[..., 0], (0.0, 1.0), f"{name}: share of the first radius", "share"))
        if "alpha" in of_method:
            for radius, ordinal in enumerate(("first", "second", "third")):
                title = f"{name}: alpha, weight of the {ordinal} radius"
                maps.append(plots.map_plot(of_method["alpha"][..., radius], within, title, "weight"))
    return {"maps": maps, "even": even}


def _bias(found: Results, scene: Scene, budget: Budget, reference: Any) -> list[plots.Plot]:
    """The bias maps of all methods, in one range."""
    mean = measures.tiles(reference)
    tests = {m.name: found.welch(scene.name, m.name, str(OWN if m.native else budget)) for m in found.suite.methods}
    known = {name: (test, plots.bias_percent(test, mean)) for name, test in tests.items() if test is not None}
    if not known:
        return []
    every = np.concatenate([np.abs(percent).ravel() for _, percent in known.values()])
    reach = max(float(np.quantile(every, 0.98)), 1e-6)
    return [plots.bias_plot(test, percent, reach, name) for name, (test, percent) in known.items()]
