"""What steers the sampler: draws from beta, the kernel weights alpha and their memory; and the pixel filters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pmc_sampler import Batch, Budget, Config, Sampler, _core

RARE = 1e-6


# --- Systematic draws from beta (4.3.2) ------------------------------------------------------------------------------
def drawn(sampler: Sampler) -> np.ndarray:
    """Samples of the next batch in each pixel, which stays open."""
    return np.bincount(sampler.ask().pixel, minlength=sampler.width * sampler.height)


@pytest.mark.parametrize("size", [(40, 30), (330, 260)])
@pytest.mark.parametrize("power", [0.25, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("how", ["direct", "members", "both"])
def test_draws_follow_beta(how: str, power: float, size: tuple[int, int], renderers: Any) -> None:
    """Systematic sampling: each pixel is drawn as often as its share of beta^power says, to less than one time; two
    samples of that kind, members and direct draws, to less than two.
    """
    pixels = size[0] * size[1]
    direct, batch_size = {"direct": (1.0, 5 * pixels), "members": (0.0, pixels), "both": (0.5, 2 * pixels)}[how]
    config = Config(
        batch=batch_size,
        direct_share=direct,
        moves=0,
        eliminate=1.0,
        pool_share=0.0,
        initial_spp=4.0,
        lookahead=0,
        beta_power=power,
    )
    sampler = Sampler(*size, Budget(spp=50), config, seed=5)
    while sampler.samples < 6 * pixels:
        batch = sampler.ask()
        sampler.tell(batch, renderers.textured(batch))
    weight = sampler.film.beta.ravel().astype(np.float64) ** power
    count = drawn(sampler)
    assert count.sum() == batch_size
    expected = batch_size * weight / weight.sum()
    assert abs(count - expected).max() < (2 if how == "both" else 1) + 1e-3
    if how == "direct":  # the negative control: were it beta to another power, more than once
        other = weight**1.3
        assert abs(count - batch_size * other / other.sum()).max() > 1.1


@pytest.mark.parametrize("every", [1, 2, 5])
@pytest.mark.parametrize("rule", ["gain", "variance"])
def test_draws_follow_beta_between_adaptations(rule: str, every: int, renderers: Any) -> None:
    """With beta adapted now and then only, its variances stay what they were, and the counts of samples go on."""
    config = Config(
        batch=1200,  # whole passes, where the pool fills in before beta is known
        direct_share=1.0,
        pool_share=0.0,
        initial_spp=4.0,
        lookahead=0,
        beta=rule,
        beta_power=1.0,
        adapt_beta_every=every,
    )
    sampler = Sampler(40, 30, Budget(spp=30), config, seed=5)
    known = 0
    while not sampler.done:
        weight = sampler.film.beta.ravel().astype(np.float64)
        adapts = sampler.samples >= 4800 and weight.sum() > 0
        batch = sampler.ask()
        if adapts:
            count = np.bincount(batch.pixel, minlength=1200)
            assert abs(count - len(batch) * weight / weight.sum()).max() < 1.001
            known += 1
        sampler.tell(batch, renderers.textured(batch))
    assert known > 8


def test_samples_under_way_count_as_taken(renderers: Any) -> None:
    """With three batches ahead, batch k is drawn from what batches up to k - 4 told, and as if the samples of the three
    between were taken: by var / (tvi^2 (n + under way)^2). The negative control is beta as it was.
    """
    config = Config(batch=1200, direct_share=1.0, pool_share=0.0, initial_spp=4.0, lookahead=3, beta_power=1.0)
    sampler = Sampler(40, 30, Budget(spp=20), config, seed=5)
    counts: list[np.ndarray] = []
    films: list[tuple[np.ndarray, np.ndarray]] = []
    while not sampler.done:
        batch = sampler.ask()
        counts.append(np.bincount(batch.pixel, minlength=1200))
        sampler.tell(batch, renderers.textured(batch))
        films.append((sampler.film.beta.ravel().astype(np.float64), sampler.film.samples.ravel().astype(np.float64)))
    surprised = 0
    for k in range(
        12, len(counts)
    ):  # by then the samples of the pool, four a pixel and four while beta is unknown, are told
        beta, n = films[k - 4]
        weight = beta * n**2 / (n + sum(counts[k - 3 : k])) ** 2
        assert abs(counts[k] - 1200 * weight / weight.sum()).max() < 1.001
        surprised += abs(counts[k] - 1200 * beta / beta.sum()).max() > 1.5
    assert surprised > 4


def textured_sampler(config: Config, renderers: SimpleNamespace) -> tuple[Sampler, np.ndarray]:
    """A sampler of 10x10 pixels that was told 8 samples a pixel, and beta of each pixel."""
    sampler = Sampler(10, 10, Budget(spp=50), config, seed=5)
    while sampler.samples < 800:
        batch = sampler.ask()
        sampler.tell(batch, renderers.textured(batch))
    return sampler, sampler.film.beta.ravel().astype(np.float64)


def test_draws_are_unbiased(renderers: SimpleNamespace) -> None:
    """Over random offsets the mean count of every pixel is its share: 600 draws of 37 from 100 pixels, each pixel
    within 5.5 standard errors (a false alarm in 2 x 10^5). The negative control is an offset that is always 0.5.

    With beta = var / tvi a batch that is dropped leaves beta as it was, so that every draw is from the same density.
    """
    config = Config(
        direct_share=1.0, pool_share=0.0, initial_spp=8.0, lookahead=0, batch=37, beta="variance", beta_power=1.0
    )
    sampler, weight = textured_sampler(config, renderers)
    share = 37 * weight / weight.sum()
    counts = []
    for _ in range(600):
        batch = sampler.ask()
        counts.append(np.bincount(batch.pixel, minlength=100))
        sampler.drop(batch)
        assert np.array_equal(sampler.film.beta.ravel(), weight.astype(np.float32))
    fraction = share % 1
    error = np.sqrt(fraction * (1 - fraction) / 600) + 1e-9
    assert (abs(np.mean(counts, axis=0) - share) < 5.5 * error).all()
    # Slots run through the tile row by row, as pixels do on an image narrower than a tile.
    fixed = np.bincount(np.searchsorted(np.cumsum(share), np.arange(37) + 0.5), minlength=100)
    assert (abs(fixed - share) > 5.5 * error).any()


def test_members_are_regenerated_without_bias(renderers: SimpleNamespace, tools: Any) -> None:
    """The same for 37 members that are put at some of 337 draws: each pixel's mean count over 600 batches within 5.5
    standard errors of its share. The negative control puts them at every ninth draw from the same one on.
    """
    config = Config(
        direct_share=0.82,
        pool_share=0.0,
        initial_spp=8.0,
        population=37,
        moves=1,
        radii=(0.001,),
        eliminate=1.0,
        beta="variance",
        beta_power=1.0,
    )
    sampler, weight = textured_sampler(config, renderers)
    share = 37 * weight / weight.sum()
    counts = []
    for _ in range(600):
        batch = sampler.ask()
        members = tools.members(sampler)
        assert len(members) == 37
        counts.append(np.bincount(members["y"].astype(int) * 10 + members["x"].astype(int), minlength=100))
        sampler.drop(batch)
    assert 330 < len(batch) - 2 * 37 < 345
    error = np.sqrt(np.maximum(share % 1 * (1 - share % 1), 0.01) / 600)
    assert (abs(np.mean(counts, axis=0) - share) < 5.5 * error).all()
    fixed = np.bincount(np.searchsorted(np.cumsum(share), np.arange(37) + 0.5), minlength=100)
    assert (abs(fixed - share) > 5.5 * error).any()


# --- alpha (4.3.3) ---------------------------------------------------------------------------------------------------
def free(**changes: Any) -> Config:
    settings: dict[str, Any] = {
        "lookahead": 0,
        "initial_spp": 0.0,
        "pool_share": 0.0,
        "direct_share": 0.0,
        "eliminate": 0.0,
        "evaluate_regenerated": False,
        "adapt_alpha_every": 1,
    }
    return Config(**{**settings, **changes})


def adapted(found: np.ndarray, kernels: int, floor: float) -> np.ndarray:
    """alpha_k = floor / K + (1 - floor) share_k, the share of 1 / var_k among kernels with two samples or more; the
    others keep what they had.
    """
    result = np.zeros((len(found), 3))
    for member, alpha in zip(found, result, strict=True):
        n, m2 = member["kernel"]["n"][:kernels].astype(float), member["kernel"]["m2"][:kernels].astype(float)
        before = member["alpha"][:kernels].astype(float)
        known = n >= 2
        variance = np.where(known, m2 / np.maximum(n - 1, 1), 0)
        inverse = np.where(variance > 0, 1 / np.where(variance > 0, variance, 1), 0)
        if inverse.sum() == 0:
            alpha[:kernels] = before if not known.any() else 1 / kernels
            continue
        share = np.where(known, inverse / inverse.sum() * before[known].sum(), before)
        alpha[:kernels] = floor / kernels + (1 - floor) * share
    return result


@pytest.mark.parametrize("floor", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("moves", [2, 9])
def test_alpha_follows_its_equation(floor: float, moves: int, renderers: Any, tools: Any) -> None:
    """Against NumPy, from the members' own statistics; it sums to one, and no kernel falls below its floor."""
    radii = (0.5, 2.0, 6.0)
    sampler = Sampler(48, 40, Budget(spp=90), free(radii=radii, population=300, moves=moves, alpha_floor=floor), seed=3)
    image = renderers.right_half(48)  # black on the left: no variance there
    batch = sampler.ask()
    seen_unknown = seen_flat = False
    for _ in range(4):
        sampler.tell(batch, image(batch))
        before = tools.members(sampler).copy()
        batch = sampler.ask()
        alpha = tools.members(sampler)["alpha"]
        np.testing.assert_allclose(alpha, adapted(before, 3, floor), atol=2e-6)
        np.testing.assert_allclose(alpha.sum(axis=1), 1.0, atol=1e-6)
        assert alpha.min() >= floor / 3 - 1e-6
        seen_unknown |= bool((before["kernel"]["n"] < 2).any())
        seen_flat |= bool((before["kernel"]["m2"].sum(axis=1) == 0).any())
    assert seen_unknown or moves == 9
    assert seen_flat


