"""Batches divided among processes that wait for them. Exact."""

from __future__ import annotations

import gc
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO")


@pytest.fixture
def pool(povray: Any, tmp_path: Path, clean: None, plain_camera: Any) -> Any:
    """A function that gives a pool for a scene's text, and one that gives rays for it."""
    from pmc_sampler.adapters.povray import source, worker
    from pmc_sampler.adapters.povray.ray_mesh import mesh_camera

    camera = povray.Camera("perspective", **plain_camera)
    made = []

    def make(text: str, processes: int = 2, timeout: float = 60.0) -> Any:
        file = tmp_path / "scene.pov"
        file.write_text(text)
        made.append(worker.Pool(source.of_file(file, (), (), timeout), processes))
        return made[-1]

    def rays(count: int) -> Callable[[int, int], str]:
        positions = np.random.default_rng(count).random((count, 2)) * 64
        return lambda first, last: mesh_camera(camera, 64, 64, positions[first:last])

    make.rays = rays  # type: ignore[attr-defined]
    yield make
    for one in made:
        one.close()


def test_values_depend_neither_on_room_nor_on_what_waits(
    pool: Any, noisy_text: str, running: Callable[[], list[str]]
) -> None:
    cold, warm = pool(noisy_text), pool(noisy_text)
    assert running() == []
    rays = pool.rays(9000)
    first = cold.trace(9000, rays)
    assert first.shape == (9000, 3)
    assert first.std() > 0.1
    assert warm.trace(12000, pool.rays(12000)).shape == (12000, 3)
    waiting = list(warm._waiting)
    assert [one.size for one in waiting] == [6000, 6000]
    assert warm.trace(9000, rays).tobytes() == first.tobytes()
    assert not set(waiting) & set(warm._workers)  # those it was that traced
    assert pool(noisy_text, processes=1).trace(9000, rays).tobytes() != first.tobytes()  # the negative control


def test_more_pieces_than_processes(pool: Any, plain_text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.povray import worker

    rays = pool.rays(1000)
    whole = pool(plain_text).trace(1000, rays)
    monkeypatch.setattr(worker, "_LARGEST", 340)
    divided = pool(plain_text)
    np.testing.assert_array_equal(divided.trace(1000, rays), whole)
    assert len(divided._workers) == len(divided._waiting) == 2


def test_nothing_is_started_for_nothing(pool: Any, plain_text: str, running: Callable[[], list[str]]) -> None:
    some = pool(plain_text)
    assert some.trace(0, pool.rays(1)).shape == (0, 3)
    assert running() == []


def test_what_waits_ends_with_the_pool(povray: Any, pool: Any, plain_text: str, tmp_path: Path, clean: None) -> None:
    from pmc_sampler.adapters.povray import source, worker

    some = worker.Pool(source.of_file(_written(tmp_path, plain_text), (), (), 60.0), 1)
    some.trace(10, pool.rays(10))
    assert len(some._waiting) == 1
    del some
    gc.collect()  # `clean` looks


@pytest.mark.long
def test_it_can_wait_for_long(pool: Any, plain_text: str) -> None:
    """Longer than the ten seconds after which a thread of POV-Ray's gives another up."""
    some = pool(plain_text, processes=1)
    first = some.trace(100, pool.rays(100))
    time.sleep(12)
    waiting = list(some._waiting)
    np.testing.assert_array_equal(some.trace(100, pool.rays(100)), first)
    assert waiting[0] not in some._workers


def test_one_that_dies_while_it_waits_is_replaced(pool: Any, plain_text: str) -> None:
    some = pool(plain_text, processes=1)
    first = some.trace(100, pool.rays(100))
    process = some._waiting[0]._process
    os.kill(process._process.pid, signal.SIGKILL)
    while not process.ended:
        pass
    np.testing.assert_array_equal(some.trace(100, pool.rays(100)), first)


def test_errors_leave_nothing(pool: Any, plain_text: str, tmp_path: Path, running: Callable[[], list[str]]) -> None:
    """Each with POV-Ray's words or ours, once rays are wanted; `clean` looks at what is left."""
    cases = [
        (
            plain_text + "\nsphere { Nothing }",
            ValueError,
            r"cannot render .*scene.pov: File '.*scene.pov' line 9: Parse",
        ),
        (plain_text + "\n#while (1) #end", TimeoutError, r"did not trace 10 rays of .*scene.pov within 1.5 seconds"),
    ]
    for text, kind, message in cases:
        some = pool(text, timeout=1.5)
        with pytest.raises(kind, match=message):
            some.trace(10, pool.rays(10))
        assert some._workers == some._waiting == []


def test_one_that_is_killed_while_it_traces(pool: Any, plain_text: str) -> None:
    some = pool(plain_text, processes=1)

    def rays(first: int, last: int) -> str:
        os.kill(some._workers[0]._process._process.pid, signal.SIGKILL)
        return str(pool.rays(10)(first, last))

    with pytest.raises(RuntimeError, match=r"ended by the signal SIGKILL \(out of memory\?\) while it traced"):
        some.trace(10, rays)
    assert some.trace(10, pool.rays(10)).shape == (10, 3)  # and then it goes on


def _written(folder: Path, text: str) -> Path:
    file = folder / "written.pov"
    file.write_text(text)
    return file
