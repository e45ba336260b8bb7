"""The report: what it says of results that are whole, in part or hostile. Exact."""

from __future__ import annotations

import base64
import dataclasses
import functools
import io
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval import benchmark, compare, images, metrics, report, results, statistics, suite
from pmc_sampler.eval.report import figures, pictures, plots, words

from pmc_sampler.cli import main

pytestmark = pytest.mark.needs("skimage", "pyarrow", "tomli_w", "OpenImageIO", "jinja2", "matplotlib", "PIL")

SIZE = (40, 36)
HOSTILE = "</script><script>alert(\"1\")</script> & 'x' $a$ {{ suite }}"
SUITE = suite.parse(
    {
        "name": "test",
        "about": "Scenes that cost nothing.",
        "size": list(SIZE),
        "spp": [4, 8],
        "seeds": 2,
        "renderer": "noisy",
        "reference_spp": 64,
        "baseline": "PT",
        "metrics": ["mse", "tvi_error", "ssim"],
        "scene": [
            {"name": "diffuse", "seconds": [0.01], "crops": {"a corner": [0.5, 0.5, 1, 1]}},
            {"name": HOSTILE, "file": __file__, "spp": [4]},
        ],
        "method": [
            {"name": "PT", "sampler": "uniform"},
            {"name": HOSTILE.replace("{", "{{").replace("}", "}}"), "sampler": "pmc", "moves": 1},
            {"name": "own", "sampler": "native", "scenes": ["diffuse"]},
            {
                "name": "memory {alpha_memory}",
                "sampler": "pmc",
                "scenes": ["diffuse"],
                "sweep": {"alpha_memory": [0.2, 0.5, 0.8]},
            },
        ],
    }
)


