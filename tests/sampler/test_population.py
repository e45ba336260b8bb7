"""The population's moves and its resampling. The members are read from what the sampler saves.

Statistical tests give their false-alarm rate; their seeds are fixed, so that they fail by a change alone. Each rejects
a broken variant of what it tests.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pmc_sampler import Batch, Budget, Config, Sampler, _core

RARE = 1e-6


def free(**changes: Any) -> Config:
    """One population that fills the batches, never culled."""
    settings: dict[str, Any] = {
        "lookahead": 0,
        "initial_spp": 0.0,
        "pool_share": 0.0,
        "direct_share": 0.0,
        "eliminate": 0.0,
        "evaluate_regenerated": False,
        "moves": 1,
    }
    return Config(**{**settings, **changes})


def steps(sampler: Sampler, image: Any, tools: SimpleNamespace, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the members before and after each of `count` iterations, (count, members, 2) float64."""
    batch = sampler.ask()
    before, after = [], []
    for _ in range(count):
        start = tools.members(sampler)
        sampler.tell(batch, image(batch))
        batch = sampler.ask()
        end = tools.members(sampler)
        before.append(np.stack([start["x"], start["y"]], axis=1))
        after.append(np.stack([end["x"], end["y"]], axis=1))
    return np.array(before, np.float64), np.array(after, np.float64)


