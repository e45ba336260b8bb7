"""Finds a shared LLVM library that Dr.Jit can use, before Dr.Jit looks for one itself.

Mitsuba's `llvm_*` variants compile for the CPU with an LLVM that the system provides. Dr.Jit takes the newest
it finds when it is first imported and keeps it for the life of the process. With a version that cannot
compile its kernels it *aborts the process*, which no `except` catches. So the library is chosen here, by name
where a version is known to work, else by compiling a small kernel in a process of its own.

Tried with Dr.Jit 1.5 on x86-64, Debian 12, every version its archive has: 13 and 14 are turned down by
Dr.Jit, 15 and 16 abort ("Cannot select: fminimum"), 19 and 22 work. 17 and 18 could not be tried.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import platform
import re
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["ENVIRONMENT", "PACKAGE", "Library", "LibraryError", "candidates", "find", "prepare", "require"]

ENVIRONMENT = "DRJIT_LIBLLVM_PATH"
PACKAGE = "libllvm19"  # what Debian and Ubuntu call the oldest that is known to work
_TRUSTED = range(19, 23)  # used without a trial, on x86-64
_ADVICE = f"install LLVM 19 or newer (Debian: `apt-get install {PACKAGE}`), or name one in {ENVIRONMENT}"

# The operations that older back ends cannot select, in a loop; prints the version of the library in use.
_TRIAL = """
import resource
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import drjit as dr
from drjit.llvm import Float, UInt32
x = dr.linspace(Float, 0, 1, 64) + dr.opaque(Float, 0.5)
step = lambda i, y: (i + 1, dr.maximum(dr.minimum(y, 3), 1) * y)
i, y = dr.while_loop((UInt32(0), x), lambda i, y: i < 4, step)
assert dr.sum(dr.gather(Float, y, UInt32(0, 5)))[0] > 0
print(*dr.detail.llvm_version())
"""


class LibraryError(RuntimeError):
    """No LLVM that Dr.Jit can use; the message says what was found and what to install."""


@dataclass(frozen=True)
class Library:
    """A shared LLVM: where it is, and its major version where the file's name tells it."""

    path: str
    version: int | None

    def __str__(self) -> str:
        return f"LLVM {self.version} ({self.path})" if self.version else self.path

    @classmethod
    def at(cls, path: str | Path) -> Library:
        """The library at `path`, its version read from the name of the file it stands for."""
        real = Path(os.path.realpath(path))
        match = re.match(r"libLLVM(?:-|\.so\.|\.)(\d+)", real.name)
        return cls(str(path), int(match.group(1)) if match else None)


def candidates(folders: list[Path] | None = None) -> list[Library]:
    """The LLVM libraries in `folders` (the system's by default), the most promising first, each file once."""
    found: dict[str, Library] = {}
    for folder in _folders() if folders is None else folders:
        for pattern in ("libLLVM*.so*", "libLLVM*.dylib"):
            for file in sorted(folder.glob(pattern)):
                real = os.path.realpath(file)
                if os.path.isfile(real):
                    found.setdefault(real, Library.at(real))
    return sorted(found.values(), key=lambda library: (_trusted(library), library.version or 0), reverse=True)


def find(folders: list[Path] | None = None) -> Library:
    """The LLVM to use: the one the user names in DRJIT_LIBLLVM_PATH, else the newest of the system's that
    works.

    Raises LibraryError if there is none, with the package to install.
    """
    named = os.environ.get(ENVIRONMENT)
    if named:
        library = Library.at(named)
        if os.sep in named and not os.path.isfile(named):
            raise LibraryError(f"{ENVIRONMENT} names {named}, and there is no such file; {_ADVICE}")
        # Where a name without a folder leads to, the system knows.
        why = None if os.sep in named and _trusted(library) else _trial(named)
        if why is not None:
            raise LibraryError(f"{ENVIRONMENT} names {library}, which Dr.Jit cannot use ({why}); {_ADVICE}")
        return library
    turned_down = []
    for library in candidates(folders):
        why = None if _trusted(library) else _trial(library.path)
        if why is None:
            return library
        turned_down.append(f"{library}: {why}")
    found = f"found only {'; '.join(turned_down)}" if turned_down else "found none"
    raise LibraryError(
        f"Mitsuba's llvm variants need a shared LLVM library, and this machine has no usable one ({found}); {_ADVICE}"
    )


