"""The benchmark: nothing runs twice, nothing is lost, and a row says what was run. Exact, but for times."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from pmc_sampler.eval import benchmark, images, markdown, measures, metrics, references, results, suite

from pmc_sampler import Budget, Config, Sampler, render

pytestmark = pytest.mark.needs("skimage", "pyarrow", "tomli_w", "OpenImageIO")

SIZE = (24, 20)
SUITE = suite.parse(
    {
        "name": "test",
        "about": "Two scenes that cost nothing.",
        "size": list(SIZE),
        "spp": [4, 8],
        "seeds": 2,
        "renderer": "noisy",
        "reference_spp": 64,
        "baseline": "PT",
        "scene": [{"name": "cornell-box"}, {"name": "diffuse"}],
        "method": [
            {"name": "PT", "sampler": "uniform"},
            {"name": "PMC", "sampler": "pmc", "moves": 1},
        ],
    }
)
RUNS = 16


@dataclasses.dataclass(frozen=True, eq=False)
class Loader:
    """Gives renderers out, and counts them; `calls` of the scene in `fails` raise."""

    noisy: Callable[..., Any]
    fails: str = ""
    stop_after: int | None = None
    renderers: list[Any] = dataclasses.field(default_factory=list)

    def load(self, renderer: str, scene: str, *, sampler: str, size: tuple[int, int]) -> Any:
        assert renderer == "noisy"
        if scene == self.fails:
            raise RuntimeError(f"{scene} cannot\n be loaded")
        made = self.noisy(*size)
        self.renderers.append(made)
        return made

    def version(self, renderer: str) -> str:
        return "1.2"

    @property
    def hooks(self) -> benchmark.Renderers:
        return benchmark.Renderers(self.load, self.version)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished benchmark, and of its cache."""
    return tmp_path_factory.mktemp("benchmark")


@pytest.fixture
def rows(finished: Path, noisy: type) -> list[dict[str, Any]]:
    benchmark.run(SUITE, results.Folder(finished / "out"), Loader(noisy).hooks, cache=finished / "cache")
    return results.load(finished / "out").rows


def same(one: list[dict[str, Any]], other: list[dict[str, Any]]) -> None:
    """That two lists of rows agree in all but times and machine."""

    def numbers(row: dict[str, Any]) -> dict[str, Any]:
        return {
            name: value for name, value in row.items() if name.split(".")[0] not in ("seconds", "started", "machine")
        }

    assert [numbers(row) for row in one] == [numbers(row) for row in other]


def test_every_run_is_one_row(rows: list[dict[str, Any]], finished: Path) -> None:
    assert {(row["scene"], row["method"], row["budget"], row["seed"]) for row in rows} == {
        (scene.name, method.name, budget, seed)
        for scene in SUITE.scenes
        for method in SUITE.methods
        for budget in ("4spp", "8spp")
        for seed in (1, 2)
    }
    assert len(list((finished / "out" / "runs").iterdir())) == len(rows) == RUNS
    for row in rows:
        assert (row["samples"], row["spp"]) == (row["budget_value"] * SIZE[0] * SIZE[1], row["budget_value"])
        assert (row["width"], row["height"], row["rejected"], row["done"], row["error"]) == (*SIZE, 0, "spp", None)
        assert (row["suite"], row["renderer"], row["numbers"]) == ("test", "noisy", "sobol")
        assert row["seconds.total"] >= row["seconds.renderer"] + row["seconds.sampler"] > 0
        versions = json.loads(row["versions"])
        assert versions["noisy"] == "1.2"
        assert versions["code"] == benchmark.fingerprint()
        assert "cores" in row["machine"]


