"""The renderer by formula: its mean is what it says, and what is no scene of it is refused. Statistical: means to five
standard errors in each of 64 pixels, which chance exceeds once in 30000 runs; the seed is fixed.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pmc_sampler import Budget, Config, Sampler, adapters


def scene(folder: Path, text: str) -> Path:
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


@pytest.mark.parametrize("numbers", ["independent", "sobol"])
def test_its_mean_is_known(numbers: str, tmp_path: Path) -> None:
    text = "brightness = 2.0\ndecades = 3.0\nblack = 0.2\nhot = 100.0\nrare = 0.01\ngain = 20.0\ninvalid = 0.05\n"
    renderer = adapters.load("analytic", scene(tmp_path, text), size=(8, 8), sampler=numbers)
    sampler = Sampler(8, 8, Budget(spp=4096), Config.uniform(), seed=1)
    sampler.run(renderer)
    error = sampler.film.plain_mean - renderer.mean
    assert (abs(error) <= 5 * sampler.film.standard_error).all()
    assert 0.04 < sampler.rejected / (4096 * 64) < 0.06
    assert 0 < (renderer.mean == 0).sum() < 3 * 32
    assert renderer.mean[4, 4, 0] == pytest.approx(100 * renderer.mean[3, 4, 0])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("bright = 1.0", "has 'bright': expected brightness, decades"),
        ("rare = 0.7", "rare is 0.7: expected a number from 0 to 0.5"),
        ("hot = true", "hot is True: expected a number"),
        ("rare = 0.1\ngain = 20.0", "rare x gain is 2: expected 1 at most"),
        ("brightness = 1e30\nhot = 1e30", "expected 3e38 at most"),
        ("= 1", "is no TOML"),
    ],
)
def test_scenes_that_cannot_be(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=sentence):
        adapters.load("analytic", scene(tmp_path, text))
