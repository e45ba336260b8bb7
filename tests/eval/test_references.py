"""References: what they say of their own noise, caching, resuming, damage."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pmc_sampler.eval import references

SETTINGS = {"scene": "noisy", "renderer": "test"}


def test_variance_is_that_of_the_mean(noisy: type, tmp_path: Path) -> None:
    """The squared error of the reference, summed over pixels and weighted by the true variance, is chi-square
    distributed; so is, less sharply, its estimate. False alarms below 1e-5 (z of 4.5 and more). The
    negative control,
    the variance of one sample in place of the mean's, must be rejected."""
    radiance = noisy(24, 20)
    reference = references.obtain(radiance, 24, 20, 256, SETTINGS, cache=tmp_path, replicates=16)
    truth = radiance.mean[..., 0]
    variance = 3 * truth**2 / 256
    squares = (reference.mean[..., 0] - truth) ** 2 / variance
    n = squares.size
    # A mean of 256 such samples has a kurtosis of 3 + (52/9 - 3) / 256, so 1 is within sqrt(2 / n) or so.
    error = math.sqrt(2.05 / n)
    assert abs(squares.mean() - 1) < 4.5 * error

    def z(estimate: np.ndarray) -> float:
        # Per pixel the estimate from 16 replicates spreads by sqrt(2 / 15) of itself.
        return abs((estimate / variance).mean() - 1) / math.sqrt(2.3 / 15 / n)

    assert z(reference.variance[..., 0]) < 4.5
    assert z(256 * reference.variance[..., 0]) > 4.5


