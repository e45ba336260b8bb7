"""Fuzzes the readers of readers.py with Atheris, coverage-guided (`make fuzz`): `fuzz.py SECONDS [READER ...]`.

Each runs in a process of its own, under a limit of memory and of time for one input. What is found is left in
build/fuzz/READER; once it is mended it goes to tests/fuzz/found/READER, which test_found.py replays. Exits with status
1 where something was found.
"""

from __future__ import annotations

import ctypes
import gc
import os
import re
import subprocess
import sys
import time
import types
from pathlib import Path

from readers import READERS, try_bytes

WORK = Path("build/fuzz")
FOLLOWED = ("pmc_sampler", "pygltflib", "tomllib", "zipfile")
MEMORY, TIME = 3000, 60  # MiB that a process may hold, seconds that an input may take


def fuzz(name: str, seconds: int) -> bool:
    """Runs one reader and says how it went: whether nothing was found."""
    found = WORK / name
    corpus = WORK / "corpus" / name
    for folder in (found, corpus):
        folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(READERS[name].seeds()):
        (corpus / f"seed{number}").write_bytes(seed)
    limits = [f"-max_total_time={seconds}", f"-rss_limit_mb={MEMORY}", f"-malloc_limit_mb={MEMORY}", f"-timeout={TIME}"]
    words = [sys.executable, __file__, "--one", name, str(corpus), f"-artifact_prefix={found}/", "-max_len=65536"]
    began = time.monotonic()
    done = subprocess.run([*words, *limits], capture_output=True, text=True, errors="replace")
    counts = re.findall(r"^#(\d+)\s.*cov: (\d+)", done.stderr, re.MULTILINE)
    inputs, reached = counts[-1] if counts else (0, 0)
    said = f"{name}: {inputs} inputs in {time.monotonic() - began:.0f} s, {reached} places reached"
    if done.returncode == 0:
        print(f"{said}, nothing found", flush=True)
        return True
    print(f"{said}, FOUND in {found}:\n{done.stderr[-4000:]}", flush=True)
    return False


def one(name: str) -> None:
    """The process of one reader; the other words are libFuzzer's."""
    import atheris

    for seed in READERS[name].seeds():
        try_bytes(name, seed)  # imports all of what is read with
    for found in gc.get_objects():  # not instrument_imports, which installations for editing get past
        if isinstance(found, types.FunctionType) and str(found.__module__).split(".")[0] in FOLLOWED:
            atheris.instrument_func(found)

    def feed(data: bytes) -> None:
        try_bytes(name, data)

    # libFuzzer ends by exit(), which libraries with threads of their own (Mitsuba's) do not all survive.
    leave = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(lambda nothing: os._exit(0))
    ctypes.CDLL(None)["__cxa_atexit"](leave, None, None)
    atheris.Setup([sys.argv[0], *sys.argv[3:]], feed)
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1] == "--one":
        one(sys.argv[2])
    else:
        results = [fuzz(name, int(sys.argv[1])) for name in sys.argv[2:] or READERS]
        sys.exit(not all(results))
