"""Unbiasedness of what claims it: the mean of the pool, the sum of the corrected image, and every pixel of the unbiased
estimator. Over 32 seeds, by Student's
t-test of the whole image and of nine tiles of 16x16 pixels, with Sidak's correction for all of them: a test of an
unbiased estimator fails once in 10^4. The plain mean, biased low by steering away from pixels that happened to look
dark (Kirk and Arvo 1991, doi:10.1145/127719.122735), is the negative control that they reject.
"""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pmc_sampler import Batch, Budget, Config, Sampler

SIZE, SEEDS, FAMILY = 48, 32, 1e-4
CONFIGS: dict[str, Config] = {
    "default": Config(),
    "greedy": Config(direct_share=1.0, pool_share=0.2),
    "population": Config(direct_share=0.0, moves=4, eliminate=0.4, regenerate_pool=0.3),
    "far ahead": Config(lookahead=4, batch=1000, initial_spp=2.0),
    "variance": Config(beta="variance", beta_power=1.0, adapt_beta_every=3),
    "jitter": Config(direct_share=0.0, regenerate_jitter=3.0, evaluate_regenerated=False, filter="gaussian"),
}


@pytest.mark.parametrize("tail", ["heavy", "light"])
@pytest.mark.parametrize("name", CONFIGS)
def test_unbiased_but_for_the_plain_mean(name: str, tail: str, renderers: SimpleNamespace, p_value: Any) -> None:
    """Paths 60 times as bright as the mean in one sample of 100, or three times in one of four; the mean is 1."""
    rare, bright = {"heavy": (0.01, 60.0), "light": (0.25, 3.0)}[tail]
    dim = (1 - rare * bright) / (1 - rare)
    pictures: dict[str, list[np.ndarray]] = {"plain_mean": [], "pool_mean": [], "mean": []}
    for seed in range(SEEDS):

        def image(batch: Batch, salt: int = seed) -> np.ndarray:
            grey = np.where(renderers.noise(batch, salt) < rare, bright, dim)
            return renderers.rgb(grey)  # type: ignore[no-any-return]

        sampler = Sampler(SIZE, SIZE, Budget(spp=16), CONFIGS[name], seed=1000 + seed)
        sampler.run(image)
        for picture, values in pictures.items():
            values.append(getattr(sampler.film, picture)[..., 0].astype(np.float64))
    assert p_value(np.array(pictures["pool_mean"])) > FAMILY
    whole = np.array(pictures["mean"]).mean(axis=(1, 2))
    assert stats.ttest_1samp(whole, 1.0).pvalue > FAMILY
    if tail == "heavy" or name == "greedy":  # members that move decouple a pixel's count from its own bright samples
        assert p_value(np.array(pictures["plain_mean"])) < FAMILY
        assert np.mean(pictures["plain_mean"]) < 1