def test_regenerated_members_start_from_what_is_remembered(renderers: Any, tools: Any) -> None:
    """Exactly: a member put anew has the alpha of the film at its place; with no memory, equal weights, though the film
    shows what others learned. The kernels are so small that members stay where they were put, or all but.
    """

    def image(batch: Batch) -> np.ndarray:
        return renderers.rgb(1 + (batch.pixel % 48 > 24) * renderers.noise(batch))  # type: ignore[no-any-return]

    for memory in (0.25, 1.0, 0.0):
        config = free(
            radii=(0.001, 0.002), population=600, moves=8, eliminate=0.5, regenerate_pool=0.5, alpha_memory=memory
        )
        sampler = Sampler(48, 40, Budget(spp=200), config, seed=3)
        for _ in range(4):
            batch = sampler.ask()
            sampler.tell(batch, image(batch))
        sampler.ask()
        found, film = tools.members(sampler), sampler.film.alpha
        new = found[found["rounds"] == 0]
        inside = (abs(new["x"] % 8 - 4) < 3.5) & (abs(new["y"] % 8 - 4) < 3.5)
        x, y = new["x"][inside].astype(int), new["y"][inside].astype(int)
        assert len(x) > 100
        assert np.array_equal(new["alpha"][inside, :2], film[y, x] if memory else np.full((len(x), 2), 0.5, np.float32))
        assert abs(film - 0.5).max() > 0.05
        np.testing.assert_allclose(film.sum(axis=2), 1.0, atol=1e-6)


