"""The error-threshold rule of production renderers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .film import Film


@dataclass
class _Block:
    top: int
    bottom: int
    left: int
    right: int

    @property
    def area(self) -> int:
        return (self.bottom - self.top) * (self.right - self.left)


class ErrorThreshold:
    """Blocks are sampled until their error is under a threshold, and split on the way.

    H. Dammertz, J. Hanika, A. Keller and H. Lensch, "A Hierarchical Automatic Stopping Condition for Monte Carlo Global
    Illumination", WSCG 2010; Cycles, appleseed and OSPRay use forms of it. With I a pixel's mean, A the mean of every
    other of its samples, a pixel's error is ``sum |I - A| / sqrt(sum I)`` over R, G and B; a block's is the mean over
    its N pixels times ``sqrt(N / pixels of the image)``. A block under the threshold ``e_t`` stops; one under
    ``256 e_t`` is split across its longer side where both parts' errors are most equal.

    The rule stops at an error, we compare at equal samples. So the threshold begins at ``step`` times the error of the
    whole image; when every block has stopped it falls to ``step`` times the largest block's error, and the blocks over
    it go on. The last pass is spread evenly over its blocks so that the budget is met to the sample.

    Settings: ``step`` in (0, 1); ``smallest``, pixels on the side under which no block is split; ``passes``, samples a
    pixel between two looks at the errors, even, so that A has half of them.
    """

    name = "error-threshold"
    initial_spp: float | None = None

    def __init__(self, radiance: Any, *, step: float = 0.9, smallest: int = 4, passes: int = 2) -> None:
        if not 0.0 < step < 1.0:
            raise ValueError(f"step is {step!r}: expected a number between 0 and 1")
        if smallest < 1 or passes < 2 or passes % 2:
            raise ValueError(
                f"smallest is {smallest!r} and passes {passes!r}: expected at least 1, and an even number of at least 2"
            )
        self._shape = (int(radiance.height), int(radiance.width))
        self._step, self._smallest, self._passes = float(step), int(smallest), int(passes)
        self._blocks = [_Block(0, self._shape[0], 0, self._shape[1])]
        self._threshold = 0.0

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """The next samples of the blocks that have not stopped."""
        table = self._table(film)
        self._split(table)
        errors = self._errors(table)
        if errors.max() <= self._threshold or not self._threshold:
            self._threshold = self._step * float(errors.max())
        chosen = np.zeros(self._shape)
        for block, error in zip(self._blocks, errors, strict=True):
            if error >= self._threshold:
                chosen[block.top : block.bottom, block.left : block.right] = self._passes
        total = float(chosen.sum())
        return (chosen * (min(at_most, total) / total)).ravel()

    def _table(self, film: Film) -> NDArray[np.float64]:
        """The pixels' errors as a summed-area table (Crow 1984, doi:10.1145/800031.808600)."""
        whole, half = film.means
        root = np.sqrt(np.maximum(whole.sum(axis=1), 0.0))
        errors = np.divide(np.abs(whole - half).sum(axis=1), root, out=np.zeros(len(root)), where=root > 0.0)
        table = np.zeros((self._shape[0] + 1, self._shape[1] + 1))
        table[1:, 1:] = errors.reshape(self._shape).cumsum(axis=0).cumsum(axis=1)
        return table

    def _errors(self, table: NDArray[np.float64]) -> NDArray[np.float64]:
        edges = np.array([(b.top, b.bottom, b.left, b.right) for b in self._blocks])
        top, bottom, left, right = edges.T
        sums = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
        areas = (bottom - top) * (right - left)
        errors: NDArray[np.float64] = np.maximum(sums, 0.0) / np.sqrt(areas * float(self._shape[0] * self._shape[1]))
        return errors

    def _split(self, table: NDArray[np.float64]) -> None:
        errors = self._errors(table)
        after: list[_Block] = []
        for block, error in zip(self._blocks, errors, strict=True):
            small = max(block.bottom - block.top, block.right - block.left) < 2 * self._smallest
            if small or not self._threshold <= error < 256.0 * max(self._threshold, self._step * errors.max()):
                after.append(block)
            else:
                after.extend(self._halves(block, table))
        self._blocks = after

    def _halves(self, b: _Block, table: NDArray[np.float64]) -> tuple[_Block, _Block]:
        tall = b.bottom - b.top >= b.right - b.left
        if tall:
            line = table[b.top : b.bottom + 1, b.right] - table[b.top : b.bottom + 1, b.left]
        else:
            line = table[b.bottom, b.left : b.right + 1] - table[b.top, b.left : b.right + 1]
        line = line - line[0]
        inner = line[self._smallest : len(line) - self._smallest]
        cut = self._smallest + int(np.argmin(np.abs(inner - line[-1] / 2)))
        if tall:
            return _Block(b.top, b.top + cut, b.left, b.right), _Block(b.top + cut, b.bottom, b.left, b.right)
        return _Block(b.top, b.bottom, b.left, b.left + cut), _Block(b.top, b.bottom, b.left + cut, b.right)
