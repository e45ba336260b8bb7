"""How much of a benchmark's time is spent, and how much is left."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .results import Row
from .suite import Run


class Clock:
    """What share of the time is spent, from what runs have cost a sample so far."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self._left = {id(run): run for run in runs}
        self._spent = 0.0
        self._rates: dict[tuple[str, str], list[float]] = {}
        self._awaited: dict[str, _Awaited] = {}

    def awaits(self, scene: str, spp: int) -> None:
        """The runs on a scene wait for a reference, or a recording, of so many samples a pixel."""
        self._awaited[scene] = _Awaited(spp)

    def prepared(self, scene: str, share: float) -> None:
        """So much of what they wait for is there."""
        self._awaited[scene].reached(share)

    def ended(self, run: Run, row: Row) -> None:
        """A run has its row."""
        del self._left[id(run)]
        if row["error"] is None:
            self._spent += row["seconds.total"]
            per = 1.0 if run.method.native else row["spp"]
            self._rates.setdefault((run.scene.name, run.method.name), []).append(row["seconds.total"] / per)

    @property
    def left(self) -> float:
        """Seconds that the runs without a row are expected to take, and what they wait for."""
        every = [rate for rates in self._rates.values() for rate in rates]
        every += [one.rate for one in self._awaited.values() if one.rate > 0.0]
        typical = float(np.median(every)) if every else 1.0
        runs = sum(
            run.budget.value
            if run.budget.kind == "seconds"
            else run.budget.value * float(np.median(self._rates.get((run.scene.name, run.method.name), [typical])))
            for run in self._left.values()
        )
        waiting = {run.scene.name for run in self._left.values()}
        return runs + sum(one.left(typical) for scene, one in self._awaited.items() if scene in waiting)

    @property
    def fraction(self) -> float:
        """Share of the expected time that is spent, 0 to 1."""
        if not self._left:
            return 1.0
        spent = self._spent + sum(one.spent for one in self._awaited.values())
        return spent / (spent + self.left)


@dataclass
class _Awaited:
    """A reference, or a recording, under way: samples a pixel, the share of them that is there, the seconds spent."""

    spp: int
    share: float = 0.0
    spent: float = 0.0
    _began: float | None = None

    def reached(self, share: float) -> None:
        now = time.perf_counter()
        self._began = now if self._began is None else self._began
        self.share, self.spent = share, now - self._began

    @property
    def rate(self) -> float:
        """Seconds that a sample of each pixel has taken; 0 if none has."""
        return self.spent / (self.share * self.spp) if self.share * self.spp else 0.0

    def left(self, typical: float) -> float:
        """Seconds to go, by a typical rate where there is none of its own."""
        return (1.0 - self.share) * self.spp * (self.rate or typical)