def test_a_row_measures_the_library_s_image(rows: list[dict[str, Any]], noisy: type, finished: Path) -> None:
    """Each figure of a row is that of the image which `render` makes, against the reference of the cache."""
    row = next(row for row in rows if (row["method"], row["seed"], row["budget"]) == ("PMC", 2, "8spp"))
    assert json.loads(row["settings"]) == {"sampler": "pmc", "moves": 1}
    assert json.loads(row["resolved"]) == Config(moves=1).resolved(row["width"], row["height"]).to_dict()
    film = render(noisy(*SIZE), *SIZE, Budget(spp=8), Config(moves=1), seed=2).film
    (reference, *_) = [references.load(path) for path in sorted((finished / "cache").iterdir())]
    x, r = film.mean, reference.mean
    assert row["mse"] == metrics.mse(x, r, reference_variance=reference.variance)
    assert row["tvi_error"] == metrics.tvi_error(x, r, reference_variance=reference.luminance_variance)
    assert row["ssim"] == metrics.ssim(x, r)
    assert (row["bias"], row["plain_bias"]) == (metrics.bias(x, r), metrics.bias(film.plain_mean, r))
    assert row["reference.mse"] == pytest.approx(reference.variance.mean(dtype=float))
    assert row["reference.spp"] == 64
    np.testing.assert_allclose(row["tiles"], measures.tiles(x), rtol=1e-12)
    assert np.shape(row["tiles"]) == (2, 2)
    assert row["limit.mse"] is None  # nobody knows the samples' variance


def test_the_first_seed_s_images_are_kept(rows: list[dict[str, Any]], noisy: type, finished: Path) -> None:
    found = results.load(finished / "out")
    path = found.image_path("diffuse", "PMC", "8spp")
    assert path == finished / "out" / "images" / "diffuse" / "pmc" / "8spp.exr"
    film = render(noisy(*SIZE), *SIZE, Budget(spp=8), Config(moves=1), seed=1).film
    image = images.read(path)
    np.testing.assert_array_equal(image.rgb, film.mean)
    assert {"samples", "error", "plain", "strategy"} <= set(image.layers)
    np.testing.assert_array_equal(image.layers["samples"], film.samples)
    assert image.metadata["pmc:seed"] == "1"
    reference = found.reference_path("diffuse")
    assert reference is not None
    assert images.read(reference).layers["luminance_variance"].shape == SIZE[::-1]
    assert len(list((finished / "out" / "images").rglob("*.exr"))) == 2 * (2 * 2 + 1)


def test_a_finished_benchmark_runs_nothing(rows: list[dict[str, Any]], finished: Path, noisy: type) -> None:
    loader = Loader(noisy)
    before = {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()}
    benchmark.run(SUITE, results.Folder(finished / "out"), loader.hooks, cache=finished / "cache")
    assert loader.renderers == []
    assert {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(("batches", "least"), [(0, 0), (3, 1), (13, 9)])
def test_an_interrupted_benchmark_runs_what_is_missing(
    batches: int, least: int, rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path
) -> None:
    """The interrupt comes in the middle of a run, after so many batches: that one is done again, no other is."""
    folder = results.Folder(tmp_path)
    left = batches

    class Stopping(noisy):  # type: ignore[misc,valid-type]
        def __call__(self, batch: Any) -> Any:
            nonlocal left
            if not left:
                raise KeyboardInterrupt
            left -= 1
            return super().__call__(batch)

    with pytest.raises(KeyboardInterrupt):
        benchmark.run(SUITE, folder, Loader(Stopping).hooks, cache=finished / "cache")
    cut = results.load(tmp_path)
    assert len(cut.rows) + cut.missing == RUNS
    assert least <= len(cut.rows) < RUNS
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*")}
    assert all(path.suffix == ".parquet" for path in kept)
    said: list[str] = []
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache", log=said.append)
    assert len(said) == cut.missing
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items())
    same(results.load(tmp_path).rows, rows)


