"""`MitsubaRenderer`: any Mitsuba scene as a callable from a batch of samples to radiance."""

from __future__ import annotations

import threading
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pmc_sampler import _core

from ..inputs import samples_of
from . import blocks, loading, threads, variants
from .rays import Evaluator
from .samplers import KINDS

__all__ = ["MitsubaRenderer"]

_ALIGNMENT = 64  # bytes; Dr.Jit compiles one kernel for aligned arrays and another for the rest


class MitsubaRenderer:
    """Renders a scene's samples with Mitsuba 3.

    Called with a `Batch` it returns the radiance of each of its samples, shape (n, 3 + aovs), float32: linear
    RGB in the scene's units, then the integrator's extra channels, named in `aov_names`. A sample's value is
    a function of its position, `scramble` and `index`, bit for bit, whatever else is in its batch.

    Positions are pixels from the top-left corner of the film's crop window, whose size is `width` by
    `height`. The film's reconstruction filter plays no part here, for it is the sampler that places samples:
    give its `Config` what `filter` holds. Nor does alpha.

    Parameters
    ----------
    scene
        A `mi.Scene`, a scene dictionary, an `.xml` file or the name of a built-in scene.
    sensor
        Which of the scene's sensors, or a `mi.Sensor`.
    integrator
        A `mi.Integrator`, a plugin's name or its dictionary, in place of the scene's own: any that returns
        radiance for a ray, such as `path`, `volpath`, `direct`, `prb` or `aov`.
    sampler
        "sobol" for Owen-scrambled Sobol points within each pixel, "independent" for independent random
        numbers.
    variant
        The Mitsuba variant to load the scene in, an unpolarised `llvm` or `cuda` one. By default the active
        one where that will do, else RGB on a CUDA device if there is one and on the CPU if not. A `mi.Scene`
        brings its own. If you have activated another one yourself, each batch changes to this one and back, which
        takes some 40 ms.
    size
        (width, height) of the film in pixels, in place of the scene's.

    Raises
    ------
    FileNotFoundError, OSError
        For a scene file that is missing or cannot be read.
    ValueError
        For an unknown scene, sensor, integrator, sampler or variant, and for one that cannot serve, with the
        reason.
    RuntimeError
        If the variant's back end does not run on this machine, with what to install.
    """

    takes_batch = True

    def __init__(
        self,
        scene: Any,
        sensor: Any = 0,
        integrator: Any = None,
        sampler: str = "sobol",
        *,
        variant: str | None = None,
        size: tuple[int, int] | None = None,
    ) -> None:
        if sampler not in KINDS:
            raise ValueError(f"a sampler is {' or '.join(repr(kind) for kind in KINDS)}, not {sampler!r}")
        given = loading.is_scene(scene)
        if given and variant not in (None, scene.variant_name()):
            raise ValueError(
                f"the scene was loaded in the variant {scene.variant_name()!r} and stays there; "
                f"it cannot be rendered in {variant!r}"
            )
        self.variant = variants.check(scene.variant_name()) if given else variants.choose(variant)
        with variants.active(self.variant):
            self.scene = loading.load_scene(scene, self.variant, size)
            self.sensor = loading.sensor_of(self.scene, sensor)
            self.integrator = loading.integrator_of(self.scene, integrator)
            if size is not None:
                loading.check_film(self.sensor, size)
            self._evaluate = Evaluator(self.variant, sampler, self.scene, self.sensor, self.integrator)
        self.sampler = sampler
        self.aov_names: list[str] = list(self.integrator.aov_names())
        self.width, self.height = (int(side) for side in self.sensor.film().crop_size())
        self._types = variants.module(self.variant)
        self._buffers: dict[str, NDArray[Any]] = {}
        self._lock = threading.Lock()

    @classmethod
    def probe(cls) -> str:
        """A line on the version and the variants that run here; raises RuntimeError if none does."""
        return variants.probe()

    @classmethod
    def version(cls) -> str:
        """Mitsuba's version."""
        return str(mi.__version__)

    @property
    def threads(self) -> _core.Executor | None:
        """Dr.Jit's threads, for the sampler's own work, in an `llvm` variant; None for the sampler's own."""
        return threads.executor() if self.variant.startswith("llvm") else None

    @property
    def signed(self) -> bool:
        """Whether single samples may be negative: a wavelength's colour lies outside the gamut of RGB."""
        return "spectral" in self.variant

    @property
    def aovs(self) -> int:
        """How many channels come after RGB."""
        return len(self.aov_names)

    @property
    def filter(self) -> dict[str, Any]:
        """The settings of a `Config` (`filter`, `filter_radius`) for the film's reconstruction filter.

        Raises ValueError for a filter with negative lobes, from which no sample can be drawn.
        """
        return loading.filter_of(self.sensor.film())

    def __repr__(self) -> str:
        return (
            f"MitsubaRenderer({self.width}x{self.height}, {self.sensor.class_name()}, "
            f"{self.integrator.class_name()}, {self.sampler}, {self.variant})"
        )

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of each sample of `batch`, shape (n, 3 + aovs), float32.

        Raises TypeError for what is no batch.
        """
        positions, scramble, index = samples_of(batch, "a MitsubaRenderer")
        n, channels = len(positions), 3 + self.aovs
        if n == 0:
            return np.empty((0, channels), np.float32)
        if n == 1:  # Dr.Jit treats arrays of length one as scalars and would record a function of its own
            positions, scramble, index = (np.repeat(values, 2, axis=0) for values in (positions, scramble, index))
        # One call at a time: the arrays below are Dr.Jit's until the result has been read. The variant has to
        # be the active one only while a function is recorded, but nobody can tell beforehand when that is.
        with self._lock, variants.active(self.variant), blocks.divided(n):
            pairs = np.ascontiguousarray(positions, np.float32).view(np.uint64)[:, 0]
            radiance = self._evaluate(
                self._types.UInt64(self._aligned("positions", pairs, np.uint64)),
                self._types.UInt32(self._aligned("scramble", scramble, np.uint32)),
                self._types.UInt32(self._aligned("index", index, np.uint32)),
            )
            out = radiance.numpy().reshape(-1, channels)
        # One row where radiance is the same everywhere.
        return np.ascontiguousarray(out[:n] if len(out) >= n else np.repeat(out, n, axis=0), np.float32)

    def _aligned(self, name: str, values: NDArray[Any], dtype: Any) -> NDArray[Any]:
        """`values` as a contiguous aligned array: itself if it is one, else a copy in a buffer that is kept
        for the next batch.
        """
        size = len(values)
        if values.dtype == dtype and values.flags.c_contiguous and values.ctypes.data % _ALIGNMENT == 0:
            return values
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            memory = np.empty(size * np.dtype(dtype).itemsize + _ALIGNMENT, np.uint8)
            offset = -memory.ctypes.data % _ALIGNMENT
            buffer = self._buffers[name] = memory[offset : offset + size * np.dtype(dtype).itemsize].view(dtype)
        buffer[:size] = values
        return buffer[:size]
