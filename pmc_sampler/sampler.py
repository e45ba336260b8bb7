"""The sampler: ask for pixel positions, tell their radiance, read the film."""

from __future__ import annotations

import contextlib
import inspect
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pmc_sampler import _core, checkpoint, inputs
from pmc_sampler.config import Budget, Config
from pmc_sampler.deadline import Deadline
from pmc_sampler.film import Film

_DONE = (None, "spp", "seconds", "visible_noise")
_ROWS = "give each sample a row, RGB first"


@dataclass(frozen=True, eq=False)
class Batch:
    """Positions for a renderer, ordered so that neighbours in the image are neighbours in the batch. Arrays are
    read-only.

    positions: (n, 2) float32, pixels, x right, y down, origin the image's top-left corner.
    pixel: (n,) uint32, y * width + x of the pixel that the sample counts for.
    index: (n,) uint32, the sample's place in its pixel's low-discrepancy sequence.
    scramble: (n,) uint32, that sequence's scramble, a hash of seed and pixel. The position took dimensions 0 and 1 of
        Owen-scrambled Sobol points; a renderer goes on from dimension 2.
    number: the batch's number, from 0.
    """

    positions: npt.NDArray[np.float32]
    pixel: npt.NDArray[np.uint32]
    index: npt.NDArray[np.uint32]
    scramble: npt.NDArray[np.uint32]
    number: int
    _native: _core.Batch = field(repr=False)

    def __len__(self) -> int:
        return len(self.pixel)


Radiance = Callable[[Any], npt.ArrayLike]
Progress = Callable[["Sampler"], None]


@dataclass(frozen=True)
class Result:
    """What a render gave and what it cost.

    seconds: wall-clock seconds, "total", "renderer" (in the callback) and "sampler" (ask and tell).
    done: the limit of the budget that ended it; None where it was interrupted.
    """

    film: Film
    samples: int
    spp: float
    rejected: int
    visible_noise: float
    seconds: dict[str, float]
    done: str | None