def test_damaged_rows_are_named_and_done_again(
    rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path
) -> None:
    folder = results.Folder(tmp_path)
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache")
    path = sorted(tmp_path.glob("runs/*"))[3]
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(
        results.BadResultsError, match=rf"{path.name}' is damaged .*; delete it and the run is done again"
    ):
        results.load(tmp_path)
    said: list[str] = []
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache", log=said.append)
    assert len(said) == 2
    assert path.name in said[0]
    same(results.load(tmp_path).rows, rows)


def test_a_scene_that_fails_is_recorded_and_the_rest_goes_on(
    rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path
) -> None:
    folder = results.Folder(tmp_path)
    benchmark.run(SUITE, folder, Loader(noisy, fails="cornell-box").hooks, cache=finished / "cache")
    found = results.load(tmp_path)
    assert (len(found.done), len(found.failed), found.missing) == (8, 8, 0)
    assert {row["error"] for row in found.failed} == {"cornell-box cannot be loaded"}
    assert {row["scene"] for row in found.failed} == {"cornell-box"}
    text = markdown.page(found)
    assert text.count("cornell-box cannot be loaded") == 8
    assert "No run has finished." in text
    # What failed is tried again, and now it works.
    said: list[str] = []
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache", log=said.append)
    assert len(said) == 8
    same(results.load(tmp_path).rows, rows)


def test_a_run_that_fails_is_recorded_and_the_rest_goes_on(finished: Path, noisy: type, tmp_path: Path) -> None:
    """The renderer fails for batches of the second seed's pool, whatever the method; seed 1 is measured."""

    class Failing(noisy):  # type: ignore[misc,valid-type]
        def __call__(self, batch: Any) -> Any:
            if batch.number == 0 and tuple(batch.scramble[:2]) in second:
                raise ValueError("out of light")
            return super().__call__(batch)

    second = set()
    for settings in (Config.uniform(), Config(moves=1)):
        for spp in (4, 8):
            second.add(tuple(Sampler(*SIZE, Budget(spp=spp), settings, seed=2).ask().scramble[:2]))
    folder = results.Folder(tmp_path)
    benchmark.run(SUITE, folder, Loader(Failing).hooks, cache=finished / "cache")
    found = results.load(tmp_path)
    assert {(row["seed"], row["error"]) for row in found.rows} == {(1, None), (2, "out of light")}


