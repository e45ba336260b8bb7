"""Peers: what they are told of a scene, their processes, and the search for equal budgets. Exact, but for the last.

The long tests render with the peers themselves, by the Python that the variable PMC_PEERS_PYTHON names.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval.peers import process, study
from pmc_sampler.eval.peers.process import PACKAGES, Peer, PeerError
from pmc_sampler.eval.peers.scene import Description, describe

SIZE = (64, 48)
FAKE = """
import os
import numpy as np

class Peer:
    version = "Fake 1"
    settings = ("strength",)

    def __init__(self, scene):
        print("chatter")
        self.shape = scene["height"], scene["width"]

    def render(self, asked):
        print("chatter")
        if asked["seed"] == 3:
            raise KeyError("three")
        if asked["seed"] == 4:
            os._exit(1)
        rgb = np.full((*self.shape, 3), asked.get("strength", 0.0), np.float32)
        return {"rgb": rgb, "samples": np.full(self.shape, asked["samples"], np.float32), "seconds": 1.5}
"""


def scene(name: str) -> Any:
    return pytest.importorskip("pmc_sampler.adapters.opencl.load").scene_of(name, SIZE)


@pytest.fixture(scope="module")
def box() -> Description:
    return describe(scene("cornell-box"))


@pytest.mark.needs("mitsuba")
def test_the_cornell_box_is_described_whole(box: Description) -> None:
    assert (box["width"], box["height"], box["max_depth"]) == (*SIZE, 12)
    assert [shape["kind"] for shape in box["shapes"]] == ["diffuse"] * 6 + ["dielectric"]
    lights = [shape["radiance"] for shape in box["shapes"] if shape["radiance"] is not None]
    np.testing.assert_allclose(lights, [(18.4, 14.0, 6.75)], rtol=1e-6)
    tangent = np.tan(np.deg2rad(39.3077 / 2))
    np.testing.assert_allclose(box["window"], np.array([-4 / 3, 4 / 3, -1, 1]) * tangent, rtol=1e-4)


@pytest.mark.needs("mitsuba")
def test_a_sphere_becomes_closed_and_faces_outwards(box: Description) -> None:
    """Its volume by the divergence theorem is the ball's, less what flat triangles cut off: below 1e-3 of it."""
    ball = box["shapes"][-1]
    assert ball["normals"] is not None
    corners = ball["vertices"].astype(np.float64)[ball["triangles"]]
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    exact = 4.0 / 3.0 * np.pi * 0.34**3
    assert 0.999 * exact < volume < exact
    assert np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).min() > 0.0
    np.testing.assert_allclose(ball["vertices"] - (0.35, 0.34, 0.25), 0.34 * ball["normals"], atol=1e-6)


@pytest.mark.needs("mitsuba")
@pytest.mark.parametrize(("name", "what"), [("thin-lens", "light from infinity"), ("cornell-box-mirrors", "conductor")])
def test_what_peers_are_not_told_of_is_refused(name: str, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        describe(scene(name))


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    shutil.copy(process._WORKERS / "__main__.py", tmp_path)
    (tmp_path / "with_fake.py").write_text(FAKE)
    monkeypatch.setattr(process, "_WORKERS", tmp_path)
    monkeypatch.setitem(PACKAGES, "fake", "fake")
    with Peer("fake", {"width": 4, "height": 3}) as peer:  # type: ignore[typeddict-item]
        yield peer


def test_a_peer_renders_in_its_process(fake: Peer) -> None:
    assert fake.version == "Fake 1"
    picture = fake.render(7, 1, {"strength": 0.5})
    assert picture.rgb.shape == (3, 4, 3)
    assert (picture.rgb == 0.5).all()
    assert (picture.spp, picture.seconds) == (7.0, 1.5)


def test_a_peer_that_fails_can_go_on_and_one_that_dies_is_named(fake: Peer) -> None:
    with pytest.raises(PeerError, match="fake failed: KeyError: 'three'"):
        fake.render(7, 3)
    with pytest.raises(PeerError, match="stregth came; settings are strength"):
        fake.render(7, 1, {"stregth": 0.5})
    assert fake.render(7, 1).spp == 7.0
    with pytest.raises(PeerError, match="fake died"):
        fake.render(7, 4)


def test_a_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PACKAGES, "missing", "no_such_package")
    with pytest.raises(PeerError, match=r"pip install numpy no_such_package\.$"):
        Peer("missing", {})  # type: ignore[typeddict-item]
    with pytest.raises(PeerError, match="cannot be run"):
        Peer("cycles", {}, "no/such/python")  # type: ignore[typeddict-item]
    with pytest.raises(ValueError, match="no peer is called 'arnold'"):
        Peer("arnold", {})  # type: ignore[typeddict-item]


