"""What every test shares: optional parts that may be missing, and where the checkout is.

A test that needs something which is not always there says so by its name, a Python module or a program:

    pytestmark = pytest.mark.needs("mitsuba")            # a whole module, or one test as a decorator

    def test_export(require):
        OpenImageIO = require("OpenImageIO")             # the module; the path, for a program

Where it is missing the test is skipped with a sentence; with CI set (and not to 0 or false) it fails.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np
import pytest

# Names that are programs, not Python modules, with the package to install.
PROGRAMS = {"povray": "povray", "bwrap": "bubblewrap", "c++": "g++", "cmake": "cmake", "chromium": "chromium"}


def under_ci() -> bool:
    """Whether a missing part is a failure."""
    return os.environ.get("CI", "").lower() not in ("", "0", "false", "no")


def find(name: str) -> ModuleType | str:
    """The module called `name`, or the path of the program; raises LookupError with what to install."""
    if name in PROGRAMS:
        path = shutil.which(name)
        if path is None:
            raise LookupError(f"needs the program {name}: install the package {PROGRAMS[name]}")
        return path
    try:
        if name == "mitsuba":
            # First: it points Dr.Jit to an LLVM library that works, and tells where there is none.
            llvm = importlib.import_module("pmc_sampler.adapters.mitsuba.llvm")
            try:
                llvm.require()
            except llvm.LibraryError as error:
                raise LookupError(f"needs Mitsuba: {error}") from None
        return importlib.import_module(name)
    except ImportError as error:
        raise LookupError(f"needs the Python module {name} ({error}): pip install '.[all]'") from None


def stop(sentence: str) -> NoReturn:
    """Skips the running test for what is missing, or fails it under CI."""
    if under_ci():
        pytest.fail(f"{sentence} (CI is set, where nothing may be missing)", pytrace=False)
    pytest.skip(sentence)


def require_or_stop(name: str) -> ModuleType | str:
    """`find(name)`; where that fails, skips the running test, or fails it under CI."""
    try:
        return find(name)
    except LookupError as error:
        stop(str(error))


@pytest.fixture(scope="session")
def require() -> Callable[[str], ModuleType | str]:
    """A function that gives a module or a program's path, or skips (under CI: fails) the test."""
    return require_or_stop


@pytest.fixture(scope="session")
def lacking() -> Callable[[str], NoReturn]:
    """A function that skips (under CI: fails) the test with a sentence, for a part that no name stands for."""
    return stop


@pytest.fixture(scope="session")
def checkout() -> Path:
    """The root of the checkout."""
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def compiler(require: Callable[[str], Any], checkout: Path) -> list[str]:
    """The C++ compiler with what the core's headers need."""
    core = str(checkout / "pmc_sampler" / "core")
    return [require("c++"), "-std=c++20", "-pthread", "-ffp-contract=off", "-I", core]


@pytest.fixture(scope="session")
def build(
    compiler: list[str], checkout: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, list[str]], Path]:
    """Compiles a source, by its path in the checkout, once and gives the program."""
    folder = tmp_path_factory.mktemp("c++")
    built: dict[tuple[str, ...], Path] = {}

    def compiled(source: str, flags: list[str]) -> Path:
        key = (source, *flags)
        if key not in built:
            program = folder / f"program{len(built)}"
            command = [*compiler, *flags, str(checkout / source), "-o", str(program)]
            process = subprocess.run(command, capture_output=True, text=True, check=False)
            assert process.returncode == 0, process.stderr
            built[key] = program
        return built[key]

    return compiled


@pytest.fixture(scope="session")
def p_value() -> Callable[..., float]:
    """p_value(images, mean=1.0, tile=16): that images (seeds, height, width) of whole tiles have that mean everywhere.

    By Student's t-test of the whole image and of each tile, with Sidak's correction for all of them.
    """
    from scipy import stats

    def of(images: np.ndarray, mean: float = 1.0, tile: int = 16) -> float:
        seeds, height, width = images.shape
        tiles = images.reshape(seeds, height // tile, tile, width // tile, tile).mean(axis=(2, 4)).reshape(seeds, -1)
        values = np.concatenate([images.mean(axis=(1, 2))[:, None], tiles], axis=1)
        smallest = stats.ttest_1samp(values, mean, axis=0).pvalue.min()
        return float(1 - (1 - smallest) ** values.shape[1])

    return of


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Carries out the `needs` marks."""
    for mark in item.iter_markers("needs"):
        for name in mark.args:
            require_or_stop(name)