@pytest.mark.parametrize("spp", [4, 16, 64])
def test_the_unbiased_estimator_at_every_count(spp: int, renderers: SimpleNamespace, p_value: Any) -> None:
    """On the left as above; on the right a third of the samples is three times as bright. The plain mean of the default
    estimator, from the same pool, is the negative control."""
    images: dict[str, list[np.ndarray]] = {"unbiased": [], "consistent": []}
    for estimator, seed in itertools.product(images, range(SEEDS)):

        def image(batch: Batch, salt: int = seed) -> np.ndarray:
            u = renderers.noise(batch, salt)
            left, right = np.where(u < 0.01, 60.0, 0.4 / 0.99), np.where(u < 1 / 3, 1.8, 0.6)
            return renderers.rgb(np.where(batch.pixel % SIZE < SIZE // 2, left, right))  # type: ignore[no-any-return]

        config = Config(estimator=estimator, initial_spp=2.0, batch=36 * max(16, spp))
        sampler = Sampler(SIZE, SIZE, Budget(spp=spp), config, seed=3000 + seed)
        sampler.run(image)
        assert sampler.film.samples.std() > 0.5
        images[estimator].append(sampler.film.plain_mean[..., 0].astype(np.float64))
        if estimator == "unbiased":
            assert np.array_equal(sampler.film.mean, sampler.film.plain_mean)
    assert p_value(np.array(images["unbiased"])) > FAMILY
    assert p_value(np.array(images["consistent"])) < FAMILY


@pytest.mark.parametrize("lookahead", [0, 2])
def test_what_steers_a_pixel_of_the_unbiased_estimator(
    lookahead: int, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """Exact: where the pixels of one colour get other radiance, they are sampled as before; and other radiance in
    samples that are not the pool's changes no count at all. Not so by default, the negative control."""

    def counts(estimator: str, changed: str) -> np.ndarray:
        config = Config(estimator=estimator, lookahead=lookahead, batch=300)
        sampler = Sampler(31, 22, Budget(spp=16), config, seed=8)
        while not sampler.done:
            batch = sampler.ask()
            grey = renderers.noise(batch, 1) ** 8
            black = (batch.pixel % 31 + batch.pixel // 31) % 2 == 0
            of_pool = tools.from_pool(sampler, batch)
            other = {"nothing": np.zeros_like(black), "black": black, "not the pool's": ~of_pool}[changed]
            sampler.tell(batch, renderers.rgb(np.where(other, renderers.noise(batch, 2) ** 2, grey)))
        return sampler.film.samples

    y, x = np.mgrid[:22, :31]
    black = (x + y) % 2 == 0
    before = counts("unbiased", "nothing")
    after = counts("unbiased", "black")
    assert np.array_equal(after[black], before[black])
    assert not np.array_equal(after[~black], before[~black])
    assert np.array_equal(counts("unbiased", "not the pool's"), before)
    consistent = counts("consistent", "nothing")
    assert not np.array_equal(counts("consistent", "black")[black], consistent[black])
    assert not np.array_equal(counts("consistent", "not the pool's"), consistent)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 1), (40, 3)])
def test_the_unbiased_estimator_on_small_images(size: tuple[int, int], renderers: SimpleNamespace) -> None:
    sampler = Sampler(*size, Budget(spp=20), Config(estimator="unbiased", batch=7), seed=2)
    sampler.run(renderers.textured)
    assert sampler.film.samples.sum() == 20 * size[0] * size[1]
    assert sampler.film.samples.min() >= 4


def test_what_the_unbiased_estimator_needs() -> None:
    with pytest.raises(ValueError, match=r"initial_spp is 0: expected at least 1 for the unbiased estimator"):
        Config(estimator="unbiased", initial_spp=0)
    with pytest.raises(ValueError, match=r"population is 30: the unbiased estimator has none"):
        Config(estimator="unbiased", population=30)
    settled = Config(estimator="unbiased", adapt_beta_every=3).resolved(64, 48)
    assert (settled.direct_share, settled.adapt_beta_every, settled.correction) == (1.0, 1, 0.0)
    with pytest.raises(ValueError, match=r"give the unbiased estimator spp or seconds"):
        Sampler(8, 8, Budget(visible_noise=0.1), Config(estimator="unbiased"))
    with pytest.raises(ValueError, match=r"estimator is 'exact': expected one of consistent, unbiased"):
        Config(estimator="exact")


def test_halves_and_plain_mean_of_the_pool_are_unbiased(renderers: Any, p_value: Any) -> None:
    """Uniform sampling is unbiased in every picture, and a 1 % loss of radiance would show (the negative control)."""
    first, plain = [], []
    for seed in range(SEEDS):
        sampler = Sampler(SIZE, SIZE, Budget(spp=16), Config.uniform(), seed=seed)

        def image(batch: Batch, salt: int = seed) -> np.ndarray:
            return renderers.rgb(2 * renderers.noise(batch, salt))  # type: ignore[no-any-return]

        sampler.run(image)
        first.append(sampler.film.halves[0][..., 0].astype(np.float64))
        plain.append(sampler.film.mean[..., 0].astype(np.float64))
    assert p_value(np.array(first)) > FAMILY
    assert p_value(np.array(plain)) > FAMILY
    assert p_value(0.99 * np.array(plain)) < FAMILY
