"""Processes of POV-Ray that have read the scene and wait for rays, and batches divided among them.

The text that a process gets ends with a file being opened for writing that is a FIFO: that waits until somebody opens
its other end. We do once the rays are in the file that is included next. So what takes long (the program's start, the
scene, its photons) is done beforehand, while the processes before are still tracing. It has to be for writing: whether
a file can be read another thread of POV-Ray looks, which must not wait for ten seconds.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import images
from .program import LastingFolder
from .source import Source, image

__all__ = ["Pool"]

_GATE, _RAYS = "pmc_gate", "pmc_rays.inc"
_ENTRY = (
    "\n#declare pmc_version = version;\n#version 3.7;\n"
    f'#fopen pmc_gate "{_GATE}" write #fclose pmc_gate\n#version pmc_version;\n#include "{_RAYS}"\n'
)
_BLOCK = 1024  # pixels; the noise depends on it, and so it does not depend on anything
_LARGEST = 1 << 18  # rays of a process, for its memory's sake; beyond 2**20 its image cannot be read
# Fewer rays would meet too few numbers of POV-Ray's one table of random numbers, the same in each process.
_SMALLEST = 4096
_PAUSE = 0.002  # seconds between looks


class Pool:
    """Traces rays in several processes at once, the next ones started while these trace.

    Parameters
    ----------
    source
        The scene.
    processes
        How many trace at once. The noise of a scene depends on it, since each draws from the same random numbers.

    Attributes
    ----------
    seconds
        What was spent so far on writing "rays" and waiting for "povray"; "cpu" is the latter's processor time.
    """

    def __init__(self, source: Source, processes: int) -> None:
        self.source, self.processes = source, processes
        self.seconds = {"rays": 0.0, "povray": 0.0, "cpu": 0.0}
        self._root = LastingFolder()
        self._workers: list[_Worker] = []  # all that are alive
        self._waiting: list[_Worker] = []
        self._number = itertools.count()
        self._close = weakref.finalize(self, _end, self._workers, self._root.close, os.getpid())

    def trace(self, count: int, rays: Callable[[int, int], str]) -> NDArray[np.float32]:
        """The radiance along `count` rays, shape (count, 3), float32, linear RGB; may be infinite.

        rays: a function that gives the camera for those from a first to before a last one.

        Raises ValueError with POV-Ray's words if it fails, TimeoutError if it takes too long, RuntimeError if it
        is killed or leaves no image. All of its processes have ended then.
        """
        out = np.empty((count, 3), np.float32)
        if count == 0:
            return out
        pieces = max(-(-count // _LARGEST), min(self.processes, count // _SMALLEST), 1)
        bounds = [count * piece // pieces for piece in range(pieces + 1)]
        todo = list(itertools.pairwise(bounds))
        size = -(-count // pieces)
        tracing: list[tuple[_Worker, int, int]] = []
        try:
            while todo or tracing:
                while todo and len(tracing) < self.processes:
                    first, last = todo.pop(0)
                    worker = self._take(size)
                    began = time.perf_counter()
                    worker.give(rays(first, last), last - first)
                    self.seconds["rays"] += time.perf_counter() - began
                    tracing.append((worker, first, last))
                while len(self._waiting) < min(self.processes, pieces):
                    self._waiting.append(self._start(size))
                began = time.perf_counter()
                done = [one for one in tracing if one[0].done()]
                for one in done:
                    worker, first, last = one
                    out[first:last] = worker.radiance()
                    tracing.remove(one)
                    self._drop(worker)
                if not done:
                    time.sleep(_PAUSE)
                self.seconds["povray"] += time.perf_counter() - began
        except BaseException:
            self.clear()
            raise
        return out

    def clear(self) -> None:
        """Ends the processes that wait; the next batch starts others."""
        while self._workers:
            self._drop(self._workers[-1])
        self._waiting.clear()

    def close(self) -> None:
        """Ends all processes and removes their files; happens by itself when the object goes, or Python ends."""
        self._close()

    def _take(self, size: int) -> _Worker:
        """A process that has room for `size` rays."""
        while self._waiting:
            worker = self._waiting.pop(0)
            if worker.size >= size and not worker.ended:
                return worker
            self._drop(worker)  # too small, or ended while it waited: a new one says why, if it does so again
        return self._start(size)

    def _start(self, size: int) -> _Worker:
        folder = self._root.path / str(next(self._number))
        folder.mkdir()
        worker = _Worker(self.source, folder, size)
        self._workers.append(worker)
        return worker

    def _drop(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        self.seconds["cpu"] += worker.close()


class _Worker:
    """A process of POV-Ray with room for `size` rays, and its folder."""

    def __init__(self, source: Source, folder: Path, size: int) -> None:
        self.size = size
        self._source, self._folder = source, folder
        os.mkfifo(folder / _GATE)
        self._gate: int | None = None
        self._given = 0
        self._until = 0.0
        self._process = source.start(folder, (f"+W{size}", "+H1", f"+BS{_BLOCK}"), _ENTRY)

    @property
    def ended(self) -> bool:
        """Whether the process is no longer there."""
        return self._process.ended

    def give(self, rays: str, count: int) -> None:
        """What to trace: the text of a camera of `count` rays."""
        (self._folder / _RAYS).write_text(rays, encoding="ascii")
        self._given = count
        self._until = time.perf_counter() + self._source.timeout
        self._gate = os.open(self._folder / _GATE, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)

    def done(self) -> bool:
        """Whether the image is there. Raises as `Pool.trace` does."""
        ended = self.ended  # asked first: the image is looked at after it
        if images.whole(image(self._folder)):
            return True
        if ended:
            result = self._process.wait()
            if result.status < 0:
                raise RuntimeError(f"{result.error} while it traced {self._source.file}")
            result.check(str(self._source.file))
            raise RuntimeError(f"POV-Ray ended without an error and without an image of {self._source.file}")
        if time.perf_counter() > self._until:
            raise TimeoutError(
                f"POV-Ray did not trace {self._given} rays of {self._source.file} within {self._source.timeout:g} "
                "seconds and was ended; give a longer timeout, if the scene does not loop for ever"
            )
        return False

    def radiance(self) -> NDArray[np.float32]:
        """The values of the rays, shape (count, 3)."""
        pixels = images.read(image(self._folder))
        if pixels.shape != (1, self.size, 3):
            raise RuntimeError(
                f"POV-Ray left an image of {pixels.shape[1]}x{pixels.shape[0]} pixels in place of {self.size}x1"
            )
        return pixels[0, : self._given]

    def close(self) -> float:
        """Ends the process and removes its folder; returns its processor time."""
        if self._gate is not None:
            os.close(self._gate)
            self._gate = None
        cpu = self._process.kill()
        shutil.rmtree(self._folder, ignore_errors=True)
        return cpu


def _end(workers: list[_Worker], remove: Callable[[], object], owner: int) -> None:
    """Leaves nothing behind. A forked child, which has this object but not the processes, keeps off."""
    if os.getpid() != owner:
        return
    for worker in workers:
        with contextlib.suppress(OSError):
            worker.close()
    workers.clear()
    remove()
