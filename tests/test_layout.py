"""Which folder may import which (exact: read from the syntax trees of all files).

The sampler knows no renderer and no metric, adapters know no metric, evaluation knows no renderer, scenes
know none of them. Only the command line finds the others, by name and at run time.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Each folder with the package it installs as and what its import statements must not reach.
FOLDERS = {
    "pmc_sampler": ("pmc_sampler", {"pmc_sampler.adapters", "pmc_sampler.eval", "pmc_sampler.scenes"}),
    "adapters": ("pmc_sampler.adapters", {"pmc_sampler.eval"}),
    "eval": ("pmc_sampler.eval", {"pmc_sampler.adapters"}),
    "scenes": ("pmc_sampler.scenes", {"pmc_sampler.adapters", "pmc_sampler.eval"}),
}


def is_command_line(path: Path) -> bool:
    """Whether a file may name the other folders at run time, and import more than NumPy."""
    parts = path.relative_to(ROOT).parts
    return parts[:2] == ("pmc_sampler", "cli") or parts in (
        ("pmc_sampler", "cli.py"),
        ("pmc_sampler", "__main__.py"),
    )


def imports(source: str, module: str, is_package: bool) -> Iterator[str]:
    """The full names that the import statements in the source of the module called `module` reach."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = module.split(".")
                parents = parents[: len(parents) - node.level + is_package]
                base = ".".join([*parents, *([base] if base else [])])
            # The name may itself be a module: `from pmc_sampler import eval`.
            yield from (f"{base}.{alias.name}" for alias in node.names)


def names_at_run_time(source: str) -> Iterator[str]:
    """Module names given to import_module, __import__ or find_spec as literal text."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__", "find_spec"):
                yield str(node.args[0].value)


def reaches(name: str, forbidden: set[str]) -> bool:
    """Whether `name` is one of the forbidden packages or lies within one."""
    return any(name == package or name.startswith(package + ".") for package in forbidden)


def files(folder: str) -> list[Path]:
    """The Python files of a top-level folder."""
    return sorted(path for path in (ROOT / folder).rglob("*.py") if "__pycache__" not in path.parts)


def full_name(path: Path) -> str:
    """The name that a file of the checkout has once installed."""
    folder, *rest = path.relative_to(ROOT).with_suffix("").parts
    return ".".join([FOLDERS[folder][0], *(part for part in rest if part != "__init__")])


@pytest.mark.parametrize("folder", FOLDERS)
def test_import_directions(folder: str) -> None:
    assert files(folder), f"{folder}/ has no Python file, so this test would hold of nothing"
    forbidden = FOLDERS[folder][1]
    wrong = []
    for path in files(folder):
        source = path.read_text(encoding="utf-8")
        reached = list(imports(source, full_name(path), path.name == "__init__.py"))
        if not is_command_line(path):
            reached += names_at_run_time(source)
        wrong += [f"{path.relative_to(ROOT)} imports {name}" for name in reached if reaches(name, forbidden)]
    assert not wrong, "\n".join(wrong)


def test_sampler_needs_numpy_alone() -> None:
    allowed = {*sys.stdlib_module_names, "numpy", "pmc_sampler"}
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in files("pmc_sampler")
        if not is_command_line(path)
        for name in imports(path.read_text(encoding="utf-8"), full_name(path), path.name == "__init__.py")
        if name.split(".")[0] not in allowed
    ]
    assert not wrong, "\n".join(wrong)


def test_core_headers_know_no_python() -> None:
    headers = sorted((ROOT / "pmc_sampler" / "core").glob("*.hpp"))
    assert headers
    include = re.compile(r'^\s*#\s*include\s*[<"](nanobind|pybind11|Python\.h|numpy)', re.MULTILINE)
    assert [path.name for path in headers if include.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize(
    ("statement", "module", "is_package"),
    [
        ("import pmc_sampler.eval.metrics", "pmc_sampler.adapters.mitsuba", False),
        ("from pmc_sampler import eval", "pmc_sampler.adapters.mitsuba", False),
        ("from pmc_sampler.eval import metrics", "pmc_sampler.adapters.mitsuba", False),
        (
            "def late():\n    from pmc_sampler.eval.metrics import tvi_error",
            "pmc_sampler.adapters.mitsuba",
            False,
        ),
        ("from ..eval import metrics", "pmc_sampler.adapters.mitsuba", False),
        ("from ..eval import metrics", "pmc_sampler.adapters", True),
        ("from .. import eval", "pmc_sampler.adapters", True),
        ("from .. import eval", "pmc_sampler.adapters.mitsuba", False),
        ("from ...eval import metrics", "pmc_sampler.adapters.mitsuba.rng", False),
    ],
)
def test_imports_sees_every_form(statement: str, module: str, is_package: bool) -> None:
    """The negative control: each of these must be seen as reaching pmc_sampler.eval."""
    assert any(reaches(name, {"pmc_sampler.eval"}) for name in imports(statement, module, is_package))


def test_imports_lets_the_others_pass() -> None:
    source = """
import numpy as np
from pmc_sampler import Sampler
from ..scenes import find
from . import evaluate
from .eval import x
"""
    reached = list(imports(source, "pmc_sampler.adapters.mitsuba", False))
    assert "pmc_sampler.scenes.find" in reached
    assert not any(reaches(name, {"pmc_sampler.eval"}) for name in reached)
