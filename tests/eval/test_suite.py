"""Suites: what a file means, and the sentence that each mistake in it gets. Exact."""

from __future__ import annotations

import copy
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pmc_sampler.eval import benchmark, suite

SMALL: dict[str, Any] = {
    "name": "small",
    "about": "A suite.",
    "size": [32, 24],
    "spp": [2, 4],
    "seconds": [0.5],
    "seeds": 3,
    "renderer": "opencl",
    "reference_spp": 64,
    "baseline": "PT",
    "scene": [{"name": "cornell-box"}, {"name": "diffuse", "size": [20, 10], "spp": [8], "seconds": []}],
    "method": [
        {"name": "PT", "sampler": "uniform"},
        {"name": "PT, independent", "sampler": "uniform", "numbers": "independent"},
        {
            "name": "PMC {eliminate} {moves}",
            "sampler": "pmc",
            "pool_share": 0.3,
            "sweep": {"eliminate": [0.2, 0.5], "moves": [1, 2]},
            "scenes": ["cornell-box"],
            "on": {"cornell-box": {"pool_share": 0.4}},
        },
    ],
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """The suite with what stands at a path such as "scene.0.name" changed; taken out for a value of `...`."""
    given = copy.deepcopy(SMALL)
    *above, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    table: Any = given
    for part in above:
        table = table[part]
    if value is ...:
        del table[last]
    else:
        table[last] = value
    return given


def test_what_a_suite_means() -> None:
    parsed = suite.parse(SMALL)
    box, diffuse = parsed.scenes
    assert (box.size, diffuse.size) == ((32, 24), (20, 10))
    assert [str(budget) for budget in box.budgets] == ["2spp", "4spp", "0.5s"]
    assert [str(budget) for budget in diffuse.budgets] == ["8spp"]
    names = [method.name for method in parsed.methods]
    assert names == ["PT", "PT, independent", "PMC 0.2 1", "PMC 0.2 2", "PMC 0.5 1", "PMC 0.5 2"]
    swept = parsed.methods[3]
    assert swept.settings == {"sampler": "pmc", "pool_share": 0.3, "eliminate": 0.2, "moves": 2}
    assert swept.settings_on("cornell-box")["pool_share"] == 0.4
    assert swept.settings_on("diffuse")["pool_share"] == 0.3
    assert {run.method.name for run in parsed.runs(diffuse)} == {"PT", "PT, independent"}


def test_a_suite_written_out_is_the_same(tmp_path: Path) -> None:
    """Nothing is left to other files: the settings of `config` are in it."""
    (tmp_path / "settings.toml").write_text("moves = 3\npool_share = 0.2\n")
    given = changed("method.1.config", "settings.toml")
    given["method"][1]["sampler"] = "pmc"
    given["method"][1]["pool_share"] = 0.5
    (tmp_path / "suite.toml").write_text(tomli_w.dumps(given))
    read = suite.read(tmp_path / "suite.toml")
    assert read.methods[1].settings == {"sampler": "pmc", "moves": 3, "pool_share": 0.5}
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "suite.toml").write_text(tomli_w.dumps(read.to_dict()))
    assert suite.read(tmp_path / "again" / "suite.toml") == read


