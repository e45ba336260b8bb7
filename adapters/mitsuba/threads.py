"""Dr.Jit's threads, for the sampler's own work.

They spin for some 20 ms after each batch in case there is more to render, and only then sleep: threads of the sampler's
own would have to wait for a processor meanwhile.
"""

import ctypes
from functools import cache
from pathlib import Path

import drjit

from pmc_sampler import _core

_FUNCTIONS = ("pool_size", "pool_thread_id", "task_submit_dep", "task_release")


@cache
def executor() -> _core.Executor | None:
    """Those threads; None where this version of Dr.Jit has no such library beside it."""
    folder = Path(drjit.__file__).parent
    for path in sorted(folder.glob("*nanothread.*")):
        try:
            library = ctypes.CDLL(str(path))
        except OSError:  # not Dr.Jit's own, which is loaded
            continue
        if all(hasattr(library, name) for name in _FUNCTIONS):
            return _core.Nanothread(*(_address(library, name) for name in _FUNCTIONS))
    return None


def _address(library: ctypes.CDLL, name: str) -> int:
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert address is not None
    return address
