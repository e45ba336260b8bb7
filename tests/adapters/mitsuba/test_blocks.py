"""How a batch is divided among processors: exact, and without a trace in values or in Dr.Jit's settings."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("mitsuba")


@pytest.mark.parametrize(
    ("samples", "threads", "size"),
    [(76800, 2, 2048), (76800, 16, 256), (307200, 16, 1024), (33_177_600, 16, 16384), (2, 1, 256), (0, 0, 256)],
)
def test_block_size(samples: int, threads: int, size: int) -> None:
    from pmc_sampler.adapters.mitsuba.blocks import block_size

    assert block_size(samples, threads) == size


def test_values_and_settings_stay(small_scene: Any, batch_of: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer, blocks

    functions = blocks._functions()
    assert functions is not None, "this Dr.Jit has the functions under other names: see drjit-core/jit.h"
    get, _ = functions
    r, batch = MitsubaRenderer(small_scene()), batch_of(32, 32, 20, 1)
    before = get()
    divided = r(batch)
    assert get() == before
    with blocks.divided(1 << 16):
        assert get() < before
    monkeypatch.setattr(blocks, "_functions", lambda: None)
    assert np.array_equal(r(batch), divided)
    with pytest.raises(ZeroDivisionError), blocks.divided(1 << 16):
        _ = 1 / 0
    assert get() == before


def test_threads_that_overlap_leave_no_trace() -> None:
    """The one that came first goes first, while the other is still inside: that is what went wrong without a count."""
    from pmc_sampler.adapters.mitsuba import blocks

    functions = blocks._functions()
    assert functions is not None
    get, _ = functions
    before = get()
    came, gone = threading.Event(), threading.Event()

    def second() -> None:
        with blocks.divided(1 << 12):
            came.set()
            assert gone.wait(60)

    thread = threading.Thread(target=second)
    with blocks.divided(1 << 16):
        thread.start()
        assert came.wait(60)
    assert get() != before  # the second one's still
    gone.set()
    thread.join()
    assert get() == before