# --- Moves (Equation 4) ----------------------------------------------------------------------------------------------
def test_moves_are_uniform_in_the_disk(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Chi-square over 8 rings of equal area in 16 sectors, away from the border: p < 1e-6. Negative controls: a radius
    uniform in [0, r), and steps turned towards one side.
    """
    radius = 7.0
    sampler = Sampler(200, 200, Budget(spp=9), free(population=20_000, radii=(radius,)), seed=1)
    start, end = steps(sampler, renderers.constant, tools, 2)
    inner = ((start > radius) & (start < 200 - radius)).all(axis=2)
    step = (end - start)[inner] / radius
    assert np.hypot(*step.T).max() < 1 + 1e-5

    def p_value(d: np.ndarray) -> float:
        ring = np.minimum((8 * (d**2).sum(axis=1)).astype(int), 7)
        sector = np.minimum((8 * (np.arctan2(d[:, 1], d[:, 0]) / np.pi + 1)).astype(int), 15)
        return float(stats.chisquare(np.bincount(ring * 16 + sector, minlength=128)).pvalue)

    assert len(step) > 30_000
    assert p_value(step) > RARE
    assert p_value(step * np.hypot(*step.T)[:, None]) < RARE
    assert p_value(step + np.array([0.02, 0.0])) < RARE


def reflected(x: np.ndarray, size: float) -> np.ndarray:
    """Triangle wave of period 2 size: the twin of the core's `reflect`."""
    x = np.abs(x) % (2 * size)
    return np.where(x < size, x, 2 * size - x)


def test_reflection_equals_its_twin() -> None:
    """Exact but for the last bit of a float; the result is always inside."""
    rng = np.random.default_rng(4)
    for size in (1.0, 12.0, 640.0, 65535.0):
        x = np.concatenate([rng.uniform(-5 * size, 5 * size, 2000), [0.0, -0.0, size, -size, 2 * size, -1e-30]])
        x = x.astype(np.float32).astype(np.float64)
        core = np.array([_core.reflect(float(value), size) for value in x])
        assert (core >= 0).all()
        assert (core < size).all()
        np.testing.assert_allclose(core, reflected(x, size), rtol=0, atol=size * 2.0**-22)


def test_moves_reflect_at_borders_and_corners(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """From near a corner of an image little larger than the kernel, nearly every move may cross a border, many two. The
    members' pixels against the density folded in NumPy, from where each began: chi-square, p < 1e-6 at most (counts of
    different starts vary less than a multinomial's). Negative controls: clipping at the border, a torus.
    """
    size, radius = 12, 5.0
    sampler = Sampler(size, size, Budget(spp=10_000), free(population=144, radii=(radius,), batch=144), seed=2)
    start, end = (a.reshape(-1, 2) for a in steps(sampler, renderers.constant, tools, 120))
    near = (start < 5).all(axis=1)
    start, end = start[near], end[near]
    # 256 points of equal area that fill the disk in a sunflower spiral, turned at random for each start.
    k = np.arange(256) + 0.5
    turn = np.random.default_rng(0).uniform(0, 2 * np.pi, (len(start), 1))
    angle, length = 2.399963 * k + turn, radius * np.sqrt(k / 256)
    x, y = start[:, :1] + length * np.cos(angle), start[:, 1:] + length * np.sin(angle)

    def cells(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.bincount((y.astype(int) * size + x.astype(int)).ravel(), minlength=size * size)

    def p_value(fold: Any) -> float:
        expected, observed = cells(fold(x), fold(y)) / 256, cells(*end.T)
        rare = expected < 5
        expected = np.append(expected[~rare], expected[rare].sum() + 1e-9)
        observed = np.append(observed[~rare], observed[rare].sum())
        return float(stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue)

    assert len(start) > 2500
    assert p_value(lambda v: reflected(v, size)) > RARE
    assert p_value(lambda v: np.clip(v, 0, size - 1e-6)) < RARE
    assert p_value(lambda v: v % size) < RARE


def test_moves_form_a_chain(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """T_R = 4 steps, each from the end of the last: variance T_R r^2 / 4 in x and y, within 5 standard errors (a false
    alarm in 10^6). The negative control is the variance of one step.
    """
    sampler = Sampler(200, 200, Budget(spp=90), free(population=20_000, radii=(3.0,), moves=4), seed=1)
    start, end = steps(sampler, renderers.constant, tools, 1)
    inner = ((start > 13) & (start < 187)).all(axis=2)
    squares = ((end - start)[inner] ** 2).ravel()
    error = squares.std() / np.sqrt(len(squares))
    assert abs(squares.mean() - 4 * 9 / 4) < 5 * error
    assert abs(squares.mean() - 9 / 4) > 5 * error


def test_kernels_are_drawn_by_alpha(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """With three radii, alike at first: chi-square of their numbers at p < 1e-6, the negative control being alpha of
    0.35, 0.33, 0.32. Each sample of the batch lies where its member went, tagged with a radius that reaches that far.
    """
    radii = (0.5, 3.0, 9.0)
    sampler = Sampler(200, 150, Budget(spp=90), free(population=30_000, radii=radii), seed=1)
    start, _ = steps(sampler, renderers.constant, tools, 1)
    place, kernel = tools.proposals(sampler)
    chosen = kernel[place]
    assert stats.chisquare(np.bincount(chosen, minlength=3)).pvalue > RARE
    assert stats.chisquare(np.bincount(chosen, minlength=3), 30_000 * np.array([0.35, 0.33, 0.32])).pvalue < RARE
    end = tools.members(sampler)
    step = np.hypot(end["x"] - start[0, :, 0], end["y"] - start[0, :, 1])
    assert (step <= np.array(radii)[chosen] * 1.0001).all()
    slot = sampler._native.save()["untold0.pixel"].view(np.uint32)
    assert np.array_equal(slot[place], end["y"].astype(np.uint32) * 200 + end["x"].astype(np.uint32))


# --- Statistics (4.1) and resampling (4.3.1) -------------------------------------------------------------------------
def test_members_know_their_samples(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Mean and squared deviations of each member's luminances, over all and for each kernel, against NumPy's."""
    sampler = Sampler(40, 30, Budget(spp=900), free(population=50, radii=(1.0, 4.0), moves=6), seed=3)
    seen: list[list[tuple[float, int]]] = [[] for _ in range(50)]
    for _ in range(5):
        batch = sampler.ask()
        place, kernel = tools.proposals(sampler)
        radiance = renderers.textured(batch)
        y = radiance @ np.array([0.2126, 0.7152, 0.0722])
        for proposal, i in enumerate(place):
            seen[proposal // 6].append((y[i], int(kernel[i])))
        sampler.tell(batch, radiance)
    for member, samples in zip(tools.members(sampler), seen, strict=True):
        assert member["rounds"] == 5
        for kernel_, running in ((None, member["all"]), (0, member["kernel"][0]), (1, member["kernel"][1])):
            values = np.array([y for y, k in samples if kernel_ in (None, k)])
            assert running["n"] == len(values)
            assert running["mean"] == pytest.approx(values.mean(), rel=1e-5)
            assert running["m2"] == pytest.approx(((values - values.mean()) ** 2).sum(), rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("by_pool", [0.0, 0.5, 1.0])
def test_members_are_evaluated_where_they_are_put(by_pool: float, renderers: Any, tools: Any) -> None:
    """Each regenerated member's own sample lies in its pixel, whether beta or the pool put it there."""
    config = free(population=200, moves=0, evaluate_regenerated=True, eliminate=0.4, regenerate_pool=by_pool)
    sampler = Sampler(40, 30, Budget(spp=20), config, seed=3)
    for _ in range(8):
        batch = sampler.ask()
        evaluated = sampler._native.save()["untold0.evaluated"].view(np.uint32)
        found, (place, kernel) = tools.members(sampler)[evaluated], tools.proposals(sampler)
        assert len(place) == len(evaluated) > 0
        assert np.array_equal(batch.pixel[place], found["y"].astype(int) * 40 + found["x"].astype(int))
        assert (kernel[place] == 3).all()
        sampler.tell(batch, renderers.textured(batch))
        told = renderers.textured(batch)[place] @ np.array([0.2126, 0.7152, 0.0722])
        np.testing.assert_allclose(tools.members(sampler)["all"]["mean"][evaluated], told, rtol=1e-5)


def graded(renderers: SimpleNamespace) -> Any:
    """Three stripes of one mean, the left without noise, the others of noise that differs thirtyfold."""

    def render(batch: Batch) -> np.ndarray:
        strength = np.array([0.0, 0.03, 1.0])[batch.pixel % 120 // 40]
        return renderers.rgb(1.0 + strength * (renderers.noise(batch) - 0.5))  # type: ignore[no-any-return]

    return render


def weights(found: np.ndarray) -> np.ndarray:
    """w = var / N_used (4.3.1)."""
    n = found["all"]["n"].astype(np.float64)
    return found["all"]["m2"] / np.maximum(n - 1, 1) / np.maximum(found["rounds"], 1)


def culled(
    eliminate: float, renderers: SimpleNamespace, tools: SimpleNamespace, iterations: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """3000 members before they are culled once more, and which of them survive that."""
    config = free(population=3000, radii=(0.5,), moves=4, eliminate=eliminate, regenerate_pool=1.0)
    sampler = Sampler(120, 100, Budget(spp=90), config, seed=6)
    for _ in range(iterations):
        batch = sampler.ask()
        sampler.tell(batch, graded(renderers)(batch))
    before = tools.members(sampler).copy()
    sampler.ask()
    return before, tools.members(sampler)["rounds"] > 0


@pytest.mark.parametrize("eliminate", [0.0, 0.25, 0.4, 0.5, 0.9, 1.0])
def test_as_many_are_culled_as_asked_for(eliminate: float, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Exactly; and those of no weight survive only where all others do."""
    before, survives = culled(eliminate, renderers, tools)
    weight = weights(before)
    assert survives.sum() == round((1 - eliminate) * 3000)
    weightless = weight < 1e-10
    assert 900 < weightless.sum() < 1100
    if survives.sum() <= (~weightless).sum():
        assert not survives[weightless].any()
    else:
        assert survives[~weightless].all()


@pytest.mark.parametrize("iterations", [1, 5])
def test_survivors_are_drawn_by_weight(iterations: int, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """A fifth survives, drawn without replacement in proportion to w = var / N_used: the number of survivors in each
    class of weight, and of N_used, is within 5 standard deviations of 200 such draws by NumPy (a false alarm in 10^5
    over the classes). Negative controls: survivors drawn regardless of weight, and in proportion to var alone.
    """
    before, survives = culled(0.8, renderers, tools, iterations)
    weight, rng = weights(before), np.random.default_rng(5)
    weight = np.where(weight > 1e-10, weight, 0)
    strata = np.digitize(weight, np.quantile(weight[weight > 0], [0.25, 0.5, 0.75, 0.9]))
    classes = strata * 2 + (before["rounds"] > 1)

    def counted(chosen: np.ndarray) -> np.ndarray:
        return np.bincount(classes[chosen], minlength=10)

    def drawn(w: np.ndarray) -> np.ndarray:
        return counted(rng.choice(3000, survives.sum(), replace=False, p=w / w.sum()))

    expected = np.array([drawn(weight) for _ in range(200)])
    deviation = np.maximum(expected.std(axis=0), 0.5)

    def stands_out(found: np.ndarray) -> bool:
        return bool((abs(found - expected.mean(axis=0)) > 5 * deviation).any())

    assert not stands_out(counted(survives))
    assert stands_out(drawn(np.ones(3000)))
    if iterations > 1:
        assert (before["rounds"] > 1).sum() > 300
        assert stands_out(drawn(weight * before["rounds"]))


@pytest.mark.parametrize("jitter", [0.0, 1.0, 4.0])
def test_the_replaced_go_where_beta_is(jitter: float, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Members regenerated from beta are in pixels of positive beta, or as far from one as the jitter reaches."""
    config = Config(
        lookahead=0, direct_share=0.0, moves=0, eliminate=1.0, initial_spp=4.0, regenerate_jitter=jitter, pool_share=0.1
    )
    sampler = Sampler(64, 32, Budget(spp=9), config, seed=5)
    while sampler.samples < 8 * 64 * 32:
        batch = sampler.ask()
        sampler.tell(batch, renderers.right_half(64)(batch))
    x = tools.members(sampler)["x"]
    assert len(x) > 500
    assert x.min() >= 32 - jitter
    if jitter:
        assert x.min() < 32