class Sampler:
    """Population Monte Carlo sampling of the image plane (Lai and Dyer 2007), by ask and tell.

    width, height: pixels, 1 to 65535 each.
    seed: 0 to 2^64 - 1.
    aovs: channels after RGB that are averaged along, at most 64.
    threads: of the sampler's own work; None for one on each processor. Or those of a renderer, its attribute `threads`:
        where they spin as they wait for its next batch, others beside them would have to wait.
    note: an attribute, a dictionary that JSON can hold: what the caller wants kept in checkpoints.
    signed: whether radiance may be negative, as a single sample of a spectral renderer is where its colour lies outside
        the gamut of RGB.

    The image depends on (radiance, config, seed, budget in samples) alone: not on threads, timing or the order in which
    batches come back. Threads of the caller may share a sampler.

    Raises ValueError or TypeError with a sentence that says what came and what was expected.
    """

    def __init__(
        self,
        width: int,
        height: int,
        budget: Budget,
        config: Config | None = None,
        seed: int = 0,
        aovs: int = 0,
        threads: int | _core.Executor | None = None,
        signed: bool = False,
    ) -> None:
        if not isinstance(budget, Budget):
            raise TypeError(f"budget is {budget!r}: expected a Budget, such as Budget(spp=64)")
        config = Config() if config is None else config
        if not isinstance(config, Config):
            raise TypeError(f"config is {config!r}: expected a Config")
        self.width = inputs.side("width", width)
        self.height = inputs.side("height", height)
        self.budget = budget
        self.config = config
        self.seed = inputs.whole("seed", seed, 0, 2**64 - 1)
        self.aovs = inputs.whole("aovs", aovs, 0, 64)
        self.signed = inputs.flag("signed", signed)
        self.note: dict[str, Any] = {}
        try:
            self._native = _core.Sampler(
                self.width,
                self.height,
                budget._native(),
                config._native(),
                self.seed,
                self.aovs,
                _threads(threads),
                self.signed,
            )
        except MemoryError:
            need = self.width * self.height * _core.film_bytes_per_pixel / 2**30
            raise MemoryError(
                f"an image of {self.width}x{self.height} needs {need:.1f} GiB of film, more than there is: "
                "choose a smaller image"
            ) from None
        self.film = Film(self._native)

    def ask(self) -> Batch:
        """The next batch of positions.

        Raises RuntimeError where more than `config.lookahead` batches are open besides, or the budget is spent.
        """
        native = self._native.ask()
        return Batch(*_core.batch_arrays(native), number=native.number, _native=native)

    def tell(self, batch: Batch, radiance: npt.ArrayLike) -> None:
        """The radiance of a batch: (n, 3 + aovs) floats, linear RGB first, in the batch's order.

        Samples that are not finite or negative do not enter the film; they are counted in `rejected`. Raises
        ValueError or TypeError, and leaves the sampler as it was, for a wrong shape or type, a masked array, a batch
        told or dropped before or drawn by another sampler, and where more than half of the samples are invalid (of
        fewer than 64 samples: where so are more than half of all until then, too).
        """
        native = _native_batch(batch)
        self._close(self._native.tell, native, _values(radiance, batch, 3 + self.aovs))

    def drop(self, batch: Batch) -> None:
        """Gives an open batch up, a lost one for instance; its samples are drawn again later, at other positions."""
        self._close(self._native.drop, _native_batch(batch))

    def put_back(self, batch: Batch) -> None:
        """Closes an open batch without an answer; the next `ask` gives the same samples again."""
        self._close(self._native.put_back, _native_batch(batch))

    def _close(self, close: Callable[..., None], native: _core.Batch, *values: npt.NDArray[np.float32]) -> None:
        """Closes a batch by a method of the core; where it is not open here, says what to do."""
        try:
            close(native, *values)
        except ValueError as error:
            if self._native.is_open(native):
                raise
            raise ValueError(f"{error}; a batch goes back once, to the sampler whose ask gave it") from None

    @property
    def done(self) -> str | None:
        """The limit that ended sampling: "spp", "seconds" or "visible_noise"; None while there is work to do."""
        return _DONE[self._native.done()]

    @property
    def samples(self) -> int:
        """Samples on the film."""
        return self._native.samples

    @property
    def spp(self) -> float:
        """Samples on the film over pixels."""
        return self._native.samples / (self.width * self.height)

    @property
    def rejected(self) -> int:
        """Samples left out because their radiance was not finite or negative."""
        return self._native.rejected

    @property
    def visible_noise(self) -> float:
        """Share of the pixels that are not settled: 1.645 standard errors of their luminance, its 90 % interval, exceed
        tvi by the variance of their own samples or of the 7x7 pixels around them, or they have fewer than two samples.
        """
        return self._native.visible_noise()

    @property
    def elapsed(self) -> float:
        """Seconds since the first ask, those before a checkpoint that was loaded and of `add_elapsed` included."""
        return self._native.elapsed

    def add_elapsed(self, seconds: float) -> None:
        """Counts seconds that were spent before the first ask, such as a renderer's set-up: into the budget, too.

        One batch is sampled at least, however short the budget.
        """
        added = inputs.number("seconds", seconds, allow_infinity=False)
        if added < 0.0:
            raise ValueError(f"seconds is {seconds!r}: expected a number from 0")
        self._native.add_elapsed(added)

    @property
    def fraction(self) -> float:
        """How much of the budget is used, in [0, 1]; of the limits of samples and seconds, the nearer one."""
        used = [1.0] if self.done else [0.0]
        if self._native.total is not None:
            used.append((self.samples + self.rejected) / self._native.total)
        if self.budget.seconds is not None:
            used.append(self.elapsed / self.budget.seconds)
        return min(1.0, max(used))

    def run(self, radiance: Radiance, progress: Progress | None = None, timeout: float | None = None) -> Result:
        """Asks and tells until the budget is met; `progress(sampler)` is called after each batch.

        radiance: called with a Batch where it has an attribute `takes_batch` that is true, or its first parameter is
            named `batch` or annotated `Batch`; else with positions, (n, 2) float32. Where it raises, the batch is
            put back, so that what was told is kept and `run` can be called again.
        timeout: seconds that it may take for a batch, in a thread of its own, before it is given up (see `Deadline`)
            and TimeoutError raised; None waits for ever, in the caller's thread.
        """
        wants_batch = _takes_batch(radiance)
        if progress is not None and not callable(progress):
            raise TypeError(f"progress is {progress!r}: expected a function of the sampler, or None")
        start = time.perf_counter()
        in_renderer = in_sampler = 0.0
        with contextlib.ExitStack() as resources:
            if timeout is not None:
                radiance = resources.enter_context(contextlib.closing(Deadline(radiance, timeout)))
            while not self.done:
                batch = None
                try:
                    t0 = time.perf_counter()
                    batch = self.ask()
                    t1 = time.perf_counter()
                    values = radiance(batch if wants_batch else batch.positions)
                    t2 = time.perf_counter()
                    self.tell(batch, values)
                except BaseException:
                    if batch is not None and self._native.is_open(batch._native):
                        self.put_back(batch)
                    raise
                t3 = time.perf_counter()
                in_renderer += t2 - t1
                in_sampler += t1 - t0 + t3 - t2
                if progress is not None:
                    progress(self)
        seconds = {"total": time.perf_counter() - start, "renderer": in_renderer, "sampler": in_sampler}
        return Result(self.film, self.samples, self.spp, self.rejected, self.visible_noise, seconds, self.done)

    def save(self, path: str | Path) -> None:
        """Writes everything that the batches to come depend on, and `note`, to one file, beside and then renamed.

        Raises OSError where it cannot be written; a file that was there before stays as it was.
        """
        header = {
            "width": self.width,
            "height": self.height,
            "budget": {k: getattr(self.budget, k) for k in ("spp", "seconds", "visible_noise")},
            "config": self.config.to_dict(),
            "seed": self.seed,
            "aovs": self.aovs,
            "signed": self.signed,
            "note": self.note,
        }
        checkpoint.write(Path(path), header, self._native.save())

    @classmethod
    def load(cls, path: str | Path, threads: int | _core.Executor | None = None) -> Sampler:
        """The sampler that `save` wrote: it goes on to the same bits. Batches that were open are asked again.

        Raises FileNotFoundError, or ValueError for a file that is damaged, of another version or no checkpoint.
        """
        header, blocks = checkpoint.read(Path(path))
        try:
            _check_film(header, sum(block.nbytes for block in blocks.values()))
            sampler = cls(
                header["width"],
                header["height"],
                Budget(**header["budget"]),
                Config.from_dict(header["config"]),
                seed=header["seed"],
                aovs=header["aovs"],
                threads=threads,
                signed=header["signed"],
            )
            sampler._native.restore(blocks)
            sampler.note = dict(header.get("note", {}))
        except (KeyError, TypeError, ValueError, RuntimeError, MemoryError) as error:
            raise ValueError(f"cannot resume from {str(path)!r}: {error}") from error
        return sampler


