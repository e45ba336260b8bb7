"""Sobol points, the places they give samples in their pixels, and the indices. Exact but for the uniformity of the Owen
scrambles, each of whose tests states its false-alarm rate and rejects a broken variant.
"""

from __future__ import annotations

import math
from collections import defaultdict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pmc_sampler import Batch, Budget, Config, Sampler, _core

EDGE_WORDS = [0, 1, 2, 255, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF]


# --- The points ------------------------------------------------------------------------------------------------------
def test_core_equals_its_twin(twin: SimpleNamespace) -> None:
    """Bit for bit, at random words and at those where bits run out."""
    rng = np.random.default_rng(0)
    words = rng.integers(0, 2**32, (3000, 2), dtype=np.uint32)
    edges = np.array([(s, i) for s in EDGE_WORDS for i in EDGE_WORDS], np.uint32)
    both = np.concatenate([words, edges])
    for pair in (0, 1, 2, 7, 1000, 0xFFFFFFFF):
        core = _core.sobol_points(both[:, 0].copy(), both[:, 1].copy(), pair)
        assert core.tobytes() == twin.sobol_pair(both[:, 0], both[:, 1], pair).tobytes()


def test_twin_follows_published_sobol_points(twin: SimpleNamespace) -> None:
    """Unscrambled, the twin's matrix gives the first points of Sobol's sequence as SciPy has them (Joe and Kuo 2008);
    its scramble is nested: each bit depends on those above it alone.
    """
    matrix = np.array([1 << 31], np.uint64)
    while len(matrix) < 32:
        matrix = np.append(matrix, matrix[-1] ^ (matrix[-1] >> np.uint64(1)))
    index = np.arange(256, dtype=np.uint64)
    second = np.zeros(256, np.uint64)
    for bit in range(8):
        second ^= np.where((index >> np.uint64(bit)) & np.uint64(1), matrix[bit], np.uint64(0))
    published = stats.qmc.Sobol(2, scramble=False).random(256)
    gray = (index ^ (index >> np.uint64(1))).astype(int)  # SciPy goes through the points in Gray-code order
    assert np.array_equal(published[:, 1], second[gray] / 2.0**32)
    rng = np.random.default_rng(1)
    x, key = rng.integers(0, 2**32, (2, 1000), dtype=np.uint32)
    for bit in range(31):
        flipped = x ^ np.uint32(1 << (bit + 1))  # of the reversed word: bits below stay
        same = np.uint32((1 << (bit + 1)) - 1)
        assert np.array_equal(twin.owen_reversed(x, key) & same, twin.owen_reversed(flipped, key) & same)


@pytest.mark.parametrize("scramble", [0, 1, 0xDEADBEEF, 0xFFFFFFFF])
@pytest.mark.parametrize("pair", [0, 1, 5])
def test_points_are_a_net(scramble: int, pair: int, twin: SimpleNamespace) -> None:
    """(0, 2)-sequence: of each run of 2^m points that starts at a multiple of 2^m, one lies in each elementary
    interval of area 2^-m, after scrambling and shuffling too.
    """
    for m in range(9):
        for run in (0, 1, 5):
            index = np.arange(run << m, (run + 1) << m)
            points = twin.sobol_pair(scramble, index, pair).astype(np.float64)
            for a in range(m + 1):
                cell = (points[:, 0] * 2**a).astype(int) * 2 ** (m - a) + (points[:, 1] * 2 ** (m - a)).astype(int)
                assert np.array_equal(np.sort(cell), np.arange(2**m))


def p_value(cells: np.ndarray, kinds: int) -> float:
    """Of Pearson's chi-square test that the cells are equally likely."""
    return float(stats.chisquare(np.bincount(cells, minlength=kinds)).pvalue)


