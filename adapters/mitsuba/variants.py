"""Which of Mitsuba's variants a renderer can use, and how it comes to be active."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from . import llvm

__all__ = ["active", "backend_trouble", "check", "choose", "module", "probe", "refusal"]


def module(variant: str) -> Any:
    """The module with the classes of `variant`, whichever variant is active."""
    return importlib.import_module(f"mitsuba.{variant}")


def refusal(variant: str) -> str | None:
    """Why batches cannot be rendered by `variant` on any machine; None if they can."""
    if variant not in mi.variants():
        usable = ", ".join(name for name in mi.variants() if refusal(name) is None)
        return f"this Mitsuba has no such variant; use one of {usable}"
    if variant.startswith("scalar"):
        return "scalar variants follow one ray at a time and cannot take a batch; use an llvm or cuda variant"
    if "polarized" in variant:
        return "polarised variants carry Stokes vectors, which no image of radiance keeps; use another"
    return None


def backend_trouble(variant: str) -> str | None:
    """Why the back end of `variant` does not run on this machine, with what to install; None if it does."""
    if variant.startswith("llvm"):
        try:
            llvm.require()
        except llvm.LibraryError as error:
            return str(error)
    elif not _cuda():
        return "Dr.Jit finds no CUDA device; install NVIDIA's driver, or use an llvm variant"
    return None


def check(variant: str) -> str:
    """`variant`, if it renders batches on this machine.

    Raises ValueError for a variant that never does and RuntimeError for one whose back end is missing.
    """
    why = refusal(variant)
    if why:
        raise ValueError(f"Mitsuba variant {variant!r} cannot be used: {why}")
    trouble = backend_trouble(variant)
    if trouble:
        raise RuntimeError(f"Mitsuba variant {variant!r} cannot run here: {trouble}")
    return variant


def probe() -> str:
    """Mitsuba's version and, for either back end, its variants or why it does not run here.

    Raises RuntimeError if neither back end runs.
    """
    usable = [name for name in mi.variants() if refusal(name) is None]
    trouble = {backend: backend_trouble(f"{backend}_") for backend in ("llvm", "cuda")}
    if all(trouble.values()):
        raise RuntimeError("; ".join(f"{backend}: {why}" for backend, why in trouble.items()))
    parts = [f"Mitsuba {mi.__version__}"]
    for backend, why in trouble.items():
        on = f" on LLVM {llvm.require()}" if backend == "llvm" and why is None else ""
        own = ", ".join(name for name in usable if name.startswith(backend))
        parts.append(f"{own}{on}" if why is None else f"no {backend} ({why})")
    return "; ".join(parts)


def choose(variant: str | None) -> str:
    """`variant`, or if it is None the active one where that will do, else RGB on a CUDA device or on the CPU.

    Raises what `check` raises.
    """
    if variant is not None:
        return check(variant)
    current = mi.variant()
    if current is not None and refusal(current) is None:
        return check(current)
    return check("cuda_ad_rgb" if _cuda() else "llvm_ad_rgb")


@dataclass
class _Ours:
    """The variant that `active` left active, if nobody has changed it since, and how many of its blocks are entered."""

    variant: str | None = None
    inside: int = 0
    changing: bool = False

    def change(self, variant: str) -> None:
        """Makes it the active one."""
        self.changing = True
        try:
            mi.set_variant(variant)
        finally:
            self.changing = False

    def noticed(self, before: str | None, after: str) -> None:
        """A variant has become the active one."""
        if not self.changing:
            self.variant = None


_ours = _Ours()
mi.detail.add_variant_callback(_ours.noticed)


@contextlib.contextmanager
def active(variant: str) -> Iterator[None]:
    """Makes `variant` the active one inside the block.

    It stays so where none was active before, or one that stayed so from here: each change costs Mitsuba some 20 ms,
    in which it loads its integrators in Python anew.
    """
    before = mi.variant()
    stays = before is None or (before == _ours.variant and not _ours.inside)
    if before != variant:
        _ours.change(variant)
        if stays:
            _ours.variant = variant
    _ours.inside += 1
    try:
        yield
    finally:
        _ours.inside -= 1
        if before != variant and not stays:
            _ours.change(before)


def _cuda() -> bool:
    import drjit as dr

    return bool(dr.has_backend(dr.JitBackend.CUDA))