def test_alpha_turns_to_small_radii_at_edges(renderers: Any) -> None:
    """A kernel that reaches across an edge sees variance, a small one sees less. Remembered alpha of the small radius
    beside edges 64 pixels apart against that between them, in standard errors over 768 cells of 8x8 pixels of each:
    above 5 (a false alarm in 10^6). The negative control, an image without edges, stays within 5.
    """
    config = free(
        radii=(0.5, 12.0), population=3000, moves=16, eliminate=1.0, regenerate_pool=1.0, evaluate_regenerated=True
    )

    def difference(bright: float) -> float:
        def image(batch: Batch) -> np.ndarray:
            stripe = np.where(batch.pixel // 64 % 2 == 0, 1.0, bright)
            return renderers.rgb(stripe + 0.2 * renderers.noise(batch))  # type: ignore[no-any-return]

        near, far = [], []
        column = np.arange(32) % 8
        for seed in range(4):
            sampler = Sampler(256, 192, Budget(spp=24), config, seed=seed)
            sampler.run(image)
            small = sampler.film.alpha[::8, ::8, 0]
            near.append(small[:, (column == 0) | (column == 7)])
            far.append(small[:, (column == 3) | (column == 4)])
        error = np.hypot(np.std(near), np.std(far)) / np.sqrt(np.size(near))
        return float((np.mean(near) - np.mean(far)) / error)

    assert difference(10.0) > 5
    assert abs(difference(1.0)) < 5


# --- Pixel filters ---------------------------------------------------------------------------------------------------
def density(name: str, x: np.ndarray) -> np.ndarray:
    """Unnormalised, at x in [-1, 1] of the radius."""
    if name == "tent":
        return 1 - abs(x)
    if name == "gaussian":  # of standard deviation 1/4, lowered to be 0 at the radius
        return np.exp(-8 * x**2) - np.exp(-8)
    if name == "blackman-harris":
        t = np.pi * (x + 1)
        return 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    return np.ones_like(x)


def cumulative(name: str) -> Any:
    """Its distribution function on [-1, 1], by the trapezoid rule on 2^16 steps."""
    x = np.linspace(-1, 1, 2**16 + 1)
    f = density(name, x)
    total = np.concatenate([[0.0], np.cumsum((f[1:] + f[:-1]) / 2)])
    return lambda at: np.interp(at, x, total / total[-1])


FILTERS = ["box", "tent", "gaussian", "blackman-harris"]


@pytest.mark.parametrize("radius", [0.5, 2.0])
@pytest.mark.parametrize("name", FILTERS)
def test_filter_inverts_its_distribution(name: str, radius: float) -> None:
    """F(offset(u)) = u to 10^-4, for all u up to the largest float below 1."""
    u = np.concatenate([np.linspace(0, 1, 5001)[:-1], [2.0**-24, 1 - 2.0**-24]])
    native = getattr(_core.Filter, name.replace("-", "_"))
    offset = np.array(_core.filter_offset(native, radius, u.tolist())) / radius
    assert abs(cumulative(name)(offset) - u).max() < 1e-4
    assert abs(offset).max() <= 1


@pytest.mark.parametrize("name", FILTERS)
def test_places_follow_the_filter(name: str) -> None:
    """The first samples of 90000 pixels in x and in y against the density of each filter: chi-square over 40 cells of
    equal probability, p < 1e-6, for its own, and rejected for every other.
    """
    config = Config.uniform(filter=name, filter_radius=1.5, batch=2**31)
    batch = Sampler(300, 300, Budget(spp=1), config, seed=2).ask()
    offset = batch.positions - (np.stack([batch.pixel % 300, batch.pixel // 300], axis=1) + 0.5)

    def p_value(axis: int, other: str) -> float:
        u = cumulative(other)(offset[:, axis].astype(np.float64) / 1.5)
        return float(stats.chisquare(np.bincount(np.minimum((u * 40).astype(int), 39), minlength=40)).pvalue)

    for axis in (0, 1):
        for other in FILTERS:
            assert (p_value(axis, other) > RARE) == (other == name)


@pytest.mark.parametrize("rare", [False, True])
def test_batches_grow_where_steering_goes_everywhere(rare: bool, renderers: SimpleNamespace) -> None:
    """From an eighth of a sample a pixel to a whole; where one sample in 500 is bright they stay small, for beta is
    that of the pixels that have just met one.
    """

    def radiance(batch: Batch) -> np.ndarray:
        noise = renderers.noise(batch)
        return renderers.rgb(1.0 + (100.0 * (noise < 0.002) if rare else noise))  # type: ignore[no-any-return]

    sampler = Sampler(256, 128, Budget(spp=40), seed=1)
    sizes = []
    while not sampler.done:
        batch = sampler.ask()
        sizes.append(len(batch))
        sampler.tell(batch, radiance(batch))
    assert set(sizes[:4]) == {256 * 128}  # the pilot
    assert 256 * 128 // 8 <= sizes[4] < 256 * 128 // 4
    assert sizes[-2] == (256 * 128 // 8 if rare else 256 * 128)
