"""When sampling ends and how many samples that took. Every test is exact: counts are compared, never times."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Sampler, luminance, render, tvi

# The radii reach no further than the smallest image of the tests, 1x1.
CONFIGS = {
    "default": Config(radii=(0.5, 1.0)),
    "uniform": Config.uniform(),
    "paper": Config.paper(population=1, radii=(1.0,)),
    "no pool": Config(radii=(1.0,), initial_spp=0.0, pool_share=0.0),
    "greedy": Config(radii=(1.0,), direct_share=1.0, initial_spp=2.0),
    "tiny batches": Config(radii=(1.0,), batch=7),
    "huge batches": Config(radii=(1.0,), batch=100_000, initial_spp=0.5),
    "unseen": Config(radii=(1.0,), evaluate_regenerated=False, regenerate_pool=0.5, moves=3, lookahead=3),
    "idle members": Config(radii=(1.0,), population=1, moves=0, eliminate=0.4, initial_spp=0.0, pool_share=0.0),
    "rare adaptation": Config(radii=(1.0,), adapt_beta_every=3, beta="variance", beta_power=1.0, eliminate=0.4),
}
SIZES = [(1, 1), (1, 9), (13, 1), (17, 5), (100, 37)]


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("spp", [0.3, 1.0, 2.5, 11.0])
def test_samples_are_met_exactly(size: tuple[int, int], spp: float, config: Config, renderers: SimpleNamespace) -> None:
    width, height = size
    sampler = Sampler(width, height, Budget(spp=spp), config, seed=1)
    expected, told = max(1, math.floor(spp * width * height + 0.5)), 0
    while not sampler.done:
        batch = sampler.ask()
        assert 0 < len(batch) <= expected - told
        told += len(batch)
        sampler.tell(batch, renderers.textured(batch))
        assert sampler.samples == told
        assert sampler.fraction == told / expected
    assert (sampler.done, told) == ("spp", expected)
    assert sampler.spp == expected / (width * height)
    assert sampler.film.samples.sum() == expected
    with pytest.raises(RuntimeError, match="budget is spent"):
        sampler.ask()


@pytest.mark.parametrize(
    ("population", "moves"),
    [(300, 1), (300, 16), (7, 3), (629, 2)],
)
def test_population_sets_the_batch(population: int, moves: int, renderers: SimpleNamespace) -> None:
    """Each iteration is the moves of all members, and those regenerated; the last is cut to the budget."""
    config = Config.paper(population=population, moves=moves, radii=(2.0, 5.0), eliminate=0.4)
    sampler = Sampler(37, 17, Budget(spp=30), config, seed=4)
    sizes = []
    while not sampler.done:
        batch = sampler.ask()
        sizes.append(len(batch))
        sampler.tell(batch, renderers.textured(batch))
    replaced = population - math.floor(0.6 * population + 0.5)
    whole = [population * (moves + 1)] + [population * moves + replaced] * len(sizes)
    assert sum(sizes) == 30 * 37 * 17
    assert sizes[:-1] == whole[: len(sizes) - 1]
    assert 0 < sizes[-1] <= whole[len(sizes) - 1]


@pytest.mark.parametrize("spp", [1, 3, 8])
@pytest.mark.parametrize("size", SIZES)
def test_uniform_gives_every_pixel_the_same(size: tuple[int, int], spp: int, renderers: SimpleNamespace) -> None:
    result = render(renderers.textured, *size, Budget(spp=spp), Config.uniform(batch=50), seed=2)
    assert (result.film.samples == spp).all()


@pytest.mark.parametrize("spp", [0.4, 1.5, 3.9])
def test_uniform_at_a_fraction_differs_by_one(spp: float, renderers: SimpleNamespace) -> None:
    samples = render(renderers.textured, 37, 21, Budget(spp=spp), Config.uniform(), seed=2).film.samples
    assert samples.sum() == round(spp * 37 * 21)
    assert set(np.unique(samples)) == {math.floor(spp), math.ceil(spp)}


@pytest.mark.parametrize("spp", [0.25, 0.5])
def test_a_part_of_a_pass_covers_the_image(spp: float, renderers: SimpleNamespace) -> None:
    """Any stretch of the pool is spread over the image: 64x48 pixels in blocks of 8x8, each within 2 of its share."""
    samples = render(renderers.textured, 64, 48, Budget(spp=spp), Config.uniform(), seed=2).film.samples
    blocks = samples.reshape(6, 8, 8, 8).sum(axis=(1, 3))
    assert abs(blocks - 64 * spp).max() <= 2


def test_one_loop_however_it_is_written(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """ask and tell, Sampler.run and render give the same bits, with a renderer of positions or of a Batch."""
    config, budget = Config(lookahead=2), Budget(spp=12)
    by_hand = Sampler(40, 30, budget, config, seed=9)
    while not by_hand.done:
        batch = by_hand.ask()
        by_hand.tell(batch, renderers.textured(batch))
    by_run = Sampler(40, 30, budget, config, seed=9)
    result = by_run.run(renderers.textured)
    assert tools.pictures(by_run) == tools.pictures(by_hand)
    assert tools.state(by_run) == tools.state(by_hand)
    rendered = render(renderers.textured, 40, 30, budget, config, seed=9)
    assert rendered.film.mean.tobytes() == by_hand.film.mean.tobytes()
    assert (result.samples, result.spp, result.rejected, result.done) == (12 * 40 * 30, 12.0, 0, "spp")
    assert result.visible_noise == by_hand.visible_noise
    assert set(result.seconds) == {"total", "renderer", "sampler"}


def test_what_a_renderer_is_called_with() -> None:
    seen: list[type] = []

    def note(argument: Any) -> np.ndarray:
        seen.append(type(argument))
        return np.ones((len(argument), 3), np.float32)

    class Renderer:
        def __init__(self, takes_batch: bool) -> None:
            self.takes_batch = takes_batch

        def __call__(self, argument: Any) -> np.ndarray:
            return note(argument)

    def by_name(batch):  # type: ignore[no-untyped-def]
        return note(batch)

    def by_type(samples: Batch) -> np.ndarray:
        return note(samples)

    def by_position(positions: np.ndarray) -> np.ndarray:
        assert positions.dtype == np.float32
        assert positions.shape[1] == 2
        return note(positions)

    for function in (Renderer(True), by_name, Renderer(False), by_position, lambda p: note(p)):
        render(function, 3, 3, Budget(spp=1), Config.uniform())
    assert seen == [Batch, Batch, np.ndarray, np.ndarray, np.ndarray]
    render(by_type, 3, 3, Budget(spp=1), Config.uniform())
    assert seen[-1] is Batch
    with pytest.raises(TypeError, match="radiance is 5: expected a function"):
        render(5, 3, 3, Budget(spp=1))  # type: ignore[arg-type]


def test_progress_is_told_of_every_batch(renderers: SimpleNamespace) -> None:
    fractions: list[float] = []
    sampler = Sampler(30, 20, Budget(spp=10), Config(batch=600, lookahead=0), seed=1)
    sampler.run(renderers.textured, progress=lambda s: fractions.append(s.fraction))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert len(fractions) == 10


def test_seconds_end_a_run(renderers: SimpleNamespace) -> None:
    """A budget of time that any batch exceeds: one batch, and the film is whole."""
    sampler = Sampler(30, 20, Budget(seconds=1e-9), seed=1)
    result = sampler.run(renderers.textured)
    assert (result.done, sampler.done) == ("seconds", "seconds")
    assert result.samples == sampler.film.samples.sum() > 0
    assert sampler.fraction == 1.0


@pytest.mark.parametrize("config", [Config(), Config.uniform(), Config(adapt_beta_every=4)])
def test_visible_noise_ends_a_run(config: Config, renderers: SimpleNamespace) -> None:
    """A constant image is done once every pixel has two samples; a noisy one goes on, until its noise is that low or
    the samples are spent.
    """
    quiet = render(renderers.constant, 40, 30, Budget(spp=64, visible_noise=0.02), config, seed=1)
    assert quiet.done == "visible_noise"
    assert quiet.visible_noise == 0.0
    assert quiet.spp <= 16
    loud = render(renderers.spikes, 40, 30, Budget(spp=64, visible_noise=0.02), config, seed=1)
    assert (loud.done, loud.spp) == ("spp", 64.0)
    assert loud.visible_noise > 0.02
    between = render(renderers.textured, 40, 30, Budget(visible_noise=0.3), config, seed=1)
    assert between.done == "visible_noise"
    assert between.visible_noise <= 0.3


def test_visible_noise_is_the_share_above_tvi(renderers: SimpleNamespace) -> None:
    """Against the definition, in float64: pixels within 0.4 % of the threshold may fall on either side. Of those whose
    own samples are quiet enough the pixels around keep some unsettled.
    """
    config = Config(white_luminance=30.0)
    sampler = Sampler(50, 40, Budget(spp=14), config, seed=3)
    sampler.run(renderers.textured)
    mean = luminance(sampler.film.plain_mean.astype(np.float64))
    # The channels' noise is independent, so luminance has its own deviations: ask for them again.
    values: list[tuple[np.ndarray, np.ndarray]] = []
    again = Sampler(50, 40, Budget(spp=14), config, seed=3)
    while not again.done:
        batch = again.ask()
        radiance = renderers.textured(batch)
        values.append((batch.pixel, luminance(radiance.astype(np.float64))))
        again.tell(batch, radiance)
    pixel = np.concatenate([p for p, _ in values])
    deviation = np.concatenate([y for _, y in values]) - mean.ravel()[pixel]
    n = np.bincount(pixel, minlength=2000).reshape(40, 50)
    squares = np.bincount(pixel, deviation**2, 2000).reshape(40, 50) * (1.645 * 30.0 / tvi(30.0 * mean)) ** 2
    around = np.empty((40, 50))
    for y, x in np.ndindex(40, 50):
        window = np.s_[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]
        around[y, x] = squares[window].sum() / (n[window] - 1).sum()
    own, pooled = squares / (n - 1) / n, around / n
    ratio = np.sqrt(np.maximum(own, pooled))
    low, high = np.mean(ratio > 1.004), np.mean(ratio > 0.996)
    assert low - 1e-9 <= sampler.visible_noise <= high + 1e-9
    assert high - low < 0.03
    assert 0.02 < np.mean(own > 1.0) < low - 0.02 < 0.9, (np.mean(own > 1.0), low)


def test_one_bright_path_unsettles_what_is_around_it() -> None:
    """A grey image with a single sample of 1000 in the middle: 7x7 pixels may have missed such a path."""

    def radiance(batch: Batch) -> np.ndarray:
        values = np.full((len(batch), 3), 0.5, np.float32)
        values[(batch.pixel == 20 * 40 + 20) & (batch.index == 2)] = 1000.0
        return values

    sampler = Sampler(40, 40, Budget(spp=8), Config.uniform(), seed=1)
    sampler.run(radiance)
    assert sampler.visible_noise == pytest.approx(49 / 1600, abs=1e-12)
    sampler = Sampler(5, 3, Budget(spp=8), Config.uniform(radii=(1.0,)), seed=1)
    sampler.run(lambda batch: np.full((len(batch), 3), 0.5, np.float32))
    assert sampler.visible_noise == 0.0


@pytest.mark.parametrize("direct", [True, False])
def test_black_costs_nothing_beyond_its_share_of_the_pool(
    direct: bool, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """The left half is black. Drawn from beta and evaluated there, no sample falls into it but the pool's; members
    that moved may, as far as their kernel reaches.
    """
    if direct:
        config, reach = Config(direct_share=1.0, pool_share=0.1, initial_spp=4.0, lookahead=0), 0
    else:
        config, reach = Config(radii=(1.0, 3.0), moves=2, eliminate=1.0, initial_spp=4.0, lookahead=0), 6
    sampler = Sampler(64, 32, Budget(spp=20), config, seed=5)
    in_black, pool_in_black = 0, 0
    while not sampler.done:
        batch = sampler.ask()
        if sampler.samples >= 4 * 64 * 32:
            deep = batch.pixel % 64 < 32 - reach
            in_black += int(deep.sum())
            pool_in_black += int((deep & tools.from_pool(sampler, batch)).sum())
        sampler.tell(batch, renderers.right_half(64)(batch))
    assert in_black == pool_in_black > 0
    bright = sampler.film.samples[:, 32:].sum()
    assert bright > 0.8 * (sampler.samples - 4 * 64 * 32)


@pytest.mark.parametrize("image", ["black", "constant"])
def test_converged_images_are_sampled_evenly(image: str, renderers: SimpleNamespace) -> None:
    """Where nothing varies there is nothing to draw from: but for members that move all samples are the pool's, as
    many for each pixel.
    """
    sampler = Sampler(40, 30, Budget(spp=16), Config(initial_spp=4.0, direct_share=1.0), seed=1)
    sampler.run(getattr(renderers, image))
    assert (sampler.film.samples == 16).all()
    assert (sampler.film.beta < 1e-20).all()  # the variance of equal values, but for rounding