class Page(HTMLParser):
    """What a page holds: its text without scripts and styles, and its elements as (tag, attributes)."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.rows: list[list[str]] = []
        self.words: list[str] = []
        self.inside = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))
        if tag in ("script", "style"):
            self.inside = tag
            self.scripts.append("")
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th") and self.rows:
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag == self.inside:
            self.inside = ""

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.scripts[-1] += data
            return
        self.words.append(data)
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] = " ".join(f"{self.rows[-1][-1]} {data}".split())

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def books(self) -> list[Any]:
        return [json.loads(script) for script in self.scripts if script.startswith('{"')]

    def svgs(self) -> list[str]:
        start = "data:image/svg+xml;base64,"
        uris = [str(image["src"]) for image in self.all("img")]
        return [base64.b64decode(uri.removeprefix(start)).decode() for uri in uris if uri.startswith(start)]


def open_png(uri: str) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.removeprefix("data:image/png;base64,")))))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report") / "the results"


@pytest.fixture
def folder(kept: Path, noisy: type) -> Path:
    """A finished benchmark; tests that change it take `copy`."""

    class Own(noisy):  # type: ignore[misc,valid-type]
        def native(self) -> SimpleNamespace:
            return SimpleNamespace(mean=self.mean.astype(np.float32), samples=1440, seconds=100.0)

    hooks = benchmark.Renderers(lambda renderer, scene, *, sampler, size: Own(*size), lambda renderer: "1.2")
    if not kept.exists():
        benchmark.run(SUITE, results.Folder(kept), hooks, cache=kept.parent / "cache")
    return kept


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


@functools.cache
def page_of(folder: Path) -> Page:
    return Page(report.page(results.load(folder)))


@pytest.fixture
def whole(folder: Path) -> Page:
    return page_of(folder)


def test_it_has_every_part(whole: Page) -> None:
    headings = ("Summary", "Error against samples and seconds", "Sweeps", "Images at 8 samples per pixel, seed 1",
                "Where the samples went", "Bias in tiles of 16 pixels", "Time", "Constants", "Provenance")  # fmt: skip
    for heading in headings:
        assert heading in whole.text
    assert "36 runs are done with 2 seeds." in whole.text
    assert "4 samples in every pixel" in whole.text, "of the uniform method on the second scene"
    assert "Slope of log MSE against log samples per pixel: PT" in whole.text
    first = {row[0] for row in whole.rows}
    measured = {"metric", *compare.constants()}
    assert {"method", *(method.name for method in SUITE.methods)} == first - measured
    assert measured <= first
    assert ["relMSE, trimmed", "epsilon = 0.01, trim = 0.001"] in whole.rows
    assert "&#34;pool_share&#34;: 0.15" in whole.html, "a setting that no suite gives"


def test_a_flip_book_has_every_image(whole: Page, folder: Path) -> None:
    first, second = whole.books()
    methods = [method.name for method in SUITE.methods]
    assert [image["name"] for image in first["images"]] == [
        "reference", *methods, *(f"tvi error of {name}" for name in methods)
    ]  # fmt: skip
    assert len(second["images"]) == 5
    found = results.load(folder)
    path, reference_path = found.image_path("diffuse", "PT", "8spp"), found.reference_path("diffuse")
    assert path is not None
    assert reference_path is not None
    image, reference = images.read(path).rgb, images.read(reference_path).rgb
    codes = open_png(first["images"][1]["uri"]) / 255
    dark, peak = first["dark"], first["peak"]
    np.testing.assert_allclose(dark * np.expm1(codes * np.log1p(peak / dark)), image, rtol=0.02, atol=1e-3)
    errors = metrics.tvi_error_map(image, reference, white_luminance=100.0)
    codes = open_png(first["images"][1 + len(methods)]["uri"]) / 255
    shown = np.clip(errors, 0.0, first["reach"])
    np.testing.assert_allclose(first["reach"] * codes**2, shown, atol=first["reach"] / 120)
    assert np.shape(first["colours"]) == (256, 3)


def test_a_table_has_the_rows_figures(whole: Page, folder: Path) -> None:
    found = results.load(folder)
    heads = next(row for row in whole.rows if row[0] == "method")
    lines = {row[0]: [" ".join(cell.split()) for cell in row] for row in reversed(whole.rows) if len(row) == len(heads)}
    assert heads[1] == "MSE ↓"
    mse = np.array([row["mse"] for row in found.select("diffuse", "PT", "4spp")])
    assert lines["PT"][1].replace("★ ", "").split()[0] == figures.rounded(float(np.median(mse)))
    bias = 100 * np.mean([row["bias"] for row in found.select("diffuse", "PT", "4spp")])
    assert lines["PT"][heads.index("bias, %")].replace("★ ", "").startswith(f"{bias:+.3f} ±")


def test_it_loads_nothing(whole: Page) -> None:
    for _, attributes in whole.elements:
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#"))
    (policy,) = [meta["content"] for meta in whole.all("meta") if meta.get("http-equiv") == "Content-Security-Policy"]
    assert str(policy).startswith("default-src 'none'; img-src data:;")
    style = whole.scripts[0]
    assert "url(" not in style
    assert "@import" not in style
    assert {str(a["href"])[1:] for a in whole.all("a")} <= {attributes.get("id") for _, attributes in whole.elements}
    assert all(image["alt"] for image in whole.all("img"))


def test_each_figure_leads_to_its_command(whole: Page, folder: Path) -> None:
    plotted = sum(str(image["src"]).startswith("data:image/svg") for image in whole.all("img"))
    assert sum(a["href"] == "#commands" for a in whole.all("a")) >= plotted > 20
    assert f"pmc-sampler bench '{folder}/suite.toml' -o '{folder}'" in whole.text


def test_hostile_names_are_text(whole: Page) -> None:
    """One script for each flip-book and the page's own, whatever the names hold."""
    assert len(whole.all("script")) == 2 + 1
    assert HOSTILE in whole.text
    assert {image["name"] for image in whole.books()[1]["images"]} >= {HOSTILE}
    legends = [svg for svg in whole.svgs() if "alert" in svg]
    assert legends
    for svg in legends:
        assert "<script" not in svg
        assert "$a$ {{ suite }}" in svg


def test_a_native_method_and_a_sweep_are_shown(whole: Page) -> None:
    assert "the renderer's own end" in whole.text
    assert "MSE against the setting alpha_memory." in whole.text
    assert whole.books()[0]["images"][9]["name"] == "tvi error of own"


