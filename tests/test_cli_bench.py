"""``pmc-sampler bench``: what it writes, what it says and what it refuses. Exact."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval import results

from pmc_sampler import adapters, cluster
from pmc_sampler.cli import main

pytestmark = pytest.mark.needs("OpenImageIO", "skimage", "pyarrow", "tomli_w", "h5py")

SUITE = """
name = "tiny"
about = "One scene that costs nothing."
size = [20, 16]
spp = [4]
seeds = 2
renderer = "lamp"
reference_spp = 32
baseline = "PT"
[[scene]]
name = "cornell-box"
[[method]]
name = "PT"
sampler = "uniform"
[[method]]
name = "PMC"
sampler = "pmc"
"""


class Lamp:
    """Lit one time in four; `stop` is the number of the batch, over all lamps, that a signal comes with."""

    takes_batch = True
    calls = 0
    stop: tuple[int, int] | None = None

    def __init__(self, size: tuple[int, int]) -> None:
        self.width, self.height = size

    def __call__(self, batch: Any) -> np.ndarray:
        Lamp.calls += 1
        if Lamp.stop is not None and Lamp.calls == Lamp.stop[0]:
            os.kill(os.getpid(), Lamp.stop[1])
        lit = (batch.scramble ^ (batch.index * np.uint32(0x9E3779B9))) * np.uint32(0x7FEB352D) < 2**30
        return np.repeat(np.where(lit, 4.0, 0.0)[:, None].astype(np.float32), 3, axis=1)


@pytest.fixture(autouse=True)
def lamp(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Lamp, "calls", 0)
    monkeypatch.setattr(Lamp, "stop", None)

    def load(renderer: str, scene: str, *, sampler: str, size: tuple[int, int]) -> Lamp:
        if renderer != "lamp":
            raise RuntimeError(f"the renderer {renderer!r} cannot run here: no light")
        return Lamp(size)

    monkeypatch.setattr(adapters, "load", load)
    monkeypatch.setattr(adapters, "version", lambda renderer: "1")
    Path("tiny.toml").write_text(SUITE)


WORDS = ["bench", "tiny.toml", "-o", "out", "--cache", "cache"]


def test_a_suite_is_run_once(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(WORDS) == 0
    out, err = capfd.readouterr()
    assert out.startswith("4 runs are in out, ")
    assert out.endswith("out/results.md is written.\n")
    lines = err.splitlines()  # one for each run, for standard error is no terminal here
    assert len(lines) == 4
    assert re.fullmatch(r"\d+%: cornell-box, 4spp, seed 1, PT: [\d.]+ s", lines[0])
    assert lines[-1].startswith("100%: ")
    assert sorted(os.listdir("out")) == ["images", "plan.json", "results.md", "runs", "suite.toml"]
    page = Path("out/results.md").read_text()
    assert "| PMC |" in page
    before = Lamp.calls
    assert main(WORDS) == 0
    assert Lamp.calls == before
    assert Path("out/results.md").read_text() == page
    # What was run can be run from the folder.
    assert main(["bench", "out/suite.toml", "-o", "again", "--cache", "cache"]) == 0
    one, other = results.load("out").rows, results.load("again").rows
    assert [(row["id"], row["mse"]) for row in one] == [(row["id"], row["mse"]) for row in other]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("batch", [3, 20])
def test_an_interrupt_leaves_what_can_be_resumed(
    number: int, batch: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """In the middle of the reference (16 batches), and of the runs."""
    monkeypatch.setattr(Lamp, "stop", (batch, number))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts its background without it
    try:
        assert main(WORDS) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capfd.readouterr().err.splitlines()[-1] == (
        "pmc-sampler bench: interrupted; out holds the runs until then, and the same command goes on from there."
    )
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    assert results.load("out").missing > 0
    kept = set(Path("out/runs").glob("*")) if batch > 17 else set()
    assert bool(kept) == (batch > 17)
    assert main(WORDS) == 0
    found = results.load("out")
    assert (len(found.done), found.missing) == (4, 0)
    assert kept < set(Path("out/runs").glob("*"))


def test_failed_runs_are_told_last(capfd: pytest.CaptureFixture[str]) -> None:
    Path("tiny.toml").write_text(
        SUITE.replace('renderer = "lamp"', "") + '[[scene]]\nname = "diffuse"\nrenderer = "candle"\n'
    )
    text = Path("tiny.toml").read_text().replace('name = "cornell-box"', 'name = "cornell-box"\nrenderer = "lamp"')
    Path("tiny.toml").write_text(text)
    assert main(WORDS) == 1
    out, err = capfd.readouterr()
    assert out.startswith("4 runs are in out")
    assert err.splitlines()[-2:] == [
        "diffuse cannot be measured: the renderer 'candle' cannot run here: no light",
        "pmc-sampler bench: 4 runs failed, the first (diffuse, PT): the renderer 'candle' cannot run here: no light",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("bench -o out quik", "no suite is called 'quik'"),
        ("bench -o out none.toml", "'none.toml' cannot be read"),
        ("bench -o out bad.toml", "'bad.toml': the suite: `seeds` is 'two'"),
        ("bench -o tiny.toml tiny.toml", "the output 'tiny.toml' is a file; name a folder"),
        ("bench -o tiny.toml/out tiny.toml", "cannot be written"),
        ("bench tiny.toml", "the following arguments are required: -o/--output"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(words: str, said: str, capfd: pytest.CaptureFixture[str]) -> None:
    Path("bad.toml").write_text(SUITE.replace("seeds = 2", 'seeds = "two"').replace('name = "tiny"', 'name = "bad"'))
    before = sorted(os.listdir())
    try:
        status = main(words.split())
    except SystemExit as error:
        status = error.code  # type: ignore[assignment]
    out, err = capfd.readouterr()
    assert status == 2
    assert out == ""
    assert said in err
    assert err.count("\n") == 1
    assert sorted(os.listdir()) == before


@pytest.mark.needs("distributed")
def test_no_cluster_is_said(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "TIMEOUT", "1s")
    assert main([*WORDS, "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:9'" in capfd.readouterr().err
    assert not Path("out").exists()
