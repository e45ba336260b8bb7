"""Runs on a Dask cluster of two worker processes: the same rows as in this process, whatever happens to a worker."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pmc_sampler.eval import benchmark, executors, images, results, suite

from pmc_sampler import Budget, Config, Sampler, render
from pmc_sampler import cluster as clusters
from pmc_sampler.cli import main

pytestmark = pytest.mark.needs("skimage", "pyarrow", "tomli_w", "OpenImageIO", "distributed")

SUITE = suite.parse(
    {
        "name": "test",
        "about": "A scene that costs nothing.",
        "size": [24, 20],
        "spp": [4, 8],
        "seeds": 2,
        "renderer": "lamp",
        "reference_spp": 32,
        "baseline": "PT",
        "scene": [{"name": "cornell-box"}],
        "method": [{"name": "PT", "sampler": "uniform"}, {"name": "PMC", "sampler": "pmc"}],
    }
)

# A module of its own, which workers can import. A worker whose renderer finds a file `once` beside the module takes it
# away and kills itself in the middle of the run; where there is a file `always`, each does.
LAMP = """
import os, signal
from pathlib import Path
import numpy as np

HERE = Path(__file__).parent

class Lamp:
    takes_batch = True
    def __init__(self, size):
        self.width, self.height = size
    def dies(self):
        if (HERE / "always").exists():
            return True
        try:
            (HERE / "once").unlink()
        except FileNotFoundError:
            return False
        return True
    def __call__(self, batch):
        if os.getpid() != int((HERE / "parent").read_text()) and self.dies():
            os.kill(os.getpid(), signal.SIGKILL)
        lit = (batch.scramble ^ (batch.index * np.uint32(0x9E3779B9))) * np.uint32(0x7FEB352D) < 2**30
        value = np.where(lit, 4.0, 0.0) * (0.1 + batch.positions[:, 0] / self.width)
        return np.repeat(value[:, None].astype(np.float32), 3, axis=1)

def load(renderer, scene, sampler, size):
    return Lamp(size)

def version(renderer):
    return "1"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the renderer's module is, importable here and in processes that are started."""
    import os

    path = tmp_path_factory.mktemp("lamp")
    (path / "lamp_of_test.py").write_text(LAMP)
    (path / "parent").write_text(str(os.getpid()))
    sys.path.insert(0, str(path))
    yield path
    sys.path.remove(str(path))
    sys.modules.pop("lamp_of_test", None)


def workers() -> Any:
    """Two worker processes of one thread each, and their scheduler."""
    import distributed

    return distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    )


@pytest.fixture(scope="module")
def cluster(folder: Path) -> Iterator[Any]:
    with workers() as made:
        yield made


@pytest.fixture(scope="module")
def alone(folder: Path) -> list[dict[str, Any]]:
    """The rows as one process makes them."""
    run(folder, folder / "alone", executors.in_process)
    return numbers(folder / "alone")


def run(folder: Path, out: Path, execute: Any) -> None:
    import importlib

    lamp = importlib.import_module("lamp_of_test")
    renderers = benchmark.Renderers(lamp.load, lamp.version)
    benchmark.run(SUITE, results.Folder(out), renderers, cache=folder / "cache", execute=execute)


def numbers(out: Path) -> list[dict[str, Any]]:
    """All of the rows but times."""
    timed = ("seconds", "started")
    return [
        {name: value for name, value in row.items() if name.split(".")[0] not in timed}
        for row in results.load(out).rows
    ]


def test_two_workers_make_the_rows_of_one_process(
    folder: Path, cluster: Any, alone: list[dict[str, Any]], tmp_path: Path
) -> None:
    with executors.on_cluster(cluster.scheduler_address) as execute:
        run(folder, tmp_path, execute)
    assert numbers(tmp_path) == alone
    assert len(alone) == 8
    for path in sorted((folder / "alone" / "images").rglob("*.exr")):
        other = images.read(tmp_path / path.relative_to(folder / "alone"))
        assert (other.rgb == images.read(path).rgb).all()


def test_a_worker_killed_in_mid_run_loses_nothing(
    folder: Path, cluster: Any, alone: list[dict[str, Any]], tmp_path: Path
) -> None:
    (folder / "once").touch()
    with executors.on_cluster(cluster.scheduler_address) as execute:
        run(folder, tmp_path, execute)
    assert not (folder / "once").exists()  # one was killed
    assert numbers(tmp_path) == alone


