"""The core under AddressSanitizer, UndefinedBehaviorSanitizer and ThreadSanitizer: random samplers driven at random by
four threads, their budgets and films checked; and the sanitizers themselves, on programs with one fault each.

``make sanitize`` runs the long ones too, and the sampler's tests in Python on a module compiled with the first two.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.needs("c++")

SANITIZERS = {
    "addresses and undefined behaviour": "address,undefined,float-cast-overflow,float-divide-by-zero",
    "threads": "thread",
}
OPTIONS = {"ASAN_OPTIONS": "detect_leaks=1", "TSAN_OPTIONS": "halt_on_error=1", "UBSAN_OPTIONS": "print_stacktrace=1"}

FAULTS = {
    "heap-buffer-overflow": (
        "addresses and undefined behaviour",
        "pmc::Buffer<float> b; b.resize(4); return b[argc + 3] > 1.0f;",
    ),
    "heap-use-after-free": (
        "addresses and undefined behaviour",
        "auto* z = new pmc::Zeroed<int>(4); int* p = z->data(); delete z; return p[argc];",
    ),
    "memory leaks": (
        "addresses and undefined behaviour",
        # Many, since what is left of a pointer on the stack or in a register counts as one.
        "int* volatile p = nullptr; for (int i = 0; i < 100; ++i) p = new int[4]; p = nullptr; return !!p;",
    ),
    "signed integer overflow": (
        "addresses and undefined behaviour",
        "volatile int x = 2147483646 + argc; return x + argc;",
    ),
    "outside the range of representable values": (
        "addresses and undefined behaviour",
        "volatile double x = 1e300 * argc; return int(x);",
    ),
    "data race": (
        "threads",
        # Each task waits for another, so that no thread does both; relaxed, so that this orders nothing.
        "int n = argc; std::atomic<int> here{0}; pmc::ThreadPool pool(4); pool.run(4, [&](std::size_t) { ++n; "
        "here.fetch_add(1, std::memory_order_relaxed); while (here.load(std::memory_order_relaxed) < 2) "
        "std::this_thread::yield(); }); return n == 0;",
    ),
}


def flags(sanitizer: str) -> list[str]:
    return ["-O1", f"-fsanitize={SANITIZERS[sanitizer]}", "-fno-sanitize-recover=all"]


def run(program: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [program, *arguments], capture_output=True, text=True, env={**os.environ, **OPTIONS}, check=False
    )


@pytest.mark.parametrize(
    ("sanitizer", "samplers"),
    [
        ("addresses and undefined behaviour", 150),
        ("threads", 30),
        pytest.param("addresses and undefined behaviour", 3000, marks=pytest.mark.long),
        pytest.param("threads", 400, marks=pytest.mark.long),
    ],
)
def test_under_sanitizers(sanitizer: str, samplers: int, build: Callable[[str, list[str]], Path]) -> None:
    """Batches told out of order, dropped, put back and partly invalid; checkpoints on the way; every picture read."""
    process = run(build("tests/sampler/stress.cpp", flags(sanitizer)), "1", str(samplers), "4")
    assert process.returncode == 0, process.stderr
    assert process.stdout == f"{samplers} samplers\n"


@pytest.mark.parametrize("fault", FAULTS)
def test_sanitizers_see(fault: str, compiler: list[str], tmp_path: Path) -> None:
    """The negative control: with the same flags, a program with one fault ends with its name."""
    sanitizer, code = FAULTS[fault]
    source = tmp_path / "fault.cpp"
    source.write_text(f"#include <memory.hpp>\n#include <parallel.hpp>\nint main(int argc, char**) {{ {code} }}\n")
    program = tmp_path / "fault"
    subprocess.run([*compiler, *flags(sanitizer), str(source), "-o", str(program)], check=True)
    process = run(program)
    assert process.returncode != 0
    assert fault in process.stderr
