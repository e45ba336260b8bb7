"""Numbers at their extremes: long sums, the whole range of floats, one pixel or sample that outshines all others, the
largest images. Exact, or within a stated rounding; what is drawn at random is held to its density by chi-square tests
that fail once in a million.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Sampler, _core, luminance, tvi

ALARM = 1e-6


def chi_square_p(observed: np.ndarray, expected: np.ndarray) -> float:
    """p-value by the normal approximation of Wilson and Hilferty (1931); expected counts of 10 and more."""
    assert expected.min() >= 10
    k = len(observed) - 1
    statistic = float(((observed - expected) ** 2 / expected).sum())
    z = ((statistic / k) ** (1 / 3) - (1 - 2 / (9 * k))) / math.sqrt(2 / (9 * k))
    return 0.5 * math.erfc(z / math.sqrt(2))


# --- Sums ------------------------------------------------------------------------------------------------------------
def values(kind: str, scale: float) -> np.ndarray:
    """10000 float32 to be told over and over."""
    rng = np.random.default_rng(5)
    made = {
        "constant": np.full(10_000, 0.7),
        "alternating": np.tile([0.1, 3.7], 5000),
        "sorted": np.sort(rng.random(10_000)),
        "sorted, falling": -np.sort(-rng.random(10_000)),
        "heavy tail": np.minimum((1 - rng.random(10_000)) ** -1.2, 1e5),
        "large mean, tiny spread": 1 + np.spacing(np.float32(1)) * rng.integers(0, 4, 10_000),
    }
    return (scale * made[kind]).astype(np.float32)


KINDS = ["constant", "alternating", "sorted", "sorted, falling", "heavy tail", "large mean, tiny spread"]


def told(program: Path, folder: Path, numbers: np.ndarray, *arguments: int) -> np.ndarray:
    (folder / "values").write_bytes(numbers.tobytes())
    command = [program, "film", folder / "values", *map(str, arguments)]
    return np.array(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split(), float)


@pytest.mark.needs("c++")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("samples", "batch"),
    [(10**6, 4096), (10**6, 1), pytest.param(10**8, 4096, marks=pytest.mark.long)],
)
def test_sums_of_many_samples(
    samples: int, batch: int, kind: str, build: Callable[[str, list[str]], Path], tmp_path: Path
) -> None:
    """Mean and variance in one pixel, the pool's mean too, to 1e-6 of exact sums for radiance of 1e-12, 1 and 1e12;
    halves to 1e-4, for they are kept as floats. Orders that are sorted tell each value many times in a row.
    """
    program = build("tests/sampler/numbers.cpp", ["-O2"])
    times = samples // 10_000
    each, cycles = (times, 1) if kind.startswith("sorted") else (1, times)
    for scale in (1e-12, 1.0, 1e12):
        numbers = values(kind, scale)
        exact = numbers.astype(np.float64)
        mean = math.fsum(exact) / len(exact)
        variance = math.fsum((exact - mean) ** 2) / len(exact)
        factor = np.array([1, 0.5, 2])
        result = told(program, tmp_path, numbers, each, cycles, batch)
        assert result[0] == samples
        np.testing.assert_allclose(result[1:4], mean * factor, rtol=1e-6)
        grey = float(luminance(factor))
        expected = variance * np.array([*factor**2, grey**2])
        if kind == "constant":
            assert (result[4:8] == 0).all()
        else:
            np.testing.assert_allclose(result[4:8], expected, rtol=1e-6)
        np.testing.assert_allclose(result[8:11], mean * factor, rtol=1e-6)
        # The first half of an alternating sequence is its first value.
        half = float(exact[0]) if kind == "alternating" else mean if each > 1 else math.fsum(exact[::2]) / 5000
        np.testing.assert_allclose(result[11:14], half * factor, rtol=1e-4)


@pytest.mark.needs("c++")
@pytest.mark.parametrize("updates", [10**6, pytest.param(10**9, marks=pytest.mark.long)])
def test_sums_of_beta(updates: int, build: Callable[[str, list[str]], Path]) -> None:
    """The weights of all tiles and their total, to 1e-6 of the sums over their pixels; brightness over 1e24."""
    command = [build("tests/sampler/numbers.cpp", ["-O2"]), "beta", str(updates)]
    samples, error = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert int(samples) >= updates
    assert 0 < float(error) < 1e-6


# --- tvi and luminance -----------------------------------------------------------------------------------------------
def test_tvi_and_its_table_over_all_floats() -> None:
    """Every 4099th float from 0 to infinity: both are finite, positive and within 6 % of one another; no NaN enters."""
    bits = np.arange(0, 0x7F800000, 4099, dtype=np.uint32)
    floats = np.append(bits.view(np.float32), np.finfo(np.float32).max).astype(np.float64)
    threshold = tvi(floats)
    assert (threshold >= 10**-2.861).all()
    assert np.isfinite(threshold).all()
    some = floats[::37]
    table = np.array([_core.inverse_square_tvi(value) for value in some])
    exact = threshold[::37] ** -2
    normal = exact > 1e-37  # below lie the denormals of the table's floats
    np.testing.assert_allclose(table[normal], exact[normal], rtol=0.06)
    assert ((table >= 0) & np.isfinite(table)).all()


def test_luminance_over_all_floats() -> None:
    """Greys keep their value; no overflow at the largest, and at least 0 at the smallest."""
    grey = np.append(np.arange(0, 0x7F800000, 65537, dtype=np.uint32).view(np.float32), np.finfo(np.float32).max)
    y = luminance(np.repeat(grey[:, None], 3, axis=1).astype(np.float64))
    np.testing.assert_allclose(y, grey.astype(np.float64), rtol=1e-15)
    assert (luminance(np.full((1, 3), np.inf)) == np.inf).all()


# --- Radiance at its extremes ----------------------------------------------------------------------------------------
WIDTH, HEIGHT = 48, 40


def rendered(
    change: Callable[[Batch, np.ndarray], None], renderers: Any, spp: float = 32, seed: int = 4, **settings: Any
) -> Sampler:
    def radiance(batch: Batch) -> np.ndarray:
        made = renderers.rgb(0.5 + renderers.noise(batch))
        change(batch, made)
        return made  # type: ignore[no-any-return]

    sampler = Sampler(WIDTH, HEIGHT, Budget(spp=spp), Config(**settings), seed=seed)
    sampler.run(radiance)
    return sampler


PLACES = {"corner": 0, "border": WIDTH // 2, "middle": 20 * WIDTH + 24, "last": WIDTH * HEIGHT - 1}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("index", [0, 1, 2, 5])
def test_a_speck_leaves_the_rest_alone(index: int, place: str, renderers: SimpleNamespace) -> None:
    """One sample of 1e30, of the pool or not: all other pixels change by 5 % at most by the correction, the film's sums
    not at all, and the image keeps the pool's energy.
    """

    def speck(batch: Batch, radiance: np.ndarray) -> None:
        radiance[(batch.pixel == PLACES[place]) & (batch.index == index)] = 1e30

    film = rendered(speck, renderers).film
    rest = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) != PLACES[place]
    ratio = film.mean[rest] / film.plain_mean[rest]
    assert abs(ratio - 1).max() < 0.05
    assert film.plain_mean[rest].max() < 3
    assert film.plain_mean[~rest].min() > 1e26
    assert np.isfinite(film.standard_error[rest]).all()
    np.testing.assert_allclose(film.mean.sum((0, 1), np.float64), film.pool_mean.sum((0, 1), np.float64), rtol=1e-5)


def test_next_to_no_weight_before_the_first_draw() -> None:
    """The first tile's weight is so small that it vanishes in the place of the first draw, and the pixel after it has
    none: there was one draw too many once, beyond the memory for them. With this seed the offset of the draws is 0,
    as in one batch of 2^24. Counts are exact; what was beyond the memory a sanitizer sees (`.ci/sanitize`).
    """

    def radiance(batch: Batch) -> np.ndarray:
        u = np.random.default_rng(batch.number).random(len(batch), np.float32)
        values = np.where(batch.pixel % 32 < 16, 1e-9 * u, np.where(batch.pixel == 16, 0.0, u))
        return np.repeat(values[:, None], 3, axis=1).astype(np.float32)

    sampler = Sampler(32, 16, Budget(spp=64), Config(initial_spp=4), seed=125821, threads=1)
    sampler.run(radiance)
    assert sampler.samples == 64 * 32 * 16
    assert sampler.film.samples.sum() == sampler.samples


@pytest.mark.parametrize("value", [1e18, 1e20, 1e30, 3e38])
def test_a_speck_draws_no_more_than_noise_where_the_image_is_unbiased(value: float, renderers: SimpleNamespace) -> None:
    """A sample of the pool whose square no float can hold. It raises its neighbours' share, as one of 1e12 does; an
    earlier sum became infinite, beta NaN, and one pixel took a third of all samples.
    """

    def speck(batch: Batch, radiance: np.ndarray) -> None:
        radiance[(batch.pixel == PLACES["middle"]) & (batch.index == 1)] = value

    film = rendered(speck, renderers, estimator="unbiased").film
    assert np.isfinite(film.beta).all()
    assert film.samples.max() < 100
    assert film.samples.min() >= 12


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("times", [1e2, 1e3, 1e5, 1e10, 1e20, 1e35])
def test_one_pixel_outshines_all_others(times: float, place: str, renderers: SimpleNamespace) -> None:
    """The energy is the pool's, nothing is lost or NaN, and no neighbour changes by more than it may."""

    def hot(batch: Batch, radiance: np.ndarray) -> None:
        radiance[batch.pixel == PLACES[place]] *= np.float32(times)

    film = rendered(hot, renderers, spp=64).film
    rest = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) != PLACES[place]
    assert np.isfinite(film.mean).all()
    assert (film.mean[rest] / film.plain_mean[rest]).max() < 12
    assert (film.mean[rest] / film.plain_mean[rest]).min() > 0.2
    np.testing.assert_allclose(film.mean.sum((0, 1), np.float64), film.pool_mean.sum((0, 1), np.float64), rtol=1e-5)


