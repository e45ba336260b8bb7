"""The C++ example: built and run as its README says, with no Python in it.

Programs are built once for all tests. Statistical: the error of the example's PMC renders against its uniform ones.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pmc_sampler

pytestmark = pytest.mark.needs("c++")

# What a process needs to run, and no path to any Python.
BARE = {"PATH": "/usr/bin:/bin"}


@pytest.fixture(scope="session")
def spheres(build: Callable[[str, list[str]], Path]) -> Path:
    return build("examples/cpp/main.cpp", ["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"])


def run(program: Path, *arguments: object) -> dict[str, float]:
    """What it printed, by name."""
    process = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, env=BARE, check=False)
    assert process.returncode == 0, process.stderr
    return {name: float(value) for name, value in (line.split() for line in process.stdout.splitlines())}


def read_pfm(path: Path) -> np.ndarray:
    """(height, width, 3) float32, the top row first."""
    kind, size, scale, values = path.read_bytes().split(b"\n", 3)
    assert (kind, scale) == (b"PF", b"-1.0")
    width, height = map(int, size.split())
    return np.frombuffer(values, "<f4").reshape(height, width, 3)[::-1]


@pytest.mark.parametrize("extra", [[], ["--uniform"]])
def test_image_and_samples(extra: list[str], spheres: Path, tmp_path: Path) -> None:
    """The budget to the sample, an image of that size, with the light at its top, coloured walls and no NaN."""
    printed = run(spheres, 48, 36, 6.5, tmp_path / "a.pfm", *extra)
    assert printed["samples"] == round(6.5 * 48 * 36)
    assert set(printed) == {"samples", "seconds_renderer", "seconds_sampler"}
    image = read_pfm(tmp_path / "a.pfm")
    assert image.shape == (36, 48, 3)
    assert np.isfinite(image).all()
    assert (image >= 0).all()
    brightest = np.unravel_index(image.sum(axis=2).argmax(), (36, 48))
    assert brightest[0] < 10
    assert 18 < brightest[1] < 30
    left, right = image[8:28, :4].mean(axis=(0, 1)), image[8:28, -4:].mean(axis=(0, 1))
    assert left[0] > 2 * left[1]
    assert right[1] > 1.5 * right[0]


def test_same_bits_whatever_the_threads(spheres: Path, tmp_path: Path) -> None:
    images = []
    for threads in (1, 2, 5):
        run(spheres, 60, 40, 8, tmp_path / "a.pfm", "--threads", threads, "--seed", 3)
        images.append((tmp_path / "a.pfm").read_bytes())
    assert images[0] == images[1] == images[2]
    run(spheres, 60, 40, 8, tmp_path / "a.pfm", "--seed", 4)
    assert (tmp_path / "a.pfm").read_bytes() != images[0]


def test_less_error_at_equal_samples(spheres: Path, tmp_path: Path) -> None:
    """MSE and tvi error of PMC below those of uniform sampling at 32 samples a pixel, the reference having 1024, for
    each of four seeds; their mean by a factor of 1.3 and 2 at least (2.7 and 4 when this was written). The factors
    vary by a fifth from seed to seed, so this fails only where the method does.
    """
    run(spheres, 64, 48, 1024, tmp_path / "reference.pfm", "--uniform", "--seed", 999)
    truth = read_pfm(tmp_path / "reference.pfm").astype(np.float64)
    errors: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for seed in range(4):
        for uniform in (True, False):
            printed = run(spheres, 64, 48, 32, tmp_path / "a.pfm", "--seed", seed, *["--uniform"] * uniform)
            assert printed["samples"] == 32 * 64 * 48
            image = read_pfm(tmp_path / "a.pfm").astype(np.float64)
            y, true_y = (100 * pmc_sampler.luminance(picture) for picture in (image, truth))
            visible = np.mean(((y - true_y) / pmc_sampler.tvi(true_y)) ** 2)
            errors[uniform].append((float(np.mean((image - truth) ** 2)), float(visible)))
    ratios = np.array(errors[True]) / np.array(errors[False])
    assert (ratios > 1).all(), ratios
    assert (ratios.mean(axis=0) > [1.3, 2.0]).all(), ratios
    # The means agree: what is compared is noise.
    assert abs(image.mean() / truth.mean() - 1) < 0.02


def test_it_measures_its_own_error(spheres: Path, tmp_path: Path) -> None:
    """--reference renders one with another seed; the printed errors are those of the files."""
    printed = run(spheres, 32, 24, 8, tmp_path / "a.pfm", "--seed", 1, "--reference", 64)
    run(spheres, 32, 24, 64, tmp_path / "b.pfm", "--uniform", "--seed", 1 + 0x5EED)
    a, b = (read_pfm(tmp_path / name).astype(np.float64) for name in ("a.pfm", "b.pfm"))
    assert printed["mse"] == pytest.approx(np.mean((a - b) ** 2), rel=1e-5)
    y, true_y = 100 * pmc_sampler.luminance(a), 100 * pmc_sampler.luminance(b)
    assert printed["tvi_error"] == pytest.approx(np.mean(((y - true_y) / pmc_sampler.tvi(true_y)) ** 2), rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        ([], 2, "expected a width, a height, samples a pixel and a file"),
        (["0", "9", "4", "a.pfm"], 2, "WIDTH is '0': expected a number from 1 to 65535\n"),
        (["9", "x", "4", "a.pfm"], 2, "HEIGHT is 'x': expected a number"),
        (["9", "9", "nan", "a.pfm"], 2, "SPP is 'nan'"),
        (["9", "9", "4", "a.pfm", "--sharp"], 2, "unknown option '--sharp'"),
        (["9", "9", "4", "a.pfm", "--seed"], 2, "--seed expects a number after it"),
        (["60000", "60000", "4", "missing/a.pfm"], 2, "cannot write 'missing/a.pfm': expected a file in a folder"),
        (["9", "9", "4", "."], 2, "cannot write '.'"),
        (["9", "9", "4", ""], 2, "cannot write ''"),
        (["9.5", "9", "4", "a.pfm"], 2, "WIDTH is '9.5': expected a whole number"),
        (["9", "9", "4", "a.pfm", "--threads", "1.5"], 2, "--threads is '1.5': expected a whole number"),
    ],
)
def test_bad_arguments(arguments: list[str], status: int, sentence: str, spheres: Path, tmp_path: Path) -> None:
    process = subprocess.run([spheres, *arguments], capture_output=True, text=True, env=BARE, cwd=tmp_path, check=False)
    assert process.returncode == status
    assert sentence in process.stderr
    assert ("usage: spheres" in process.stderr) == (status == 2)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_stays_where_the_new_one_cannot_be_written(spheres: Path, tmp_path: Path) -> None:
    """As where a disk is full: by a limit on the size of files."""
    (tmp_path / "a.pfm").write_text("of before")
    process = subprocess.run(
        ["/bin/sh", "-c", 'trap "" XFSZ; ulimit -f 1; exec "$0" 60 60 1 a.pfm', spheres],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert (process.returncode, process.stderr) == (1, f"spheres: cannot write '{tmp_path.resolve() / 'a.pfm'}'\n")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.pfm": "of before"}


def test_links_stay_and_pipes_are_refused(spheres: Path, tmp_path: Path) -> None:
    (tmp_path / "a.pfm").write_text("of before")
    (tmp_path / "link.pfm").symlink_to("a.pfm")
    run(spheres, 8, 8, 1, tmp_path / "link.pfm")
    assert (tmp_path / "link.pfm").is_symlink()
    assert read_pfm(tmp_path / "a.pfm").shape == (8, 8, 3)
    os.mkfifo(tmp_path / "pipe.pfm")
    process = subprocess.run(
        [spheres, "8", "8", "1", tmp_path / "pipe.pfm"], capture_output=True, text=True, check=False
    )
    assert process.returncode == 2
    assert "pipe.pfm': expected a file" in process.stderr
    assert (tmp_path / "pipe.pfm").is_fifo()


def test_help(spheres: Path) -> None:
    process = subprocess.run([spheres, "--help"], capture_output=True, text=True, check=False)
    assert (process.returncode, process.stderr) == (0, "")
    assert process.stdout.startswith("usage: spheres WIDTH HEIGHT SPP OUT.pfm")


def test_there_is_no_python_in_it(spheres: Path, checkout: Path) -> None:
    """Nothing of Python is included or linked, and the folder to include is the one that the package names."""
    linked = subprocess.run(["ldd", spheres], capture_output=True, text=True, check=True).stdout
    assert "python" not in linked.lower()
    sources = [*(checkout / "examples" / "cpp").glob("*.?pp"), *(checkout / "pmc_sampler" / "core").glob("*.hpp")]
    assert len(sources) > 10
    for source in sources:
        assert not re.search(r"#include <(Python|nanobind|pybind11)", source.read_text(encoding="utf-8")), source
    assert (Path(pmc_sampler.include_dir()) / "pmc.hpp").is_file()


@pytest.mark.needs("cmake")
def test_cmake_builds_it(require: Callable[[str], Any], checkout: Path, tmp_path: Path) -> None:
    """With the headers of the installed package; without them it says what is missing."""
    configure = [require("cmake"), "-S", checkout / "examples" / "cpp", "-B", tmp_path / "build"]
    wrong = subprocess.run([*configure, "-DPMC_INCLUDE_DIR=/nowhere"], capture_output=True, text=True, check=False)
    assert wrong.returncode != 0
    assert "No pmc.hpp in /nowhere" in wrong.stderr
    for command in (
        [*configure, f"-DPMC_INCLUDE_DIR={pmc_sampler.include_dir()}", "-DCMAKE_BUILD_TYPE=Debug"],
        [require("cmake"), "--build", tmp_path / "build"],
    ):
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        assert process.returncode == 0, process.stdout + process.stderr
    assert run(tmp_path / "build" / "spheres", 8, 8, 2, tmp_path / "a.pfm")["samples"] == 128


@pytest.mark.parametrize("header", ["pmc.hpp", "random.hpp"])
def test_headers_stand_alone(header: str, compiler: list[str], tmp_path: Path) -> None:
    """Any of them may come first, and in two translation units of one program."""
    for name, rest in (("a", "int main() {}"), ("b", "")):
        (tmp_path / f"{name}.cpp").write_text(f"#include <{header}>\n#include <{header}>\n{rest}\n")
    command = [*compiler, "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    sources = [tmp_path / "a.cpp", tmp_path / "b.cpp"]
    process = subprocess.run(
        [*command, *sources, "-o", tmp_path / "both"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