def render(
    radiance: Radiance,
    width: int,
    height: int,
    budget: Budget,
    config: Config | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    timeout: float | None = None,
) -> Result:
    """Renders an image: a thin loop over `Sampler.ask` and `tell` that gives the same bits. Arguments as theirs.

    A renderer with attributes `aovs`, `signed` and `threads` is taken at its word. Raises ValueError where it has a
    `width` and a `height` and they are others.
    """
    made_for = (getattr(radiance, "width", width), getattr(radiance, "height", height))
    if made_for != (width, height):
        raise ValueError(
            f"the image is {width}x{height} and the renderer renders {made_for[0]}x{made_for[1]}: give both one size"
        )
    return sampler_for(radiance, width, height, budget, config, seed).run(radiance, progress, timeout)


def sampler_for(
    radiance: Radiance, width: int, height: int, budget: Budget, config: Config | None = None, seed: int = 0
) -> Sampler:
    """A sampler for what a renderer says of itself: its extra channels (`aovs`), its `threads`, if it is `signed`."""
    aovs, signed = getattr(radiance, "aovs", 0), getattr(radiance, "signed", False)
    return Sampler(width, height, budget, config, seed, aovs=aovs, threads=threads_of(radiance), signed=signed)


def threads_of(radiance: Radiance) -> _core.Executor | None:
    """The threads that a renderer lends, if any. Where they are busy the sampler works without them."""
    threads = getattr(radiance, "threads", None)
    return threads if isinstance(threads, _core.Executor) else None


