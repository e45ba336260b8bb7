"""A renderer of known mean that costs nothing, for tests of what is measured with renderers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest


class Noisy:
    """Radiance ``mean(pixel) * noise`` with noise of mean 1 that is a function of (scramble, index) alone.

    The noise is 0 or 1/p with probability p = 1/4, so that sums over samples are exact in a float and the
    variance of one sample is 3 times the squared mean. `calls` counts batches; `fail_after` batches it
    raises KeyboardInterrupt.
    """

    takes_batch = True
    aovs = 0

    def __init__(self, width: int = 12, height: int = 10, fail_after: int | None = None) -> None:
        self.width, self.height = width, height
        self.fail_after = fail_after
        self.calls = 0

    @property
    def mean(self) -> np.ndarray:
        """The true image, shape (height, width, 3)."""
        y, x = np.mgrid[: self.height, : self.width]
        grey = 0.25 + 0.125 * ((x + 2 * y) % 5)
        return np.stack([grey, 0.5 * grey, 2.0 * grey], axis=2)

    def __call__(self, batch: Any) -> np.ndarray:
        if self.fail_after is not None and self.calls >= self.fail_after:
            raise KeyboardInterrupt
        self.calls += 1
        word = batch.scramble ^ (batch.index * np.uint32(0x9E3779B9))
        for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 1)):
            word = (word ^ (word >> np.uint32(shift))) * np.uint32(factor)
        lit = np.where(word < 2**30, 4.0, 0.0).astype(np.float32)
        return self.mean.reshape(-1, 3)[batch.pixel].astype(np.float32) * lit[:, None]


@pytest.fixture
def noisy() -> type[Noisy]:
    """The class of the renderer above."""
    return Noisy


@pytest.fixture(scope="session")
def recording_path() -> Path:
    """A recording of the Cornell box, 48x36 pixels and 64 samples of each, by the command

    pmc-sampler record cornell-box --size 48x36 --per-pixel 64 -o tests/eval/cornell-box.h5
    """
    return Path(__file__).with_name("cornell-box.h5")
