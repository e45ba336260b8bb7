"""The arrays of a scene on a device, and the sentence for those that do not fit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from .devices import label

__all__ = ["check", "guarded", "upload"]

_CODES = (
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE,
    cl.status_code.OUT_OF_RESOURCES,
    cl.status_code.OUT_OF_HOST_MEMORY,
    cl.status_code.INVALID_BUFFER_SIZE,
)


def check(device: Any, arrays: dict[str, NDArray[Any]]) -> None:
    """Raises MemoryError where the arrays cannot be on the device: one of them, or all together."""
    for name, array in arrays.items():
        if array.nbytes > device.max_mem_alloc_size:
            raise MemoryError(
                f"the scene's {name.replace('_', ' ')} take {_mib(array.nbytes)}, and the OpenCL device "
                f"{label(device)} holds at most {_mib(device.max_mem_alloc_size)} in one piece; take a smaller "
                f"scene or another device"
            )
    total = sum(array.nbytes for array in arrays.values())
    if total > device.global_mem_size:
        largest = max(arrays, key=lambda name: arrays[name].nbytes)
        raise MemoryError(
            f"the scene takes {_mib(total)}, most of it its {largest.replace('_', ' ')}, and the OpenCL device "
            f"{label(device)} has {_mib(device.global_mem_size)}; take a smaller scene or another device"
        )


def upload(context: Any, arrays: dict[str, NDArray[Any]]) -> list[Any]:
    """Buffers with the arrays' contents, in their order.

    Raises MemoryError as `check` does, and where the device refuses.
    """
    (device,) = context.devices
    check(device, arrays)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    with guarded(device, sum(array.nbytes for array in arrays.values())):
        return [cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(array)) for array in arrays.values()]


@contextmanager
def guarded(device: Any, size: int) -> Iterator[None]:
    """Turns a driver's complaint about memory into a MemoryError that says how many bytes were asked for."""
    try:
        yield
    except cl.Error as error:
        if not isinstance(error, cl.MemoryError) and error.code not in _CODES:
            raise
        raise MemoryError(
            f"the OpenCL device {label(device)} is out of memory: {_mib(size)} were asked for, and it has "
            f"{_mib(device.global_mem_size)} in all; end what else uses it, or take another device"
        ) from error


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB" if size >= 2**20 else f"{size} bytes"
