"""How finely Dr.Jit divides a batch among the processors.

On the CPU, Dr.Jit hands kernels out in blocks of 16384 samples. That is right for the whole of an image, and coarse
for a batch of one sample a pixel: 320x240 pixels make five blocks, of which two processors get three and two, and
of which sixteen processors leave eleven idle. The size can be set, process-wide, by a function of Dr.Jit's C++
interface (`drjit-core/jit.h`) that its Python interface leaves out; where a release of Dr.Jit has it under another
name, batches are divided as before.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import drjit as dr

__all__ = ["block_size", "divided"]

_PER_THREAD = 16  # blocks: the last ones to finish then cost a few percent at most
_SMALLEST, _LARGEST = 256, 16384  # samples; powers of two, Dr.Jit takes no others


@dataclass
class _Callers:
    """Who is inside `divided`, for the size is the process's: the first one in notes it, the last one out restores it.

    While several are inside, the size is that of the latest: it is a matter of speed alone.
    """

    count: int = 0
    before: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


_callers = _Callers()


@contextlib.contextmanager
def divided(samples: int) -> Iterator[None]:
    """Inside the block, kernels over so many samples keep all processors busy; after it all is as before.

    Threads may be inside at the same time.
    """
    functions = _functions()
    if functions is None:
        yield
        return
    get, put = functions
    with _callers.lock:
        if _callers.count == 0:
            _callers.before = get()
        _callers.count += 1
        put(block_size(samples, dr.thread_count()))
    try:
        yield
    finally:
        with _callers.lock:
            _callers.count -= 1
            if _callers.count == 0:
                put(_callers.before)


def block_size(samples: int, threads: int) -> int:
    """The samples in a block, a power of two, such that each thread gets several blocks."""
    share = samples // (_PER_THREAD * max(threads, 1))
    return max(_SMALLEST, min(_LARGEST, 1 << max(share, 1).bit_length() - 1))


@functools.cache
def _functions() -> tuple[Callable[[], int], Callable[[int], None]] | None:
    """Dr.Jit's `jit_llvm_block_size` and `jit_llvm_set_block_size`, if it has them."""
    library = Path(dr.__file__).parent / "libdrjit-core.so"
    try:
        core = ctypes.CDLL(str(library))
        get, put = core._Z19jit_llvm_block_sizev, core._Z23jit_llvm_set_block_sizej
    except (OSError, AttributeError):
        return None
    get.argtypes, get.restype = [], ctypes.c_uint32
    put.argtypes, put.restype = [ctypes.c_uint32], None
    return get, put
