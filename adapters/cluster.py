"""A renderer on the workers of a Dask cluster."""

from __future__ import annotations

import functools
import importlib
import pickle
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import cluster

__all__ = ["ClusterRenderer"]

PATIENCE = 60.0
"""Seconds in which another worker may come where none is left."""
_LOOK = 2.0  # seconds from one look at the workers to the next
_SMALLEST = 4096  # samples, below which a worker is not worth the way
_DESCRIBED = ("width", "height", "aovs", "aov_names", "signed", "filter", "remark")


class ClusterRenderer:
    """A renderer whose batches are traced in pieces by the workers of the cluster at `address`.

    Each worker loads `scene` with `load(renderer, scene, **options)` by itself, so files must lie where all find them.
    The value of a sample is a function of its position, scramble and index alone, so that the image is that of one
    process on the same kind of device; a piece whose worker dies is traced again by another. It has the attributes of
    the renderer that the sampler asks for, such as `width`, `height` and `filter`. A context manager: it leaves the
    cluster at its end.

    Raises `pmc_sampler.cluster.ClusterError` where there is no cluster or it has no workers, or loses them all while
    it traces, and what the renderer raises for the scene.
    """

    takes_batch = True

    def __init__(self, address: str, load: Any, renderer: str, scene: Any, **options: Any) -> None:
        self._client = cluster.connect(address)
        try:
            if not self._client.ncores():
                raise cluster.ClusterError(
                    f"the Dask scheduler at {address!r} has no workers; start some by "
                    f"`dask worker {address} --nthreads 1`."
                )
            self._made = pickle.dumps((load, renderer, scene, options))
            described = self._client.submit(_describe, self._made, pure=False).result()
        except BaseException:
            self._client.close()
            raise
        for name, value in described.items():
            setattr(self, name, value)

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of each sample of `batch`, shape (n, 3 + aovs)."""
        workers = max(1, len(self._client.ncores()))
        pieces = min(workers, -(-len(batch) // _SMALLEST))
        arrays = (batch.positions, batch.pixel, batch.index, batch.scramble)
        parts = zip(*(np.array_split(array, pieces) for array in arrays), strict=True)
        traced = [self._client.submit(_trace, self._made, *part, pure=False) for part in parts]
        try:
            self._wait(traced)
            return np.concatenate(self._client.gather(traced))
        except BaseException:  # an interrupt as well: the workers need not go on
            self._client.cancel(traced)
            raise

    def _wait(self, traced: Any) -> None:
        """Until all are traced; Dask by itself would wait for ever where no worker is left.

        Raises ClusterError then, and where the scheduler has gone.
        """
        distributed = importlib.import_module("distributed")
        missing = 0
        while True:
            try:
                with self._client.as_current():
                    distributed.wait(traced, timeout=_LOOK)
                return
            except TimeoutError:
                missing = 0 if self._client.status == "running" and self._client.ncores() else missing + 1
            if missing * _LOOK > PATIENCE:
                raise cluster.ClusterError(
                    f"no worker of the Dask cluster is left, and none came within {PATIENCE:g} s"
                )

    def __enter__(self) -> ClusterRenderer:
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()


@functools.lru_cache(maxsize=1)
def _loaded(made: bytes) -> Any:
    load, renderer, scene, options = pickle.loads(made)
    return load(renderer, scene, **options)


def _describe(made: bytes) -> dict[str, Any]:
    radiance = _loaded(made)
    return {name: getattr(radiance, name) for name in _DESCRIBED if hasattr(radiance, name)}


class _Piece(SimpleNamespace):
    """Part of a batch, with its arrays."""

    def __len__(self) -> int:
        return len(self.pixel)


def _trace(
    made: bytes,
    positions: NDArray[np.float32],
    pixel: NDArray[np.uint32],
    index: NDArray[np.uint32],
    scramble: NDArray[np.uint32],
) -> NDArray[np.float32]:
    piece = _Piece(positions=positions, pixel=pixel, index=index, scramble=scramble)
    return np.asarray(_loaded(made)(piece), dtype=np.float32)