def test_rows_of_other_code_are_not_taken(
    rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = results.Folder(tmp_path)
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache")
    monkeypatch.setattr(benchmark, "fingerprint", lambda: "other")
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache")
    assert len(list(tmp_path.glob("runs/*"))) == 2 * RUNS
    assert {json.loads(row["versions"])["code"] for row in results.load(tmp_path).rows} == {"other"}


def test_more_seeds_run_what_is_new(rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path) -> None:
    folder = results.Folder(tmp_path)
    benchmark.run(SUITE, folder, Loader(noisy).hooks, cache=finished / "cache")
    said: list[str] = []
    more = dataclasses.replace(SUITE, seeds=3)
    benchmark.run(more, folder, Loader(noisy).hooks, cache=finished / "cache", log=said.append)
    assert len(said) == RUNS // 2
    found = results.load(tmp_path)
    assert (len(found.rows), found.suite.seeds) == (24, 3)


def test_a_budget_in_seconds_is_recorded(noisy: type, tmp_path: Path) -> None:
    timed = dataclasses.replace(
        SUITE,
        scenes=tuple(
            dataclasses.replace(scene, budgets=(suite.Budget("seconds", 0.05),)) for scene in SUITE.scenes[:1]
        ),
        seeds=1,
    )
    benchmark.run(timed, results.Folder(tmp_path / "out"), Loader(noisy).hooks, cache=tmp_path)
    found = results.load(tmp_path / "out").rows
    assert len(found) == 2
    for row in found:
        assert (row["budget"], row["budget_kind"], row["budget_value"]) == ("0.05s", "seconds", 0.05)
        assert row["done"] == "seconds"
        assert row["seconds.total"] >= 0.05
        assert row["spp"] == row["samples"] / (SIZE[0] * SIZE[1]) > 0


def test_progress_goes_from_nought_to_one(noisy: type, tmp_path: Path) -> None:
    seen: list[float] = []
    benchmark.run(
        SUITE,
        results.Folder(tmp_path / "out"),
        Loader(noisy).hooks,
        cache=tmp_path,
        progress=lambda fraction, note: seen.append(fraction),
    )
    assert seen[0] < 0.1
    assert seen[-1] == 1.0
    assert all(0.0 <= fraction <= 1.0 for fraction in seen)


def test_files_can_be_read_as_one_table(rows: list[dict[str, Any]], finished: Path) -> None:
    """Without this package: every file has the same types."""
    table = pq.read_table(finished / "out" / "runs")
    assert table.num_rows == RUNS
    assert {"mse", "seconds.total", "settings"} <= set(table.column_names)


def test_the_fingerprint_is_of_contents(tmp_path: Path) -> None:
    file = tmp_path / "a.py"
    file.write_text("one")
    first = benchmark.fingerprint([file])
    assert benchmark.fingerprint([file]) == first
    assert benchmark.fingerprint() != first
    file.write_text("two")
    assert benchmark.fingerprint([file]) != first


def test_no_results_are_refused(tmp_path: Path) -> None:
    with pytest.raises(results.BadResultsError, match="holds no results"):
        results.load(tmp_path)


def made(method: str, seed: int, budget: str, error: float, bias: float) -> dict[str, Any]:
    return {
        **{"scene": "cornell-box", "method": method, "seed": seed, "width": 4, "height": 3, "spp": float(budget[:-3])},
        **{"mse": error, "tvi_error": 2 * error, "bias": bias, "plain_bias": 2 * bias, "rejected": 1, "error": None},
        **{"budget": budget, "renderer": "noisy", "versions": '{"noisy": "1.2"}', "machine": "one core"},
        **{"seconds.total": 2.0, "seconds.renderer": 1.5, "seconds.sampler": 0.1},
        **{"reference.mse": 1e-6, "reference.tvi_error": 2e-6, "reference.bias": 1e-4, "reference.spp": 64},
        **{"limit.mse": error / 10, "limit.tvi_error": error / 5},
    }


SCALES = {"mse": 1.0, "tvi_error": 2.0}


def test_the_page_has_factors_intervals_biases_and_slopes(tmp_path: Path) -> None:
    """Made rows: PMC has an eighth of the error of each seed's PT, whatever that seed's error is."""
    rows = []
    for seed, error in ((1, 1.0), (2, 10.0), (3, 100.0)):
        for budget, less in (("4spp", 1.0), ("8spp", 0.25)):
            rows += [made("PT", seed, budget, less * error, 0.0)]
            rows += [made("PMC", seed, budget, less * error / 8, 0.001 * seed)]
    one_scene = dataclasses.replace(SUITE, scenes=SUITE.scenes[:1], seeds=3)
    text = markdown.page(results.Results(tmp_path / "out", one_scene, rows, 2))
    head = next(line for line in text.splitlines() if line.startswith("| method"))
    lines = [line for line in text.splitlines() if line.startswith("| PMC")]
    assert len(lines) == 2
    cells = dict(
        zip(*([cell.strip() for cell in line.strip("|").split("|")] for line in (head, lines[0])), strict=True)
    )
    assert cells["MSE factor"] == cells["tvi error factor"] == "8.00 (8.00 to 8.00)"
    assert cells["MSE"] == "1.25"
    assert cells["limit reached: MSE"] == cells["limit reached: tvi error"] == "10%"
    assert cells["bias %"] == "+0.200 ± 0.058"
    assert (cells["seconds"], cells["renderer"], cells["sampler"]) == ("2.00", "75.0 %", "5.0 %")
    assert "PMC -2.00 (-2.00 to -2.00)" in text
    least = "MSE *PMC*, and *PT*, the next, 8.00 (8.00 to 8.00) times as much"
    assert text.count(f"Least: {least}; {least.replace('MSE', 'tvi error')}, seed by seed.") == 2
    assert "2 runs are missing" in text
    assert "`pmc-sampler bench out/suite.toml -o out`" in text
    assert "12 samples were rejected" in text


def test_no_error_at_all_is_a_dash(tmp_path: Path) -> None:
    """As of a recording whose every sample was drawn: there is nothing to divide by."""
    rows = [made(*of, 1.0 if of[0] == "PT" else 0.0, 0.0) for of in (("PT", 1, "4spp"), ("PMC", 1, "4spp"))]
    one_scene = dataclasses.replace(SUITE, scenes=SUITE.scenes[:1], seeds=1)
    text = markdown.page(results.Results(tmp_path / "out", one_scene, rows, 0))
    (line,) = (line for line in text.splitlines() if line.startswith("| PMC"))
    assert line.startswith("| PMC | 0 | – | 0 | – | – | – |")


def test_no_more_error_than_the_references_is_a_dash(tmp_path: Path) -> None:
    """Neither a factor nor a least error is made of what subtracting left below nought."""
    rows = [made(*of, 1.0 if of[0] == "PT" else -0.01, 0.0) for of in (("PT", 1, "4spp"), ("PMC", 1, "4spp"))]
    one_scene = dataclasses.replace(SUITE, scenes=SUITE.scenes[:1], seeds=1)
    text = markdown.page(results.Results(tmp_path / "out", one_scene, rows, 0))
    (line,) = (line for line in text.splitlines() if line.startswith("| PMC"))
    assert line.startswith("| PMC | -0.01 | – | -0.02 | – | – | – |")
    assert "Least:" not in text
    assert "of so few seeds" in text


@pytest.mark.parametrize(("deviations", "factor"), [(0.2, "8.00 (8.00 to 8.00)"), (0.4, "–")])
def test_an_error_within_what_the_references_noise_leaves_is_a_dash(
    tmp_path: Path, deviations: float, factor: str
) -> None:
    """At most three standard deviations: 1/8 and 2/8 are five or two and a half of them."""
    rows = [made(*of, 1.0 if of[0] == "PT" else 0.125, 0.0) for of in (("PT", 1, "4spp"), ("PMC", 1, "4spp"))]
    for row in rows:
        row |= {f"reference.{name}.deviation": deviations * 0.125 * scale for name, scale in SCALES.items()}
    one_scene = dataclasses.replace(SUITE, scenes=SUITE.scenes[:1], seeds=1)
    text = markdown.page(results.Results(tmp_path / "out", one_scene, rows, 0))
    (line,) = (line for line in text.splitlines() if line.startswith("| PMC"))
    assert line.startswith(f"| PMC | 0.125 | {factor} | 0.25 | {factor} |")
    assert ("Least:" in text) == (factor != "–")
    assert f"; the standard deviation of what that leaves: MSE {0.125 * deviations:.2g}, tvi error" in text


def test_the_deviation_of_what_the_references_noise_leaves() -> None:
    """By simulation: 4000 references of 5 replicates with normal noise, of which the true image is the test.

    The standard deviation of 4000 values near to normal is known to about 1.3 %: 6 % is over four standard errors.
    With the variance's own error or its square's bias forgotten it would be 11 % or 22 % off.
    """
    rng = np.random.default_rng(8)
    true = rng.uniform(0.1, 2.0, (8, 8, 1)) * np.ones(3)
    spread = true[..., :1] * rng.uniform(0.01, 0.1, (8, 8, 1))  # grey: the channels are as one
    errors: dict[str, list[float]] = {"mse": [], "tvi_error": []}
    told: dict[str, list[float]] = {"mse": [], "tvi_error": []}
    for _ in range(4000):
        replicates = true + spread * rng.standard_normal((5, 8, 8, 1))
        variance = (replicates.var(axis=0, ddof=1) / 5).astype(np.float32)
        mean = replicates.mean(axis=0).astype(np.float32)
        reference = references.Reference(mean, variance, variance[..., 0], 5, 5, 0, 0.0, "made")
        noise = measures.reference_noise(reference, 100.0)
        for name, found in measures.measure(true, reference, 100.0, errors).items():
            errors[name].append(found)
            told[name].append(noise[f"{name}.deviation"])
    for name, values in errors.items():
        assert np.std(values) == pytest.approx(np.sqrt(np.mean(np.square(told[name]))), rel=0.06)


def test_a_renderer_that_hangs_fails_its_runs(noisy: type, tmp_path: Path) -> None:
    """The runs of one scene; those of the other go on."""

    class Hanging(noisy):  # type: ignore[misc]
        def __call__(self, batch: Any) -> Any:
            if self.hangs:
                time.sleep(3.0)
            return super().__call__(batch)

    def load(renderer: str, scene: str, *, sampler: str, size: tuple[int, int]) -> Any:
        made = Hanging(*size)
        made.hangs = scene == SUITE.scenes[1].source
        return made

    hooks = benchmark.Renderers(load, lambda renderer: "1")
    benchmark.run(SUITE, results.Folder(tmp_path / "out"), hooks, cache=tmp_path / "cache", timeout=1.0)
    found = results.load(tmp_path / "out")
    assert {row["scene"] for row in found.failed} == {SUITE.scenes[1].name}
    assert {row["error"] for row in found.failed} == {"the renderer gave no answer within 1 s"}
    assert {row["scene"] for row in found.done} == {SUITE.scenes[0].name}


def test_a_worker_with_other_code_is_refused(noisy: type, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(benchmark, "_own_code", lambda: "other")
    benchmark.run(SUITE, results.Folder(tmp_path / "out"), Loader(noisy).hooks, cache=tmp_path / "cache")
    found = results.load(tmp_path / "out")
    assert found.done == []
    assert "other code than the process that began" in found.failed[0]["error"]


def test_a_folder_has_one_suite(rows: list[dict[str, Any]], finished: Path, noisy: type) -> None:
    other = dataclasses.replace(SUITE, name="another")
    with pytest.raises(results.BadResultsError, match=r"holds results of the suite .*: give 'another' another folder"):
        benchmark.run(other, results.Folder(finished / "out"), Loader(noisy).hooks, cache=finished / "cache")
    assert results.load(finished / "out").rows == rows


def test_an_image_of_another_run_is_made_again(noisy: type, tmp_path: Path) -> None:
    """Where a setting was changed and changed back, the row is there, and the image that of the other one."""
    loader, folder = Loader(noisy), results.Folder(tmp_path / "out")
    for white in (100.0, 200.0, 100.0):
        given = dataclasses.replace(SUITE, white_luminance=white, scenes=SUITE.scenes[:1])
        benchmark.run(given, folder, loader.hooks, cache=tmp_path / "cache")
        found = results.load(folder.path)
        for row in found.rows:
            if row["seed"] == 1:
                name = results.image_name(row["scene"], row["method"], row["budget"])
                assert folder.image_id(name) == row["id"]


def test_files_with_a_failed_run_are_one_table(noisy: type, tmp_path: Path) -> None:
    import pyarrow.parquet

    loader = Loader(noisy, fails=SUITE.scenes[1].source)
    benchmark.run(SUITE, results.Folder(tmp_path / "out"), loader.hooks, cache=tmp_path / "cache")
    table = pyarrow.parquet.read_table(tmp_path / "out" / "runs")
    assert any(table["error"].to_pylist())
    assert not all(table["error"].to_pylist())


def test_the_page_of_real_rows(rows: list[dict[str, Any]], finished: Path) -> None:
    text = markdown.page(results.load(finished / "out"))
    assert text.count("\n## ") == 2
    assert text.count("\n### ") == 4
    # Every line of a table has as many cells as its head.
    assert len({line.count("|") for line in text.splitlines() if line.startswith("|")}) == 1


def test_bias_is_tested_over_seeds(finished: Path, noisy: type, tmp_path: Path) -> None:
    """Over all 4 tiles together the unbiased method alarms falsely in one of 1000 such tests, and this seeded one does
    not. The negative control, a renderer that is half as bright, is found in every tile."""

    class Dark(noisy):  # type: ignore[misc,valid-type]
        def __call__(self, batch: Any) -> Any:
            return super().__call__(batch) * np.float32(0.5)

    uniform = dataclasses.replace(SUITE, methods=SUITE.methods[:1], scenes=SUITE.scenes[:1], seeds=8)
    found = []
    for name, kind in (("right", noisy), ("dark", Dark)):
        # The references are those of the right renderer in both.
        benchmark.run(uniform, results.Folder(tmp_path / name), Loader(kind).hooks, cache=finished / "cache")
        tested = results.load(tmp_path / name).welch("cornell-box", "PT", "8spp", alpha=0.001)
        assert tested is not None
        found.append(tested.biased)
    assert not found[0].any()
    assert found[1].all()


@pytest.mark.needs("h5py")
def test_a_recording_is_made_once_and_is_its_own_reference(noisy: type, tmp_path: Path) -> None:
    """The scene is rendered for the recording alone; the errors are against its exact mean, and the least is known."""
    given = SUITE.to_dict()
    given["scene"] = [{"name": "cornell-box", "size": list(SIZE), "spp": [8], "renderer": "noisy", "recorded_spp": 16}]
    given["method"].append({"name": "oracle", "sampler": "neyman", "numbers": "independent"})
    recorded = suite.parse(given)
    loader = Loader(noisy)
    benchmark.run(recorded, results.Folder(tmp_path / "out"), loader.hooks, cache=tmp_path)
    assert len(loader.renderers) == 1
    assert loader.renderers[0].calls == 16
    found = results.load(tmp_path / "out")
    assert len(found.done) == 6
    (path,) = tmp_path.glob("*.h5")
    recording = benchmark.Recording(path)
    for row in found.done:
        assert row["reference.mse"] == row["reference.tvi_error"] == row["reference.bias"] == 0.0
        # Of independent samples in proportion to their deviation s, the mean of s^2 / n is mean(s)^2 / 8.
        s = np.sqrt(recording.variance.mean(axis=2))
        assert row["limit.mse"] == pytest.approx(s.mean() ** 2 / 8)
    image = found.image_path("cornell-box", "PT", "8spp")
    assert image is not None
    assert (images.read(image).layers["samples"] == 8).all()
    assert "limit reached: tvi error" in markdown.page(found)
    # The file itself as a scene gives the same numbers.
    given["scene"] = [{"name": "cornell-box", "recording": str(path), "spp": [8]}]
    benchmark.run(suite.parse(given), results.Folder(tmp_path / "again"), loader.hooks, cache=tmp_path)
    assert len(loader.renderers) == 1
    again = results.load(tmp_path / "again").done
    assert [row["mse"] for row in again] == [row["mse"] for row in found.done]


def test_images_too_small_for_a_metric_are_refused() -> None:
    given = SUITE.to_dict()
    given["scene"][0]["size"] = [24, 10]
    with pytest.raises(suite.BadSuiteError, match="scene 'cornell-box' is 24x10 pixels, and ssim needs 11x11"):
        benchmark.check(suite.parse(given))
    given["metrics"] = ["mse"]
    benchmark.check(suite.parse(given))


def test_an_oracle_without_known_variances_is_refused() -> None:
    given = SUITE.to_dict()
    given["method"].append({"name": "oracle", "sampler": "neyman"})
    with pytest.raises(suite.BadSuiteError, match="method 'oracle' on scene 'cornell-box': neyman needs the variance"):
        benchmark.check(suite.parse(given))
