"""What must hold of metrics for any images (hypothesis). Exact up to floating point; the seeds are hypothesis's own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pmc_sampler.eval import metrics

pytestmark = pytest.mark.needs("skimage", "flip_evaluator", "OpenImageIO", "colour")

SHAPE = (12, 13, 3)
# Values of single precision, as images have; nothing so small that its square underflows.
IMAGES = arrays(np.float32, SHAPE, elements=st.floats(2.0**-10, 16.0, width=32))
FEW = settings(max_examples=8, deadline=None)

ERRORS = {
    name: getattr(metrics, name)
    for name in (
        *("tvi_error", "threshold_ratio", "visible_pixels", "yee", "mse", "rmse", "relmse", "smape"),
        *("delta_e", "ldr_flip", "flip"),
    )
}
MAPS = {
    "tvi_error": metrics.tvi_error_map,
    "threshold_ratio": metrics.threshold_ratio_map,
    "mse": metrics.squared_error_map,
    "relmse": metrics.relmse_map,
    "smape": metrics.smape_map,
    "delta_e": metrics.delta_e_map,
    "ldr_flip": metrics.ldr_flip_map,
    "flip": metrics.flip_map,
}


@pytest.mark.parametrize("name", ERRORS)
@FEW
@given(image=IMAGES)
def test_equal_images_have_no_error(name: str, image: np.ndarray) -> None:
    assert ERRORS[name](image, image) == pytest.approx(0.0, abs=1e-6)


@FEW
@given(image=IMAGES)
def test_equal_images_have_the_best_similarity(image: np.ndarray) -> None:
    assert metrics.ssim(image, image) == pytest.approx(1.0)
    assert metrics.pu21_ssim(image, image) == pytest.approx(1.0)
    assert metrics.psnr(image, image) == metrics.pu21_psnr(image, image) == np.inf
    assert metrics.bias(image, image) == 0.0


@pytest.mark.parametrize("name", MAPS)
@FEW
@given(test=IMAGES, reference=IMAGES)
def test_a_figure_is_the_mean_of_its_map(name: str, test: np.ndarray, reference: np.ndarray) -> None:
    values = MAPS[name](test, reference)
    assert values.shape[:2] == SHAPE[:2]
    assert values.min() >= 0.0
    assert values.mean() == pytest.approx(ERRORS[name](test, reference), rel=1e-5, abs=1e-12)


@FEW
@given(test=IMAGES, reference=IMAGES)
def test_similarity_is_the_mean_of_its_map_without_the_border(test: np.ndarray, reference: np.ndarray) -> None:
    local = metrics.ssim_map(test, reference)
    assert local.shape == SHAPE[:2]
    assert local[5:-5, 5:-5].mean() == pytest.approx(metrics.ssim(test, reference), abs=1e-9)


@pytest.mark.parametrize("name", ["mse", "rmse", "psnr", "smape", "ssim", "pu21_psnr", "pu21_ssim"])
@FEW
@given(test=IMAGES, reference=IMAGES)
def test_these_do_not_ask_which_is_the_reference(name: str, test: np.ndarray, reference: np.ndarray) -> None:
    metric = getattr(metrics, name)
    assert metric(test, reference) == pytest.approx(metric(reference, test), rel=1e-9)


@pytest.mark.parametrize("name", ["tvi_error", "relmse", "threshold_ratio"])
def test_those_do(name: str) -> None:
    """The negative control of the test above."""
    dark, bright = np.full(SHAPE, 0.1), np.full(SHAPE, 1.0)
    assert ERRORS[name](dark, bright) < 0.5 * ERRORS[name](bright, dark)


@pytest.mark.parametrize("name", ["tvi_error", "threshold_ratio", "mse", "rmse", "relmse", "smape"])
@FEW
@given(reference=IMAGES, noise=IMAGES)
def test_more_of_the_same_noise_is_more_error(name: str, reference: np.ndarray, noise: np.ndarray) -> None:
    errors = [ERRORS[name](reference + amount * noise, reference) for amount in (0.0, 0.25, 0.5, 1.0)]
    assert np.all(np.diff(errors) > 0.0)


@pytest.mark.parametrize("name", [n for n in ERRORS if n not in ("yee", "ldr_flip", "flip")])
@FEW
@given(test=IMAGES, reference=IMAGES, seed=st.integers(0, 2**32 - 1))
def test_errors_of_pixels_do_not_depend_on_their_places(
    name: str, test: np.ndarray, reference: np.ndarray, seed: int
) -> None:
    order = np.random.default_rng(seed).permutation(SHAPE[0] * SHAPE[1])
    moved = [image.reshape(-1, 3)[order].reshape(SHAPE) for image in (test, reference)]
    assert ERRORS[name](*moved) == pytest.approx(ERRORS[name](test, reference), rel=1e-6)


@FEW
@given(test=IMAGES, reference=IMAGES, factor=st.sampled_from([0.25, 2.0, 8.0]))
def test_units_cancel(test: np.ndarray, reference: np.ndarray, factor: float) -> None:
    """Radiance in another unit, with the white's luminance told in it, is the same light."""
    white = {"white_luminance": 100.0 / factor}
    for name in ("tvi_error", "threshold_ratio", "pu21_psnr"):
        metric = getattr(metrics, name)
        assert metric(factor * test, factor * reference, **white) == pytest.approx(metric(test, reference), rel=1e-5)
    assert metrics.bias(factor * test, factor * reference) == pytest.approx(metrics.bias(test, reference), abs=1e-6)
    for name in ("ssim", "delta_e"):
        metric = getattr(metrics, name)
        exposed = metric(factor * test, factor * reference, exposure=1.0 / factor)
        assert exposed == pytest.approx(metric(test, reference), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("metric", ["tvi_error", "relmse"])
def test_subtracting_the_references_variance_is_unbiased(metric: str) -> None:
    """40 noisy references of one truth: the mean of the errors left is the error against the truth.

    A z-test over the references, false alarms 1e-6 (t of 6.0 at 39 degrees of freedom). Two negative controls must
    fail: nothing subtracted, and the variance of one sample instead of that of the mean of four.
    """
    rng = np.random.default_rng(8)
    truth = rng.uniform(0.5, 2.0, (40, 50, 3))
    test = truth * rng.uniform(0.95, 1.05, truth.shape)
    sigma = 0.02  # of the reference; constant, so that luminance's variance is known
    weights = np.array([0.2126, 0.7152, 0.0722])
    variance = (
        np.full(truth.shape[:2], sigma**2 * (weights**2).sum())
        if metric == "tvi_error"
        else np.full(truth.shape, sigma**2)
    )
    measure = ERRORS[metric]
    expected = measure(test, truth)
    references = [truth + sigma * rng.standard_normal(truth.shape) for _ in range(40)]

    def t(share: float) -> float:
        left = [measure(test, r, reference_variance=share * variance) - expected for r in references]
        return abs(np.mean(left)) / (np.std(left, ddof=1) / np.sqrt(len(left)))

    assert t(1.0) < 6.0
    assert t(0.0) > 6.0
    assert t(4.0) > 6.0
