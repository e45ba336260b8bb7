"""The error-threshold rule of production renderers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .film import Film


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

    Settings: ``step`` in (0, 1); ``smallest``, pixels on the side under which no block is split; ``growth``, samples
    between two looks at the errors as a share of those that a pixel has, two at least and an even number, so that A has
    half of them.
    """

    name = "error-threshold"
    initial_spp: float | None = None

    def __init__(self, radiance: Any, *, step: float = 0.5, smallest: int = 2, growth: float = 0.125) -> None:
        if not 0.0 < step < 1.0:
            raise ValueError(f"step is {step!r}: expected a number between 0 and 1")
        if smallest < 1 or not growth >= 0.0:
            raise ValueError(f"smallest is {smallest!r} and growth {growth!r}: expected at least 1 and at least 0")
        self._shape = (int(radiance.height), int(radiance.width))
        self._step, self._smallest, self._growth = float(step), int(smallest), float(growth)
        # Of each block top, bottom, left and right; and of each pixel the block that it is in.
        self._blocks = np.array([[0, self._shape[0], 0, self._shape[1]]])
        self._owner = np.zeros(self._shape, np.int64)
        self._threshold = 0.0

    def allocate(self, film: Film, drawn: NDArray[np.int64], at_most: int) -> NDArray[np.float64]:
        """The next samples of the blocks that have not stopped."""
        table = self._table(film)
        self._split(table)
        errors = self._errors(table)
        if errors.max() < self._threshold or not self._threshold:
            self._threshold = self._step * float(errors.max())
        going = (errors >= self._threshold)[self._owner.ravel()]
        wanted = np.where(going, np.maximum(2.0, 2.0 * np.floor(self._growth / 2 * drawn)), 0.0)
        total = float(wanted.sum())
        return wanted * (min(at_most, total) / total)

    def _table(self, film: Film) -> NDArray[np.float64]:
        """The pixels' errors as a summed-area table (Crow 1984, doi:10.1145/800031.808600)."""
        whole, half = film.means
        root = np.sqrt(np.maximum(whole.sum(axis=1), 0.0))
        errors = np.divide(np.abs(whole - half).sum(axis=1), root, out=np.zeros(len(root)), where=root > 0.0)
        table = np.zeros((self._shape[0] + 1, self._shape[1] + 1))
        table[1:, 1:] = errors.reshape(self._shape).cumsum(axis=0).cumsum(axis=1)
        return table

    def _errors(self, table: NDArray[np.float64]) -> NDArray[np.float64]:
        top, bottom, left, right = self._blocks.T
        sums = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
        areas = (bottom - top) * (right - left)
        errors: NDArray[np.float64] = np.maximum(sums, 0.0) / np.sqrt(areas * float(self._owner.size))
        return errors

    def _split(self, table: NDArray[np.float64]) -> None:
        """Splits the blocks whose error is from ``e_t`` to under ``256 e_t``, each once."""
        errors = self._errors(table)
        threshold = self._threshold or self._step * float(errors.max())
        top, bottom, left, right = self._blocks.T
        large = np.maximum(bottom - top, right - left) >= 2 * self._smallest
        halves: list[list[int]] = []
        for number in np.flatnonzero(large & (errors >= threshold) & (errors < 256.0 * threshold)):
            y0, y1, x0, x1 = self._blocks[number]
            tall = y1 - y0 >= x1 - x0
            line = (
                table[y0 : y1 + 1, x1] - table[y0 : y1 + 1, x0]
                if tall
                else table[y1, x0 : x1 + 1] - table[y0, x0 : x1 + 1]
            )
            line = line - line[0]
            cut = self._smallest + int(
                np.argmin(np.abs(line[self._smallest : len(line) - self._smallest] - line[-1] / 2))
            )
            first, second = [y0, y1, x0, x1], [y0, y1, x0, x1]
            if tall:
                first[1] = second[0] = y0 + cut
            else:
                first[3] = second[2] = x0 + cut
            self._blocks[number] = first
            self._owner[second[0] : second[1], second[2] : second[3]] = len(self._blocks) + len(halves)
            halves.append(second)
        self._blocks = np.concatenate([self._blocks, np.array(halves, self._blocks.dtype).reshape(-1, 4)])
