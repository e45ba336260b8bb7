"""Runs on a Dask cluster of two worker processes: the same rows as in this process, whatever happens to a worker."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pmc_sampler.eval import benchmark, executors, images, results, suite

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

# A module of its own, which workers can import. Renderers whose folder has a file `fatal` kill their process by their
# second batch; the file is taken away first, unless it says that they always do.
LAMP = """
import os, signal
from pathlib import Path
import numpy as np

HERE = Path(__file__).parent

class Lamp:
    takes_batch = True
    def __init__(self, size):
        self.width, self.height = size
        self.calls = 0
    def __call__(self, batch):
        self.calls += 1
        fatal = HERE / "fatal"
        if os.getpid() != int((HERE / "parent").read_text()) and self.calls == 2 and fatal.exists():
            with open(HERE / "killed", "a") as stream:
                stream.write(f"{os.getpid()}\\\\n")
            if fatal.read_text() != "always":
                fatal.unlink()
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
    (path / "lamp_of_test.py").write_text(LAMP.replace("\\\\", "\\"))
    (path / "parent").write_text(str(os.getpid()))
    sys.path.insert(0, str(path))
    yield path
    sys.path.remove(str(path))
    sys.modules.pop("lamp_of_test", None)


@pytest.fixture(scope="module")
def cluster(folder: Path) -> Iterator[Any]:
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as made:
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
    # Renderers of earlier tests are kept by the workers and are past their second batch.
    cluster_workers = list(cluster.workers.values())
    assert len(cluster_workers) == 2
    with executors.on_cluster(cluster.scheduler_address) as execute:
        restart(cluster)
        (folder / "fatal").write_text("once")
        run(folder, tmp_path, execute)
    assert not (folder / "fatal").exists()  # one was killed
    assert (folder / "killed").read_text().count("\n") >= 1
    (folder / "killed").unlink()
    assert numbers(tmp_path) == alone


@pytest.mark.long
def test_runs_that_kill_every_worker_are_recorded(folder: Path, cluster: Any, tmp_path: Path) -> None:
    restart(cluster)
    (folder / "fatal").write_text("always")
    try:
        with executors.on_cluster(cluster.scheduler_address) as execute:
            run(folder, tmp_path, execute)
    finally:
        (folder / "fatal").unlink()
    found = results.load(tmp_path)
    assert (found.missing, len(found.failed)) == (0, len(found.rows))
    assert all("lost" in row["error"] or "died" in row["error"] for row in found.failed)


def restart(cluster: Any) -> None:
    """New worker processes, whose renderers have done nothing."""
    import distributed

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        client.restart()


def test_no_scheduler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "TIMEOUT", "1s")
    with (
        pytest.raises(
            executors.ClusterError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'.*dask scheduler"
        ),
        executors.on_cluster("tcp://127.0.0.1:9"),
    ):
        pass


def test_calls_come_in_order_in_this_process() -> None:
    assert list(executors.in_process(lambda shared, k: shared + k, 10, [1, 2])) == [(0, 11), (1, 12)]
