"""The verdicts on what the paper says of its method.

Exact, but for the bootstrap intervals: of errors that differ fivefold over dozens of tiles, and of equal ones.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pmc_sampler.eval import benchmark, results, suite
from pmc_sampler.eval.report import page
from pmc_sampler.eval.report.claims import between, claims, edges, most, noise_map, order, ratio_within, share_within
from pmc_sampler.eval.statistics import Interval

pytestmark = pytest.mark.needs("scipy", "skimage", "pyarrow", "tomli_w", "OpenImageIO", "jinja2", "matplotlib", "PIL")


def test_the_hardest_tenth_is_where_the_variance_is() -> None:
    mean, variance = np.full((60, 80, 3), 0.5), np.full((60, 80), 1e-4)
    variance[20:36, 30:50] = 1.0
    hard = most(noise_map(variance, mean, 100.0))
    assert 0.05 < hard.mean() < 0.12  # pixels may be alike
    assert hard[24:32, 34:46].all()
    assert not hard[:, :20].any()
    assert not most(np.ones((4, 4))).any()


def test_edges_are_steps() -> None:
    mean = np.full((40, 60, 3), 0.2)
    mean[:, 30:] = 0.8
    found = edges(mean)
    assert found[:, 29:31].all()
    assert not found[:, :27].any()


def test_errors_within_a_mask() -> None:
    rng = np.random.default_rng(1)
    base, own = rng.exponential(1.0, (2, 96, 128))
    mask = np.zeros((96, 128), bool)
    mask[:, 64:] = True
    base[mask] *= 5.0
    within, elsewhere = ratio_within(base, own, mask), ratio_within(base, own, ~mask)
    assert 4.0 < within.low < within.median < within.high < 6.0
    assert elsewhere.low < 1.0 < elsewhere.high
    one_tile = ratio_within(base, own, np.arange(96 * 128).reshape(96, 128) < 3)
    assert (one_tile.low, one_tile.high) == (float("-inf"), float("inf"))


def test_shares_within_a_mask() -> None:
    """The first part is half of the whole, and within the mask two thirds; without that nothing is shown."""
    rng = np.random.default_rng(3)
    first, second = rng.exponential(1.0, (2, 96, 128))
    mask = np.arange(96 * 128).reshape(96, 128) % 7 == 0
    same = share_within(first, first + second, mask)
    assert same.low < 1.0 < same.high
    first[mask] *= 2.0
    more = share_within(first, first + second, mask)
    assert 1.2 < more.low < 4 / 3 < more.high < 1.45


@pytest.mark.parametrize(
    ("low", "high", "held"),
    [(0.85, 0.95, True), (0.7, 0.9, None), (0.9, 1.1, None), (0.5, 1.5, None), (0.5, 0.7, False), (1.1, 1.3, False)],
)
def test_slightly_more_error(low: float, high: float, held: bool | None) -> None:
    assert between(Interval(0.5 * (low + high), low, high), 0.8, 1.0) is held


def test_the_order_of_gains() -> None:
    gains = [(0.3, Interval(1.1, 1.0, 1.2), "room"), (0.02, Interval(4.0, 3.0, 5.0), "box")]
    claim = order(gains, "paper", 6)
    assert (claim.held, claim.verdict) == (True, "held")
    assert "box: 2 % and 4.00 (3.00 to 5.00), room: 30 % and 1.10 (1.00 to 1.20)" in claim.figures
    assert order([(0.01, *gains[0][1:]), gains[1]], "paper", 6).verdict == "did not hold"
    unsure = (0.3, Interval(3.5, 2.5, 4.5), "room")
    assert order([unsure, gains[1]], "paper", 6).verdict == "not shown"
    assert order(gains, "paper", 5).verdict == "not shown"


def test_a_report_has_the_verdicts(tmp_path: Path, noisy: type) -> None:
    """Of the paper's parameters alone, and once both they and uniform sampling by the same numbers have run."""
    made = suite.parse(
        {
            "name": "test",
            "about": "Two scenes.",
            "size": [48, 32],
            "spp": [24],
            "seeds": 2,
            "renderer": "noisy",
            "reference_spp": 64,
            "baseline": "PT",
            "metrics": ["tvi_error"],
            "scene": [{"name": "diffuse", "crops": {"the middle": [0.25, 0.25, 0.75, 0.75]}}, {"name": "thin-lens"}],
            "method": [
                {"name": "PT", "sampler": "uniform"},
                {"name": "paper", "sampler": "pmc", "preset": "paper", "radii": [1.0, 3.0]},
                {"name": "alone", "sampler": "pmc", "preset": "paper", "numbers": "independent", "radii": [1.0]},
                {"name": "shipped", "sampler": "pmc"},
            ],
        }
    )
    hooks = benchmark.Renderers(lambda renderer, scene, *, sampler, size: noisy(*size), lambda renderer: "1.2")
    benchmark.run(made, results.Folder(tmp_path / "results"), hooks, cache=tmp_path / "cache")
    found = results.load(tmp_path / "results")
    said = claims(found)
    assert {claim.where.split(",")[1].strip() for claim in said if "," in claim.where} == {"paper"}
    texts = [claim.text.split(":")[0] for claim in said if claim.where.startswith("diffuse")]
    assert [text.split()[0] for text in texts] == ["Less", "Less", "Slightly", "Small"]
    assert "Less error there: the middle" in [claim.text for claim in said]
    html = page(found)
    assert html.count("Small radii at edges and in caustics") == 2
    assert 'id="claims"' in html
    (tmp_path / "results" / "images" / "diffuse" / "reference.exr").unlink()
    assert not any(claim.where.startswith("diffuse") for claim in claims(found))