def test_a_peers_memory_manager_is_in_place_from_the_beginning(tmp_path: Path) -> None:
    """A package that brings one with it is started again with it, once; the loader finds it by name, spaces or not."""
    folder = tmp_path / "site with spaces"
    (folder / "some_peer").mkdir(parents=True)
    (folder / "some_peer" / "__init__.py").touch()
    text = f"""
        import os, runpy, sys
        sys.path.insert(0, {str(folder)!r})
        preload = runpy.run_path({str(process._WORKERS / "__main__.py")!r})["preload"]
        os.execve = lambda path, words, environment: print(environment["LD_PRELOAD"], environment["LD_LIBRARY_PATH"])
        preload("some_peer")
        os.environ["PMC_PEER_PRELOADED"] = "1"
        preload("some_peer")
    """

    def started() -> str:
        words = [sys.executable, "-c", textwrap.dedent(text)]
        environment = {**os.environ, "LD_LIBRARY_PATH": ""}
        return subprocess.run(words, check=True, capture_output=True, text=True, env=environment).stdout

    assert started() == ""
    libraries = folder / "some_peer.libs"
    libraries.mkdir()
    for name in ("libtbbmalloc_proxy-1.so.2", "libtbbmalloc-1.so.2", "libother.so"):
        (libraries / name).touch()
    assert started() == f"libtbbmalloc-1.so.2 libtbbmalloc_proxy-1.so.2 {libraries}\n"


def test_counts_from_their_shares() -> None:
    """Whatever the largest count is, where some pixel stopped as soon as it could; other steps are refused."""
    for largest in (32, 48, 192, 1024):
        exact = np.array([[32, 48, 112], [largest, 32, largest]], np.float32).clip(max=largest)
        shares = (exact / np.float32(largest)).astype(np.float32)
        np.testing.assert_array_equal(process.counts(shares, most=1024, step=16, first=32), exact)
    np.testing.assert_array_equal(process.counts(np.ones((2, 2), np.float32), most=64, step=16, first=64), 64.0)
    with pytest.raises(PeerError, match="fit no multiples of 16"):
        process.counts(np.array([[0.123, 1.0]], np.float32), most=64, step=16, first=32)


@pytest.mark.parametrize("start", [1e-4, 0.02, 5.0])
def test_the_threshold_that_meets_a_budget(start: float) -> None:
    asked = []

    def achieved(threshold: float) -> float:
        asked.append(threshold)
        return min(max(3.0 / threshold, 16.0), 1024.0)

    found = study.threshold_for(64.0, achieved, start=start)
    assert achieved(found) == pytest.approx(64.0, rel=0.02)
    assert len(asked) < 12


def test_a_budget_that_no_threshold_meets_is_refused() -> None:
    with pytest.raises(ValueError, match="no noise threshold gives 64 samples a pixel: the nearest is 100% off"):
        study.threshold_for(64.0, lambda threshold: 128.0)


def test_gains_are_at_equal_samples_and_of_common_seeds() -> None:
    uniform = [{"seed": seed, "mse": 2.0 * seed, "spp": 64.0} for seed in (1, 2, 3)]
    adaptive = [{"seed": seed, "mse": 1.0 * seed, "spp": 32.0} for seed in (2, 3, 4)]
    gain = study.gains(adaptive, uniform, "mse")
    assert (gain.median, gain.low, gain.high) == (4.0, 4.0, 4.0)
    with pytest.raises(ValueError, match="at least one value"):
        study.gains(adaptive[2:], uniform, "mse")


@pytest.mark.long
@pytest.mark.needs("mitsuba", "pyopencl", "OpenImageIO")
@pytest.mark.parametrize(
    ("name", "adaptive"),
    [("cycles", {"threshold": 0.05, "min_samples": 4}), ("luxcore", {"strength": 0.95, "warmup": 8, "step": 8})],
)
def test_a_peer_renders_the_same_scene(name: str, adaptive: dict[str, Any], box: Description) -> None:
    """Tiles of 16x16 pixels agree with the OpenCL tracer's within 5 %, about four standard errors of both; the
    negative control is the picture upside down. Counts are what was asked for, and not even where it is adaptive."""
    from pmc_sampler.adapters import load
    from pmc_sampler.eval.measures import tiles

    from pmc_sampler import Budget, Config, render

    ours = tiles(render(load("opencl", "cornell-box", size=SIZE), *SIZE, Budget(spp=2048), Config.uniform()).film.mean)
    try:
        peer = Peer(name, box, os.environ.get("PMC_PEERS_PYTHON", sys.executable))
    except PeerError as error:
        pytest.skip(str(error))
    with peer:
        picture = peer.render(1024, 1)
        assert picture.spp == pytest.approx(1024, rel=0.05)
        assert np.ptp(picture.samples) <= 0.01 * 1024
        theirs = tiles(picture.rgb)
        np.testing.assert_allclose(theirs, ours, rtol=0.05, atol=1e-3)
        assert not np.allclose(theirs[::-1], ours, rtol=0.05, atol=1e-3)
        steered = peer.render(128, 1, adaptive)
        assert steered.spp <= 1.05 * 128
        assert np.ptp(steered.samples) > 16
