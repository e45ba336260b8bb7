"""Which OpenCL device traces: found, listed and chosen."""

from __future__ import annotations

import atexit
import os
import re
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any


def _with_cache() -> None:
    """Gives PoCL and pyopencl a folder for what they compile where the user has none: PoCL has no device without."""
    folder = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        made = os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="pmc_sampler-")
        atexit.register(shutil.rmtree, made, ignore_errors=True)


_with_cache()
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # pyopencl warns of caches it cannot open; that is for those who look for it
    import pyopencl as cl

__all__ = ["VARIABLE", "choose", "devices", "label"]

VARIABLE = "PMC_SAMPLER_DEVICE"
_KINDS = {"cpu": cl.device_type.CPU, "gpu": cl.device_type.GPU, "accelerator": cl.device_type.ACCELERATOR}
_INSTALL = (
    "install a driver for your GPU, or a device that runs on the CPU: pip install pocl-binary-distribution "
    "(or, on Debian, apt install pocl-opencl-icd)"
)


def devices() -> list[Any]:
    """All OpenCL devices of this machine that can compile a kernel, best first.

    GPUs come before CPUs. Of several PoCLs (Debian's beside that of pip) the newer one comes first.
    """
    return sorted((device for device in _all() if not _too_old(device)), key=_rank)


def _all() -> list[Any]:
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # what the loader raises where it knows no platform
        return []
    found = []
    for platform in platforms:
        try:
            found.extend(platform.get_devices())
        except cl.Error:  # a platform without a device; the others may have some
            continue
    return [device for device in found if device.available and device.compiler_available]


def _too_old(device: Any) -> bool:
    """Whether this is a PoCL whose compiler does not know the processor, and so compiles nothing for it.

    It calls the processor "generic", which it then refuses as a target on x86 (github.com/pocl/pocl/issues/1049).
    """
    return re.search(r"PoCL HSTR: \S*(x86_64|i\d86)\S*-generic\b", device.version) is not None


def choose(name: str | None = None) -> Any:
    """The device meant by `name`: its place in `devices()`; "cpu", "gpu" or "accelerator" for the best of that kind;
    or a part, in capitals or not, of what `label` says of this device alone.

    Without a name, that in the environment variable PMC_SAMPLER_DEVICE; without that, or where it is empty, the best.

    Raises RuntimeError if there is no device at all, ValueError if none is meant, or several are.
    """
    found = devices()
    if not found:
        if old := _all():
            raise RuntimeError(
                f"the OpenCL device {label(old[0])} is older than this processor and compiles nothing for it, and "
                "there is no other; install a newer PoCL (on Debian, apt install pocl-opencl-icd), or a driver of a GPU"
            )
        raise RuntimeError(f"there is no OpenCL device on this machine; {_INSTALL}")
    if name is None and not os.environ.get(VARIABLE):
        return found[0]
    source = "" if name is not None else f" (from {VARIABLE})"
    wanted = os.environ[VARIABLE] if name is None else name
    if re.fullmatch(r"\d{1,9}", wanted) and int(wanted) < len(found):
        return found[int(wanted)]
    if wanted.lower() in _KINDS:
        meant = [device for device in found if device.type & _KINDS[wanted.lower()]][:1]
    else:
        meant = [device for device in found if wanted.strip() and wanted.lower() in label(device).lower()]
    if len(meant) == 1:
        return meant[0]
    there = "; ".join(f"{found.index(device)}: {label(device)}" for device in meant or found)
    if meant:
        raise ValueError(
            f"{len(meant)} OpenCL devices are called {wanted!r}{source}; give the number of one of: {there}"
        )
    raise ValueError(
        f"no OpenCL device is called {wanted!r}{source}; give the number, the kind ({', '.join(_KINDS)}) or a part of "
        f"the name of: {there}"
    )


def label(device: Any) -> str:
    """The device's name and its platform's, with the version of the driver."""
    return f"{device.name.strip()} ({device.platform.name.strip()}, {device.driver_version.strip()})"


def _rank(device: Any) -> tuple[int, ...]:
    if device.type & cl.device_type.GPU:
        return 0, bool(device.host_unified_memory), -device.max_compute_units  # those on boards first
    kind = 1 if device.type & cl.device_type.ACCELERATOR else 2
    pocl = re.search(r"PoCL (\d+)\.(\d+)", f"{device.platform.version} {device.version}", re.IGNORECASE)
    return kind, *((-int(number) for number in pocl.groups()) if pocl else (-1000,))