def test_batches_of_one_render_go_to_the_workers(folder: Path, cluster: Any) -> None:
    """The same bits as in one process, a worker that is killed in mid-batch included."""
    import importlib

    from pmc_sampler.adapters.cluster import ClusterRenderer

    lamp = importlib.import_module("lamp_of_test")
    here = lamp.load("lamp", "here", "sobol", (160, 120))
    alone = render(here, 160, 120, Budget(spp=6), Config(), seed=3).film.mean
    with ClusterRenderer(
        cluster.scheduler_address, lamp.load, "lamp", "here", sampler="sobol", size=(160, 120)
    ) as radiance:
        assert (radiance.width, radiance.height) == (160, 120)
        (folder / "once").touch()
        made = render(radiance, 160, 120, Budget(spp=6), Config(), seed=3).film.mean
    assert not (folder / "once").exists()
    assert (made == alone).all()


def test_a_cluster_without_workers_keeps_what_was_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All workers go after three batches. No batch waits for ever, what was told stays, and another renderer goes on
    to the same bits.
    """
    import importlib

    from pmc_sampler.adapters import cluster as adapter

    monkeypatch.setattr(adapter, "PATIENCE", 0.5)
    monkeypatch.setattr(adapter, "_LOOK", 0.3)
    lamp = importlib.import_module("lamp_of_test")
    here = lamp.load("lamp", "here", "sobol", (80, 60))
    sampler = Sampler(80, 60, Budget(spp=6), Config(), seed=3)
    with (
        workers() as made,
        adapter.ClusterRenderer(made.scheduler_address, lamp.load, "lamp", "h", sampler="sobol", size=(80, 60)) as far,
    ):

        def radiance(batch: Any) -> Any:
            if sampler.spp == 3.0:
                made.scale(0)
                made.sync(made._correct_state)
            return far(batch)

        with pytest.raises(clusters.ClusterError, match="no worker of the Dask cluster is left"):
            sampler.run(as_batch(radiance))
    assert sampler.spp == 3.0
    sampler.run(here)
    assert (sampler.film.mean == render(here, 80, 60, Budget(spp=6), Config(), seed=3).film.mean).all()


def as_batch(function: Any) -> Any:
    """The function as a renderer that takes batches."""
    function.takes_batch = True
    return function


@pytest.mark.needs("pyopencl", "mitsuba")
def test_the_command_renders_on_the_workers(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["render", "diffuse", "--size", "96x72", "--spp", "4"]
    assert main([*words, "-o", str(tmp_path / "here.exr")]) == 0
    assert main([*words, "-o", str(tmp_path / "there.exr"), "--scheduler", cluster.scheduler_address]) == 0
    here, there = (images.read(tmp_path / f"{name}.exr") for name in ("here", "there"))
    assert (here.rgb == there.rgb).all()
    assert (here.layers["samples"] == there.layers["samples"]).all()
    monkeypatch.setattr(clusters, "TIMEOUT", "1s")
    capsys.readouterr()
    assert main([*words, "-o", str(tmp_path / "none.exr"), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
    assert main([*words, "-o", str(tmp_path / "none.exr"), "--scheduler", "foo"]) == 2
    assert "'foo' is no address of a Dask scheduler; give one such as tcp://host:8786" in capsys.readouterr().err
    assert not (tmp_path / "none.exr").exists()


@pytest.mark.long
def test_runs_that_kill_their_worker_are_recorded(folder: Path, tmp_path: Path) -> None:
    import dask

    (folder / "always").touch()
    try:
        with (
            dask.config.set({"distributed.scheduler.allowed-failures": 0}),
            workers() as cluster,
            executors.on_cluster(cluster.scheduler_address) as execute,
        ):
            run(folder, tmp_path, execute)
    finally:
        (folder / "always").unlink()
    found = results.load(tmp_path)
    assert (found.missing, len(found.failed)) == (0, 8)
    assert all("Attempted to run task" in row["error"] for row in found.failed)


def test_no_scheduler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "TIMEOUT", "1s")
    with (
        pytest.raises(clusters.ClusterError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'.*dask scheduler"),
        executors.on_cluster("tcp://127.0.0.1:9"),
    ):
        pass


def test_calls_come_in_order_in_this_process() -> None:
    assert list(executors.in_process(lambda shared, k: shared + k, 10, [1, 2])) == [(0, 11), (1, 12)]
