"""Recordings: what they hold, what a replay draws, resuming, and files that are no recordings."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from pmc_sampler.eval import recorded
from pmc_sampler.eval.recorded import BadRecordingError, Recording, record
from scipy import stats

from pmc_sampler import Budget, Config, luminance, render


def batch(pixel: int, index: np.ndarray, scramble: Any) -> SimpleNamespace:
    index = np.asarray(index, np.uint32)
    every = np.broadcast_to(np.asarray(scramble, np.uint32), index.shape).copy()
    return SimpleNamespace(pixel=np.full(index.shape, pixel, np.uint32), index=index, scramble=every)


# --- What is stored --------------------------------------------------------------------------------------------------
def test_every_pixel_has_the_renderers_own_samples(noisy: type, tmp_path: Path) -> None:
    """Exact: a uniform render by the renderer is the mean of what was stored (its values fit 16 bits)."""
    record(noisy(), 12, 10, 32, tmp_path / "a.h5", seed=3, settings={"scene": "noisy"})
    replay = Recording(tmp_path / "a.h5")
    image = render(noisy(), 12, 10, Budget(spp=32), Config.uniform(batch=120), seed=3).film.plain_mean
    np.testing.assert_allclose(replay.mean, image, rtol=1e-6)
    assert replay.samples.dtype == np.float16
    assert (replay.width, replay.height, replay.per_pixel, replay.settings) == (12, 10, 32, {"scene": "noisy"})
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_bright_samples_are_stored_in_32_bits(tmp_path: Path) -> None:
    record(lambda b: np.full((len(b), 3), 1e6, np.float32), 4, 4, 2, tmp_path / "a.h5")
    replay = Recording(tmp_path / "a.h5")
    assert replay.samples.dtype == np.float32
    assert np.array_equal(replay.mean, np.full((4, 4, 3), 1e6))


@pytest.mark.parametrize("signed", [False, True])
def test_invalid_samples_stay_out_of_mean_and_variance(signed: bool, tmp_path: Path) -> None:
    class Faulty:
        signed = False

        def __call__(self, b: Any) -> np.ndarray:
            value = np.array([1.0, np.nan, -1.0, 3.0], np.float32)[b.index % 4]
            return np.repeat(value[:, None], 3, axis=1)

    renderer = Faulty()
    renderer.signed = signed
    record(renderer, 5, 4, 4, tmp_path / "a.h5")
    replay = Recording(tmp_path / "a.h5")
    kept = np.array([1.0, -1.0, 3.0] if signed else [1.0, 3.0])
    np.testing.assert_allclose(replay.mean, kept.mean())
    np.testing.assert_allclose(replay.variance, kept.var())
    np.testing.assert_allclose(replay.luminance_variance, kept.var())
    values = replay(batch(7, np.arange(4), 1))
    assert np.isnan(values[:, 0]).sum() == 4 - len(kept)
    assert replay.reference.rejected == 20 * (4 - len(kept))


# --- What is replayed ------------------------------------------------------------------------------------------------
def test_the_replays_mean_is_the_stored_mean(recording_path: Path) -> None:
    """Exact: over K indices, whichever scramble and round, Sobol replays are the K samples in another order."""
    replay = Recording(recording_path)
    k, orders = replay.per_pixel, set()
    for pixel in (300, 700, 1000):
        stored = np.sort(replay.samples[pixel].astype(np.float32), axis=0)
        for scramble in (0, 1, 0xFFFFFFFF):
            for start in (0, k, 5 * k):
                values = replay(batch(pixel, np.arange(start, start + k), scramble))
                assert np.array_equal(np.sort(values, axis=0), stored)
                assert np.array_equal(values.astype(np.float64).mean(axis=0), replay.mean.reshape(-1, 3)[pixel])
                orders.add(values.tobytes())
    assert len(orders) == 27  # each another order
    image = render(replay, 48, 36, Budget(spp=k), Config.uniform()).film.plain_mean
    np.testing.assert_allclose(image, replay.mean, rtol=1e-6)


def test_moments_are_those_of_the_samples(recording_path: Path) -> None:
    replay = Recording(recording_path)
    samples = replay.samples.astype(np.float64)
    np.testing.assert_allclose(replay.variance.reshape(-1, 3), samples.var(axis=1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(replay.luminance_variance.ravel(), luminance(samples).var(axis=1), rtol=1e-9, atol=1e-12)
    reference = replay.reference
    assert not reference.variance.any()
    assert np.array_equal(reference.mean, replay.mean.astype(np.float32))


def numbered(folder: Path, k: int, sampler: str) -> Recording:
    """A recording of two pixels whose samples are their numbers."""
    path = folder / "numbered.h5"
    record(lambda b: np.repeat(b.index[:, None].astype(np.float32), 3, axis=1), 2, 1, k, path)
    return Recording(path, sampler)


def test_sobol_replay_keeps_strata(tmp_path: Path) -> None:
    """Exact: aligned blocks of 2^m indices are replayed from aligned blocks. Control: independent ones are not."""

    def blocks_stay(replay: Recording) -> bool:
        for scramble in range(20):
            order = replay(batch(1, np.arange(64), scramble))[:, 0].astype(int)
            for m in range(7):
                if (np.ptp(order.reshape(-1, 2**m) >> m, axis=1) > 0).any():
                    return False
        return True

    assert blocks_stay(numbered(tmp_path, 64, "sobol"))
    assert not blocks_stay(numbered(tmp_path, 64, "independent"))


def test_draws_are_uniform(tmp_path: Path) -> None:
    """Chi-square over scrambles (Sobol) and over indices (independent), 4 tests at p < 1e-6; the negative control is
    one scramble for all."""
    for sampler in ("sobol", "independent"):
        replay = numbered(tmp_path, 64, sampler)
        scrambles = np.random.default_rng(1).integers(2**32, size=20_000, dtype=np.uint32)

        def p(replay: Recording, index: np.ndarray, scramble: Any) -> float:
            drawn = replay(batch(0, index, scramble))[:, 0].astype(int)
            return float(stats.chisquare(np.bincount(drawn, minlength=64)).pvalue)

        assert p(replay, np.full(20_000, 11), scrambles) > 1e-6
        assert p(replay, np.full(20_000, 64 + 11), scrambles) > 1e-6
        assert p(replay, np.full(20_000, 11), np.full(20_000, 5)) < 1e-6
    assert p(replay, np.arange(20_000), 5) > 1e-6


def test_independent_draws_have_the_stated_variance(recording_path: Path) -> None:
    """Variance of the mean of n draws is the stored variance over n: a chi-square z over pixels below 4.5."""
    replay = Recording(recording_path, "independent")
    pixels = np.flatnonzero(replay.luminance_variance.ravel() > 0)
    errors = np.zeros(len(pixels))
    for seed in range(40):
        image = render(replay, 48, 36, Budget(spp=16), Config.uniform(), seed=seed).film.plain_mean
        off = luminance(image.astype(np.float64)) - luminance(replay.mean)
        errors += (off.ravel()[pixels] ** 2) / (replay.luminance_variance.ravel()[pixels] / 16)
    ratio = errors / 40
    z = (ratio.mean() - 1) / (ratio.std(ddof=1) / np.sqrt(len(ratio)))
    assert abs(z) < 4.5
    assert abs((1.2 * ratio.mean() - 1) / (1.2 * ratio.std(ddof=1) / np.sqrt(len(ratio)))) > 4.5  # the control


# --- Resuming --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("after", [1, 5, 15])
def test_an_interrupted_recording_resumes_to_the_same_bits(after: int, noisy: type, tmp_path: Path) -> None:
    record(noisy(), 12, 10, 16, tmp_path / "whole.h5", seed=2)
    cut = tmp_path / "cut.h5"
    seen: list[float] = []
    with pytest.raises(KeyboardInterrupt):
        record(noisy(fail_after=after), 12, 10, 16, cut, seed=2)
    assert not cut.exists()
    with (tmp_path / "cut.h5.part").open("ab") as stream:
        stream.write(b"torn")  # as an interruption in the middle of a write leaves it
    rest = noisy()
    record(rest, 12, 10, 16, cut, seed=2, progress=seen.append)
    assert rest.calls == 16 - after
    assert seen[-1] == 1.0
    assert cut.read_bytes() == (tmp_path / "whole.h5").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.h5", "whole.h5"]
    record(rest, 12, 10, 16, cut, seed=2)  # it is there already
    assert rest.calls == 16 - after


def test_another_recording_is_not_overwritten(noisy: type, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with pytest.raises(KeyboardInterrupt):
        record(noisy(fail_after=3), 12, 10, 16, path, seed=2)
    with pytest.raises(BadRecordingError, match="seed is 2 and not 3"):
        record(noisy(), 12, 10, 16, path, seed=3)
    record(noisy(), 12, 10, 16, path, seed=2)
    before = path.read_bytes()
    with pytest.raises(BadRecordingError, match="per_pixel is 16 and not 32"):
        record(noisy(), 12, 10, 32, path, seed=2)
    assert path.read_bytes() == before
    other = tmp_path / "b.h5"
    Path(f"{other}.part").write_text("my notes")
    with pytest.raises(BadRecordingError, match="no unfinished recording"):
        record(noisy(), 12, 10, 16, other)
    assert Path(f"{other}.part").read_text() == "my notes"
    for per_pixel in (0, 48, 2**21):
        with pytest.raises(BadRecordingError, match="power of two"):
            record(noisy(), 12, 10, per_pixel, tmp_path / "c.h5")
    with pytest.raises(BadRecordingError, match="cannot be written"):
        record(noisy(), 12, 10, 16, tmp_path / "none" / "c.h5")
    with pytest.raises(BadRecordingError, match="radiance of shape"):
        record(lambda b: np.zeros((3, 3), np.float32), 12, 10, 16, tmp_path / "d.h5")


# --- Files that are no recordings ------------------------------------------------------------------------------------
def test_two_at_once_are_refused(noisy: type, tmp_path: Path) -> None:
    """The second one; the first is whole."""
    path = tmp_path / "a.h5"

    def meanwhile(share: float) -> None:
        if share < 1.0:
            with pytest.raises(BadRecordingError, match="is being written by another process"):
                record(noisy(), 12, 10, 16, path, seed=2)

    record(noisy(), 12, 10, 16, path, seed=2, progress=meanwhile)
    record(noisy(), 12, 10, 16, tmp_path / "b.h5", seed=2)
    assert (Recording(path).mean == Recording(tmp_path / "b.h5").mean).all()


def test_damaged_and_foreign_files_are_named(recording_path: Path, tmp_path: Path) -> None:
    with pytest.raises(BadRecordingError, match="there is no recording"):
        Recording(tmp_path / "none.h5")
    data = recording_path.read_bytes()
    for name, content in (
        ("cut", data[: len(data) // 2]),
        ("flipped", data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 0xFF]) + data[len(data) // 2 + 1 :]),
        ("text", b"no HDF5"),
        ("empty", b""),
    ):
        path = tmp_path / f"{name}.h5"
        path.write_bytes(content)
        with pytest.raises(BadRecordingError, match="no whole recording"):
            Recording(path)
    with pytest.raises(ValueError, match="expected one of sobol, independent"):
        Recording(recording_path, "halton")


HEAD = {"format": recorded.FORMAT, "version": 1, "width": 4, "height": 2, "per_pixel": 8, "signed": False, "seed": 0}


def forge(
    path: Path, head: dict[str, Any], shape: tuple[int, ...] = (8, 8, 3), kind: str = "f2", **storage: Any
) -> None:
    storage = {"chunks": (1, *shape[1:]), "compression": "gzip", "shuffle": True, "fletcher32": True, **storage}
    with h5py.File(path, "w") as file:
        file.attrs["head"] = json.dumps({"settings": {}, **head})
        stored = file.create_dataset("samples", shape, kind, **storage)
        if stored.size < 10**6:
            stored[...] = np.zeros(shape)


@pytest.mark.parametrize(
    ("changes", "storage", "said"),
    [
        ({"format": "other"}, {}, "not a recording's"),
        ({"version": 9}, {}, "version 9"),
        ({"width": 5}, {}, "not floats of shape"),
        ({"width": -4, "height": -2}, {}, "speaks of"),
        ({"width": "4"}, {}, "speaks of"),
        ({"per_pixel": 6}, {}, "speaks of"),
        ({"signed": "yes"}, {}, "incomplete"),
        ({"settings": 3}, {}, "incomplete"),
        ({}, {"kind": "i2"}, "not floats"),
        ({}, {"chunks": (8, 1, 3)}, "as `record` stores"),
        ({}, {"compression": None}, "as `record` stores"),
        # Terabytes that were never written, and a gigabyte in few bytes.
        ({"width": 2**20, "height": 2**10, "per_pixel": 512}, {"shape": (2**30, 512, 3)}, "promises"),
        ({"width": 2**10, "height": 2**10, "per_pixel": 64}, {"shape": (2**20, 64, 3)}, "promises"),
    ],
)
def test_hostile_heads_are_refused(changes: dict[str, Any], storage: dict[str, Any], said: str, tmp_path: Path) -> None:
    forge(tmp_path / "good.h5", HEAD)
    assert Recording(tmp_path / "good.h5").mean.shape == (2, 4, 3)
    forge(tmp_path / "bad.h5", {**HEAD, **changes}, **storage)
    with pytest.raises(BadRecordingError, match=said):
        Recording(tmp_path / "bad.h5")


def test_links_to_elsewhere_are_not_followed(tmp_path: Path) -> None:
    forge(tmp_path / "good.h5", HEAD)
    with h5py.File(tmp_path / "bad.h5", "w") as file:
        file.attrs["head"] = json.dumps({"settings": {}, **HEAD})
        file["samples"] = h5py.ExternalLink("good.h5", "samples")
    with pytest.raises(BadRecordingError, match="samples are missing"):
        Recording(tmp_path / "bad.h5")
