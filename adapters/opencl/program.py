"""From the tables of a scene to a kernel that is compiled for them."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path
from typing import Any

import pyopencl as cl

from .devices import label

__all__ = ["build", "source"]

_FOLDER = Path(__file__).resolve().parent / "kernels"
# Each uses those before it.
_FILES = (
    "vector",
    "random",
    "geometry",
    "trace",
    "microfacet",
    "metallic",
    "bsdf",
    "surface",
    "material",
    "light",
    "path",
    "render",
)
# Divisions and square roots may be off by some units in the last place; nothing counts on more than that.
OPTIONS = ("-cl-std=CL1.2",)


@cache
def _text() -> str:
    parts = []
    for name in _FILES:
        file = _FOLDER / f"{name}.cl"
        parts.append(f'#line 1 "{name}.cl"\n{file.read_text(encoding="utf-8")}')
    return "\n".join(parts)


def source(macros: dict[str, str]) -> str:
    """The text that is compiled: all kernel files after the macros, which are names and values."""
    return "".join(f"#define {name} {value}\n" for name, value in macros.items()) + _text()


def build(
    context: Any, macros: dict[str, str], kernel: str = "render", more: str = "", options: tuple[str, ...] = OPTIONS
) -> Any:
    """A kernel, compiled for the context's one device. `more` is source text after that of the files.

    A program that was built before comes from a cache on disk: the driver's where it has one (PoCL, NVIDIA), else
    that of pyopencl.

    Raises RuntimeError with the device, the options and the compiler's log for a kernel that does not build.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cl.CompilerWarning)
            return cl.Kernel(cl.Program(context, source(macros) + more).build(list(options)), kernel)
    except cl.Error as error:
        (device,) = context.devices
        raise RuntimeError(
            f"the kernel does not build for the OpenCL device {label(device)} with the options {' '.join(options)!r}; "
            f"choose another device, or report this with what its compiler says: {error}"
        ) from error
