"""What the renderer consists of, without POV-Ray: orders and lens points, images that are not whole, a scene's blocks.

Exact, but where a test gives its false-alarm rate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("OpenImageIO")


@pytest.fixture(scope="module")
def words() -> tuple[Any, Any]:
    """The scramble and index of 4096 samples: 64 in each of 64 pixels."""
    rng = np.random.default_rng(7)
    return np.repeat(rng.integers(0, 1 << 32, 64, np.uint32), 64), np.tile(np.arange(64, dtype=np.uint32), 64)


def test_orders_are_permutations_that_differ(povray: Any, words: Any) -> None:
    """The places of the samples in two orders are uncorrelated: false alarm 1e-5 each, 4.4 standard deviations."""
    from pmc_sampler.adapters.povray import numbers

    scramble, index = words
    orders = [numbers.order(scramble, index, number) for number in range(3)]
    orders.append(numbers.order(scramble, index + np.uint32(64), 0))  # the next batch, if it had the same number
    places = [np.argsort(order) for order in orders]
    for k, order in enumerate(orders):
        assert (np.sort(order) == np.arange(len(order))).all()
        for other in (np.arange(len(order)), *places[:k]):
            assert abs(np.corrcoef(places[k], other)[0, 1]) < 4.4 / np.sqrt(len(order))
    mixed = np.random.default_rng(1).permutation(len(index))
    again = numbers.order(scramble[mixed], index[mixed], 0)
    assert (mixed[again] == orders[0]).all()  # the samples' order does not depend on how they came


@pytest.mark.parametrize("sampler", ["independent", "sobol"])
def test_lens_points_are_uniform(povray: Any, words: Any, sampler: str) -> None:
    """Counts in 8 x 8 cells: chi-square of 63 degrees, false alarm 1e-6 for independent ones (above 137). Sobol points
    have one of a pixel's 64 in each cell. The negative control: points on the diagonal."""
    from pmc_sampler.adapters.povray import numbers

    points = numbers.lens(sampler, *words)
    assert points.shape == (4096, 2)
    assert points.min() >= 0
    assert points.max() < 1

    def cells(values: Any) -> Any:
        return np.bincount((values * 8).astype(int) @ (1, 8), minlength=64)

    def chi2(values: Any) -> float:
        expected = len(values) / 64
        return float(((cells(values) - expected) ** 2 / expected).sum())

    assert chi2(points) < 137
    assert chi2(points[:, [0, 0]]) > 137
    if sampler == "sobol":
        assert all((cells(points[k : k + 64]) == 1).all() for k in range(0, 4096, 64))


def test_an_image_counts_once_it_is_whole(povray: Any, tmp_path: Path) -> None:
    import OpenImageIO as oiio  # noqa: N813
    from pmc_sampler.adapters.povray import images

    file, part = tmp_path / "whole.exr", tmp_path / "part.exr"
    pixels = np.random.default_rng(0).random((20, 300, 3), np.float32).astype(np.float16)  # two chunks
    oiio.ImageBuf(pixels).write(str(file))
    assert images.whole(file)
    assert images.read(file).tobytes() == pixels.astype(np.float32).tobytes()
    data = file.read_bytes()
    for size in (0, 3, 100, 500, len(data) // 2, len(data) - 1):
        part.write_bytes(data[:size])
        assert not images.whole(part)
    assert not images.whole(tmp_path / "none.exr")
    # Offsets of 0, as they are before OpenEXR knows them.
    place = images._header(data)[1]
    part.write_bytes(data[: place + 8] + bytes(8) + data[place + 16 :])
    assert not images.whole(part)


def test_global_photons_are_found(povray: Any) -> None:
    from pmc_sampler.adapters.povray.scene_text import has_radiosity, with_photons

    text = """// global_settings { photons { } }
    #declare S = "global_settings { photons {"; /* /* nested */ global_settings { photons { } } */
    sphere { 0, 1 photons { target } }
    global_settings { max_trace_level 5 #if (1) photons { count 9 media { 3 } } #else photons{spacing 1} #end }
    plane { y, 0 photons { collect off } }"""
    changed = with_photons(text, "X")
    assert changed.replace("{ X ", "{").replace(" ", "") == text.replace(" ", "")
    assert changed.count("photons { X  count 9") == changed.count("photons{ X spacing 1") == 1
    assert changed.count("X") == 2
    assert with_photons(text.replace("count 9", 'load_file "mine"'), "X").count("X") == 0
    assert not has_radiosity(text)
    assert has_radiosity("global_settings { radiosity { } }")
    assert not has_radiosity("finish { radiosity { } } // global_settings { radiosity { } }")
