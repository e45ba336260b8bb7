"""Parts that are missing: a skip with a sentence, and a failure under CI (tests/conftest.py). Exact."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import types
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

TESTS = """
import pytest

@pytest.mark.needs("mitsuba")
def test_without_llvm():
    raise AssertionError("has run")

@pytest.mark.needs("pyopencl")
def test_without_opencl():
    raise AssertionError("has run")

@pytest.mark.needs("numpy", "povray")
def test_without_povray():
    raise AssertionError("has run")

def test_without_a_compiler(build):
    raise AssertionError("has run")

def test_without_a_part(lacking):
    lacking("needs a part")

@pytest.mark.needs("numpy")
def test_that_has_all(require):
    assert require("numpy").__name__ == "numpy"
"""
SENTENCES = {
    "test_without_llvm": "needs Mitsuba: DRJIT_LIBLLVM_PATH names /nope/x.so, and there is no such file; install LLVM "
    "19 or newer (Debian: `apt-get install libllvm19`), or name one in DRJIT_LIBLLVM_PATH",
    "test_without_opencl": "needs the Python module pyopencl (there is none): pip install '.[all]'",
    "test_without_povray": "needs the program povray: install the package povray",
    "test_without_a_compiler": "needs the program c++: install the package g++",
    "test_without_a_part": "needs a part",
}
UNDER_CI = " (CI is set, where nothing may be missing)"


@pytest.fixture
def outcomes(tmp_path: Path, checkout: Path) -> Callable[..., tuple[int, list[str]]]:
    """A function from settings of the environment to how the tests above end, where their parts are missing: the exit
    status, and a line on each that did not pass, then one on all."""
    shutil.copy(checkout / "tests" / "conftest.py", tmp_path)
    (tmp_path / "test_parts.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = needs: what a test needs\n")
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "pyopencl.py").write_text('raise ImportError("there is none")\n')

    def run(**settings: str) -> tuple[int, list[str]]:
        kept = {name: value for name, value in os.environ.items() if name not in ("CI", "PYTEST_ADDOPTS")}
        missing = {
            "PATH": str(tmp_path / "empty"),
            "PYTHONPATH": str(tmp_path / "modules"),
            "DRJIT_LIBLLVM_PATH": "/nope/x.so",
            "COLUMNS": "1000",
        }
        command = [sys.executable, "-m", "pytest", "-q", "-rfEs", "-p", "no:cacheprovider", "test_parts.py"]
        done = subprocess.run(
            command, cwd=tmp_path, env={**kept, **missing, **settings}, capture_output=True, text=True, timeout=100
        )
        lines = done.stdout.splitlines()
        return done.returncode, [
            *(line for line in lines if line.startswith(("SKIPPED", "FAILED", "ERROR "))),
            lines[-1],
        ]

    return run


@pytest.mark.needs("mitsuba")
def test_a_missing_part_is_a_skip(outcomes: Callable[..., tuple[int, list[str]]]) -> None:
    status, (*lines, summary) = outcomes()
    assert sorted(line.partition(": ")[2] for line in lines) == sorted(SENTENCES.values())
    assert all(line.startswith("SKIPPED [1] ") for line in lines)
    assert "1 passed, 5 skipped in" in summary
    assert status == 0


@pytest.mark.needs("mitsuba")
def test_a_missing_part_is_a_failure_under_ci(outcomes: Callable[..., tuple[int, list[str]]]) -> None:
    status, (*lines, summary) = outcomes(CI="1")
    failed = {line.partition("::")[2].partition(" - ")[0]: line.partition(" - ")[2] for line in lines}
    assert failed == {name: f"Failed: {sentence}{UNDER_CI}" for name, sentence in SENTENCES.items()}
    assert "1 failed, 1 passed, 4 errors in" in summary  # an error is a failure before the test itself
    assert status == 1


@pytest.mark.parametrize(
    ("value", "expected"),
    [(None, False), ("", False), ("0", False), ("False", False), ("no", False), ("1", True), ("true", True)],
)
def test_what_counts_as_ci(checkout: Path, monkeypatch: pytest.MonkeyPatch, value: str | None, expected: bool) -> None:
    spec = spec_from_file_location("a_conftest", checkout / "tests" / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    conftest: types.ModuleType = module_from_spec(spec)
    spec.loader.exec_module(conftest)
    monkeypatch.delenv("CI", raising=False)
    if value is not None:
        monkeypatch.setenv("CI", value)
    assert conftest.under_ci() is expected