def config_for(radiance: Radiance, settings: Mapping[str, Any]) -> Config:
    """Settings as `Config.from_dict` takes them, for what a renderer says of itself.

    Its `width` and `height` scale the preset "paper"; where it has a `filter`, the settings of its film's
    reconstruction filter, they are the image's unless `settings` name one. Where it has a `batching`, settings such as
    `batch` and `lookahead` that suit it, they hold unless `settings` name others or start from the preset "paper".
    """
    size = (getattr(radiance, "width", 640), getattr(radiance, "height", 480))
    filtered = {} if "filter" in settings else getattr(radiance, "filter", {})
    batching = {} if settings.get("preset") == "paper" else getattr(radiance, "batching", {})
    return Config.from_dict({**batching, **filtered, **settings}, size)


def _takes_batch(radiance: Radiance) -> bool:
    if not callable(radiance):
        raise TypeError(f"radiance is {radiance!r}: expected a function of positions or of a Batch")
    if hasattr(radiance, "takes_batch"):
        return bool(radiance.takes_batch)
    try:
        parameters = list(inspect.signature(radiance).parameters.values())
    except (TypeError, ValueError):  # builtins without a signature
        return False
    return bool(parameters) and (parameters[0].name == "batch" or parameters[0].annotation in (Batch, "Batch"))


def _native_batch(batch: Batch) -> _core.Batch:
    if not isinstance(batch, Batch):
        raise TypeError(f"got {type(batch).__name__}: expected the Batch that ask returned")
    return batch._native


def _values(radiance: npt.ArrayLike, batch: Batch, channels: int) -> npt.NDArray[np.float32]:
    """What was told of a batch as the core takes it."""
    what, expected = f"for batch {batch.number}", (len(batch), channels)
    if np.ma.isMaskedArray(radiance):
        raise TypeError(
            f"tell: got a masked array {what}, expected a plain one: fill it, with NaN for what is no sample"
        )
    try:
        array = np.asarray(radiance)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"tell: got radiance that is no array {what}, expected shape {expected}: {_ROWS}") from error
    if array.shape != expected:
        raise ValueError(f"tell: got radiance of shape {array.shape} {what}, expected {expected}: {_ROWS}")
    if array.dtype.kind != "f":
        raise TypeError(f"tell: got radiance of type {array.dtype} {what}, expected float32: convert it with astype")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite and is counted as such
        return np.ascontiguousarray(array, dtype=np.float32)


def _check_film(header: Mapping[str, Any], stored: int) -> None:
    """Raises ValueError where a checkpoint speaks of a larger film than it has bytes for: before one is made."""
    sides = [inputs.side(name, header[name]) for name in ("width", "height")]
    need = sides[0] * sides[1] * (_core.film_bytes_per_pixel + 8 * inputs.whole("aovs", header["aovs"], 0, 64))
    if need > stored:
        raise ValueError(f"an image of {sides[0]}x{sides[1]} takes {need} bytes of film, and it holds {stored}")


def _threads(threads: int | _core.Executor | None) -> int | _core.Executor:
    if isinstance(threads, _core.Executor):
        return threads
    return 0 if threads is None else inputs.whole("threads", threads, 1, 1024)