def test_luminance_variance_counts_what_channels_share(noisy: type, tmp_path: Path) -> None:
    """Exact: all channels carry the same noise, so the luminance's deviation is the sum of theirs."""
    reference = references.obtain(noisy(), 12, 10, 64, SETTINGS, cache=tmp_path)
    deviation = np.sqrt(reference.variance) @ np.array([0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(np.sqrt(reference.luminance_variance), deviation, rtol=1e-4, atol=1e-7)
    expected = math.sqrt(float(reference.luminance_variance.sum())) / 120 / reference.mean_luminance
    assert reference.bias_error == pytest.approx(expected, rel=1e-5)
    black = replace(reference, mean=np.zeros_like(reference.mean))
    with pytest.raises(ValueError, match="the reference is black, so no bias"):
        _ = black.bias_error


def test_a_cached_reference_is_not_rendered_again(noisy: type, tmp_path: Path) -> None:
    first = references.obtain(noisy(), 12, 10, 32, SETTINGS, cache=tmp_path)
    radiance = noisy()
    again = references.obtain(radiance, 12, 10, 32, SETTINGS, cache=tmp_path)
    assert radiance.calls == 0
    np.testing.assert_array_equal(again.mean, first.mean)
    np.testing.assert_array_equal(again.variance, first.variance)
    assert (again.spp, again.replicates, again.rejected, again.key) == (32, 16, 0, first.key)
    # Anything else is another reference.
    other = references.obtain(radiance, 12, 10, 32, {**SETTINGS, "version": 2}, cache=tmp_path)
    assert radiance.calls > 0
    assert other.key != first.key
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("after", [1, 7, 23, 40])
def test_an_interrupted_reference_resumes_to_the_same_bits(after: int, noisy: type, tmp_path: Path) -> None:
    def obtain(radiance: object, folder: str) -> references.Reference:
        return references.obtain(radiance, 64, 64, 64, SETTINGS, cache=tmp_path / folder, replicates=4, save_seconds=0)

    whole = obtain(noisy(64, 64), "whole")
    with pytest.raises(KeyboardInterrupt):
        obtain(noisy(64, 64, fail_after=after), "cut")
    total = noisy(64, 64)
    resumed = obtain(total, "cut")
    np.testing.assert_array_equal(resumed.mean, whole.mean)
    np.testing.assert_array_equal(resumed.variance, whole.variance)
    # Nothing was rendered twice: one sample a pixel and batch, 64 in all.
    assert total.calls == 64 - after
    assert len(list((tmp_path / "cut").iterdir())) == 1


def test_progress_goes_from_nought_to_one(noisy: type, tmp_path: Path) -> None:
    seen: list[float] = []
    references.obtain(noisy(), 12, 10, 32, SETTINGS, cache=tmp_path, progress=seen.append)
    assert seen == sorted(seen)
    assert 0.0 < seen[0] < 0.1
    assert seen[-1] == 1.0


def test_a_reference_is_rendered_to_a_target_noise(noisy: type, tmp_path: Path) -> None:
    """Replicates are added until the noise is that, and no more: one less would not have been enough, but for the
    noise's own error, which 16 replicates of 480 pixels leave at under 5 % (4 standard errors)."""
    radiance = noisy(24, 20)
    first = references.obtain(radiance, 24, 20, 64, SETTINGS, cache=tmp_path)
    wanted = first.noise / 1.5
    finer = references.obtain(radiance, 24, 20, 64, SETTINGS, cache=tmp_path, noise=wanted)
    assert finer.noise <= wanted < first.noise
    assert finer.spp == 4 * finer.replicates
    assert 16 * 1.5**2 * 0.9 < finer.replicates < 16 * 1.5**2 * 1.1
    calls = radiance.calls
    again = references.obtain(radiance, 24, 20, 64, SETTINGS, cache=tmp_path, noise=wanted)
    assert radiance.calls == calls
    np.testing.assert_array_equal(again.mean, finer.mean)
    # What asks for no more than it has needs no more replicates, and is the same picture.
    same = references.obtain(radiance, 24, 20, 64, SETTINGS, cache=tmp_path, noise=2 * first.noise)
    np.testing.assert_array_equal(same.mean, first.mean)
    with pytest.raises(references.BadReferenceError, match="must be above 0"):
        references.obtain(radiance, 24, 20, 64, SETTINGS, cache=tmp_path, noise=0.0)


@pytest.mark.parametrize(("spp", "replicates"), [(0, 16), (100, 16), (8, 16), (64, 1)])
def test_numbers_that_do_not_divide_are_refused(spp: int, replicates: int, noisy: type, tmp_path: Path) -> None:
    with pytest.raises(references.BadReferenceError, match="multiple"):
        references.obtain(noisy(), 12, 10, spp, SETTINGS, cache=tmp_path, replicates=replicates)


def test_damaged_files_are_named(noisy: type, tmp_path: Path) -> None:
    references.obtain(noisy(), 12, 10, 32, SETTINGS, cache=tmp_path)
    (path,) = tmp_path.glob("*.npz")
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(references.BadReferenceError, match="delete it"):
        references.obtain(noisy(), 12, 10, 32, SETTINGS, cache=tmp_path)
    np.savez(tmp_path / "foreign.npz", picture=np.zeros(3))
    with pytest.raises(references.BadReferenceError, match="mean is missing"):
        references.load(tmp_path / "foreign.npz")
    with pytest.raises(references.BadReferenceError, match="there is no reference"):
        references.load(tmp_path / "none.npz")


def test_the_cache_is_where_the_system_wants_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert references.cache_folder() == tmp_path / "pmc_sampler" / "references"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert references.cache_folder() == tmp_path / ".cache" / "pmc_sampler" / "references"


def test_the_identity_is_of_contents(tmp_path: Path) -> None:
    scene, mesh = tmp_path / "a.xml", tmp_path / "a.ply"
    scene.write_text('<shape><string name="filename" value="a.ply"/></shape>')
    seen = [references.identify(str(scene), "numpy", "2.0")]
    mesh.write_text("mesh")
    seen.append(references.identify(str(scene), "numpy", "2.0"))
    scene.write_text(scene.read_text() + " ")
    seen.append(references.identify(str(scene), "numpy", "2.0"))
    assert len({identity["contents"] for identity in seen}) == 3
    assert {identity["renderer_version"] for identity in seen} == {"2.0"}
