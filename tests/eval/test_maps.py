"""Error maps: their files hold the values, and their pictures show where the errors are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pmc_sampler.eval import compare, images, maps

pytestmark = pytest.mark.needs("skimage", "flip_evaluator", "OpenImageIO", "colour", "matplotlib")


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    """Equal but for a patch at the top left."""
    reference = np.random.default_rng(2).uniform(0.1, 0.7, (20, 30, 3)).astype(np.float32)
    test = reference.copy()
    test[2:8, 3:12] *= 1.3
    return test, reference


def test_files_hold_the_maps(pair: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    found = compare.error_maps(*pair)
    names = {"tvi_error", "threshold_ratio", "mse", "relmse", "smape", "delta_e", "ldr_flip", "ssim", "flip"}
    assert {error.metric for error in found} == names
    files = maps.write(tmp_path / "new" / "folder", found)
    assert sorted(os.listdir(tmp_path / "new" / "folder")) == sorted(file.name for file in files)
    values = {measure.name: measure for measure in compare.compare(*pair)}
    for error in found:
        image = images.read(tmp_path / "new" / "folder" / f"{error.metric}.exr")
        np.testing.assert_array_equal(image.rgb[..., 0], error.values.astype(np.float32))
        assert image.metadata["pmc:metric"] == error.name
        assert values[error.name].constants == error.constants
        if error.metric != "ssim":  # whose figure leaves out the border
            assert error.values.mean() == pytest.approx(values[error.name].value, rel=1e-5)


def test_pictures_are_bright_where_the_error_is(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """All of the drawn map is compared: 12 pixels for each of the image's 30x20, at the margins' offset."""
    for error in compare.error_maps(*pair):
        drawn = maps.draw(error).sum(axis=2)[75 : 75 + 240, 25 : 25 + 360]
        cells = drawn.reshape(20, 12, 30, 12).mean(axis=(1, 3))
        assert cells[4:6, 6:9].min() > cells[14:, 20:].max() + 0.2, error.metric


def test_equal_images_have_maps_too(pair: tuple[np.ndarray, np.ndarray]) -> None:
    for error in compare.error_maps(pair[1], pair[1]):
        np.testing.assert_allclose(error.values, error.best, atol=1e-6)
        assert maps.draw(error).shape[2] == 3


def test_a_folder_that_cannot_be_made_is_refused(pair: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(images.ImageError, match="for maps cannot be made"):
        maps.write(tmp_path / "file", compare.error_maps(*pair))
