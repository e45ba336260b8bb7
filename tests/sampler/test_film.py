"""The film against an oracle that recomputes every picture in float64 from all that was told, within the tolerances of
`Oracle.check`; random settings are in test_properties.py.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Film, Sampler, _core, luminance, tvi

CONFIGS: dict[str, Config] = {
    "default": Config(initial_spp=3.0),
    "uniform": Config.uniform(batch=700),
    "population": Config(
        direct_share=0.0, moves=4, radii=(1.0, 3.0, 8.0), eliminate=0.4, regenerate_pool=0.5, batch=900
    ),
    "paper": Config.paper(population=100, radii=(2.0, 5.0, 9.0)),
    "no pool": Config(initial_spp=0.0, pool_share=0.0, regenerate_pool=0.2, adapt_beta_every=3),
}


def with_aovs(image: Any, noise: Any) -> Any:
    """Two channels more: one of either sign, one constant."""

    def render(batch: Batch) -> np.ndarray:
        extra = np.stack([noise(batch, 9) - 0.5, np.full(len(batch), 3.0)], axis=1)
        return np.concatenate([image(batch), extra], axis=1).astype(np.float32)

    return render


@pytest.mark.parametrize("name", CONFIGS)
def test_pictures(name: str, renderers: SimpleNamespace, oracle: Any) -> None:
    sampler = Sampler(43, 30, Budget(spp=20), CONFIGS[name], seed=2, aovs=2)
    truth = oracle(sampler)
    sampler.run(truth.watch(with_aovs(renderers.textured, renderers.noise)))
    truth.check(sampler.film)
    film = sampler.film
    first, second = film.halves
    n = film.samples[..., None].astype(np.float64)
    together = (np.ceil(n / 2) * first + np.floor(n / 2) * second) / np.maximum(n, 1)
    np.testing.assert_allclose(together, film.plain_mean, rtol=1e-5, atol=0)


@pytest.mark.parametrize(
    ("change", "picture"),
    [
        ("value", "plain_mean"),
        ("aov", "aovs"),
        ("invalid", "samples"),
        ("lost", "samples"),
        ("order", "first_half"),
        ("correction", "mean"),
    ],
)
def test_the_oracle_sees(change: str, picture: str, renderers: SimpleNamespace, oracle: Any) -> None:
    """The negative control: with one value told a hundredth off, a sample or batch missing, two batches the other way
    round or another strength of the correction, it disagrees, and by the picture that shows it.
    """
    sampler = Sampler(43, 30, Budget(spp=20), CONFIGS["default"], seed=2, aovs=2)
    truth = oracle(sampler)
    sampler.run(truth.watch(with_aovs(renderers.textured, renderers.noise)))
    truth.check(sampler.film)
    batches = truth.batches
    _, values = batches[2]
    if change in ("value", "aov"):
        values[100, 1 if change == "value" else 3] *= 1.01
    elif change == "invalid":
        values[100, 1] = np.nan
    elif change == "lost":
        truth.drop(batches.pop(2)[0])
    elif change == "order":
        batches[2], batches[3] = batches[3], batches[2]
    else:
        truth.sampler = SimpleNamespace(
            **{name: getattr(sampler, name) for name in ("width", "height", "seed", "aovs", "signed", "_native")},
            **{name: getattr(sampler, name) for name in ("samples", "rejected")},
            config=dataclasses.replace(sampler.config, correction=0.99),
        )
    with pytest.raises(AssertionError, match=f"^{picture}"):
        truth.check(sampler.film)


def test_shapes_and_types() -> None:
    film = Sampler(7, 5, Budget(spp=4), Config(radii=(1.0, 2.0)), aovs=3).film
    assert isinstance(film, Film)
    shapes = {"samples": (5, 7), "beta": (5, 7), "alpha": (5, 7, 2), "aovs": (5, 7, 3)}
    for name in ("mean", "plain_mean", "pool_mean", "standard_error", "strategy", "samples", "beta", "alpha", "aovs"):
        picture = getattr(film, name)
        assert picture.shape == shapes.get(name, (5, 7, 3)), name
        assert picture.dtype == (np.uint32 if name == "samples" else np.float32), name
        picture[...] = 7  # the caller's to keep
        assert not np.array_equal(getattr(film, name), picture), name
    assert np.isinf(film.standard_error).all()
    assert (film.mean == 0).all()
    assert np.allclose(film.alpha, 0.5)
    assert all(half.shape == (5, 7, 3) for half in film.halves)
    assert Sampler(7, 5, Budget(spp=4)).film.aovs.shape == (5, 7, 0)


@pytest.mark.parametrize(("estimator", "more"), [("consistent", 0), ("unbiased", 4)])
def test_film_is_small(estimator: str, more: int) -> None:
    """96 bytes a pixel, without AOVs and the sums of tiles: 16 bytes for 256 pixels, and 12 of alpha for 64; for the
    unbiased estimator the deviations of the pool as well.
    """
    assert _core.film_bytes_per_pixel <= 96
    blocks = Sampler(64, 64, Budget(spp=1), Config(estimator=estimator))._native.save()
    film = {name: block.nbytes for name, block in blocks.items() if name.startswith(("film.", "alpha."))}
    assert sum(film.values()) <= (_core.film_bytes_per_pixel + more + 0.3) * 64 * 64


def test_a_large_mean_with_a_tiny_spread_loses_nothing(oracle: Any, renderers: SimpleNamespace) -> None:
    """Values in 1000 to 1000.001, at the resolution of floats: the textbook sum of squares would find noise alone."""

    def bright(batch: Batch) -> np.ndarray:
        return renderers.rgb(1000.0 + 0.001 * renderers.noise(batch))  # type: ignore[no-any-return]

    sampler = Sampler(20, 20, Budget(spp=30), Config.uniform(), seed=1)
    truth = oracle(sampler)
    sampler.run(truth.watch(bright))
    np.testing.assert_allclose(sampler.film.standard_error, truth.pictures()["standard_error"], rtol=1e-4)


def test_strategy_is_who_proposed(renderers: SimpleNamespace) -> None:
    """Brightness is the sample count; with one radius, red; where no kernel proposes, grey."""
    red = Sampler(30, 20, Budget(spp=8), Config(radii=(2.0,), initial_spp=2.0), seed=1)
    red.run(renderers.textured)
    picture = red.film.strategy
    density = red.film.samples / red.film.samples.max()
    np.testing.assert_allclose(picture.sum(axis=2), density, rtol=1e-6)
    coloured = picture[..., 1] == 0
    assert coloured.mean() > 0.5
    assert (picture[..., 2][coloured] == 0).all()
    np.testing.assert_allclose(picture[..., 0][coloured], density[coloured], rtol=1e-6)
    grey = Sampler(30, 20, Budget(spp=8), Config.uniform(), seed=1)
    grey.run(renderers.textured)
    np.testing.assert_allclose(grey.film.strategy, 1 / 3, rtol=1e-6)
    assert (Sampler(30, 20, Budget(spp=8)).film.strategy == 0).all()


# --- beta ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("rule", ["gain", "variance"])
def test_beta_follows_its_equation(rule: str, renderers: SimpleNamespace, oracle: Any) -> None:
    """var / (tvi^2 n^2), or var / tvi up to a factor that all pixels share; 0.3 % for the core's table of tvi,
    whose two jumps are left out, and for its sums.
    """
    config = Config(beta=rule, initial_spp=8.0, white_luminance=50.0, lookahead=0)
    sampler = Sampler(43, 30, Budget(spp=64), config, seed=2)
    truth = oracle(sampler)
    while sampler.samples < 8 * 43 * 30:  # no batch has been drawn from beta: none counts as under way
        batch = sampler.ask()
        sampler.tell(batch, truth.watch(renderers.textured)(batch))
    told = truth.joined()
    y = luminance(told.radiance)
    n = np.bincount(told.pixel)
    mean = np.bincount(told.pixel, y) / n
    variance = np.bincount(told.pixel, (y - mean[told.pixel]) ** 2) / (n - 1)
    threshold = tvi(50.0 * mean) / 50.0
    expected = variance / (threshold**2 * n**2 if rule == "gain" else threshold)
    log = np.log10(50.0 * mean)
    smooth = (abs(log + 1.44) > 0.02) & (abs(log - 1.9) > 0.02)
    actual = sampler.film.beta.ravel()
    if rule == "variance":
        actual, expected = actual / actual.mean(), expected / expected.mean()
    np.testing.assert_allclose(actual[smooth], expected[smooth], rtol=3e-3)
    assert smooth.mean() > 0.9


# --- The energy correction -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sigma", [0.5, 4.0, 12.0, 200.0])
@pytest.mark.parametrize("size", [(64, 48), (37, 61), (5, 3)])
def test_correction_has_the_sum_of_the_pool(size: tuple[int, int], sigma: float, renderers: SimpleNamespace) -> None:
    """Exactly but for floats, where every pixel has samples of the pool and nothing is kept from going below 0."""
    config = Config(correction_sigma=sigma, initial_spp=2.0, radii=(1.0, 2.0))
    sampler = Sampler(*size, Budget(spp=16), config, seed=3)
    sampler.run(renderers.textured)
    film = sampler.film
    assert film.mean.min() > 0
    corrected, pool = film.mean.sum((0, 1), dtype=np.float64), film.pool_mean.sum((0, 1), dtype=np.float64)
    np.testing.assert_allclose(corrected, pool, rtol=1e-5)
    plain = film.plain_mean.sum((0, 1), dtype=np.float64)
    assert abs(plain / pool - 1).max() > 1e-4, "the plain mean does too: this test shows nothing"


def test_strength_of_the_correction(renderers: SimpleNamespace) -> None:
    """Linear from the plain mean at 0 to the corrected one at 1."""
    images = {}
    for strength in (0.0, 0.5, 1.0):
        sampler = Sampler(40, 30, Budget(spp=8), Config(correction=strength, initial_spp=2.0), seed=3)
        sampler.run(renderers.textured)
        images[strength] = sampler.film.mean
    assert np.array_equal(images[0.0], sampler.film.plain_mean)
    np.testing.assert_allclose(images[0.5], (images[0.0] + images[1.0]) / 2, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", CONFIGS)
def test_constant_images_stay_as_they_are(name: str, renderers: SimpleNamespace) -> None:
    sampler = Sampler(43, 30, Budget(spp=9), CONFIGS[name], seed=2)
    sampler.run(renderers.constant)
    seen = sampler.film.samples > 0
    assert np.array_equal(sampler.film.mean, sampler.film.plain_mean)
    assert (sampler.film.mean[seen] == np.array([0.7, 0.3, 0.1], np.float32)).all()


def test_black_stays_black(renderers: SimpleNamespace) -> None:
    """Alone, and in the dark half beside a bright one, where the correction moves much radiance about."""
    black = Sampler(40, 30, Budget(spp=9), seed=2)
    black.run(renderers.black)
    assert (black.film.mean == 0).all()
    half = Sampler(40, 30, Budget(spp=9), Config(initial_spp=2.0), seed=2)
    half.run(renderers.right_half(40, renderers.spikes))
    assert (half.film.mean[:, :20] == 0).all()
    assert half.film.mean[:, 20:].min() >= 0
    assert not np.array_equal(half.film.mean[:, 20:], half.film.plain_mean[:, 20:])


def test_halves_at_the_largest_float() -> None:
    """The first half's mean falls between two floats: what that leaves for the second is rounded to the largest float,
    not to infinity.
    """
    largest = np.finfo(np.float32).max
    for sign in (1, -1):
        sampler = Sampler(16, 16, Budget(spp=3), Config.uniform(batch=256), seed=1, signed=True)
        values = sign * np.array([largest, largest, np.nextafter(largest, np.float32(0))])
        sampler.run(lambda batch, values=values: np.repeat(values[batch.index, None], 3, axis=1))
        first, second = sampler.film.halves
        assert (first == values[2]).all()
        assert (second == values[1]).all()
