"""Population Monte Carlo sampling of the image plane: spends a renderer's samples where noise can be seen.

Lai and Dyer, "Population Monte Carlo Path Tracing", UW-Madison CS TR 1614, 2007.
"""

from pathlib import Path

from pmc_sampler.config import Budget, Config
from pmc_sampler.film import Film
from pmc_sampler.perception import luminance, tvi
from pmc_sampler.sampler import Batch, Result, Sampler, render

__version__ = "0.1.0"
__all__ = [
    "Batch",
    "Budget",
    "Config",
    "Film",
    "Result",
    "Sampler",
    "include_dir",
    "luminance",
    "render",
    "tvi",
]


def include_dir() -> str:
    """The folder to give a C++ compiler (-I) for `#include <pmc.hpp>`: headers only, C++20, no dependency."""
    return str(Path(__file__).parent / "core")
