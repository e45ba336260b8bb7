"""A renderer's own way to choose samples in a benchmark. Exact, but for times."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval import benchmark, images, markdown, results, suite

pytestmark = pytest.mark.needs("skimage", "pyarrow", "tomli_w", "OpenImageIO")

SIZE = (24, 20)
GIVEN: dict[str, Any] = {
    "name": "own",
    "about": "A renderer that has a way of its own.",
    "size": list(SIZE),
    "spp": [4],
    "seconds": [0.1],
    "seeds": 2,
    "renderer": "noisy",
    "reference_spp": 64,
    "baseline": "PT",
    "scene": [{"name": "diffuse"}],
    "method": [
        {"name": "PT", "sampler": "uniform"},
        {"name": "grid {depth}", "sampler": "native", "sweep": {"depth": [1, 2]}},
    ],
}


@pytest.fixture
def renderers(noisy: type) -> Any:
    """Renderers whose own image is the true one times its settings' `depth`, and takes 100 s for each."""

    class Own(noisy):  # type: ignore[misc]
        def native(self, *, depth: int) -> SimpleNamespace:
            return SimpleNamespace(
                mean=(depth * self.mean).astype(np.float32), samples=depth * 480, seconds=100.0 * depth
            )

    return benchmark.Renderers(lambda renderer, scene, *, sampler, size: Own(*size), lambda renderer: "1")


def test_native_methods_run_once_a_seed(renderers: Any, tmp_path: Path, noisy: type) -> None:
    made = suite.parse(GIVEN)
    assert [str(budget) for budget in made.budgets(made.scenes[0])] == ["4spp", "0.1s", "own"]
    benchmark.run(made, results.Folder(tmp_path), renderers, cache=tmp_path / "cache")
    found = results.load(tmp_path)
    assert not found.failed
    assert not found.missing
    for depth in (1, 2):
        rows = found.select("diffuse", f"grid {depth}", "own")
        assert [row["seed"] for row in rows] == [1, 2]
        for row in rows:
            assert (row["spp"], row["samples"], row["done"]) == (depth, depth * 480, "own")
            assert (row["seconds.total"], row["seconds.sampler"]) == (100 * depth, 0.0)
            assert row["bias"] == row["plain_bias"] == pytest.approx(depth - 1, abs=0.1)
        path = found.image_path("diffuse", f"grid {depth}", "own")
        assert path is not None
        np.testing.assert_array_equal(images.read(path).rgb, (depth * noisy(*SIZE).mean).astype(np.float32))
    assert len(found.select("diffuse", "PT", "4spp")) == 2
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*.parquet"))
    benchmark.run(made, results.Folder(tmp_path), renderers, cache=tmp_path / "cache")
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*.parquet")) == before


@pytest.mark.parametrize("native", [True, False])
def test_set_up_counts_where_it_does_in_the_native_method(renderers: Any, tmp_path: Path, native: bool) -> None:
    """A set-up that is longer than the budget leaves time for one batch; where no native method runs it is free."""

    def load(*names: str, **options: Any) -> Any:
        time.sleep(0.3)
        return renderers.load(*names, **options)

    given = {**GIVEN, "spp": [], "seconds": [0.25], "seeds": 1}
    if not native:
        given["method"] = given["method"][:1]
    slow = benchmark.Renderers(load, renderers.version)
    benchmark.run(suite.parse(given), results.Folder(tmp_path), slow, cache=tmp_path / "cache")
    (row,) = results.load(tmp_path).select("diffuse", "PT", "0.25s")
    if native:
        assert row["seconds.total"] >= row["seconds.setup"] >= 0.3
        assert row["samples"] == 4096, "one batch"
    else:
        assert row["seconds.setup"] == 0.0
        assert row["samples"] > 4096


def test_the_page_compares_at_no_more_cost(renderers: Any, tmp_path: Path) -> None:
    """Grids of one and two samples a pixel, said to take 100 and 200 s; uniform sampling takes four, or 0.1 s."""
    benchmark.run(suite.parse(GIVEN), results.Folder(tmp_path), renderers, cache=tmp_path / "cache")
    found = results.load(tmp_path)
    assert found.within("diffuse", "PT", 1e-9, "mse") == []
    assert found.within("diffuse", "PT", 3.9, "mse", "spp") == []
    assert {row["budget"] for row in found.within("diffuse", "PT", 4.0, "mse", "spp")} == {"4spp"}
    best = found.within("diffuse", "PT", 100.0, "mse")
    assert {row["budget"] for row in best} == {"0.1s"}, "it has more samples than 4 a pixel, and less error"
    tables = markdown.page(found).split("### The renderer's own")[1].split("\n\n")
    heads = [table.splitlines()[0] for table in tables if table.startswith("| the renderer's own")]
    assert ["in no more time" in head for head in heads] == [False, True, False]
    assert ["in no more samples" in head for head in heads] == [False, False, True]
    _, of_time, of_samples = (line for table in tables for line in table.splitlines() if line.startswith("| grid 2"))
    own = found.select("diffuse", "grid 2", "own")
    error = np.median([results.known(row, "mse") for row in best])
    ratio = f"{np.median([row['mse'] for row in own]) / error:.2f}" if error > 0 else "–"
    assert f"| {ratio} at 0.1s" in of_time
    assert "none costs as little" in of_samples


def test_what_has_no_way_of_its_own(renderers: Any, noisy: type, tmp_path: Path) -> None:
    """A renderer without one leaves failed rows; a recording is refused before anything runs."""
    plain = benchmark.Renderers(lambda renderer, scene, *, sampler, size: noisy(*size), lambda renderer: "1")
    benchmark.run(suite.parse(GIVEN), results.Folder(tmp_path), plain, cache=tmp_path / "cache")
    found = results.load(tmp_path)
    assert {row["error"] for row in found.failed} == {"the renderer 'noisy' has no sampling of its own"}
    assert len(found.failed) == 4
    assert len(found.done) == 4
    recorded = {**GIVEN, "recorded_spp": 8}
    with pytest.raises(suite.BadSuiteError, match="is the renderer's own: 'diffuse' is a recording"):
        benchmark.run(suite.parse(recorded), results.Folder(tmp_path / "other"), renderers, cache=tmp_path / "cache")
