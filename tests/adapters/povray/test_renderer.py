"""The renderer as the sampler and its users see it.

Exact, but where a test gives its false-alarm rate. Noise is that of an area light with jitter.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from pmc_sampler import Budget, Config, render
from pmc_sampler.sampler import config_for

pytestmark = pytest.mark.needs("povray", "OpenImageIO")

Array = npt.NDArray[Any]
SIZE = (48, 36)
HALF = 2.0**-10  # relative rounding of half floats, truncated


def test_centres_of_pixels_are_povrays_own_image(make: Any, own_image: Any, plain_text: str, centres: Any) -> None:
    ours = make(plain_text)(centres()).reshape(SIZE[1], SIZE[0], 3)
    assert ours.dtype == np.float32
    assert ours.std() > 0.1
    np.testing.assert_allclose(ours, own_image(plain_text, SIZE), rtol=2 * HALF, atol=1e-6)


def test_the_same_batch_gives_the_same_values_in_any_order(make: Any, noisy_text: str, centres: Any) -> None:
    """And another number other noise, which is the negative control."""
    renderer = make(noisy_text, processes=2)
    batch = centres(spp=6)  # of which each process gets some
    first = renderer(batch)
    assert renderer(batch).tobytes() == first.tobytes()
    order = np.random.default_rng(0).permutation(len(batch))
    shuffled = dataclasses.replace(batch[order], number=0)
    assert renderer(shuffled).tobytes() == first[order].tobytes()
    assert renderer(dataclasses.replace(batch, number=1)).tobytes() != first.tobytes()


@pytest.mark.needs("bwrap")
def test_a_sandbox_changes_no_value(make: Any, plain_text: str, centres: Any) -> None:
    """Nor keeps it from being warm for the second batch; its photons are found in it, too."""
    lit = plain_text.replace("assumed_gamma 1.0", "assumed_gamma 1.0 photons { count 300 }")
    lit = lit.replace("} }\nplane", "} photons { target reflection on } }\nplane")
    renderer = make(lit, sandbox=True)
    assert renderer._pool.source.sandboxed
    values = [renderer(centres()) for _ in range(2)]
    assert values[0].tobytes() == values[1].tobytes() == make(lit)(centres()).tobytes()


def test_noise_of_batches_is_independent(make: Any, noisy_text: str, centres: Any) -> None:
    """The correlation of the noise of two batches, over the pixels in the penumbra: false alarm 1e-5 (4.4 standard
    deviations of independent draws; each pixel's noise is normalised). Without shuffling it is near 1: the negative
    control, by batches that are in one order by their number."""
    size = (64, 48)
    renderer = make(noisy_text, size=size, processes=1)
    batches = [renderer(centres(size, number=number)).mean(axis=1) for number in range(8)]
    values = np.stack(batches)
    noise = values - values.mean(axis=0)
    some = noise.std(axis=0) > 1e-3
    assert some.sum() > 100
    noise = noise[:, some] / noise[:, some].std(axis=0)
    # With the mean of 8 taken off, independent noise correlates by -1/7.
    pairs = [float((noise[i] * noise[i + 1]).mean()) for i in range(0, 8, 2)]
    assert abs(np.mean(pairs) + 1 / 7) < 4.4 / np.sqrt(len(pairs) * some.sum())
    again = [renderer(centres(size, number=0)).mean(axis=1) for _ in range(2)]
    assert np.corrcoef(again[0][some], again[1][some])[0, 1] > 0.999


def test_noise_averages_to_povrays(make: Any, own_image: Any, noisy_text: str, batch_of: Any) -> None:
    """64 samples a pixel against POV-Ray's own 64 in a grid: their difference has the size that noise of the measured
    variance has (false alarm below 1e-6: 5 standard deviations of the mean over the image). Not so with a lamp that is
    a tenth brighter: the negative control."""
    size = (16, 12)
    batch = dataclasses.replace(batch_of(*size, 64, 0), number=0)
    values = make(noisy_text, size=size)(batch).reshape(12, 16, 64, 3)
    error = np.sqrt(2 * values.var(axis=2).mean() / 64 / (16 * 12))
    for factor, same in (("1", True), ("1.1", False)):
        reference = own_image(noisy_text.replace("-5> 1", f"-5> {factor}"), size, "+A0.0", "+AM1", "+R8", "-J")
        assert (abs(float((values.mean(axis=2) - reference).mean())) < 5 * error) == same


def test_the_batches_that_suit_it(make: Any, plain_text: str) -> None:
    small = make(plain_text, size=(20, 10))
    assert config_for(small, {}) == Config(batch=400, filter_radius=0.5)  # two samples a pixel
    result = render(small, 20, 10, Budget(spp=4), config_for(small, {}))
    assert result.samples == 800


def test_focal_blur_and_its_samplers(make: Any, plain_text: str, plain_camera: Any, centres: Any) -> None:
    """Points of the lens differ from sample to sample, and the two samplers have one mean (false alarm below 1e-6, and
    Sobol points less noise)."""
    size = (16, 12)
    camera = {**plain_camera, "aperture": 0.8, "focal_distance": 3.0}
    mean, spread = {}, {}
    for sampler in ("independent", "sobol"):
        values = make(plain_text, camera=camera, size=size, sampler=sampler)(centres(size, spp=64))
        per_pixel = values.reshape(12 * 16, 4, 16, 3).mean(axis=2)  # four means of 16 samples
        mean[sampler], spread[sampler] = values.mean(), per_pixel.var(axis=1).mean()
    sharp = make(plain_text, size=size)(centres(size, spp=2)).reshape(-1, 2, 3)
    assert (sharp[:, 0] == sharp[:, 1]).all()
    assert 0 < spread["sobol"] < spread["independent"]
    assert abs(mean["sobol"] - mean["independent"]) < 5 * np.sqrt(2 * spread["independent"] / (12 * 16 * 4))


def test_empty_batches_and_batches_out_of_sight(
    make: Any, plain_text: str, plain_camera: Any, centres: Any, running: Callable[[], list[str]]
) -> None:
    renderer = make(plain_text, camera={**plain_camera, "kind": "fisheye", "angle": 90.0, "right": (1, 0, 0)})
    batch = centres()
    assert renderer(batch[:0]).shape == (0, 3)
    assert (renderer(batch[:1]) == 0).all()  # the corner, outside the circle
    assert running() == []
    values = renderer(batch).reshape(SIZE[1], SIZE[0], 3)
    assert (values[0, 0] == 0).all()
    assert (values[18, 24] > 0).any()


def test_infinite_values_are_clamped_and_counted(make: Any, plain_text: str, centres: Any) -> None:
    text = plain_text.replace("rgb <0.8, 0.5, 0.2> }", "rgb 1 } finish { emission 1e6 diffuse 0 }")
    renderer = make(text)
    values = renderer(centres())
    assert np.isfinite(values).all()
    assert renderer.clamped == (values == 65504.0).all(axis=1).sum() > 100


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"sampler": "halton"}, ValueError, r"'independent' or 'sobol', not 'halton'"),
        ({"options": ["Antialias=On"]}, ValueError, r"'Antialias=On' is no option .* can be given here; what can be"),
        ({"options": "Declare=A=1"}, TypeError, r"options are a sequence of strings"),
        ({"options": ["Declare=A= b c"]}, ValueError, r"takes no spaces"),
        ({"options": ["+L/no/such/folder"]}, FileNotFoundError, r"there is no folder /no/such/folder"),
        ({"options": ["no.ini"]}, FileNotFoundError, r"the INI file no.ini cannot be read: No such file"),
        ({"size": (0, 10)}, ValueError, r"a size is \(width, height\) in whole pixels"),
        ({"timeout": 0}, ValueError, r"timeout is 0: expected a number above 0"),
        ({"processes": 0}, ValueError, r"processes is 0: expected a whole number"),
        ({"camera": {"location": (0, 0, 0)}}, ValueError, r"a camera is a Camera, or a mapping with location, right"),
    ],
)
def test_what_cannot_be_gets_a_sentence(
    make: Any, plain_text: str, options: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        make(plain_text, **options)


def test_missing_scenes_and_programs(
    povray: Any, clean: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plain_text: str
) -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no scene file nothing.pov"):
        povray.PovRayRenderer("nothing.pov")
    with pytest.raises(TypeError, match=r"a PovRayRenderer is called with a Batch .* not with list"):
        povray.PovRayRenderer.__call__(object.__new__(povray.PovRayRenderer), [])
    assert povray.PovRayRenderer.probe().startswith("POV-Ray 3.")
    monkeypatch.setenv("PATH", str(tmp_path))
    for call in (lambda: povray.PovRayRenderer("scene.pov"), povray.PovRayRenderer.probe):
        with pytest.raises(RuntimeError, match=r"no program povray on the path; install it"):
            call()


def test_from_the_command_line(
    tmp_path: Path, clean: None, plain_text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The suffix chooses the renderer, and the camera is the scene's own."""
    from pmc_sampler.cli import main

    monkeypatch.chdir(tmp_path)
    Path("my scene.pov").write_text(plain_text)
    assert main(["render", "my scene.pov", "--size", "32x24", "--spp", "8", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["renderer"], summary["samples"], summary["rejected"]) == ("povray", 8 * 32 * 24, 0)
    assert Path("my scene.exr").exists()
    assert main(["render", "none.pov"]) == 2
    assert "there is no scene file none.pov" in capsys.readouterr().err
