"""What a renderer may be and say of itself. Exact."""

import contextlib
import os
import signal
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Sampler, deadline, render
from pmc_sampler.sampler import config_for

SPP = 24


def test_signed_radiance_enters_the_film(renderers: SimpleNamespace) -> None:
    """Single samples below zero are kept where the renderer says they may be, and left out where it does not."""

    def radiance(batch: Batch) -> np.ndarray:
        return np.repeat(renderers.noise(batch)[:, None] - 0.25, 3, axis=1).astype(np.float32)

    kept = Sampler(20, 12, Budget(spp=SPP), Config.uniform(), signed=True)
    kept.run(radiance)
    assert kept.rejected == 0
    assert kept.samples == SPP * 240
    assert abs(kept.film.mean.mean() - 0.25) < 0.03  # standard error 0.004
    assert kept.film.plain_mean.min() > 0.0
    lost = Sampler(20, 12, Budget(spp=SPP), Config.uniform())
    lost.run(radiance)
    assert lost.rejected > 0.2 * SPP * 240
    assert lost.film.mean.mean() > 0.3


def test_signed_is_kept_by_a_checkpoint(tmp_path: Any, renderers: SimpleNamespace) -> None:
    Sampler(5, 5, Budget(spp=1), signed=True).save(tmp_path / "state")
    assert Sampler.load(tmp_path / "state").signed


def test_no_colour_where_there_is_none(renderers: SimpleNamespace) -> None:
    """Red noise beside green noise: the energy correction brings neither to the other's side."""

    def radiance(batch: Batch) -> np.ndarray:
        speck = np.where(renderers.noise(batch) < 0.03, 20.0, 0.2)
        left = batch.positions[:, 0] < 32
        return np.stack([speck * left, speck * ~left, 0 * speck], axis=1).astype(np.float32)

    film = render(radiance, 64, 32, Budget(spp=SPP)).film
    assert not np.array_equal(film.mean, film.plain_mean)
    assert not film.mean[:, :32, 1].any()
    assert not film.mean[:, 32:, 0].any()
    assert not film.mean[:, :, 2].any()


def test_threads_may_share_a_sampler(renderers: SimpleNamespace) -> None:
    """Four threads ask, tell and look at the film: every sample is counted once and the image is that of one thread."""
    config = Config(lookahead=3)
    sampler = Sampler(160, 120, Budget(spp=12), config, seed=4)
    trouble: list[BaseException] = []

    def work() -> None:
        try:
            while not sampler.done:
                try:
                    batch = sampler.ask()
                except RuntimeError:  # the others have all that is left, or as much as lookahead allows
                    continue
                sampler.tell(batch, renderers.textured(batch))
                assert np.isfinite(sampler.film.mean).all()
        except BaseException as error:
            trouble.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert trouble == []
    assert sampler.samples == 12 * 160 * 120
    alone = render(renderers.textured, 160, 120, Budget(spp=12), config, seed=4).film
    np.testing.assert_array_equal(sampler.film.mean, alone.mean)


