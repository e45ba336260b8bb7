"""Dask clusters, which the runs of a benchmark and the batches of a render can go to (package `distributed`)."""

from __future__ import annotations

import importlib
from typing import Any

TIMEOUT = "20s"
"""How long a scheduler may take to answer."""


class ClusterError(RuntimeError):
    """A Dask cluster that cannot be used; the message says why and what to do."""


def connect(address: str) -> Any:
    """A `distributed.Client` of the scheduler at `address`, such as `tcp://host:8786`; to be closed by the caller.

    Raises ClusterError where there is no scheduler, and without the package.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise ClusterError(
            f"a cluster needs Dask, which cannot be imported ({error}): pip install 'pmc-sampler[dask]'."
        ) from error
    if ":" not in address:  # Dask would look for it for long
        raise ClusterError(f"{address!r} is no address of a Dask scheduler; give one such as tcp://host:8786.")
    try:
        return distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {address!r} ({error}); start one by `dask scheduler`, and workers by "
            f"`dask worker {address} --nthreads 1`."
        ) from error
