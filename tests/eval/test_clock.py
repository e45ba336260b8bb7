"""How much of a benchmark's time is left. Exact."""

from __future__ import annotations

from typing import Any

import pytest
from pmc_sampler.eval import clock, suite

pytestmark = pytest.mark.needs("skimage")

GIVEN: dict[str, Any] = {
    "name": "clock",
    "about": "Two scenes.",
    "size": [24, 20],
    "spp": [4],
    "seeds": 1,
    "renderer": "noisy",
    "reference_spp": 64,
    "baseline": "PT",
    "scene": [{"name": "diffuse"}, {"name": "cornell-box"}],
    "method": [{"name": "PT", "sampler": "uniform"}, {"name": "PMC", "sampler": "pmc"}],
}


def test_references_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the seconds that samples have taken so far, of the same method and scene where there are any."""
    now = 100.0
    monkeypatch.setattr(clock.time, "perf_counter", lambda: now)
    read = suite.parse(GIVEN)
    runs = [run for scene in read.scenes for run in read.runs(scene)]
    watch = clock.Clock(runs)
    watch.awaits("diffuse", 64)
    watch.awaits("cornell-box", 0)  # it is there
    watch.prepared("diffuse", 0.0)
    assert watch.fraction == 0.0
    now += 8.0
    watch.prepared("diffuse", 0.25)  # 16 samples a pixel: 0.5 s each
    assert watch.left == 0.75 * 64 * 0.5 + 4 * 4 * 0.5
    assert watch.fraction == 8 / (8 + 24 + 8)
    now += 24.0
    watch.prepared("diffuse", 1.0)
    assert watch.left == 8.0
    watch.ended(runs[0], {"error": None, "seconds.total": 6.0, "spp": 4.0})  # 1.5 s a sample, so that 1 s is typical
    assert watch.left == 12.0
    assert watch.fraction == 38 / 50
    watch.ended(runs[1], {"error": "it failed"})
    for run in runs[2:]:
        watch.ended(run, {"error": None, "seconds.total": 4.0, "spp": 4.0})
    assert watch.fraction == 1.0


def test_a_reference_that_no_run_waits_for_is_not_awaited() -> None:
    read = suite.parse(GIVEN)
    runs = [run for scene in read.scenes for run in read.runs(scene)]
    watch = clock.Clock(runs)
    watch.awaits("diffuse", 64)
    assert watch.left == 64.0 + 16.0
    for run in runs[:2]:
        watch.ended(run, {"error": "it cannot be rendered"})
    assert watch.left == 8.0
