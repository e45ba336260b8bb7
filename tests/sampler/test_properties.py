"""Whatever the settings, the size and the renderer: the budget is met to the sample, nothing crashes, no picture holds
a NaN, and the film is that of an oracle in NumPy. Random examples, the same ones on every run.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pmc_sampler import Batch, Budget, Config, Sampler

exactly = settings(
    max_examples=300,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

shares = st.sampled_from([0.0, 0.01, 0.3, 0.5, 0.97, 1.0])


@st.composite
def samplers(draw: Any) -> Sampler:
    """Any sampler that may be made, of at most 40x40 pixels."""
    width, height = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    moves = draw(st.integers(0, 5))
    population = draw(st.none() | st.integers(1, width * height))
    evaluated, eliminate, direct = draw(st.booleans()), draw(shares), draw(shares)
    if moves == 0:  # members that never move are evaluated where they are put, or there are none
        evaluated = True
        if population is not None:
            eliminate = max(eliminate, 0.01)
    radii = st.floats(0.01, max(width, height))
    config = Config(
        batch=draw(st.none() | st.integers(1, 3000)),
        initial_spp=draw(st.none() | st.sampled_from([0.0, 0.3, 2.0])),
        pool_share=draw(shares),
        direct_share=direct,
        lookahead=draw(st.integers(0, 4)),
        population=population,
        moves=moves,
        radii=tuple(draw(st.lists(radii, min_size=1, max_size=3))),
        eliminate=eliminate,
        regenerate_pool=draw(shares),
        regenerate_jitter=draw(st.sampled_from([0.0, 1.0, 50.0])),
        evaluate_regenerated=evaluated,
        adapt_alpha_every=draw(st.integers(1, 4)),
        adapt_beta_every=draw(st.integers(1, 4)),
        alpha_floor=draw(shares),
        alpha_memory=draw(shares),
        beta=draw(st.sampled_from(["gain", "variance"])),
        beta_power=draw(st.sampled_from([0.25, 0.8, 1.0, 1.5, 2.0])),
        white_luminance=draw(st.sampled_from([1e-6, 1.0, 100.0, 1e9])),
        filter=draw(st.sampled_from(["box", "tent", "gaussian", "blackman-harris"])),
        filter_radius=draw(st.none() | st.floats(0.1, 16)),
        correction=draw(shares),
        correction_sigma=draw(st.floats(0.5, 256)),
        correction_knee=draw(st.floats(1e-6, 1)),
    )
    spp = draw(st.floats(0.001, 12))
    return Sampler(width, height, Budget(spp=spp), config, seed=draw(st.integers(0, 2**64 - 1)), threads=1)


@st.composite
def images(draw: Any) -> Any:
    """Renderers: a grey of any size, a share of the pixels black, of the samples bright, and of them invalid."""
    scale = 10.0 ** draw(st.integers(-30, 30))
    dark, rare, bad = draw(shares), draw(shares), draw(st.sampled_from([0.0, 0.0, 0.1]))
    brightness = draw(st.sampled_from([1.0, 10.0, 1e6]))

    def image(batch: Batch, renderers: SimpleNamespace) -> np.ndarray:
        with np.errstate(all="ignore"):
            lit = (batch.pixel * np.uint32(2654435761) >> np.uint32(8)) / 2.0**24 >= dark
            grey = scale * lit * np.where(renderers.noise(batch) < rare, brightness, 1.0)
            values = renderers.rgb(grey)
        values[renderers.noise(batch, 1) < bad, 1] = np.nan
        if 2 * np.isnan(values[:, 1]).sum() > len(values):
            values[:, 1] = 0
        return values  # type: ignore[no-any-return]

    return image


@given(sampler=samplers(), image=images(), order=st.integers(0, 2**32 - 1))
@exactly
def test_any_sampler(
    sampler: Sampler, image: Any, order: int, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    pixels = sampler.width * sampler.height
    total = max(1, math.floor(sampler.budget.spp * pixels + 0.5))  # type: ignore[operator]

    def checked(batch: Batch) -> np.ndarray:
        assert 0 < len(batch) <= total
        assert batch.pixel.max() < pixels
        assert np.isfinite(batch.positions).all()
        return image(batch, renderers)  # type: ignore[no-any-return]

    left = tools.shuffled(sampler, checked, np.random.default_rng(order))
    assert not left
    assert sampler.done == "spp"
    assert sampler.samples + sampler.rejected == total
    film = sampler.film
    assert film.samples.sum() == sampler.samples
    for name in ("mean", "plain_mean", "pool_mean", "strategy", "beta", "alpha"):
        picture = getattr(film, name)
        assert np.isfinite(picture).all(), name
        assert (picture >= 0).all(), name
    assert all(np.isfinite(half).all() and (half >= 0).all() for half in film.halves)
    error = film.standard_error
    assert not np.isnan(error).any()
    assert np.isinf(error[film.samples < 2]).all()
    np.testing.assert_allclose(film.alpha.sum(axis=2), 1, atol=1e-5)
    assert 0 <= sampler.visible_noise <= 1
    if sampler.config.pool_share == 1.0 and not sampler.rejected:
        assert film.samples.max() - film.samples.min() <= 1


@given(sampler=samplers(), data=st.data())
@exactly
def test_any_sampler_with_batches_lost(sampler: Sampler, data: Any, renderers: SimpleNamespace) -> None:
    """Dropped, put back or told, in any order: what is told in the end is the budget."""
    open_: list[Batch] = []
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    while not sampler.done:
        try:
            open_.append(sampler.ask())
        except RuntimeError:
            assert open_
        batch = open_.pop(rng.integers(len(open_)))
        action = rng.choice(["tell", "tell", "drop", "put_back"])
        if action == "tell":
            sampler.tell(batch, renderers.textured(batch))
        else:
            getattr(sampler, action)(batch)
    pixels = sampler.width * sampler.height
    assert sampler.done == "spp"
    assert sampler.samples == max(1, math.floor(sampler.budget.spp * pixels + 0.5))  # type: ignore[operator]
    assert sampler.film.samples.sum() == sampler.samples


# --- The film against the oracle -------------------------------------------------------------------------------------
@st.composite
def any_samplers(draw: Any) -> Sampler:
    """Any settings, or near a preset; with channels besides RGB, and where radiance may be negative, too."""
    preset = draw(st.sampled_from(["any", "default", "uniform", "paper", "unbiased"]))
    made = draw(samplers())
    config, size = made.config, (made.width, made.height)
    if preset != "any":
        radii = tuple(min(radius, float(max(size))) for radius in (5.0, 10.0, 50.0))
        changes = {name: getattr(config, name) for name in ("batch", "lookahead", "filter", "filter_radius")}
        config = {
            "default": Config,
            "uniform": Config.uniform,
            "paper": lambda **changes: Config.paper(*size, radii=radii, **changes),
            "unbiased": lambda **changes: Config(estimator="unbiased", **changes),
        }[preset](**changes)
    aovs, signed = draw(st.integers(0, 2)), draw(st.booleans())
    return Sampler(*size, made.budget, config, seed=made.seed, aovs=aovs, threads=1, signed=signed)


@st.composite
def radiances(draw: Any) -> Any:
    """Renderers: values over up to 60 powers of ten, of either sign, black, rare, NaN, infinite."""
    scale, spread = draw(st.integers(-40, 37)), draw(st.sampled_from([1.0, 8.0, 30.0, 60.0, 0.0]))
    dark, bad = draw(st.sampled_from([0.0, 0.0, 0.5, 0.97])), draw(st.sampled_from([0.0, 0.0, 0.1, 0.45]))
    negative = draw(shares)

    def radiance(batch: Batch, sampler: Sampler, renderers: SimpleNamespace) -> np.ndarray:
        largest = np.finfo(np.float32).max
        channels = 3 + sampler.aovs
        noise = np.stack([renderers.noise(batch, c) for c in range(channels)], axis=1)
        values = np.minimum(10.0 ** (scale + spread * (noise - 0.5)), largest)
        values[renderers.noise(batch, 21) < dark] = 0.0
        minus = renderers.noise(batch, 22) < negative
        values[minus, 0 if sampler.signed else 3 :] *= -1
        places = np.flatnonzero(renderers.noise(batch, 23) < bad)[: len(batch) // 2]
        values[places, places % channels] = np.resize([np.nan, np.inf, -np.inf], len(places))
        if not sampler.signed:
            below = places[places % 4 == 0]
            values[below, below % 3] = -(10.0**scale)
        return values.astype(np.float32)

    return radiance


def told(
    sampler: Sampler,
    oracle: Any,
    radiance: Any,
    data: Any,
    path: Path,
    renderers: SimpleNamespace,
    tools: SimpleNamespace,
) -> Any:
    """All batches of a budget told, lost and put back in any order, with a checkpoint somewhere; the oracle of them."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    truth, open_ = oracle(sampler), []
    saved = data.draw(st.none() | st.integers(0, sampler._native.total - 1))
    while not sampler.done:
        if saved is not None and sampler.samples + sampler.rejected >= saved:
            sampler.save(path)
            truth.check(sampler.film)
            sampler = truth.sampler = Sampler.load(path, threads=1)
            truth.check(sampler.film)
            saved = None
            open_.clear()  # they are asked again
        if (batch := tools.asked_or_taken(sampler, open_, rng, 0.6)) is None:
            continue
        action = rng.choice(["tell", "drop", "put_back"], p=[0.9, 0.05, 0.05])
        if action == "tell":
            values = radiance(batch, sampler, renderers)
            sampler.tell(batch, values)
            truth.add(batch, values)
        else:
            getattr(sampler, action)(batch)
            if action == "drop":
                truth.drop(batch)
    return truth


@pytest.fixture(scope="session")
def against_the_oracle(oracle: Any, renderers: SimpleNamespace, tools: SimpleNamespace, tmp_path_factory: Any) -> Any:
    """Checks a film that is `told` against the oracle."""

    def check(sampler: Sampler, radiance: Any, data: Any) -> None:
        state = tmp_path_factory.getbasetemp() / "state"
        truth = told(sampler, oracle, radiance, data, state, renderers, tools)
        assert truth.sampler.samples + truth.sampler.rejected == truth.sampler._native.total
        truth.check(truth.sampler.film)

    return check


@given(sampler=any_samplers(), radiance=radiances(), data=st.data())
@settings(exactly, max_examples=250)
def test_any_film(sampler: Sampler, radiance: Any, data: Any, against_the_oracle: Any) -> None:
    """Counts exactly, all pictures within the tolerances of `Oracle.check`."""
    against_the_oracle(sampler, radiance, data)


@pytest.mark.long
@given(sampler=any_samplers(), radiance=radiances(), data=st.data())
@settings(exactly, max_examples=5000, derandomize=False)
def test_any_film_at_length(sampler: Sampler, radiance: Any, data: Any, against_the_oracle: Any) -> None:
    against_the_oracle(sampler, radiance, data)
