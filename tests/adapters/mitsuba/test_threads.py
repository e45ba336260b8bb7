"""The sampler's work on Dr.Jit's own threads."""

from __future__ import annotations

import ctypes
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Budget, Config, Sampler
from pmc_sampler.sampler import sampler_for

pytestmark = pytest.mark.needs("mitsuba")


@pytest.fixture
def renderer(mi: Any, small_scene: Any) -> Any:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    return MitsubaRenderer(small_scene())


@pytest.mark.parametrize("scale", [1.0, 1e-18, 1e-38], ids=["usual", "with denormal squares", "with denormal sums"])
def test_the_same_bits_as_on_threads_of_its_own(renderer: Any, scale: float) -> None:
    """Dr.Jit's threads treat denormal numbers as zeros while they work for it, and not while they work for us."""
    images = []
    for threads in (1, renderer.threads):
        sampler = Sampler(96, 64, Budget(spp=16), Config(), seed=3, threads=threads)
        while not sampler.done:
            batch = sampler.ask()
            sampler.tell(batch, np.float32(scale) * np.sin(batch.positions[:, [0, 1, 0]] * batch.index[:, None]) ** 2)
        images.append((sampler.film.mean, sampler.film.standard_error, sampler.film.beta))
    for ours, theirs in zip(*images, strict=True):
        assert np.array_equal(ours, theirs)
    assert images[0][0].max() > 0


def test_a_renderer_lends_its_threads(renderer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sampler that is made for the renderer gets them; one in a CUDA variant has its own."""
    import drjit as dr

    assert renderer.threads.size == dr.thread_count()
    given: list[Any] = []
    made = Sampler.__init__

    def init(self: Sampler, *arguments: Any, **options: Any) -> None:
        given.append(options["threads"])
        made(self, *arguments, **options)

    monkeypatch.setattr(Sampler, "__init__", init)
    sampler_for(renderer, 96, 64, Budget(spp=1))
    monkeypatch.setattr(renderer, "variant", "cuda_ad_rgb")
    sampler_for(renderer, 96, 64, Budget(spp=1))
    assert given[0] is not None
    assert given[1:] == [None]


def test_threads_that_do_not_come_are_not_waited_for(renderer: Any) -> None:
    """As when the renderer hangs, or has work of its own in the queue: the caller does all, to the same bits."""
    import drjit as dr

    def render(threads: Any) -> Any:
        sampler = Sampler(96, 64, Budget(spp=8), Config(), seed=2, threads=threads)
        while not sampler.done:
            batch = sampler.ask()
            sampler.tell(batch, np.sin(batch.positions[:, [0, 1, 0]] * batch.index[:, None]) ** 2)
        return sampler.film.mean

    entered, release = threading.Semaphore(0), threading.Event()
    nanothread = ctypes.CDLL(str(next(Path(dr.__file__).parent.glob("libnanothread.*"))))
    nanothread.task_submit_dep.restype = ctypes.c_void_p
    call = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_void_p)(lambda *_: (entered.release(), release.wait(60)))
    task = nanothread.task_submit_dep(None, None, 0, dr.thread_count(), call, None, 0, None, 1, 0)
    try:
        assert entered.acquire(timeout=60)
        assert np.array_equal(render(renderer.threads), render(1))
    finally:
        release.set()
        nanothread.task_wait_and_release(ctypes.c_void_p(task))


def test_after_a_change_of_their_number(renderer: Any) -> None:
    """A sampler goes on, to the same bits, whatever `dr.set_thread_count` does meanwhile."""
    import drjit as dr

    def render(counts: list[int]) -> Any:
        sampler = Sampler(96, 64, Budget(spp=8), Config(batch=4096), seed=1, threads=renderer.threads)
        for step in range(1000):
            if sampler.done:
                break
            dr.set_thread_count(counts[step % len(counts)])
            batch = sampler.ask()
            sampler.tell(batch, np.sin(batch.positions[:, [0, 1, 0]] * batch.index[:, None]) ** 2)
        return sampler.film.mean

    before = dr.thread_count()
    try:
        assert np.array_equal(render([2]), render([4, 1, 3]))
    finally:
        dr.set_thread_count(before)