@pytest.mark.parametrize("times", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("seed", range(16, 28))
def test_a_bright_pixel_s_noise_leaves_the_dark_dark(seed: int, times: float, renderers: SimpleNamespace) -> None:
    """It is up to 20 times all that the neighbours have. At most they become 11 times as bright, where the mean that
    the limit goes by is five times what they are, or a fifth. With an earlier limit nothing was left of them where its
    pool had too little, as with 1e5 and seeds 16, 22 and 27.
    """

    def hot(batch: Batch, radiance: np.ndarray) -> None:
        radiance[batch.pixel == PLACES["middle"]] *= np.float32(times)

    film = rendered(hot, renderers, spp=64, seed=seed).film
    ratio = film.mean / film.plain_mean
    assert ratio.min() > 0.2
    assert ratio.max() < 12
    np.testing.assert_allclose(film.mean.sum((0, 1), np.float64), film.pool_mean.sum((0, 1), np.float64), rtol=1e-5)


@pytest.mark.parametrize("scale", [1e-38, 1e-30, 1e-12, 1e12, 1e30, 1e37])
def test_images_of_any_brightness(scale: float, renderers: SimpleNamespace) -> None:
    """The unit does not matter: the image is that of scale 1 but for rounding, where the exposure goes
    along or the radiance does not steer.
    """
    one = rendered(lambda batch, radiance: None, renderers, direct_share=1.0, initial_spp=32.0).film

    def scaled(batch: Batch, radiance: np.ndarray) -> None:
        radiance *= np.float32(scale)

    film = rendered(scaled, renderers, direct_share=1.0, initial_spp=32.0).film
    assert np.array_equal(film.samples, one.samples)
    np.testing.assert_allclose(film.mean / scale, one.mean, rtol=2e-6 if scale > 1e-35 else 1e-4)
    np.testing.assert_allclose(film.standard_error / scale, one.standard_error, rtol=2e-6 if scale > 1e-35 else 1e-4)


def test_black_images_and_black_pools(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Black stays black; light that the pool never saw is taken away, and nothing falls below 0."""
    dark = rendered(lambda batch, radiance: radiance.fill(0), renderers).film
    assert not dark.mean.any()
    alike = Sampler(WIDTH, HEIGHT, Budget(spp=32), seed=4)

    def unseen(batch: Batch, radiance: np.ndarray) -> None:
        of_pool = tools.from_pool(alike, batch)
        radiance[of_pool] = 0
        radiance[of_pool & (batch.index == 0)] = 1e-3  # lest nothing steer

    film = rendered(unseen, renderers).film
    assert film.plain_mean.mean() > 0.1
    assert (film.mean >= 0).all()
    assert film.mean.mean() < film.plain_mean.mean() / 5


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_specks_far_below_the_brightest(sigma: float, signed: bool, renderers: SimpleNamespace) -> None:
    """A column of 3e37 and, beyond its neighbourhood, single pixels of 1e-6: these, as shares of the brightest, are at
    the end of floats. No NaN, and they stay what they are.
    """

    def radiance(batch: Batch) -> np.ndarray:
        column = batch.pixel % WIDTH
        grey = np.where(column == 0, 3e37, 1e-6 * (batch.pixel % 7 == 0)) * (0.5 + renderers.noise(batch))
        return renderers.rgb(np.where(signed & (renderers.noise(batch, 1) < 0.5), -grey, grey))  # type: ignore[no-any-return]

    sampler = Sampler(WIDTH, HEIGHT, Budget(spp=16), Config(correction_sigma=sigma, initial_spp=2.0), 4, signed=signed)
    sampler.run(radiance)
    film = sampler.film
    assert np.isfinite(film.mean).all()
    assert (film.plain_mean[:, 30:] != 0).any()
    assert abs(film.mean[:, 30:]).max() < 1e-5


def test_constant_images_have_no_variance() -> None:
    """Whatever the value: no rounding may look like noise that sampling could remove."""
    for value in (0.1, 1 / 3, 7e11, 3e-13):
        sampler = Sampler(20, 16, Budget(spp=40), seed=1)
        sampler.run(lambda batch, value=value: np.full((len(batch), 3), value, np.float32))
        assert not sampler.film.beta.any()
        assert not sampler.film.standard_error[sampler.film.samples > 1].any()


# --- Sizes and kernels -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 3), (17, 16)])
@pytest.mark.parametrize("radius", [0.3, 1.0, 8.0])
def test_kernels_keep_images_of_any_shape_even(
    size: tuple[int, int], radius: float, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """Members that are placed evenly stay even under disks that reflect at the borders: chi-square over pixels of the
    last move of 400 batches, corners and images of one pixel in width included.
    """
    width, height = size
    pixels = width * height
    radius = min(radius, max(size))
    config = Config(
        initial_spp=0.0, pool_share=0.0, direct_share=0.0, population=pixels, moves=5, radii=(radius,), eliminate=1.0,
        regenerate_pool=1.0, evaluate_regenerated=False, lookahead=0,
    )  # fmt: skip
    rounds = max(30, 12_000 // pixels)
    counts = np.zeros(pixels)
    sampler = Sampler(width, height, Budget(spp=5.0 * rounds), config, seed=9)
    while not sampler.done:
        batch = sampler.ask()
        place, _ = tools.proposals(sampler)
        counts += np.bincount(batch.pixel[place.reshape(pixels, 5)[:, 4]], minlength=pixels)
        sampler.tell(batch, renderers.constant(batch))
    assert counts.sum() == pixels * rounds
    if pixels > 1:
        # Members of one round are stratified, so counts vary less than independent ones: the test is on the safe side.
        assert chi_square_p(counts, np.full(pixels, float(rounds))) > ALARM


@pytest.mark.parametrize("size", [(32768, 2), (2, 32768), (65535, 1), (1, 65535)])
def test_long_images(size: tuple[int, int], renderers: SimpleNamespace) -> None:
    sampler = Sampler(*size, Budget(spp=6), Config(initial_spp=2.0), seed=2)
    sampler.run(renderers.textured)
    assert sampler.samples == sampler.film.samples.sum() == 6 * size[0] * size[1]
    assert np.isfinite(sampler.film.mean).all()
    assert sampler.film.samples.min() >= 2


@pytest.mark.long
@pytest.mark.parametrize("image", ["hot", "equal", "black"])
def test_draws_among_33_million_pixels(image: str, renderers: SimpleNamespace) -> None:
    """8192x4096 pixels after two samples each. One with variance gets all that beta draws, all alike get the same, and
    where there is none the pool goes on evenly.
    """
    width, height, pixel = 8192, 4096, 12_345_678
    config = Config(initial_spp=2.0, pool_share=0.0, direct_share=1.0, lookahead=0, batch=2**22, beta_power=1.0)
    sampler = Sampler(width, height, Budget(spp=4), config, seed=3)
    while sampler.samples < 2 * width * height:
        batch = sampler.ask()
        values = np.zeros((len(batch), 3), np.float32)
        bright = batch.index == 1 if image == "equal" else (batch.pixel == pixel) & (batch.index == 1)
        if image != "black":
            values[bright] = 1.0
        sampler.tell(batch, values)
    drawn = np.bincount(sampler.ask().pixel, minlength=width * height)
    if image == "hot":
        assert drawn[pixel] == 2**22
        return
    # Blocks of 64x64 pixels: even, and at most by chance uneven where it is chance.
    blocks = drawn.reshape(height // 64, 64, width // 64, 64).sum((1, 3)).ravel().astype(float)
    assert chi_square_p(blocks, np.full(blocks.size, 2**22 / blocks.size)) > ALARM
    assert drawn.max() <= 1


LARGEST = (32768, 16384)


@pytest.mark.long
@pytest.mark.parametrize("config", ["default", "uniform"])
@pytest.mark.parametrize("size", [(8192, 8192), (65535, 1021), (1021, 65535), LARGEST])
def test_the_largest_images(
    size: tuple[int, int], config: str, renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """Batches of all parts of the image, positions in their pixels, each pixel once in a pass of the pool, steering to
    where the noise is, counts exact. The film takes memory only where samples fall, but address space for all of it,
    which a machine may refuse.
    """
    width, height = size
    half = 2**17 / (width * height)
    settings = {"batch": 2**15, "lookahead": 1}
    made = Config.uniform(**settings) if config == "uniform" else Config(initial_spp=half, **settings)
    try:
        sampler = Sampler(width, height, Budget(spp=2 * half), made, seed=2)
    except MemoryError as error:
        if size != LARGEST:
            raise
        pytest.skip(f"{error} (as address space: /proc/sys/vm/overcommit_memory of 1 grants it)")
    told: dict[bool, list[np.ndarray]] = {True: [], False: []}
    while not sampler.done:
        batch = sampler.ask()
        x, y = batch.pixel % width, batch.pixel // width
        assert np.array_equal(np.floor(batch.positions), np.stack([x, y], axis=1))
        assert y.max() < height
        of_pool = batch.index < sampler._native.reserved
        told[True].append(batch.pixel[of_pool])
        told[False].append(batch.pixel[~of_pool])
        sampler.tell(batch, renderers.textured(batch))
    pool, steered = (np.concatenate(told[of_pool]) for of_pool in (True, False))
    assert sampler.samples == len(pool) + len(steered) == 2**18
    assert sampler.rejected == 0
    assert len(np.unique(pool)) == len(pool)  # all are of the first pass
    # Evenly over the image: 64 parts of it.
    parts = np.bincount(pool // width * 8 // height * 8 + pool % width * 8 // width, minlength=64)
    assert parts.min() > 0.9 * len(pool) / 64
    assert len(steered) == 0 if config == "uniform" else len(steered) > 2**16