def test_each_seed_has_every_method_before_the_next_begins() -> None:
    parsed = suite.parse(SMALL)
    order = list(parsed.runs(parsed.scenes[0]))
    assert [run.seed for run in order] == sorted(run.seed for run in order)
    assert Counter((run.method.name, str(run.budget), run.seed) for run in order) == Counter(
        (method.name, budget, seed)
        for method in parsed.methods
        for budget in ("2spp", "4spp", "0.5s")
        for seed in (1, 2, 3)
    )
    groups = [order[k : k + 6] for k in range(0, len(order), 6)]
    assert all(len({str(run.budget) for run in group}) == 1 for group in groups)
    # The methods of a budget begin with another one in each seed, and within one at each budget.
    first = {(run[0].seed, str(run[0].budget)): run[0].method.name for run in groups}
    assert len({first[seed, "2spp"] for seed in (1, 2, 3)}) == 3
    assert len({first[1, budget] for budget in ("2spp", "4spp", "0.5s")}) == 3


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("seeds", 0, "`seeds` is 0: expected a whole number from 1"),
        ("seeds", ..., "`seeds` is missing"),
        ("seedz", 2, "unknown key; a key is 'seedz'.*did you mean 'seeds'"),
        ("about", "", "`about` is ''"),
        ("metrics", ["mse", "msee"], "a metric is 'msee'.*did you mean 'mse'"),
        ("metrics", [], "metrics is \\[\\]"),
        ("baseline", "PTT", "baseline is 'PTT'.*did you mean 'PT'"),
        ("white_luminance", -1, "`white_luminance` is -1: expected a number above 0"),
        ("scene", [], "no scenes: expected one or more tables \\[\\[scene\\]\\]"),
        ("scene.0.name", "cornel-box", "no built-in scene is called 'cornel-box'.*write `file`"),
        ("scene.1.name", "cornell-box", "would share files"),
        ("scene.1.size", [20], "scene 'diffuse': `size` is \\[20\\]"),
        ("size", ..., "scene 'cornell-box': `size` is missing"),
        ("renderer", ..., "scene 'cornell-box': `renderer` is missing"),
        ("reference_spp", ..., "no `reference_spp`"),
        ("reference_noise", 0, "`reference_noise` is 0"),
        ("spp", [4, 0], "`spp` is 0: expected a number above 0"),
        ("spp", 4, "`spp` is 4: expected a list"),
        ("spp", [4, 4.0], "'4spp' and '4spp' would share files"),
        ("scene.1.spp", [], "scene 'diffuse' has no budget"),
        ("scene.0.options", 3, "options is 3"),
        ("scene.0.crops", 3, "crops is 3"),
        (
            "scene.0.crops",
            {"a": [0.5, 0, 0.4, 1]},
            "the crop 'a' is .*: expected left, top, right and bottom as shares",
        ),
        ("scene.0.crops", {"a": [0, 0, 1]}, "the crop 'a' is"),
        ("scene.0.recorded_spp", 0, "`recorded_spp` is 0: expected a whole number from 1"),
        ("scene.0.recorded_spp", 24, "`recorded_spp` is 24: expected a power of two"),
        ("method.0.numbers", "halton", "numbers is 'halton': expected one of sobol, independent"),
        ("method.0.sampler", ..., "method 'PT': `sampler` is missing"),
        ("method.1.name", "pt", "'PT' and 'pt' would share files"),
        ("method.1.name", "---", "no letter or digit"),
        ("method.2.name", "PMC {moves}", "would share files"),
        ("method.2.name", "PMC {survival}", "the name may hold \\{setting\\}"),
        ("method.2.sweep", {"moves": 2}, "sweep is .*: expected a table with a list"),
        ("method.2.scenes", ["room"], "scene is 'room'"),
        ("method.2.on", {"room": {"moves": 3}}, "scene is 'room'"),
        ("method.2.on", {"cornell-box": 3}, "on is .*tables"),
        ("method.0.config", "none.toml", "none.toml.* cannot be read"),
    ],
)
def test_each_mistake_has_its_sentence(path: str, value: Any, said: str, tmp_path: Path) -> None:
    file = tmp_path / "suite.toml"
    file.write_text(tomli_w.dumps(changed(path, value)))
    with pytest.raises(suite.BadSuiteError, match=f"suite.toml.*{said}"):
        suite.read(file)


def test_a_scene_that_no_method_runs_on() -> None:
    given = changed("baseline", "PMC 0.2 1")
    given["method"] = given["method"][2:]
    with pytest.raises(suite.BadSuiteError, match="no method runs on scene 'diffuse'"):
        suite.parse(given)


def test_files_that_are_no_suite(tmp_path: Path) -> None:
    with pytest.raises(suite.BadSuiteError, match=r"none\.toml.* cannot be read"):
        suite.read(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("name = ")
    with pytest.raises(suite.BadSuiteError, match=r"bad\.toml.* is no TOML"):
        suite.read(tmp_path / "bad.toml")
    with pytest.raises(suite.BadSuiteError, match=r"no suite is called 'quik'.*did you mean 'quick'"):
        suite.find("quik")


@pytest.mark.needs("skimage")
@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("method.0.sampler", "unifrom", "method 'PT' on scene 'cornell-box': .*unifrom"),
        ("method.2.pool_shar", 0.3, "method 'PMC 0.2 1' on scene 'cornell-box': .*pool_shar"),
        ("method.2.sweep.eliminate", [0.2, 1.5], "method 'PMC 1.5 1' on scene 'cornell-box': eliminate is 1.5"),
        ("scene.0", {"file": "none.xml"}, "scene 'none': there is no file .*none.xml"),
    ],
)
def test_what_no_sampler_takes_is_refused_before_rendering(path: str, value: Any, said: str) -> None:
    given = changed(path, value)
    if path == "scene.0":
        given["method"].pop()
    with pytest.raises(suite.BadSuiteError, match=said):
        benchmark.check(suite.parse(given))


@pytest.mark.needs("skimage")
@pytest.mark.parametrize("name", suite.shipped())
def test_shipped_suites_can_run(name: str) -> None:
    shipped = suite.read(suite.find(name))
    benchmark.check(shipped)
    assert shipped.name == name


def test_quick_is_shipped() -> None:
    assert "quick" in suite.shipped()
