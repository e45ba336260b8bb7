"""The sampler's work on Dr.Jit's own threads."""

from __future__ import annotations

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
    """A sampler that is made for the renderer gets them; one with a time-out, or in a CUDA variant, has its own."""
    import drjit as dr

    assert renderer.threads.size == dr.thread_count()
    given: list[Any] = []
    made = Sampler.__init__

    def init(self: Sampler, *arguments: Any, **options: Any) -> None:
        given.append(options["threads"])
        made(self, *arguments, **options)

    monkeypatch.setattr(Sampler, "__init__", init)
    sampler_for(renderer, 96, 64, Budget(spp=1))
    sampler_for(renderer, 96, 64, Budget(spp=1), timeout=60.0)
    monkeypatch.setattr(renderer, "variant", "cuda_ad_rgb")
    sampler_for(renderer, 96, 64, Budget(spp=1))
    assert given[0] is not None
    assert given[1:] == [None, None]


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