def test_owen_scrambles_are_uniform(twin: SimpleNamespace) -> None:
    """Over scrambles, every point is uniform in the square, and points of two pairs are independent.

    12 tests at p < 1e-6 each: a false alarm in 10^5. Negative controls: one scramble for all; the second pair equal to
    the first.
    """
    rng = np.random.default_rng(2)
    scrambles = rng.integers(0, 2**32, 20_000, dtype=np.uint32)
    threshold = 1e-6

    def square(a: np.ndarray, b: np.ndarray) -> float:
        return p_value((a * 16).astype(int) * 16 + (b * 16).astype(int), 256)

    for index in (0, 1, 17, 0x80000000):
        first = twin.sobol_pair(scrambles, np.full(20_000, index), 0)
        other = twin.sobol_pair(scrambles, np.full(20_000, index), 1)
        assert square(first[:, 0], first[:, 1]) > threshold
        assert square(first[:, 0], other[:, 0]) > threshold
        assert square(first[:, 1], other[:, 1]) > threshold
        assert square(first[:, 0], first[:, 0]) < threshold
    unscrambled = twin.sobol_pair(np.full(20_000, 7), np.full(20_000, 3), 0)
    assert square(unscrambled[:, 0], unscrambled[:, 1]) < threshold


def test_places_of_neighbouring_pixels_are_independent(twin: SimpleNamespace) -> None:
    """The first sample's place, over the pixels of an image and against the next pixel's: 3 tests at p < 1e-6. The
    negative control is a pixel against itself.
    """
    sampler = Sampler(160, 120, Budget(spp=1), Config.uniform(batch=2**31), seed=3)
    batch = sampler.ask()
    order = np.argsort(batch.pixel)
    place = (batch.positions[order] % 1.0).astype(np.float64)

    def together(a: np.ndarray, b: np.ndarray) -> float:
        return p_value((a * 12).astype(int) * 12 + (b * 12).astype(int), 144)

    assert together(place[:, 0], place[:, 1]) > 1e-6
    assert together(place[:-1, 0], place[1:, 0]) > 1e-6
    assert together(place[:-160, 1], place[160:, 1]) > 1e-6
    assert together(place[:, 0], place[:, 0]) < 1e-6


# --- Positions -------------------------------------------------------------------------------------------------------
def batches(sampler: Sampler, radiance: Any) -> list[Batch]:
    told = []
    while not sampler.done:
        batch = sampler.ask()
        told.append(batch)
        sampler.tell(batch, radiance(batch))
    return told