def test_one_seed_has_no_spread(copy: Path) -> None:
    found = results.load(copy)
    rows = [row for row in found.rows if row["seed"] == 1]
    page = Page(report.page(dataclasses.replace(found, rows=rows, suite=dataclasses.replace(SUITE, seeds=1))))
    assert "one seed, so that nothing is known of the spread" in page.text
    assert "A test of bias needs two seeds or more." in page.text
    assert "±" not in page.text


def test_missing_and_failed_runs_are_told(copy: Path) -> None:
    found = results.load(copy)
    for row in found.select("diffuse", "PT", "8spp"):
        (copy / "runs" / f"{row['id']}.parquet").unlink()
    results.Folder(copy).store({**found.rows[0], "error": "no <b>light</b>"})
    page = Page(report.page(results.load(copy)))
    assert "33 runs are done with 2 seeds; 1 failed; 2 have not been run." in page.text
    assert "no <b>light</b>" in page.text
    assert len(page.books()) == 2


def test_without_images_it_says_so(copy: Path) -> None:
    shutil.rmtree(copy / "images")
    page = Page(report.page(results.load(copy)))
    assert page.text.count("Images are missing") == 2
    assert not page.books()


def test_without_runs_it_says_so(tmp_path: Path) -> None:
    results.Folder(tmp_path).begin(SUITE, ["a", "b"])
    page = Page(report.page(results.load(tmp_path)))
    assert "0 runs are done with 2 seeds; 2 have not been run." in page.text
    assert page.text.count("No run is done.") == 2
    assert not page.svgs()


def test_the_command_writes_the_same_page_again(
    copy: Path, whole: Page, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(copy)]) == 0
    written = Page((copy / "report.html").read_text(encoding="utf-8"))
    assert written.svgs() == whole.svgs()
    assert written.books() == whole.books()
    assert re.fullmatch(rf"{copy}/report.html is written: [\d.]+ MB, [\d.]+ s\.\n", capsys.readouterr().out)


def test_a_report_that_fails_leaves_the_old_one(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (copy / "report.html").write_text("old", encoding="utf-8")

    def full(self: Path, *rest: Any, **settings: Any) -> None:
        with open(self, "w") as file:
            file.write("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    assert main(["report", str(copy)]) == 2
    assert (copy / "report.html").read_text(encoding="utf-8") == "old"
    assert not list(copy.glob("*.part")) + list(copy.glob(".*part"))


def test_no_results_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path / "none")]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert said.err.count("\n") == 1
    assert "none' holds no results of a benchmark (No such file or directory); `pmc-sampler bench -o " in said.err
    assert not list(tmp_path.iterdir())


def made(method: str, seed: int, error: float, bias: float) -> dict[str, Any]:
    return {
        **{"scene": "diffuse", "method": method, "seed": seed, "budget": "4spp", "spp": 4.0, "error": None},
        **{"mse": error, "tvi_error": 2 * error, "bias": bias, "seconds.total": 2.0, "tiles": [[1.0]]},
        **{"limit.mse": error / 10, "limit.tvi_error": error / 5},
    }


def test_lists_are_swept_as_numbers_are(tmp_path: Path) -> None:
    """Radii side by side in their order, each with its error; of numbers and lists no mixture."""
    given = {"name": "radii {radii}", "sampler": "pmc", "sweep": {"radii": [[50.0], [0.5, 1.5, 4.0], [5.0]]}}
    pt = {"name": "PT", "sampler": "uniform"}
    one = suite.parse(
        {
            **{"name": "test", "about": "Radii.", "size": [8, 8], "spp": [4], "seeds": 1, "renderer": "noisy"},
            **{"reference_spp": 64, "baseline": "PT", "scene": [{"name": "diffuse"}], "method": [pt, given]},
        }
    )
    names = {tuple(m.settings["radii"]): m.name for m in one.methods[1:]}
    assert words.sweeps(results.Results(tmp_path, one, [], 0)) == [("radii", names)]
    rows = [made(name, 1, float(radii[0]), 0.0) for radii, name in names.items()]
    found = results.Results(tmp_path, one, rows, 0)
    plot = plots.sweep_plot(found, one.scenes[0], "mse", "radii", names)
    assert plot is not None
    assert plot.alt == "MSE on diffuse against radii: at 4spp 0.5 for 0.5, 1.5, 4, 5 for 5, 50 for 50"


