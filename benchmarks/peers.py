"""What the adaptive sampling of Blender's Cycles and of LuxCore gains over their own uniform one, beside PMC's gain.

    python benchmarks/peers.py [--peers cycles luxcore] [--python PYTHON] [--spp 64] [--seeds 5] -o benchmarks/

Cycles needs the package bpy, LuxCore pyluxcore, in this Python or in that of --python:
`python3.11 -m venv peers && peers/bin/pip install bpy pyluxcore`. All render the same scene; each is measured against
a reference of its own making. Runs are kept in peers.jsonl as they end; the same command goes on after an
interruption. Without any peer the page is made again from what is there.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pmc_sampler.adapters import load, version
from pmc_sampler.adapters.opencl.load import scene_of
from pmc_sampler.eval import images, measures, references, statistics
from pmc_sampler.eval.metrics import WHITE_LUMINANCE
from pmc_sampler.eval.peers import study
from pmc_sampler.eval.peers.process import PACKAGES, Peer, PeerError, Picture
from pmc_sampler.eval.peers.scene import describe

from pmc_sampler import Budget, Config, render
from pmc_sampler.cli.arguments import size

UNIFORM = "uniform"
OURS = "opencl"
TITLES = {"cycles": "Cycles", "luxcore": "LuxCore", OURS: "our OpenCL tracer"}

# Cycles stops pixels one by one: the most samples of a pixel, as a multiple of the budget, and the least. The noise
# threshold is then the one that meets the budget.
CYCLES = (
    {"most": 4, "min_samples": 0},
    {"most": 16, "min_samples": 0},
    {"most": 16, "min_samples": 16},
    {"most": 64, "min_samples": 16},
)
LUXCORE = (
    {"strength": 0.95, "warmup": 32, "step": 32},  # its defaults
    {"strength": 0.95, "warmup": 16, "step": 16},
    {"strength": 0.95, "warmup": 8, "step": 8},
    {"strength": 0.8, "warmup": 8, "step": 8},
    {"strength": 0.95, "warmup": 8, "step": 8, "gamma": 2.2},
)
