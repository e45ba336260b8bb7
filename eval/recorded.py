"""Recordings: a renderer's samples, K of every pixel, in one HDF5 file, replayed as a renderer of known mean.

Studies of samplers on a recording cost no rendering and need no reference: the expectation of a replayed sample is
the mean of the K stored ones, exactly.
"""

import contextlib
import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pmc_sampler import Budget, Config, Sampler, _core, limits, luminance

from .references import Reference, key

FORMAT = "pmc_sampler recording"
VERSION = 1
LARGEST_HALF = 65504.0
"""The largest float16; samples are stored in 16 bits where the brightest is at most that, else in 32."""
FAINTEST_HALF = 0.0625
"""The brightest must be at least that, too: float16 has steps of 6e-8 near 0, in which faint radiance is lost."""
_CHUNK_BYTES = 2**20
_NUMBERS = ("sobol", "independent")


class BadRecordingError(ValueError):
    """A recording that cannot be made or read; the message says which file and what to do."""


def record(
    radiance: Callable[..., Any],
    width: int,
    height: int,
    per_pixel: int,
    path: str | os.PathLike[str],
    *,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Render ``per_pixel`` samples of every pixel, uniformly in the pixel's own box, and store them at ``path``.

    What is rendered is appended, pass by pass of one sample a pixel, to ``PATH.part``; the same call goes on from it
    after an interruption and comes to the same bits. The finished file is written beside its place and renamed into
    it. Where it is there already, and of the same settings, nothing is done.

    Parameters: ``radiance`` a renderer that takes a batch, ``signed`` or not; extra channels (``aovs``) are not
    stored. ``per_pixel`` a power of two, so that the replay can shuffle a low-discrepancy sequence without losing its
    strata. ``settings``, JSON, names what the samples depend on besides (scene, renderer, versions, random numbers).
    ``progress`` is called with the finished share. Samples that are not finite or negative (unless ``signed``) are
    stored as NaN. Raises :class:`BadRecordingError`.
    """
    target = Path(path)
    head = _head(width, height, per_pixel, bool(getattr(radiance, "signed", False)), seed, settings or {})
    if target.exists():
        _must_match(head, Recording(target).head, target)
        return
    partial = target.with_name(f"{target.name}.part")
    with _Passes(partial, head, width * height) as passes:
        sampler = Sampler(width, height, Budget(spp=per_pixel), Config.uniform(batch=width * height), seed)
        for number in range(per_pixel):
            batch = sampler.ask()
            if number >= passes.count:
                passes.append(batch.pixel, np.asarray(radiance(batch), np.float32)[:, :3], head["signed"])
                if progress is not None:
                    progress((number + 1) / per_pixel)
            # Uniform batches do not depend on what was told, so that passes made before need not be read.
            sampler.tell(batch, np.zeros((len(batch), 3), np.float32))
        with _written(target):
            _finish(target, head, passes.array(per_pixel))
            partial.unlink()


class Recording:
    """A recording as a renderer: called with a batch, it gives each sample one of the K of the sample's pixel.

    ``sampler``: which one. ``"independent"``: drawn anew by a hash of (scramble, index), with replacement.
    ``"sobol"``: the K samples without replacement, in an order that is a nested uniform (Owen) shuffle by the
    scramble; after K the next ones come in another order. Such a shuffle maps aligned blocks of 2^m indices to
    aligned blocks, so that the strata of recorded Sobol points stay strata. Positions are not looked at.

    Attributes: ``width``, ``height``, ``per_pixel`` (K), ``signed``, ``settings``; ``mean`` (height, width, 3)
    float64, the exact expectation of a replayed sample that is valid; ``variance`` (height, width, 3) and
    ``luminance_variance`` (height, width), float64, those of one replayed sample.

    The file is read into memory whole. Raises :class:`BadRecordingError` for a missing, foreign or damaged file.
    """

    takes_batch = True
    aovs = 0

    def __init__(self, path: str | os.PathLike[str], sampler: str = "sobol") -> None:
        if sampler not in _NUMBERS:
            raise ValueError(f"sampler is {sampler!r}: expected one of {', '.join(_NUMBERS)}")
        self.path, self.sampler = Path(path), sampler
        with _read(self.path) as (head, stored):
            self.head: dict[str, Any] = head
            self.width, self.height, self.per_pixel = int(head["width"]), int(head["height"]), int(head["per_pixel"])
            self.signed = bool(head["signed"])
            self.settings: dict[str, Any] = head["settings"]
            self.samples: NDArray[np.floating] = np.empty(stored.shape, stored.dtype)
            moments = np.empty((2, stored.shape[0], 4))
            for first in range(0, stored.shape[0], stored.chunks[0]):
                rows = slice(first, first + stored.chunks[0])
                self.samples[rows] = block = stored[rows]
                moments[:, rows] = _moments(block.astype(np.float64))
        mean, variance = moments.reshape(2, self.height, self.width, 4)
        self.mean = mean[..., :3]
        self.variance, self.luminance_variance = variance[..., :3], variance[..., 3]
        self._flat = self.samples.reshape(-1, 3)

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of each sample of ``batch``, shape (n, 3) float32; NaN where an invalid one is drawn."""
        draw = _core.shuffled_index if self.sampler == "sobol" else _core.mix
        which = draw(batch.scramble, batch.index) & np.uint32(self.per_pixel - 1)
        drawn: NDArray[np.float32] = self._flat[batch.pixel.astype(np.int64) * self.per_pixel + which].astype(
            np.float32
        )
        return drawn

    @property
    def reference(self) -> Reference:
        """The exact mean as a reference without variance."""
        nothing = np.zeros((self.height, self.width, 3), np.float32)
        rejected = int(np.isnan(self.samples[..., 0]).sum())
        name = key(self.head)
        return Reference(self.mean.astype(np.float32), nothing, nothing[..., 0], self.per_pixel, 1, rejected, 0.0, name)


def _head(
    width: int, height: int, per_pixel: int, signed: bool, seed: int, settings: Mapping[str, Any]
) -> dict[str, Any]:
    if per_pixel < 1 or per_pixel & (per_pixel - 1) or per_pixel > 2**20:
        raise BadRecordingError(
            f"a recording holds a power of two of samples per pixel, at most 2^20; {per_pixel} came."
        )
    sizes = {"width": width, "height": height, "per_pixel": per_pixel}
    full = {"format": FORMAT, "version": VERSION, **sizes, "signed": signed, "seed": seed, "settings": dict(settings)}
    head: dict[str, Any] = json.loads(json.dumps(full, default=str))
    return head


def _must_match(wanted: Mapping[str, Any], found: Mapping[str, Any], path: Path) -> None:
    for name, value in wanted.items():
        if found.get(name) != value:
            raise BadRecordingError(
                f"{str(path)!r} is another recording, whose {name} is {found.get(name)!r} and not {value!r}; "
                "give the same options, another file, or delete it."
            )


@contextlib.contextmanager
def _written(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        raise BadRecordingError(f"the recording {str(path)!r} cannot be written: {why}.") from error


class _Passes:
    """The file of an unfinished recording: its head as a line of JSON, then float32 RGB of every pixel, by passes."""

    def __init__(self, path: Path, head: Mapping[str, Any], pixels: int) -> None:
        self._path, self._pass_bytes = path, pixels * 3 * 4
        line = json.dumps(head, sort_keys=True).encode() + b"\n"
        self._start = len(line)
        with _written(path):
            self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise BadRecordingError(f"the recording {str(path)!r} is being written by another process.") from error
        try:
            with _written(path):
                self._begin(line, head)
        except BaseException:
            self._file.close()
            raise

    def _begin(self, line: bytes, head: Mapping[str, Any]) -> None:
        if self._file.tell() == 0:
            self._file.write(line)
            self._file.flush()
        self._file.seek(0)
        found = self._file.readline(2**20)
        if found != line:
            try:
                then = json.loads(found)
                known = then["format"] == FORMAT
            except (ValueError, TypeError, KeyError):
                known = False
            if not known:
                raise BadRecordingError(
                    f"{str(self._path)!r} is no unfinished recording; give another name, or delete it."
                )
            _must_match(head, then, self._path)
        passes = self._file.seek(0, os.SEEK_END) - self._start
        self.count = passes // self._pass_bytes
        # An interruption in the middle of a write left part of a pass.
        self._file.truncate(self._start + self.count * self._pass_bytes)

    def __enter__(self) -> "_Passes":
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def append(self, pixel: NDArray[np.uint32], values: NDArray[np.float32], signed: bool) -> None:
        """One sample of every pixel."""
        if values.shape != (len(pixel), 3):
            raise BadRecordingError(
                f"the renderer gave radiance of shape {values.shape}; expected ({len(pixel)}, 3) or more channels."
            )
        valid = np.isfinite(values).all(axis=1)
        if not signed:
            valid = valid & (values >= 0.0).all(axis=1)
        image = np.empty_like(values)
        image[pixel] = np.where(np.expand_dims(valid, 1), values, np.nan)
        with _written(self._path):
            self._file.write(image.tobytes())
            self._file.flush()
        self.count += 1

    def array(self, per_pixel: int) -> NDArray[np.float32]:
        """Shape (per_pixel, pixels, 3), read as it is used."""
        os.fsync(self._file.fileno())
        shape = (per_pixel, self._pass_bytes // 12, 3)
        return np.memmap(self._path, np.float32, "r", self._start, shape)


def _finish(target: Path, head: Mapping[str, Any], passes: NDArray[np.float32]) -> None:
    per_pixel, pixels, _ = passes.shape
    brightest = max(float(np.nanmax(np.abs(one), initial=0.0)) for one in passes)
    kind = np.dtype(np.float16 if FAINTEST_HALF <= brightest <= LARGEST_HALF else np.float32)
    rows = max(1, min(pixels, _CHUNK_BYTES // (per_pixel * 3 * kind.itemsize)))
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with h5py.File(beside, "w") as file:
            file.attrs["head"] = json.dumps(head, sort_keys=True)
            stored = file.create_dataset(
                "samples",
                (pixels, per_pixel, 3),
                kind,
                chunks=(rows, per_pixel, 3),
                compression="gzip",
                shuffle=True,
                fletcher32=True,
            )
            for first in range(0, pixels, rows):
                stored[first : first + rows] = passes[:, first : first + rows].transpose(1, 0, 2).astype(kind)
        with beside.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)


@contextlib.contextmanager
def _read(path: Path) -> Iterator[tuple[dict[str, Any], Any]]:
    """The head and the dataset of a recording, checked before anything is allocated for it."""
    if not path.is_file():
        raise BadRecordingError(f"there is no recording {str(path)!r}; `pmc-sampler record` makes one.")
    try:
        with h5py.File(path, "r") as file:
            head = json.loads(file.attrs["head"])
            if head["format"] != FORMAT:
                raise ValueError("its head is not a recording's")
            if head["version"] != VERSION:
                raise ValueError(f"it is of version {head['version']}, and this version of pmc_sampler reads {VERSION}")
            stored = file["samples"] if isinstance(file.get("samples", getlink=True), h5py.HardLink) else None
            _check_stored(stored, head, path.stat().st_size)
            yield head, stored
    except Exception as error:  # h5py, json and zlib make errors of a dozen kinds of what is damaged
        raise BadRecordingError(
            f"{str(path)!r} is no whole recording ({error}); record it anew or name another file."
        ) from error


def _check_stored(stored: Any, head: Mapping[str, Any], file_bytes: int) -> None:
    width, height, per_pixel = (head[name] for name in ("width", "height", "per_pixel"))
    if not all(type(n) is int and 1 <= n <= 2**20 for n in (width, height, per_pixel)) or per_pixel & (per_pixel - 1):
        raise ValueError(f"its head speaks of {width}x{height} pixels and {per_pixel} samples of each")
    if not isinstance(head["signed"], bool) or not isinstance(head["settings"], dict):
        raise ValueError("its head is incomplete")
    if not isinstance(stored, h5py.Dataset):
        raise ValueError("its samples are missing")
    shape = (width * height, per_pixel, 3)
    if stored.shape != shape or stored.dtype not in (np.float16, np.float32):
        raise ValueError(f"its samples are {stored.dtype} of shape {stored.shape}, not floats of shape {shape}")
    plain = stored.compression == "gzip" and stored.scaleoffset is None and stored.fletcher32
    if stored.is_virtual or stored.external or not plain or stored.chunks[1:] != shape[1:]:
        raise ValueError("its samples are not stored as `record` stores them")
    limits.check("its head", stored.size * stored.dtype.itemsize, file_bytes)
    if stored.id.get_num_chunks() != -(-shape[0] // stored.chunks[0]):
        raise ValueError("some of its samples were never written")


def _moments(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean and variance of R, G, B and luminance over the valid ones of samples (pixels, K, 3): (2, pixels, 4)."""
    valid = np.isfinite(samples[..., 0])
    count = np.maximum(valid.sum(axis=1), 1)[:, None]
    values = np.concatenate([samples, np.asarray(luminance(samples))[..., None]], axis=2)
    values[~valid] = 0.0
    mean = values.sum(axis=1) / count
    values -= mean[:, None]
    values[~valid] = 0.0
    return np.stack([mean, (values**2).sum(axis=1) / count])
