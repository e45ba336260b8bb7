"""The random numbers: Dr.Jit's against a NumPy rendering of the definition, and what the definition
promises."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

pytestmark = pytest.mark.needs("mitsuba")

Words = npt.NDArray[np.uint32]
VARIANT = "llvm_ad_rgb"


def reverse(x: Words) -> Words:
    """The bits of 32-bit words in reverse."""
    bits = (x[..., None] >> np.arange(32, dtype=np.uint32)) & 1
    return (bits << np.arange(31, -1, -1, dtype=np.uint32)).sum(axis=-1, dtype=np.uint32)


def words(seed: int, size: int) -> Words:
    return np.random.default_rng(seed).integers(0, 1 << 32, size, np.uint32)


def pair(scramble: Words, index: Words, number: int) -> npt.NDArray[np.float64]:
    """Both coordinates of a pair of dimensions, shape (n, 2), by NumPy."""
    from pmc_sampler.adapters.mitsuba import samplers

    xy = samplers.sobol_pair(reverse, scramble, index, np.full_like(index, number))
    return np.stack([word >> 8 for word in xy], axis=1) * 2.0**-24


def started(mi: Any, kind: str, scramble: Words, index: Words) -> Any:
    from pmc_sampler.adapters.mitsuba.samplers import sampler_class

    sampler = sampler_class(VARIANT, kind)()
    sampler.start(mi.UInt32(scramble), mi.UInt32(index))
    return sampler


def test_definition_of_the_second_coordinate() -> None:
    """Exact: the shift-and-xor form is the bit reversal of the Pascal triangle modulo 2, Sobol's second
    generator matrix."""
    from pmc_sampler.adapters.mitsuba.samplers import _SECOND

    index = np.concatenate([np.arange(64, dtype=np.uint32), words(1, 64)])
    columns = np.zeros(32, np.uint32)  # the image of each bit of the index, as a fraction
    column = np.uint32(1 << 31)
    for bit in range(32):
        columns[bit] = column
        column ^= column >> np.uint32(1)
    expected = np.zeros_like(index)
    for bit in range(32):
        expected ^= np.where((index >> np.uint32(bit)) & 1, columns[bit], np.uint32(0))
    folded = index
    for shift, mask in _SECOND:
        folded = folded ^ ((folded >> np.uint32(shift)) & np.uint32(mask))
    assert np.array_equal(reverse(folded), expected)


def test_mitsuba_gives_the_defined_numbers(mi: Any) -> None:
    """Exact: next_2d and next_1d take fresh pairs from 1 on."""
    scramble, index = words(2, 1000), np.arange(1000, dtype=np.uint32) * 77
    sampler = started(mi, "sobol", scramble, index)
    assert np.array_equal(np.array(sampler.next_2d()).T, pair(scramble, index, 1))
    assert np.array_equal(np.array(sampler.next_1d()), pair(scramble, index, 2)[:, 0])
    assert np.array_equal(np.array(sampler.next_2d()).T, pair(scramble, index, 3))


def test_the_core_took_pair_0() -> None:
    """Exact but for rounding to float32: the core's positions are the same definition's pair 0."""
    from pmc_sampler import Budget, Config, Sampler

    batch = Sampler(40, 30, Budget(spp=8), Config.uniform(), seed=5).ask()
    corner = np.stack([batch.pixel % 40, batch.pixel // 40], axis=1)
    expected = corner + pair(batch.scramble, batch.index, 0)
    assert np.abs(batch.positions - expected).max() <= 40 * 2.0**-24


@pytest.mark.parametrize("number", [1, 2, 31])
def test_points_are_a_net(number: int) -> None:
    """Exact: of 64 consecutive points from a multiple of 64, one lies in each elementary interval of area
    1/64."""
    for scramble in words(3, 8):
        for first in (0, 64, 4096):
            index = np.arange(first, first + 64, dtype=np.uint32)
            points = pair(np.full(64, scramble, np.uint32), index, number)
            for split in range(7):
                cells = np.floor(points * [1 << split, 1 << (6 - split)]).astype(int)
                assert len({tuple(cell) for cell in cells}) == 64


def test_pairs_and_pixels_are_independent_of_each_other() -> None:
    """Correlations of 64-point means between pairs and between scrambles; false alarms: 1 in 1e6 (5 standard
    deviations)."""
    scramble = np.repeat(words(4, 4096), 4)
    index = np.tile(np.arange(4, dtype=np.uint32), 4096)
    columns = np.stack([pair(scramble, index, number)[:, k] for number in (1, 2, 3) for k in (0, 1)])
    order_kept = np.corrcoef(columns)[np.triu_indices(6, 1)]
    assert np.abs(order_kept).max() < 5 / np.sqrt(len(index))
    first_points = columns[0].reshape(-1, 4)[:, 0]
    assert abs(np.corrcoef(first_points[1:], first_points[:-1])[0, 1]) < 5 / np.sqrt(len(first_points))


@pytest.mark.parametrize("kind", ["sobol", "independent"])
def test_numbers_are_uniform_and_below_one(mi: Any, kind: str) -> None:
    """Chi-square over 64 cells of single points of 65536 sequences; false alarms: 1 in 1e6."""
    from scipy import stats

    sampler = started(mi, kind, words(6, 65536), np.arange(65536, dtype=np.uint32) % 7)
    for numbers in (*sampler.next_2d(), sampler.next_1d()):
        values = np.array(numbers)
        assert values.min() >= 0
        assert values.max() < 1
        assert stats.chisquare(np.bincount((values * 64).astype(int), minlength=64)).pvalue > 1e-6


@pytest.mark.parametrize("kind", ["sobol", "independent"])
def test_numbers_change_inside_a_symbolic_loop(mi: Any, kind: str) -> None:
    """Exact: a loop that is traced once draws what a loop unrolled by hand draws."""
    import drjit as dr

    scramble, index = words(7, 256), np.arange(256, dtype=np.uint32)
    unrolled = started(mi, kind, scramble, index)
    expected = [np.array(unrolled.next_1d()) for _ in range(5)]
    looped = started(mi, kind, scramble, index)
    target = dr.zeros(mi.Float, 5 * 256)

    def body(i: Any, sampler: Any) -> Any:
        dr.scatter(target, sampler.next_1d(), i * 256 + dr.arange(mi.UInt32, 256))
        return i + 1, sampler

    dr.while_loop((dr.zeros(mi.UInt32, 256), looped), lambda i, _: i < 5, body, mode="symbolic")
    assert np.array_equal(np.array(target).reshape(5, 256), expected)
    assert len({values.tobytes() for values in expected}) == 5


def test_independent_streams_do_not_repeat(mi: Any) -> None:
    """No index of a scramble and no scramble gives another's numbers; false alarms: below 1 in 1e4 (birthday
    bound)."""
    scramble, index = np.repeat(words(8, 64), 64), np.tile(np.arange(64, dtype=np.uint32), 64)
    sampler = started(mi, "independent", scramble, index)
    streams = np.stack([np.array(sampler.next_1d()) for _ in range(3)], axis=1)
    assert len(np.unique(streams, axis=0)) == len(streams)
    assert abs(np.corrcoef(streams[1:, 0], streams[:-1, 0])[0, 1]) < 5 / np.sqrt(len(streams))
