"""A path tracer in OpenCL as a renderer of the sampler's batches: runs on any GPU, and on the CPU by PoCL."""

from __future__ import annotations

try:
    import pyopencl as _pyopencl  # noqa: F401
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"pyopencl is not installed (no module {error.name!r}); `pip install 'pmc-sampler[opencl]'`", name=error.name
    ) from error

from .renderer import OpenCLRenderer

__all__ = ["OpenCLRenderer"]