def test_gains_stand_beside_their_bias(tmp_path: Path) -> None:
    """PMC has an eighth of the error of each seed's PT, whatever that seed's error is."""
    rows = []
    for seed, error in ((1, 1e-5), (2, 1e-4), (3, 1e-3)):
        rows += [made("PT", seed, error, 0.0), made(SUITE.methods[1].name, seed, error / 8, 0.001 * seed)]
    one = dataclasses.replace(SUITE, scenes=SUITE.scenes[:1], methods=SUITE.methods[:2], seeds=3)
    found = results.Results(tmp_path, one, rows, 0)
    _, said = words.summary(found)
    assert said == (
        f"diffuse, 4 samples per pixel: {HOSTILE} has the least MSE, 1.25·10⁻⁵ (PT: 8.00 times as large, 95 % interval "
        "8.00 to 8.00) and the least tvi error, 2.50·10⁻⁵ (PT: 8.00 times as large, 95 % interval 8.00 to 8.00). "
        "Its bias: +0.200 ± 0.058 % of the mean luminance."
    )
    table = words.table(found, one.scenes[0], one.scenes[0].budgets[0], ["mse"], "a title")
    assert table is not None
    assert table.heads == [
        "MSE in 10⁻⁴ ↓", "MSE factor ↑", "MSE, limit reached, % ↑", "bias, %", "samples per pixel", "seconds ↓"
    ]  # fmt: skip
    (_, pt), (_, pmc) = table.rows
    assert [cell.text for cell in pt[:4]] == ["1.00", "1.00", "10.0", "+0.000"]
    assert [cell.text for cell in pmc[:4]] == ["0.125", "8.00", "10.0", "+0.200"]
    assert [cell.best for cell in pmc[:2]] == [True, True]
    assert (pmc[0].interval, pt[3].best) == ("0.0125 to 1.25", True)
    # Where there is no error at all there is nothing to divide by.
    rows[-1] |= {"mse": 0.0}
    table = words.table(found, one.scenes[0], one.scenes[0].budgets[0], ["mse"], "a title")
    assert table is not None
    assert [cell.text for cell in table.rows[1][1][1:3]] == ["–", "–"]


def test_budgets_in_seconds_alone_have_no_empty_axes(tmp_path: Path) -> None:
    budget = suite.Budget("seconds", 2.0)
    for budgets, said in (((budget,), "MSE against seconds;"), ((suite.Budget("spp", 4.0),), "MSE against samples")):
        scene = dataclasses.replace(SUITE.scenes[0], budgets=budgets)
        one = dataclasses.replace(SUITE, scenes=(scene,), methods=SUITE.methods[:1], seeds=1)
        row = {**made("PT", 1, 0.1, 0.0), "budget": str(budgets[0])}
        plot = plots.error_plot(results.Results(tmp_path, one, [row], 0), scene, "mse")
        assert plot is not None
        assert plot.caption.startswith(said)


@pytest.mark.parametrize(
    ("value", "text", "in_powers"),
    [
        (0.012, "0.0120", "0.0120"),
        (9.999, "10.0", "10.0"),
        (1234.0, "1234", "1234"),
        (-0.5, "-0.500", "-0.500"),
        (0.0, "0", "0"),
        (3.456e-7, "0.000000346", "3.46·10⁻⁷"),
        (2e6, "2000000", "2.00·10⁶"),
        (float("nan"), "nan", "nan"),
    ],
)
def test_numbers_have_three_figures(value: float, text: str, in_powers: str) -> None:
    assert figures.rounded(value) == text
    assert figures.number(value) == in_powers