def prepare() -> None:
    """Points Dr.Jit to a usable LLVM, unless it is loaded already.

    Raises nothing: without a usable LLVM the CUDA and scalar variants still work, and `require` speaks up for
    the others. In that case Dr.Jit is imported here, so that `require` is alone in saying it.
    """
    if "drjit" in sys.modules or os.name == "nt":
        return
    try:
        os.environ[ENVIRONMENT] = find().path
    except LibraryError:
        # Where Dr.Jit is missing, the import of Mitsuba tells.
        with _without_dr_jits_lines(), contextlib.suppress(ImportError):
            importlib.import_module("drjit")


def require() -> str:
    """Makes sure that an LLVM variant can run in this process; returns the version, as in "19.1.7".

    Raises LibraryError, before Dr.Jit compiles anything, if it cannot.
    """
    if "drjit" not in sys.modules:
        prepare()
        if os.name != "nt":
            find()
    import drjit as dr

    loaded: tuple[int, ...] = dr.detail.llvm_version() if dr.has_backend(dr.JitBackend.LLVM) else ()
    if not loaded:
        other = find()  # raises where there is none at all
        raise LibraryError(
            f"Dr.Jit found no LLVM library when it was imported, and {other} would have done; "
            f"start anew and import {__package__} before mitsuba"
        )
    if not _trusted(Library("", loaded[0])):
        why = _trial(None)
        if why is not None:
            raise LibraryError(
                f"Dr.Jit has loaded LLVM {loaded[0]}, which it cannot use ({why}), and keeps it for this "
                f"process; {_ADVICE}, and start anew"
            )
    return ".".join(str(part) for part in loaded)


def _trusted(library: Library) -> bool:
    return library.version in _TRUSTED and platform.machine() in ("x86_64", "AMD64")


@functools.cache
def _trial(path: str | None) -> str | None:
    """Compiles a kernel with the library at `path` (None: Dr.Jit's own choice) in another process: None, or
    what went wrong."""
    environment: dict[str, Any] = dict(os.environ)
    if path is not None:
        environment[ENVIRONMENT] = path
    try:
        done = subprocess.run(
            [sys.executable, "-c", _TRIAL],
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"a trial in another process did not end: {error}"
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"it aborts the process with signal {-done.returncode}"
    return "Dr.Jit turns it down"


@contextlib.contextmanager
def _without_dr_jits_lines() -> Iterator[None]:
    """Keeps from standard error what Dr.Jit writes there of an LLVM that it cannot use; other lines come at the end."""
    lines = [b"jitc_llvm_init(): ", b"jit_llvm_init(): "]
    if os.environ.get(ENVIRONMENT):
        lines.append(b'jit_find_library(): Unable to load "' + os.fsencode(os.environ[ENVIRONMENT]))
    with contextlib.ExitStack() as open_files:
        try:
            kept = open_files.enter_context(tempfile.TemporaryFile())
            shown = os.dup(2)
        except OSError:  # there is no place to keep lines, or no standard error
            yield
            return
        open_files.callback(os.close, shown)
        os.dup2(kept.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(shown, 2)
            kept.seek(0)
            others = b"".join(line for line in kept if not line.startswith(tuple(lines)))
            with contextlib.suppress(OSError):  # as if nobody read them
                os.write(2, others)


def _folders() -> Iterator[Path]:
    """Where shared libraries are on this system; folders that do not exist are left out by globbing
    nothing."""
    for entry in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep):
        if entry:
            yield Path(entry)
    yield Path(sys.prefix) / "lib"
    multiarch = sysconfig.get_config_var("MULTIARCH")
    for root in (Path("/usr/local/lib"), Path("/lib"), Path("/usr/lib")):
        if multiarch:
            yield root / multiarch
        yield root
    yield Path("/usr/lib64")
    for pattern in (
        "/usr/lib/llvm*/lib",
        "/usr/lib/llvm/*/lib64",
        "/opt/homebrew/opt/llvm*/lib",
        "/usr/local/opt/llvm*/lib",
    ):
        yield from sorted(Path("/").glob(pattern[1:]))
