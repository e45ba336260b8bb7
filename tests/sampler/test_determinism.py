"""The image is a function of (radiance, config, seed, budget in samples) alone: not of threads, of the order of
answers, of interruptions or of when the sampler was saved. All exact: every picture and all saved state, bit for bit.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Budget, Config, Sampler

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "uniform": {"pool_share": 1.0, "correction": 0.0},
    "population": {"direct_share": 0.0, "moves": 3, "eliminate": 0.4, "regenerate_pool": 0.5, "population": 60},
    "direct": {"direct_share": 1.0, "beta_power": 1.0},
    "unbiased": {"estimator": "unbiased"},
    "rare": {"adapt_beta_every": 2, "adapt_alpha_every": 2, "beta": "variance", "evaluate_regenerated": False},
}


def config(name: str, lookahead: int, **changes: Any) -> Config:
    settings = {"initial_spp": 2.0, "batch": 300, "radii": (1.0, 3.0), **SETTINGS[name], **changes}
    return Config(lookahead=lookahead, **settings)


def sampler(name: str, lookahead: int, threads: int | None = 1, **changes: Any) -> Sampler:
    return Sampler(33, 21, Budget(spp=9), config(name, lookahead, **changes), seed=11, threads=threads)


def finished(some: Sampler, radiance: Any, tools: SimpleNamespace) -> tuple[dict[str, bytes], dict[str, bytes]]:
    some.run(radiance)
    return tools.pictures(some), tools.state(some)


@pytest.mark.parametrize("size", [(530, 271), (528, 272)])
@pytest.mark.parametrize("name", SETTINGS)
def test_threads(name: str, size: tuple[int, int], renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Large enough that the work is cut into pieces: sorting and the pool at 16384 samples a piece, blocks of 64 tiles.
    With whole tiles alone the pool's pieces are written side by side; with others one after the other.
    """
    changes = {"batch": 200_000, "initial_spp": 1.0, "regenerate_jitter": 2.0}
    if "population" in SETTINGS[name]:
        changes["population"] = 30_000
    settings = config(name, 1, **changes)
    results = []
    for threads in (1, 2, 16):
        some = Sampler(*size, Budget(spp=4), settings, seed=5, threads=threads)
        results.append(finished(some, renderers.textured, tools))
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("lookahead", [0, 1, 3])
@pytest.mark.parametrize("name", SETTINGS)
def test_order_of_answers(name: str, lookahead: int, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    expected = finished(sampler(name, lookahead), renderers.textured, tools)
    for order in range(4):
        some = sampler(name, lookahead)
        left = tools.shuffled(some, renderers.textured, np.random.default_rng(order))
        assert not left
        assert (tools.pictures(some), tools.state(some)) == expected


def test_a_batch_waits_for_the_first_that_is_due(renderers: SimpleNamespace) -> None:
    """With one batch ahead, batch 2 may not be drawn before batch 0 is told, though 1 is told already."""
    some = sampler("default", 1)
    first, second = some.ask(), some.ask()
    some.tell(second, renderers.textured(second))
    with pytest.raises(RuntimeError, match="tell or drop batch 0 first"):
        some.ask()
    some.tell(first, renderers.textured(first))
    assert some.ask().number == 2


@pytest.mark.parametrize("lookahead", [0, 3])
def test_where_visible_noise_ends_it(lookahead: int, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """The batch that meets the limit is the last on the film, however many others are open or told by then."""
    made = Budget(visible_noise=0.25), config("default", lookahead)
    expected = Sampler(33, 21, *made, seed=11)
    expected.run(renderers.textured)
    assert expected.samples > 2000
    for order in range(6):
        some = Sampler(33, 21, *made, seed=11)
        for batch in tools.shuffled(some, renderers.textured, np.random.default_rng(order)):
            some.tell(batch, renderers.textured(batch))
        assert some.done == "visible_noise"
        assert tools.pictures(some) == tools.pictures(expected)


def test_lookahead_is_part_of_the_result(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """The negative control of the order of answers: what batches know of one another does show in the bits."""
    one = finished(sampler("default", 0), renderers.textured, tools)[0]
    other = finished(sampler("default", 1), renderers.textured, tools)[0]
    assert one["mean"] != other["mean"]


@pytest.mark.parametrize("name", SETTINGS)
def test_seeds_differ_in_every_bit(name: str) -> None:
    batches = []
    for seed in (0, 1, 1 << 31, 1 << 32, 1 << 63, (1 << 64) - 1):
        some = Sampler(33, 21, Budget(spp=9), config(name, 1), seed=seed)
        batches.append(some.ask().scramble.tobytes())
    assert len(set(batches)) == len(batches)


@pytest.mark.parametrize("lookahead", [0, 1, 3])
@pytest.mark.parametrize("name", SETTINGS)
def test_resumed_anywhere(
    name: str, lookahead: int, tmp_path: Path, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """Saved at arbitrary points with batches open and some told out of turn, it goes on to the same bits; so does the
    sampler that was saved.
    """
    expected = finished(sampler(name, lookahead), renderers.textured, tools)
    rng = np.random.default_rng(lookahead)
    for until in (1, 1500, 3000, 4500, 6000):
        some = sampler(name, lookahead)
        left = tools.shuffled(some, renderers.textured, rng, until)
        path = tmp_path / f"{until}.npz"
        some.save(path)
        again = Sampler.load(path, threads=2)
        assert tools.state(again) == tools.state(some)
        assert again.done == some.done
        assert finished(again, renderers.textured, tools) == expected
        for batch in left:
            some.tell(batch, renderers.textured(batch))
        assert finished(some, renderers.textured, tools) == expected


def test_resumed_with_answers_waiting(tmp_path: Path, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Four batches out, two told and one dropped while the first is open: all of that is in the file."""

    def begin() -> tuple[Sampler, list[Any]]:
        some = sampler("default", 3)
        while some.samples < 2500:
            batch = some.ask()
            some.tell(batch, renderers.textured(batch))
        open_ = [some.ask() for _ in range(4)]
        some.tell(open_[3], renderers.textured(open_[3]))
        some.tell(open_[1], renderers.textured(open_[1]))
        some.drop(open_[2])
        return some, open_

    some, open_ = begin()
    some.save(tmp_path / "waiting.npz")
    again = Sampler.load(tmp_path / "waiting.npz")
    batch = again.ask()
    assert batch.number == open_[0].number
    assert batch.positions.tobytes() == open_[0].positions.tobytes()
    with pytest.raises(RuntimeError, match=f"tell or drop batch {batch.number} first"):
        again.ask()
    again.tell(batch, renderers.textured(batch))
    some.tell(open_[0], renderers.textured(open_[0]))
    assert finished(again, renderers.textured, tools) == finished(some, renderers.textured, tools)
    assert again.samples == 9 * 33 * 21


@pytest.mark.parametrize("lookahead", [0, 2])
def test_put_back(lookahead: int, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """A batch put back is asked again next, and nothing else shows that it was."""
    expected = finished(sampler("default", lookahead), renderers.textured, tools)
    some, rng = sampler("default", lookahead), np.random.default_rng(3)
    while not some.done:
        batch = some.ask()
        before = tools.state(some)
        if rng.random() < 0.4:
            some.put_back(batch)
            assert tools.state(some) == before
            with pytest.raises(ValueError, match=f"batch {batch.number} is not open"):
                some.tell(batch, renderers.textured(batch))
            again = some.ask()
            assert again.number == batch.number
            assert again.positions.tobytes() == batch.positions.tobytes()
            batch = again
        some.tell(batch, renderers.textured(batch))
    assert (tools.pictures(some), tools.state(some)) == expected


def test_run_goes_on_after_a_renderer_that_raised(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    expected = finished(sampler("default", 1), renderers.textured, tools)
    calls = 0

    def fails(batch: Any) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls % 3 == 0:
            raise KeyboardInterrupt
        return renderers.textured(batch)

    some = sampler("default", 1)
    while not some.done:
        try:
            some.run(fails)
        except KeyboardInterrupt:
            continue
    assert calls > 6
    assert (tools.pictures(some), tools.state(some)) == expected


@pytest.mark.parametrize("name", SETTINGS)
def test_dropped_samples_are_drawn_again(name: str, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """The budget is met exactly whatever is dropped, at other places of the sequences; and dropping in another order
    makes no difference.
    """
    results = []
    for order in (1, -1):
        some, rng = sampler(name, 1), np.random.default_rng(8)
        used: set[tuple[int, int]] = set()
        told = 0
        while not some.done:
            open_ = [some.ask()]
            if some.samples + len(open_[0]) < 9 * 33 * 21:
                open_.append(some.ask())
            lost = [batch for batch in open_ if rng.random() < 0.3]
            for batch in open_[::order]:
                points = set(zip(batch.scramble.tolist(), batch.index.tolist(), strict=True))
                assert not points & used
                used |= points
                if batch in lost:
                    some.drop(batch)
                else:
                    some.tell(batch, renderers.textured(batch))
                    told += len(batch)
        assert told == some.samples == 9 * 33 * 21
        assert some.film.samples.sum() == told
        results.append((tools.pictures(some), tools.state(some)))
    assert results[0] == results[1]


def test_the_last_batch_dropped_over_and_over(renderers: SimpleNamespace) -> None:
    some = sampler("default", 1)
    while some.samples < 8 * 33 * 21:
        batch = some.ask()
        some.tell(batch, renderers.textured(batch))
    for _ in range(20):
        some.drop(some.ask())
    some.run(renderers.textured)
    assert some.samples == 9 * 33 * 21


def test_the_memory_of_batches_that_nobody_holds_is_used_again(renderers: SimpleNamespace) -> None:
    """And of no other: what is held keeps its values, though the sampler has long gone on."""
    settings = Config(batch=100_000)
    held, copies, addresses = [], [], set()
    for keep in (False, True):
        some = Sampler(640, 480, Budget(spp=6), settings, seed=2)
        while not some.done:
            batch = some.ask()
            addresses.add((keep, batch.positions.ctypes.data))
            if keep:
                held.append(batch.positions)
                copies.append(batch.positions.copy())
            some.tell(batch, renderers.textured(batch))
            del batch
    assert len(held) > 10
    assert len({address for kept, address in addresses if not kept}) <= 2
    assert len({address for kept, address in addresses if kept}) == len(held)
    for positions, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(positions, copy)
