"""The kernel's random numbers: Sobol points are the core's, independent ones are uniform and uncorrelated.

Statistical tests have a false-alarm rate of 1e-4.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pmc_sampler import _core

pytestmark = pytest.mark.needs("pyopencl", "scipy")

DRAW = """
kernel void probe(global const uint* scramble, global const uint* index, global float* out) {
    const int i = get_global_id(0);
    const Sequence s = sequence(scramble[i], index[i]);
    vstore8(draws(&s, FIRST), i, out);
}
"""
EDGES = [0, 1, 2, 255, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF]


@pytest.fixture(scope="module")
def draws(parts: Any, camera: Any, call: Any, white_sky: Any) -> Any:
    scene = parts.Scene(camera(), (parts.Material("diffuse"),), environment=white_sky)

    def draw(words: Any, first: int, independent: bool = False) -> Any:
        macros = {"FIRST": f"{first}u", "INDEPENDENT": str(int(independent))}
        (out,) = call(scene, DRAW, len(words), [words[:, 0], words[:, 1]], [(np.float32, 8)], **macros)
        return out

    return draw


@pytest.mark.parametrize("first", [0, 2, 6, 1002])
def test_sobol_points_are_the_cores(draws: Any, first: int) -> None:
    """Bit for bit, four pairs of dimensions at once."""
    words = np.random.default_rng(0).integers(0, 2**32, (2000, 2), dtype=np.uint32)
    words = np.concatenate([words, np.array([(s, i) for s in EDGES for i in EDGES], np.uint32)])
    ours = draws(words, first)
    for k in range(4):
        core = _core.sobol_points(words[:, 0].copy(), words[:, 1].copy(), first + k)
        assert core[:, 0].tobytes() == ours[:, k].tobytes()
        assert core[:, 1].tobytes() == ours[:, 4 + k].tobytes()


def test_independent_numbers(draws: Any) -> None:
    """Uniform in each dimension, and uncorrelated between dimensions, neighbouring indices and scrambles."""
    from scipy import stats

    count = 1 << 17
    index = np.arange(count, dtype=np.uint32)
    tables = [draws(np.stack([np.full(count, 7, np.uint32), index], 1), first, independent=True) for first in (2, 6)]
    tables.append(draws(np.stack([index, np.full(count, 7, np.uint32)], 1), 2, independent=True))
    for table in tables:
        assert table.min() >= 0.0
        assert table.max() < 1.0
        p = [stats.chisquare(np.bincount((column * 256).astype(int), minlength=256)).pvalue for column in table.T]
        assert -np.expm1(len(p) * np.log1p(-min(p))) > 1e-4
        columns = np.concatenate([table, np.roll(table, 1, axis=0)], axis=1) - 0.5
        correlation = np.corrcoef(columns.T)[np.triu_indices(16, 1)] * np.sqrt(count)
        assert -np.expm1(len(correlation) * np.log1p(-2 * stats.norm.sf(np.abs(correlation).max()))) > 1e-4
    assert len(np.unique(np.concatenate([table[:, 0] for table in tables]))) > 0.98 * 3 * count * (
        1 - 3 * count / 2**25
    )
