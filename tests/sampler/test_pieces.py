"""The core's parts one by one, in C++, each held to its definition (pieces/). Exact, or within a stated rounding."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.needs("c++")


@pytest.mark.parametrize("part", ["film", "pool", "systematic", "population", "parallel", "rounding", "perception"])
def test_pieces(part: str, build: Callable[[str, list[str]], Path]) -> None:
    """A part that keeps what its header says has nothing to say, and no thread of it waits forever."""
    program = build(f"tests/sampler/pieces/{part}.cpp", ["-O2"])
    process = subprocess.run([program], capture_output=True, text=True, check=False, timeout=60)
    assert process.returncode == 0, process.stderr
    assert process.stdout == process.stderr == ""
