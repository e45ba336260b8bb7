"""Mitsuba 3 as a renderer of the sampler's batches, and the sampler as a Mitsuba integrator."""

from __future__ import annotations

from . import llvm

llvm.prepare()  # before mitsuba is imported: that is when Dr.Jit takes the first LLVM it finds

try:
    import mitsuba as _mitsuba  # noqa: F401
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"Mitsuba is not installed (no module {error.name!r}); `pip install 'pmc-sampler[mitsuba]'`",
        name=error.name,
    ) from error

from .integrator import register  # noqa: E402
from .renderer import MitsubaRenderer  # noqa: E402

register()

__all__ = ["MitsubaRenderer"]
