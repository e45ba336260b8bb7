"""Ask and tell for rules that decide how many samples each pixel gets next."""

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmc_sampler import Budget, _core

from .allocation import whole
from .film import Film


@dataclass(frozen=True, eq=False)
class Batch:
    """Positions for a renderer, with the arrays of :class:`pmc_sampler.Batch`, sorted by pixel."""

    positions: NDArray[np.float32]
    pixel: NDArray[np.uint32]
    index: NDArray[np.uint32]
    scramble: NDArray[np.uint32]
    number: int

    def __len__(self) -> int:
        return len(self.pixel)


class Rule(Protocol):
    """How the samples after the first ones are divided."""

    name: str
    initial_spp: float | None
    """Samples a pixel before the rule is asked; None: a sixteenth of the budget, held to 4 to 16, as PMC's."""

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """The share of the next batch of each pixel, (pixels,); they sum to a whole number from 1 to ``at_most``."""
        ...


class AllocatingSampler:
    """A sampler whose ``rule`` says how many samples each pixel gets in the next batch, from what was told so far.

    Each pixel has one low-discrepancy sequence, of which it gets every index once and in order. The image is the plain
    mean. Batches are drawn one at a time, so that a rule sees all that was sampled. The image depends on (radiance,
    rule, seed, budget in samples) alone.

    ``budget``: ``spp``, met to the sample, and ``seconds``; there is no ``visible_noise``.
    """

    def __init__(
        self,
        width: int,
        height: int,
        budget: Budget,
        rule: Rule,
        seed: int = 0,
        *,
        initial_spp: float | None = None,
        signed: bool = False,
    ) -> None:
        if budget.visible_noise is not None or (budget.spp is None and budget.seconds is None):
            raise ValueError(f"budget is {budget}: {rule.name} ends by spp or seconds")
        self.width, self.height, self.budget, self.rule, self.seed = width, height, budget, rule, seed
        pixels = width * height
        self._total = None if budget.spp is None else max(1, round(budget.spp * pixels))
        if initial_spp is None:
            initial_spp = rule.initial_spp
        if initial_spp is None:
            initial_spp = 4.0 if budget.spp is None else min(16.0, max(4.0, budget.spp / 16))
        if not initial_spp >= 0:
            raise ValueError(f"initial_spp is {initial_spp!r}: expected 0 or more")
        self.initial_spp = float(initial_spp)
        self.settings: dict[str, Any] = {}
        self._initial = round(initial_spp * pixels)
        self._random = np.random.Generator(np.random.Philox(seed))
        self._scramble = self._random.integers(2**32, size=pixels, dtype=np.uint32)
        self._drawn = np.zeros(pixels, np.int64)
        self._signed = signed
        self._number = 0
        self._open: Batch | None = None
        self._done: str | None = None
        self._began: float | None = None
        self.rejected = 0
        self.film = Film(width, height)

    @property
    def samples(self) -> int:
        """Samples on the film."""
        return int(self.film.n.sum())

    @property
    def spp(self) -> float:
        """Samples on the film over pixels."""
        return self.samples / (self.width * self.height)

    @property
    def elapsed(self) -> float:
        """Seconds since the first ask."""
        return 0.0 if self._began is None else time.perf_counter() - self._began

    @property
    def done(self) -> str | None:
        """The limit that ended sampling: "spp" or "seconds"; None while there is work to do."""
        return self._done

    def ask(self) -> Batch:
        """The next batch. Raises RuntimeError where one is open, or the budget is spent."""
        if self._open is not None:
            raise RuntimeError(f"ask: batch {self._open.number} is open; tell its radiance first")
        if self.done:
            raise RuntimeError(f"ask: the budget is spent ({self.done})")
        if self._began is None:
            self._began = time.perf_counter()
        self._open = self._batch(self._counts())
        self._number += 1
        return self._open

    def tell(self, batch: Batch, radiance: ArrayLike) -> None:
        """The radiance of the open batch: (n, 3) floats, linear RGB, in the batch's order.

        Samples that are not finite or negative do not enter the film; they are counted in ``rejected``. Raises
        ValueError or TypeError, and leaves the sampler as it was, for a wrong shape or type, for a batch that is not
        the open one, and where more than half of the samples are invalid.
        """
        if not isinstance(batch, Batch):
            raise TypeError(f"got {type(batch).__name__}: expected the Batch that ask returned")
        if batch is not self._open:
            raise ValueError(f"tell: batch {batch.number} was told before or is another sampler's")
        values = np.asarray(radiance)
        if values.shape != (len(batch), 3):
            raise ValueError(f"tell: got radiance of shape {values.shape}, expected {(len(batch), 3)}")
        if values.dtype.kind != "f":
            raise TypeError(f"tell: got radiance of type {values.dtype}, expected float32")
        valid = np.isfinite(values).all(axis=1)
        if not self._signed:
            valid &= (values >= 0.0).all(axis=1)
        invalid = len(batch) - int(np.count_nonzero(valid))
        if 2 * invalid > len(batch):
            raise ValueError(f"tell: {invalid} of {len(batch)} samples are not finite or negative")
        if invalid:
            self.film.add(batch.pixel[valid], batch.index[valid], values[valid].astype(np.float64))
        else:
            self.film.add(batch.pixel, batch.index, values.astype(np.float64))
        self.rejected += invalid
        self._open = None
        # Here and nowhere else, so that time that passes between a look at `done` and `ask` is no error.
        if self._total is not None and self.samples + self.rejected >= self._total:
            self._done = "spp"
        elif self.budget.seconds is not None and self.elapsed >= self.budget.seconds:
            self._done = "seconds"

    def _counts(self) -> NDArray[np.int64]:
        pixels, used = len(self._drawn), int(self._drawn.sum())
        left = pixels * 2**16 if self._total is None else self._total - used
        if used < self._initial:
            size = min(pixels, self._initial - used, left)
            shares = np.full(pixels, size / pixels)
        else:
            shares = self.rule.allocate(self.film, self._drawn, left)
            size = round(float(shares.sum()))
        return whole(shares, size, self._random.random())

    def _batch(self, counts: NDArray[np.int64]) -> Batch:
        pixel = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
        first = np.cumsum(counts) - counts
        index = (np.arange(len(pixel)) + (self._drawn - first)[pixel]).astype(np.uint32)
        scramble = self._scramble[pixel]
        self._drawn += counts
        y, x = np.divmod(pixel, np.uint32(self.width))
        corner = np.stack([x, y], axis=1).astype(np.float32)
        # In a large coordinate, a fraction near 1 rounds up to the next pixel.
        positions = np.minimum(corner + _core.sobol_points(scramble, index, 0), np.nextafter(corner + 1, np.float32(0)))
        for array in (positions, pixel, index, scramble):
            array.flags.writeable = False
        return Batch(positions, pixel, index, scramble, self._number)
