"""References: long uniform renders with the variance of their own mean, cached in files and resumable.

A reference is the mean of independent replicates, each a uniform render with Sobol points and a seed of its
own. The variance of the mean is taken from the spread between replicates: Sobol points are not independent
within one, so the variance of single samples would overstate the reference's noise and too much would be
subtracted.
"""

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import Budget, Config, Sampler, luminance, npz, scenes
from pmc_sampler.sampler import sampler_for, threads_of

SEED = 0x5EED_0000
"""Seed of the first replicate; measured runs use small seeds, so none shares a reference's samples."""
REPLICATES = 16
"""Uniform renders that a reference is the mean of, from whose spread its own noise is known."""


class BadReferenceError(ValueError):
    """A reference that cannot be made or read; the message says which file and what to do."""


@dataclass(frozen=True)
class Reference:
    """A reference image and how far it may be trusted.

    ``mean`` (height, width, 3) float32 linear RGB; ``variance`` (height, width, 3) float32 of that mean;
    ``luminance_variance`` (height, width) float32 of its luminance; ``spp`` samples per pixel over all
    ``replicates``; ``rejected`` samples that were not finite or negative; ``seconds`` it took; ``key``
    names what it is a reference of.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    luminance_variance: NDArray[np.float32]
    spp: int
    replicates: int
    rejected: int
    seconds: float
    key: str

    @property
    def mean_luminance(self) -> float:
        """Mean luminance of the image."""
        return float(luminance(self.mean.astype(np.float64)).mean())

    @property
    def noise(self) -> float:
        """Root mean square over pixels of the luminance's standard error, relative to the mean luminance."""
        return float(np.sqrt(self.luminance_variance.mean(dtype=np.float64))) / self.mean_luminance

    @property
    def bias_error(self) -> float:
        """Standard error of the mean luminance, relative to it: a measured bias is uncertain by as much.

        Raises ValueError where that is 0.
        """
        if self.mean_luminance == 0.0:
            raise ValueError("the reference is black, so no bias relative to its mean luminance exists.")
        n = self.luminance_variance.size
        return float(np.sqrt(self.luminance_variance.sum(dtype=np.float64))) / n / self.mean_luminance