def test_an_interrupt_after_tell_keeps_the_batch(renderers: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    sampler = Sampler(40, 30, Budget(spp=SPP), seed=4)
    tell = Sampler.tell

    def interrupted(self: Sampler, batch: Batch, radiance: Any) -> None:
        tell(self, batch, radiance)
        raise KeyboardInterrupt

    monkeypatch.setattr(Sampler, "tell", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sampler.run(renderers.textured)
    monkeypatch.undo()
    assert sampler.samples == 4096  # the first batch
    sampler.run(renderers.textured)
    whole = render(renderers.textured, 40, 30, Budget(spp=SPP), seed=4).film
    np.testing.assert_array_equal(sampler.film.mean, whole.mean)


def test_a_renderer_that_hangs_is_given_up(renderers: SimpleNamespace) -> None:
    """What was told stays, the batch is asked again, and `run` goes on to the same bits. The thread that was given up
    answers to nobody.
    """
    sampler, go_on = Sampler(40, 30, Budget(spp=SPP), seed=4), threading.Event()
    calls: list[int] = []

    def hangs(batch: Batch) -> np.ndarray:
        calls.append(batch.number)
        if len(calls) == 3:
            go_on.wait()
        return renderers.textured(batch)

    with pytest.raises(TimeoutError, match=r"the renderer gave no answer within 0\.5 s"):
        sampler.run(hangs, timeout=0.5)
    told = sampler.samples
    assert (calls, deadline.hung()) == ([0, 1, 2], True)
    go_on.set()
    while deadline.hung():
        pass
    assert sampler.samples == told
    sampler.run(hangs, timeout=60.0)
    assert calls[3] == 2
    whole = render(renderers.textured, 40, 30, Budget(spp=SPP), seed=4, timeout=60.0).film
    np.testing.assert_array_equal(sampler.film.mean, whole.mean)


def test_a_time_out_passes_answers_and_errors_on() -> None:
    """One thread, not the caller's, for all calls."""
    threads: set[int] = set()

    def inverse(x: float) -> float:
        threads.add(threading.get_ident())
        return 1.0 / x

    timed = deadline.Deadline(inverse, 60.0)
    with contextlib.closing(timed):
        assert [timed(2.0), timed(4.0)] == [0.5, 0.25]
        with pytest.raises(ZeroDivisionError):
            timed(0.0)
        assert timed(1.0) == 1.0
    assert len(threads) == 1
    assert threading.get_ident() not in threads
    assert not deadline.hung()
    for seconds in (0.0, -1.0, float("inf")):
        with pytest.raises(ValueError, match="expected seconds above 0"):
            deadline.Deadline(inverse, seconds)


def test_an_interrupt_reaches_one_who_waits(renderers: SimpleNamespace) -> None:
    """Ctrl-C while the renderer, in its thread, does not come back: the batch is asked again."""
    sampler, go_on = Sampler(40, 30, Budget(spp=SPP), seed=4), threading.Event()

    def hangs(batch: Batch) -> np.ndarray:
        if not go_on.is_set():
            os.kill(os.getpid(), signal.SIGINT)  # handled by the main thread
            go_on.wait()
        return renderers.textured(batch)

    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # what a shell starts in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            sampler.run(hangs, timeout=60.0)
    finally:
        signal.signal(signal.SIGINT, before)
    go_on.set()
    assert sampler.samples == 0
    sampler.run(hangs, timeout=60.0)
    whole = render(renderers.textured, 40, 30, Budget(spp=SPP), seed=4).film
    np.testing.assert_array_equal(sampler.film.mean, whole.mean)


class Sized:
    """A renderer of one size with an extra channel."""

    takes_batch = True
    width, height, aovs = 20, 12, 1

    def __call__(self, batch: Batch) -> np.ndarray:
        return np.full((len(batch), 4), [0.1, 0.2, 0.3, -7.0], np.float32)


def test_a_renderer_is_taken_at_its_word() -> None:
    film = render(Sized(), 20, 12, Budget(spp=4)).film
    assert film.aovs.shape == (12, 20, 1)
    assert (film.aovs == -7.0).all()
    with pytest.raises(ValueError, match=r"the image is 10x12 and the renderer renders 20x12: give both one size"):
        render(Sized(), 10, 12, Budget(spp=4))


def test_settings_for_a_renderer() -> None:
    plain = SimpleNamespace(width=64, height=48)
    assert config_for(plain, {"preset": "paper"}) == Config.paper(64, 48)
    assert config_for(plain, {"preset": "paper"}).population == 50
    filtered = SimpleNamespace(width=64, height=48, filter={"filter": "gaussian", "filter_radius": 1.5})
    assert config_for(filtered, {}) == Config(filter="gaussian", filter_radius=1.5)
    assert config_for(filtered, {"filter": "tent"}) == Config(filter="tent")
    slow = SimpleNamespace(width=64, height=48, batching={"batch": 9000, "lookahead": 2})
    assert config_for(slow, {}) == Config(batch=9000, lookahead=2)
    assert config_for(slow, {"preset": "uniform", "batch": 70}) == Config.uniform(batch=70, lookahead=2)
    assert config_for(slow, {"preset": "paper"}) == Config.paper(64, 48)