@pytest.mark.parametrize(
    ("low", "high", "at"),
    [
        (16.0, 64.0, [20.0, 50.0]),
        (0.34, 2.2, [0.5, 1.0, 2.0]),
        (0.3, 0.4, [0.2, 0.5]),
        (1.0, 1.0, [1.0]),
        (3.0, 3.0, [2.0, 5.0]),
        (1e-5, 1e-2, [1e-5, 1e-4, 1e-3, 1e-2]),
        (1e-12, 1e3, [1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 1.0, 100.0]),
    ],
)
def test_ticks_are_at_one_two_and_five(low: float, high: float, at: list[float]) -> None:
    assert figures.ticks(low, high) == at


def test_the_numbers_of_an_axis_have_one_form() -> None:
    assert figures.tick_labels([0.0005, 0.1, 20.0]) == ["0.0005", "0.1", "20"]
    assert figures.tick_labels([1e-6, 2e-5, 0.1]) == ["10⁻⁶", "2·10⁻⁵", "10⁻¹"]


def test_crops_that_the_suite_names(whole: Page) -> None:
    width, height = SIZE[0] - SIZE[0] // 2, SIZE[1] - SIZE[1] // 2
    assert f"Crop: {width}x{height} pixels from ({SIZE[0] // 2}, {SIZE[1] // 2}), a corner" in whole.text
    tiny = dataclasses.replace(
        SUITE.scenes[0], crops=(("all", (0.0, 0.0, 1.0, 1.0)), ("a point", (0.99, 0.9, 1.0, 0.91)))
    )
    assert pictures.named_crops(tiny, (3, 5, 3)) == [
        pictures.Crop(0, 0, 5, 3, "all"),
        pictures.Crop(4, 2, 1, 1, "a point"),
    ]


def test_crops_are_where_methods_differ_and_where_the_best_loses() -> None:
    reference = np.full((90, 120, 3), 0.5, dtype=np.float32)
    base, best = reference.copy(), reference.copy()
    base[10:20, 10:20] += 0.2  # the base is wrong in more of the image: the other one is the best
    base[60:70, 15:25] += 0.1
    best[60:65, 100:105] += 0.1
    crops = pictures.choose_crops({"base": base, "best": best}, "base", reference, 100.0)
    assert [crop.why.split(",")[0] for crop in crops] == [
        "where the methods differ most in thresholds",
        "where the baseline's error in thresholds is greatest",
        "where best is farthest behind the baseline in thresholds",
    ]
    for crop, (x, y) in zip(crops, ((15, 15), (20, 65), (102, 62)), strict=True):
        assert crop.left <= x < crop.left + crop.width
        assert crop.top <= y < crop.top + crop.height
        assert crop.of(reference).shape == (32, 32, 3)
    assert pictures.choose_crops({"base": reference}, "base", reference, 100.0) == []


def test_a_strategy_image_is_bright_enough_to_see() -> None:
    """Most pixels have a tenth of the samples of a few: by the square root they show at a third."""
    shares = np.full((20, 20, 3), 0.1, dtype=np.float32)
    shares[:, :2] = 1.0
    shares[0, 0] = 100.0
    shown = open_png(pictures.strategy(shares))
    assert shown[10, 10, 0] == round(255 * 0.1**0.5)
    assert shown[10, 1, 0] == 255


def test_limits_are_never_empty() -> None:
    assert plots.limits(np.zeros((4, 4)), log=True) == (0.5, 2.0)
    assert plots.limits(np.full((4, 4), 3.0)) == (2.5, 3.5)
    assert plots.limits(np.full((4, 4), np.nan)) == (0.5, 1.5)


def test_bias_of_a_black_tile_is_finite() -> None:
    replicates = np.array([[[0.0, 1.0]], [[0.0, 1.1]]])
    reference = np.array([[0.0, 1.0]])
    test = statistics.welch(replicates, reference, np.zeros((1, 2)), 2)
    np.testing.assert_allclose(plots.bias_percent(test, reference), [[0.0, 5.0]])
    assert np.isfinite(plots.bias_percent(test, np.zeros((1, 2)))).all()