def key(settings: Mapping[str, Any]) -> str:
    """A short name for all that a reference depends on: scene, renderer, versions, size, samples."""
    text = json.dumps(settings, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def digest(path: Path) -> str:
    """A short name for a file's contents."""
    with path.open("rb") as stream:
        whole = hashlib.sha256()
        while block := stream.read(1 << 20):
            whole.update(block)
    return whole.hexdigest()[:16]


def identify(scene: str, renderer: str, version: str) -> dict[str, str]:
    """What a scene's image depends on besides size and samples, for :func:`key`.

    ``scene`` is a built-in scene's name or a file; its contents count, and those of the files that it names.
    ``renderer`` is a renderer's name; ``version`` what else its images depend on, as
    :func:`pmc_sampler.adapters.version` has it.
    """
    return {
        "scene": scene,
        "contents": scenes.digest(scenes.path(scene) if scene in scenes.names() else scene),
        "renderer": renderer,
        "renderer_version": version,
    }


def cache_folder() -> Path:
    """The user's cache folder for references, ``$XDG_CACHE_HOME/pmc_sampler`` or ``~/.cache/pmc_sampler``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "pmc_sampler" / "references"


def obtain(
    radiance: Callable[..., Any],
    width: int,
    height: int,
    spp: int,
    settings: Mapping[str, Any],
    *,
    cache: str | os.PathLike[str] | None = None,
    replicates: int = REPLICATES,
    noise: float | None = None,
    save_seconds: float = 60.0,
    progress: Callable[[float], None] | None = None,
) -> Reference:
    """The reference from the cache, or rendered into it, resuming what an interruption left.

    Parameters: ``radiance`` a renderer (see :class:`pmc_sampler.Sampler`) whose samples are low-discrepancy
    or independent; ``spp`` a multiple of ``replicates``; ``settings`` names everything besides size and
    samples that the image depends on (scene, renderer, versions) and, with those, makes the key; ``noise``, if
    given, adds replicates of as many samples until :attr:`Reference.noise` is at most that; ``cache``
    a folder, made when missing; state is saved after each replicate and every ``save_seconds`` within one;
    ``progress`` is called with the finished share. Raises :class:`BadReferenceError`.
    """

    def replicate(seed: int, each: int, state: Path, share: Callable[[float], None]) -> tuple[NDArray[np.float32], int]:
        sampler = _sampler(state, radiance, width, height, each, seed)
        saved = time.perf_counter()
        while not sampler.done:
            batch = sampler.ask()
            sampler.tell(batch, radiance(batch))
            share(min(sampler.spp / each, 1.0))
            if time.perf_counter() - saved > save_seconds:
                sampler.save(state)
                saved = time.perf_counter()
        return sampler.film.plain_mean, sampler.rejected

    return replicated(
        replicate,
        width,
        height,
        spp,
        settings,
        cache=cache,
        replicates=replicates,
        noise=noise,
        progress=progress,
    )


Replicate = Callable[[int, int, Path, Callable[[float], None]], tuple[NDArray[np.float32], int]]


def replicated(
    replicate: Replicate,
    width: int,
    height: int,
    spp: int,
    settings: Mapping[str, Any],
    *,
    cache: str | os.PathLike[str] | None = None,
    replicates: int = REPLICATES,
    noise: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Reference:
    """As :func:`obtain`, of a renderer that makes whole images.

    ``replicate(seed, spp, state, share)`` gives a uniform render, (height, width, 3), and the count of its rejected
    samples; it may keep ``state``, a file, where it is interrupted, and call ``share`` with the finished part of it.
    """
    if replicates < 2 or spp < replicates or spp % replicates:
        raise BadReferenceError(
            f"a reference needs at least 2 replicates and samples per pixel in a multiple of them; "
            f"{spp} spp in {replicates} came."
        )
    if noise is not None and not noise > 0.0:
        raise BadReferenceError(f"a reference's noise must be above 0, for example 0.01; {noise!r} came.")
    full = _described(width, height, spp, settings, replicates, noise)
    folder = Path(cache) if cache is not None else cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    name = key(full)
    path = folder / f"{name}.npz"
    if path.is_file():
        return load(path)
    state = _Replicates.resume(folder / f"{name}.part.npz", height, width)
    inner = folder / f"{name}.sampler"
    each = spp // replicates
    while (wanted := state.wanted(replicates, noise)) > state.count:

        def share(part: float, done: int = state.count, of: int = wanted) -> None:
            if progress is not None:
                progress((done + part) / of)

        began = time.perf_counter()
        image, rejected = replicate(SEED + state.count, each, inner, share)
        share(1.0)
        state.add(image, rejected, time.perf_counter() - began)
        state.save(folder / f"{name}.part.npz")
        inner.unlink(missing_ok=True)
    reference = state.reference(each * state.count, name)
    _save(path, {field.name: getattr(reference, field.name) for field in fields(reference)}, settings=full)
    (folder / f"{name}.part.npz").unlink(missing_ok=True)
    return reference


def is_cached(
    folder: Path, width: int, height: int, spp: int, settings: Mapping[str, Any], noise: float | None = None
) -> bool:
    """Whether :func:`obtain` would find the reference of these arguments, whole, in the cache ``folder``."""
    return (folder / f"{key(_described(width, height, spp, settings, REPLICATES, noise))}.npz").is_file()


def _described(
    width: int, height: int, spp: int, settings: Mapping[str, Any], replicates: int, noise: float | None
) -> dict[str, Any]:
    full = {**settings, "width": width, "height": height, "spp": spp, "replicates": replicates, "seed": SEED}
    return full if noise is None else {**full, "noise": noise}


def load(path: str | os.PathLike[str]) -> Reference:
    """Read a reference file; raises :class:`BadReferenceError` for a missing, foreign or damaged one."""
    data = _read(Path(path))
    try:
        return Reference(
            mean=data["mean"],
            variance=data["variance"],
            luminance_variance=data["luminance_variance"],
            spp=int(data["spp"]),
            replicates=int(data["replicates"]),
            rejected=int(data["rejected"]),
            seconds=float(data["seconds"]),
            key=str(data["key"]),
        )
    except KeyError as error:
        raise BadReferenceError(f"{str(path)!r} is no reference: {error.args[0]} is missing.") from error


@dataclass
class _Replicates:
    """Running mean and sum of squared deviations over replicates (Welford 1962), of R, G, B and luminance."""

    count: int
    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    rejected: int
    seconds: float

    @classmethod
    def resume(cls, path: Path, height: int, width: int) -> "_Replicates":
        if not path.is_file():
            return cls(0, np.zeros((height, width, 4)), np.zeros((height, width, 4)), 0, 0.0)
        data = _read(path)
        return cls(int(data["count"]), data["mean"], data["squares"], int(data["rejected"]), float(data["seconds"]))

    def add(self, image: NDArray[np.float32], rejected: int, seconds: float) -> None:
        rgb = image.astype(np.float64)
        values = np.concatenate([rgb, np.asarray(luminance(rgb), dtype=np.float64)[..., None]], axis=2)
        self.count += 1
        before = values - self.mean
        self.mean = self.mean + before / self.count
        self.squares = self.squares + before * (values - self.mean)
        self.rejected += rejected
        self.seconds += seconds

    def save(self, path: Path) -> None:
        _save(path, {field.name: getattr(self, field.name) for field in fields(self)})

    def wanted(self, least: int, noise: float | None) -> int:
        """How many replicates it will take: ``least``, or as many as bring the noise down to ``noise``."""
        if noise is None or self.count < least:
            return least
        return max(self.count, math.ceil(self.count * (self.reference(0, "").noise / noise) ** 2))

    def reference(self, spp: int, name: str) -> Reference:
        variance = (self.squares / (self.count - 1) / self.count).astype(np.float32)
        return Reference(
            self.mean[..., :3].astype(np.float32),
            variance[..., :3],
            variance[..., 3],
            spp,
            self.count,
            self.rejected,
            self.seconds,
            name,
        )


def _sampler(inner: Path, radiance: Any, width: int, height: int, spp: int, seed: int) -> Sampler:
    if inner.is_file():
        sampler = Sampler.load(inner, threads_of(radiance))
        if sampler.seed == seed:
            return sampler
    return sampler_for(radiance, width, height, Budget(spp=spp), Config.uniform(), seed)


def _save(path: Path, arrays: Mapping[str, Any], settings: Mapping[str, Any] | None = None) -> None:
    contents = dict(arrays)
    if settings is not None:
        contents["settings"] = json.dumps(settings, sort_keys=True, default=str)
    try:
        npz.write(path, contents)
    except OSError as error:
        raise BadReferenceError(f"the reference {str(path)!r} cannot be written: {error.strerror or error}.") from error


def _read(path: Path) -> npz.Arrays:
    try:
        return npz.read(path)
    except FileNotFoundError as error:
        raise BadReferenceError(f"there is no reference {str(path)!r}.") from error
    except (OSError, ValueError) as error:
        raise BadReferenceError(f"{str(path)!r} is damaged ({error}); delete it to render it anew.") from error