def test_places_are_the_first_pair(twin: SimpleNamespace, renderers: SimpleNamespace) -> None:
    """Pixel corner + dimensions 0 and 1 of (scramble, index), bit for bit, rounded down where the sum of the two floats
    would be the next pixel's corner.
    """
    for batch in batches(Sampler(70, 45, Budget(spp=9), Config(initial_spp=2), seed=6), renderers.textured):
        corner = np.stack([batch.pixel % 70, batch.pixel // 70], axis=1).astype(np.float32)
        place = corner + twin.sobol_pair(batch.scramble, batch.index, 0)
        expected = np.minimum(place, np.nextafter(corner + 1, np.float32(0)))
        assert batch.positions.tobytes() == expected.tobytes()


@pytest.mark.parametrize("size", [(8192, 3), (3, 8192), (60_000, 1)])
def test_box_positions_lie_in_their_pixel(size: tuple[int, int]) -> None:
    """Far from the origin the spacing of floats is coarse: 8192 + (1 - 2^-13) rounds up to 8193."""
    batch = Sampler(*size, Budget(spp=8), Config.uniform(batch=2**31), seed=1).ask()
    x, y = np.floor(batch.positions).astype(np.uint32).T
    assert np.array_equal(y * np.uint32(size[0]) + x, batch.pixel)


@pytest.mark.parametrize("radius", [0.5, 1.0, 3.7])
@pytest.mark.parametrize("name", ["box", "tent", "gaussian", "blackman-harris"])
def test_filtered_positions_lie_within_the_radius(name: str, radius: float) -> None:
    config = Config.uniform(filter=name, filter_radius=radius)
    batch = Sampler(40, 30, Budget(spp=64), config, seed=1).ask()
    centre = np.stack([batch.pixel % 40, batch.pixel // 40], axis=1) + 0.5
    distance = np.abs(batch.positions.astype(np.float64) - centre)
    assert distance.max() <= radius + 4e-6  # the spacing of floats at 40
    assert distance.max() > 0.5 * radius


def test_batch_is_read_only_and_coherent() -> None:
    """Samples of a 16x16 tile are together, and those of a pixel where whole passes are drawn."""
    batch = Sampler(64, 48, Budget(spp=8), Config.uniform(batch=2**31), seed=1).ask()
    for array in (batch.positions, batch.pixel, batch.index, batch.scramble):
        assert not array.flags.writeable
        assert len(array) == len(batch)
    assert (batch.positions.dtype, batch.pixel.dtype) == (np.float32, np.uint32)
    assert (batch.index.dtype, batch.scramble.dtype) == (np.uint32, np.uint32)
    for key, kinds in ((batch.pixel, 64 * 48), (batch.pixel // 64 // 16 * 4 + batch.pixel % 64 // 16, 12)):
        assert (key[1:] != key[:-1]).sum() == kinds - 1


def test_batch_outlives_its_sampler(renderers: SimpleNamespace) -> None:
    sampler = Sampler(64, 48, Budget(spp=8), seed=1)
    batch = sampler.ask()
    kept = batch.positions.copy()
    positions = batch.positions
    del sampler, batch
    assert np.array_equal(positions, kept)


# --- Indices ---------------------------------------------------------------------------------------------------------
CONFIGS: dict[str, dict[str, Any]] = {
    "default": {},
    "population": {"direct_share": 0.0, "moves": 3, "eliminate": 0.4, "regenerate_pool": 0.5, "population": 200},
    "unseen": {"evaluate_regenerated": False, "regenerate_pool": 0.5},
    "partly seen": {"moves": 0, "eliminate": 0.4, "regenerate_pool": 1.0, "direct_share": 0.0},
    "never replaced": {"eliminate": 0.0, "direct_share": 0.2},
    "no pool": {"pool_share": 0.0, "initial_spp": 0.0},
    "uniform": {"pool_share": 1.0, "correction": 0.0},
}


@pytest.mark.parametrize("lookahead", [0, 1, 3])
@pytest.mark.parametrize("name", CONFIGS)
def test_indices_count_up(name: str, lookahead: int, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """Over a whole run, with batches open and told in any order, a pixel's samples are the points of one sequence: the
    reserved first ones by the pool, in turn, and those after by all else, each once. What the pool takes beyond its
    reserve are the points of another, in turn. No two pixels share a scramble.
    """
    settings = {"radii": (1.0, 3.0), "batch": 170, "initial_spp": 2.0, **CONFIGS[name]}
    sampler = Sampler(23, 19, Budget(spp=9), Config(lookahead=lookahead, **settings), seed=4)
    reserved = sampler._native.reserved
    indices, pixels = defaultdict(list), defaultdict(set)

    def note(batch: Batch) -> np.ndarray:
        for scramble, index, pixel in zip(
            batch.scramble.tolist(), batch.index.tolist(), batch.pixel.tolist(), strict=True
        ):
            indices[scramble].append(index)
            pixels[scramble].add(pixel)
        return renderers.textured(batch)  # type: ignore[no-any-return]

    tools.shuffled(sampler, note, np.random.default_rng(lookahead))
    assert sum(map(len, indices.values())) == 9 * 23 * 19
    assert all(len(owners) == 1 for owners in pixels.values())
    first = set(tools.scrambles(sampler).tolist())
    assert len(first) == 23 * 19  # so that no pixel's is another's
    for scramble, used in indices.items():
        limit = reserved if scramble in first else 0
        pool, others = sorted(i for i in used if i < limit), sorted(i for i in used if i >= limit)
        assert pool == list(range(len(pool)))
        assert others == list(range(limit, limit + len(others)))
    assert any(max(used) >= reserved for used in indices.values()) == (name != "uniform")


@pytest.mark.parametrize("name", [name for name in CONFIGS if name != "uniform"])
def test_the_reserve_is_what_the_pool_takes(name: str, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """So that all samples of most pixels are an unbroken stretch of one sequence: to a pass and a half."""
    settings = {"radii": (1.0, 3.0), "batch": 340, "initial_spp": 2.0, **CONFIGS[name]}
    sampler = Sampler(46, 38, Budget(spp=20), Config(**settings), seed=4)
    count = 0
    while not sampler.done:
        batch = sampler.ask()
        count += int(tools.from_pool(sampler, batch).sum())
        sampler.tell(batch, renderers.textured(batch))
    assert abs(sampler._native.reserved - count / (46 * 38)) <= 1.5


def test_passes_beyond_the_reserve(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """At a pace that nobody knows yet 256 samples a pixel are reckoned with; the pool goes on in its own sequence."""
    sampler = Sampler(20, 10, Budget(seconds=1e6), Config(initial_spp=0.0, pool_share=0.5), seed=4)
    indices: dict[bool, set[int]] = {True: set(), False: set()}
    while sampler.spp < 300:
        batch = sampler.ask()
        first = batch.scramble == tools.scrambles(sampler)[batch.pixel]
        for whether in (True, False):
            indices[whether].update(batch.index[first == whether].tolist())
        sampler.tell(batch, renderers.textured(batch))
    assert 128 <= sampler._native.reserved < 140
    assert indices[True] == set(range(max(indices[True]) + 1))
    assert indices[False] == set(range(max(indices[False]) + 1))
    assert len(indices[False]) > 5


def test_seconds_reserve_what_the_time_suffices_for(renderers: SimpleNamespace) -> None:
    """By the pace of the pilot's batches but the first, which may compile. A second of this machine's is neglected."""
    pixels, config = 128 * 128, Config(batch=128 * 128, initial_spp=4.0, pool_share=0.25, direct_share=1.0)
    sampler = Sampler(128, 128, Budget(seconds=10_000), config, seed=4)
    for number in range(4):
        assert sampler._native.reserved == 2**32 - 1  # the pilot is the pool's: no pass of it is beyond the reserve
        batch = sampler.ask()
        sampler._native.add_elapsed(1000 if number == 0 else 100)
        sampler.tell(batch, renderers.textured(batch))
    sampler.ask()
    # 1300 s are over, and 8700 suffice for 87 samples a pixel more
    assert sampler.samples == 4 * pixels
    assert abs(sampler._native.reserved - math.ceil(4 + 0.25 * 87)) <= 1
    restored = Sampler(128, 128, Budget(seconds=10_000), config, seed=4)
    restored._native.restore(sampler._native.save())
    assert restored._native.reserved == sampler._native.reserved


@pytest.mark.parametrize("name", ["default", "population", "unseen"])
def test_pool_goes_pass_by_pass(name: str, renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    """After each batch every pixel has as many samples from the pool as every other, or one more."""
    settings = {"radii": (1.0, 3.0), "batch": 170, "initial_spp": 2.0, **CONFIGS[name]}
    sampler = Sampler(23, 19, Budget(spp=40), Config(lookahead=0, **settings), seed=4)
    count = np.zeros(23 * 19, int)
    while not sampler.done:
        batch = sampler.ask()
        from_pool = tools.from_pool(sampler, batch)
        count += np.bincount(batch.pixel[from_pool], minlength=len(count))
        assert count.max() - count.min() <= 1
        sampler.tell(batch, renderers.textured(batch))
    assert count.max() > 5
