"""The renderer behind the sampler: a path tracer in OpenCL."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from ..inputs import samples_of
from . import devices, memory, program
from .load import scene_of
from .scene import Scene
from .tables import SAMPLERS, tables

__all__ = ["OpenCLRenderer"]

# A kernel on a GPU that also draws the screen is ended by its driver after some seconds.
_SECONDS = 0.25
_FIRST = 1 << 14  # paths, while nothing is known about how long they take
_LARGEST = 1 << 22
_GROUP = 64


def next_piece(count: int, seconds: float, piece: int, largest: int) -> int:
    """How many paths the next call of the kernel traces, after one of `count` paths that took `seconds`.

    As many as take `_SECONDS`, and at most twice as many as now: paths through glass may be much slower than those
    before them. A path's value does not depend on it.
    """
    wanted = count / max(seconds, 1e-6) * _SECONDS
    return int(np.clip(wanted, _GROUP, min(2 * piece, largest)))


class OpenCLRenderer:
    """A path tracer on an OpenCL device: called with a `Batch`, it returns the radiance of each sample.

    The value of a sample is a function of its position, scramble and index alone, on one device.

    Parameters
    ----------
    scene
        A built-in scene's name, a Mitsuba `.xml` file within the subset that `mitsuba_scene` lists, a glTF 2.0
        file (`.gltf`, `.glb`), or a `Scene`.
    sampler
        "sobol" for Owen-scrambled Sobol points, "independent" for independent random numbers.
    device
        The number of an OpenCL device in the list that `pmc-sampler renderers` prints, its kind ("cpu", "gpu",
        "accelerator"), or a part of its name that no other has.
        By default what the environment variable PMC_SAMPLER_DEVICE says, else the best one.
    size
        (width, height) of the film in pixels, in place of the scene's.
    hierarchy
        Whether rays are traced through a hierarchy of boxes; by default where it is faster.

    Attributes
    ----------
    seconds
        What was spent so far on "transfers" to and from the device, and in its "kernel".

    Raises
    ------
    FileNotFoundError, OSError
        For a scene file that is missing or cannot be read.
    ValueError
        For an unknown scene, sampler or device, and for a scene that cannot be rendered, with the reason.
    MemoryError
        If the scene does not fit the device's memory.
    RuntimeError
        If there is no OpenCL device, with what to install, or its compiler fails, with its log.
    """

    takes_batch = True

    def __init__(
        self,
        scene: Any,
        sampler: str = "sobol",
        *,
        device: str | None = None,
        size: tuple[int, int] | None = None,
        hierarchy: bool | None = None,
    ) -> None:
        if sampler not in SAMPLERS:
            raise ValueError(f"a sampler is {' or '.join(repr(kind) for kind in SAMPLERS)}, not {sampler!r}")
        self._device = devices.choose(device)
        self.scene: Scene = scene_of(scene, size)
        self.sampler = sampler
        self.width, self.height = self.scene.camera.width, self.scene.camera.height
        compiled = tables(self.scene, sampler, hierarchy)
        self._context = cl.Context([self._device])
        self._queue = cl.CommandQueue(self._context)
        self._kernel = program.build(self._context, compiled.macros)
        self._arrays = memory.upload(self._context, compiled.arrays)
        for place, array in enumerate(self._arrays, start=5):
            self._kernel.set_arg(place, array)
        limit = self._kernel.get_work_group_info(cl.kernel_work_group_info.WORK_GROUP_SIZE, self._device)
        self._group = min(_GROUP, limit)
        self._lock = threading.Lock()
        self._capacity = 0
        self._buffers: tuple[Any, ...] = ()
        self._piece, self._largest = _FIRST, _LARGEST
        self.seconds = {"transfers": 0.0, "kernel": 0.0}
        self._compile()

    @classmethod
    def probe(cls) -> str:
        """A line with the devices; raises RuntimeError if there is none."""
        devices.choose("0")
        return "; ".join(f"{i}: {devices.label(device)}" for i, device in enumerate(devices.devices()))

    @classmethod
    def version(cls) -> str:
        """That of pyopencl, and a digest of the kernels' text."""
        digest = hashlib.sha256(program.source({}).encode()).hexdigest()
        return f"{cl.VERSION_TEXT}, kernels {digest[:12]}"

    @property
    def device(self) -> str:
        """The device's name and its platform's."""
        return devices.label(self._device)

    @property
    def filter(self) -> Mapping[str, Any]:
        """The settings of a `Config` (`filter`, `filter_radius`) for the film's reconstruction filter."""
        return self.scene.filter

    def __repr__(self) -> str:
        return f"OpenCLRenderer({self.width}x{self.height}, {self.sampler}, {self.device})"

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of each sample of `batch`, shape (n, 3), float32, linear RGB.

        Raises TypeError for what is no batch, MemoryError if the device has no memory for it.
        """
        positions, scramble, index = samples_of(batch, "an OpenCLRenderer")
        inputs = (
            np.ascontiguousarray(positions, np.float32),
            np.ascontiguousarray(scramble, np.uint32),
            np.ascontiguousarray(index, np.uint32),
        )
        out = np.empty((len(positions), 3), np.float32)
        with self._lock:
            done = 0
            while done < len(out):
                count = min(self._piece, len(out) - done)
                try:
                    seconds = self._trace(
                        tuple(array[done : done + count] for array in inputs), out[done : done + count]
                    )
                except MemoryError:
                    if count <= _FIRST:
                        raise
                    self._largest = count // 2  # for good: what else is on the device may stay there
                    self._piece = min(self._piece, self._largest)
                    continue
                self._piece = next_piece(count, seconds, self._piece, self._largest)
                done += count
        return out

    def _trace(self, inputs: tuple[NDArray[Any], ...], out: NDArray[np.float32]) -> float:
        """Seconds of the kernel."""
        count = len(out)
        with memory.guarded(self._device, count * 28):
            buffers = self._room(count)
            began = time.perf_counter()
            for buffer, array in zip(buffers[:3], inputs, strict=True):
                cl.enqueue_copy(self._queue, buffer, array, is_blocking=False)
            self._queue.finish()
            copied = time.perf_counter()
            self._enqueue(count, buffers, count)
            self._queue.finish()
            traced = time.perf_counter()
            cl.enqueue_copy(self._queue, out, buffers[3])
            ended = time.perf_counter()
        self.seconds["kernel"] += traced - copied
        self.seconds["transfers"] += ended - began - (traced - copied)
        return traced - copied

    def _compile(self) -> None:
        """Traces no path, so that what drivers do when a kernel is first called is done before the first sample.

        PoCL compiles then, for small and for large calls: both that a batch of one sample a pixel is cut into.
        """
        pixels = self.width * self.height
        try:
            with memory.guarded(self._device, 28):
                for items in {min(pixels, _FIRST), min(pixels, _LARGEST)}:
                    self._enqueue(0, self._room(1), items)
                self._queue.finish()
        except cl.Error as error:
            raise RuntimeError(
                f"the OpenCL device {self.device} does not start the kernel; choose another device, or report this "
                f"with what its driver says: {error}"
            ) from error

    def _enqueue(self, count: int, buffers: tuple[Any, ...], items: int) -> None:
        """Starts the kernel over `count` samples in so many work items, or some more."""
        for place, value in enumerate((np.uint32(count), *buffers)):
            self._kernel.set_arg(place, value)
        size = -(-items // self._group) * self._group
        cl.enqueue_nd_range_kernel(self._queue, self._kernel, (size,), (self._group,))

    def _room(self, count: int) -> tuple[Any, ...]:
        """Buffers for positions, scrambles, indices and radiance of `count` samples, kept for later batches."""
        if count > self._capacity:
            self._buffers, self._capacity = (), 0  # first freed, then asked for
            flags = cl.mem_flags
            self._buffers = (
                *(cl.Buffer(self._context, flags.READ_ONLY, count * size) for size in (8, 4, 4)),
                cl.Buffer(self._context, flags.WRITE_ONLY, count * 12),
            )
            self._capacity = count
        return self._buffers
