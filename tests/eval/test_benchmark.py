"""The benchmark of samplers: nothing runs twice, nothing is lost, and the page says what the rows say."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from pmc_sampler.eval import benchmark, results

from pmc_sampler import Config

pytestmark = pytest.mark.needs("skimage", "flip_evaluator")

METHODS = (benchmark.BASELINE, benchmark.STRATIFIED, benchmark.Method("default", lambda w, h: Config(), "sobol"))
PLAN = benchmark.Plan(scenes=("one", "two"), width=24, height=20, spp=4, seeds=2, reference_spp=64, methods=METHODS)


class Loader:
    """Counts batches over all renderers that it hands out."""

    def __init__(self, noisy: type, fail_after: int | None = None) -> None:
        self.noisy, self.left = noisy, fail_after
        self.renderers: list[Any] = []

    def __call__(self, scene: str, sampler: str) -> Any:
        renderer = self.noisy(24, 20)
        self.renderers.append(renderer)
        if self.left is not None:
            renderer.fail_after = self.left
        return renderer


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder and cache of a finished benchmark."""
    return tmp_path_factory.mktemp("benchmark")


@pytest.fixture
def rows(finished: Path, noisy: type) -> list[dict[str, Any]]:
    return benchmark.run(PLAN, Loader(noisy), benchmark.Rows(finished / "rows.jsonl"), cache=finished / "cache")


def test_every_run_is_one_row(rows: list[dict[str, Any]], finished: Path) -> None:
    assert {(row["scene"], row["method"], row["seed"]) for row in rows} == {
        (scene, method.name, seed) for scene in PLAN.scenes for method in METHODS for seed in (1, 2)
    }
    lines = (finished / "rows.jsonl").read_text().splitlines()
    assert len(lines) == len(rows) == 12
    for row in rows:
        assert row["samples"] == 4 * 24 * 20
        assert row["rejected"] == 0
        assert set(row["seconds"]) == {"total", "renderer", "sampler"}
        assert row["mse"] > 0
        assert row["reference"]["mse"] > 0


def test_seeds_are_interleaved(rows: list[dict[str, Any]], finished: Path) -> None:
    """In the order of running each seed has all methods before the next begins, and starts with another."""
    order = [json.loads(line) for line in (finished / "rows.jsonl").read_text().splitlines()]
    assert [row["seed"] for row in order[:6]] == [1, 1, 1, 2, 2, 2]
    assert order[0]["method"] != order[3]["method"]


def test_a_finished_benchmark_runs_nothing(rows: list[dict[str, Any]], finished: Path, noisy: type) -> None:
    loader = Loader(noisy)
    before = (finished / "rows.jsonl").read_bytes()
    again = benchmark.run(PLAN, loader, benchmark.Rows(finished / "rows.jsonl"), cache=finished / "cache")
    assert again == rows
    assert loader.renderers == []
    assert (finished / "rows.jsonl").read_bytes() == before


@pytest.mark.parametrize("kept", [0, 5])
def test_an_interrupted_benchmark_runs_what_is_missing(
    kept: int, rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path
) -> None:
    """The last row was torn by the interruption: it is cut off and its run repeated, the others are kept."""
    lines = (finished / "rows.jsonl").read_text().splitlines(keepends=True)
    path = tmp_path / "rows.jsonl"
    path.write_text("".join(lines[:kept]) + lines[kept][:50])
    said: list[str] = []
    again = benchmark.run(PLAN, Loader(noisy), benchmark.Rows(path), cache=finished / "cache", log=said.append)
    assert len([line for line in said if "tvi error" in line]) == 12 - kept
    assert path.read_text().splitlines(keepends=True)[:kept] == lines[:kept]
    for one, other in zip(again, rows, strict=True):
        for name in ("id", "mse", "tvi_error", "bias"):
            assert one[name] == other[name]


def test_rows_of_other_code_are_not_taken(
    rows: list[dict[str, Any]], finished: Path, noisy: type, tmp_path: Path
) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes((finished / "rows.jsonl").read_bytes())
    other = dataclasses.replace(PLAN, code="other")
    benchmark.run(other, Loader(noisy), benchmark.Rows(path), cache=finished / "cache")
    assert len(path.read_text().splitlines()) == 24


def test_the_fingerprint_is_of_contents(tmp_path: Path) -> None:
    file = tmp_path / "a.py"
    file.write_text("one")
    first = benchmark.fingerprint([file])
    assert benchmark.fingerprint([file]) == first
    assert benchmark.fingerprint() != first
    file.write_text("two")
    assert benchmark.fingerprint([file]) != first


def page(rows: list[dict[str, Any]]) -> str:
    return results.page(
        rows,
        [method.name for method in METHODS],
        benchmark.BASELINE.name,
        benchmark.STRATIFIED.name,
        command="make bench",
        versions={"mitsuba": "3.9.1"},
    )


def made(scene: str, method: str, seed: int, error: float, bias: float) -> dict[str, Any]:
    return {
        **{"scene": scene, "method": method, "seed": seed, "width": 4, "height": 3, "spp": 8, "code": "c0de"},
        **{"mse": error, "tvi_error": 2 * error, "bias": bias, "plain_bias": 2 * bias, "rejected": 1},
        "config": {"white_luminance": 100.0},
        "reference_spp": 64,
        "seconds": {"total": 2.0, "renderer": 1.5, "sampler": 0.1},
        "reference": {"mse": 1e-6, "tvi_error": 2e-6, "bias_error": 1e-4},
    }


def test_the_page_has_factors_intervals_and_biases() -> None:
    """Made rows: the default has half the error of each seed's baseline, whatever the seed's own error is."""
    rows = []
    for seed, error in ((1, 1.0), (2, 10.0), (3, 100.0)):
        rows += [
            made("one", METHODS[0].name, seed, error, 0.0),
            made("one", METHODS[1].name, seed, error / 2, 0.0),
            made("one", "default", seed, error / 8, 0.001 * seed),
        ]
    text = page(rows)
    (line,) = [line for line in text.splitlines() if line.startswith("| default")]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[2] == cells[4] == "8.00 (8.00 to 8.00)"
    assert cells[5] == cells[6] == "4.00 (4.00 to 4.00)"
    assert cells[7] == "+0.200 ± 0.058"
    assert cells[9:] == ["2.00", "75.0 %", "5.0 %"]
    (base,) = [line for line in text.splitlines() if line.startswith(f"| {METHODS[0].name} ")]
    assert "| 1 |" in base
    assert "`make bench`" in text
    assert "4x3 pixels, 8 samples per pixel, 3 seeds" in text
    assert "mitsuba 3.9.1" in text
    assert "9 samples were rejected" in text


def test_the_page_of_real_rows(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    text = page(rows)
    assert text.count("## ") == 2
    # Every line of a table has as many cells as its head.
    bars = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert bars == {13}
    results.write(tmp_path / "results.md", text)
    assert (tmp_path / "results.md").read_text() == text
    assert [file.name for file in tmp_path.iterdir()] == ["results.md"]
