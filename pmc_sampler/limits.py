"""How much memory a file may make a program take: files are data, and a small one that promises much is refused."""

from __future__ import annotations

import os

RATIO = 1032
"""Deflate's largest: no file that is compressed by it can hold more than so many times its own bytes."""
SMALL = 1 << 26
"""Bytes that any file may ask for, since single colours compress without end in some formats (WebP)."""


def check(what: str, need: int, file_bytes: int) -> None:
    """Raises ValueError where `what`, read from `file_bytes` bytes, would take `need` bytes: more than those can hold,
    or more memory than the machine has.
    """
    if need > max(SMALL, RATIO * file_bytes):
        raise ValueError(f"{what} promises {need} bytes, more than the {file_bytes} bytes of its file can hold")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if need > memory:
        raise ValueError(f"{what} takes {need / 2**30:.1f} GiB of memory, and there are {memory / 2**30:.1f}")
