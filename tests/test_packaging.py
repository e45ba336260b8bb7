"""What an installation must have and must not have (exact)."""

from __future__ import annotations

import importlib.metadata
import importlib.resources
import importlib.util
import re
from pathlib import Path

import pytest

import pmc_sampler

DISTRIBUTION = importlib.metadata.distribution("pmc-sampler")


def test_bare_package_needs_numpy_alone() -> None:
    always = [entry for entry in DISTRIBUTION.requires or [] if "extra ==" not in entry]
    assert [re.split(r"[^\w-]", entry)[0] for entry in always] == ["numpy"]


def test_extras() -> None:
    extras = set(DISTRIBUTION.metadata.get_all("Provides-Extra"))
    assert {"mitsuba", "opencl", "povray", "eval", "all"} <= extras


@pytest.mark.parametrize("name", ["adapters", "eval", "scenes"])
def test_folders_install_inside_the_package(name: str) -> None:
    assert importlib.util.find_spec(f"pmc_sampler.{name}") is not None
    # Were the checkout on sys.path, every `import eval` would find ours.
    assert importlib.util.find_spec(name) is None, "run `pytest` or `make test`, not `python -m pytest`"


def test_data_is_installed_beside_the_code() -> None:
    root = Path(pmc_sampler.__file__).parent
    assert (root / "py.typed").is_file()
    assert (root / "_core.pyi").is_file()
    assert list((root / "core").glob("*.hpp")), "the headers are the C++ interface"


def test_the_report_s_page_is_installed() -> None:
    root = importlib.resources.files("pmc_sampler.eval.report")
    for name in ("template.html", "report.css", "report.js"):
        assert (root / name).is_file()


def test_entry_points_are_found() -> None:
    scripts = importlib.metadata.entry_points(group="console_scripts", name="pmc-sampler")
    assert [script.value for script in scripts] == ["pmc_sampler.cli:main"]
    renderers = importlib.metadata.entry_points(group="pmc_sampler.renderers")
    assert "mitsuba" in {renderer.name for renderer in renderers}


def test_versions_agree(checkout: Path) -> None:
    citation = (checkout / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {DISTRIBUTION.version}\n" in citation
    assert pmc_sampler.__version__ == DISTRIBUTION.version
