"""Metrics against formulas written out anew, outside programs and published values.

Exact up to floating point unless a test states a false-alarm rate.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from pmc_sampler.eval import compare, metrics
from pmc_sampler.eval.display import SHOULDER, display, srgb_decode, srgb_encode, tone_map

from pmc_sampler import luminance

pytestmark = pytest.mark.needs("skimage", "flip_evaluator", "OpenImageIO", "colour", "scipy")

SHAPE = (24, 32, 3)


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    """A test image and a reference with values from 0 to about 8, grey nowhere."""
    rng = np.random.default_rng(11)
    reference = rng.gamma(1.0, 1.0, SHAPE)
    return np.maximum(reference * rng.uniform(0.7, 1.3, SHAPE) + rng.normal(0, 0.01, SHAPE), 0), reference


def grey(value: float) -> np.ndarray:
    return np.full(SHAPE, value)


@pytest.mark.parametrize(
    ("cd", "threshold"), [(0.01, 0.00547), (0.1, 0.0403), (1.0, 0.391), (10.0, 1.072), (100.0, 5.559)]
)
def test_one_threshold_is_a_tvi_error_of_one(cd: float, threshold: float) -> None:
    """The thresholds are Ferwerda's and Ward Larson's, computed outside, to three or four figures."""
    reference, test = grey(cd / 100), grey((cd + threshold) / 100)
    assert metrics.tvi_error(test, reference) == pytest.approx(1.0, rel=3e-3)
    assert metrics.threshold_ratio(test, reference) == pytest.approx(1.0, rel=2e-3)
    assert metrics.visible_pixels(grey((cd + 0.99 * threshold) / 100), reference) == 0.0
    assert metrics.visible_pixels(grey((cd + 1.01 * threshold) / 100), reference) == 1.0


def test_white_luminance_sets_the_unit() -> None:
    # 1.0 is 10 cd/m2, where the threshold is 1.072.
    assert metrics.tvi_error(grey(1 + 0.2144), grey(1), white_luminance=10.0) == pytest.approx(4.0, rel=3e-3)


def test_tvi_error_is_of_luminance(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """A change of colour at equal luminance costs nothing."""
    _, reference = pair
    changed = reference.copy()
    changed[..., 0] += 0.0722 / 0.2126 * 0.3
    changed[..., 2] -= 0.3
    assert metrics.tvi_error(changed, reference) == pytest.approx(0.0, abs=1e-6)
    assert metrics.mse(changed, reference) > 0.03


def test_mse_and_psnr_are_those_of_openimageio(pair: tuple[np.ndarray, np.ndarray]) -> None:
    import OpenImageIO

    test, reference = (image.astype(np.float32) for image in pair)
    buffers = [OpenImageIO.ImageBuf(np.ascontiguousarray(image)) for image in (reference, test)]
    outside = OpenImageIO.ImageBufAlgo.compare(*buffers, 0.0, 0.0)
    assert metrics.rmse(test, reference) == pytest.approx(outside.rms_error, rel=1e-6)
    # OpenImageIO takes the larger image's maximum as the peak.
    peak = float(max(test.max(), reference.max()))
    assert metrics.psnr(test, reference, peak=peak) == pytest.approx(outside.PSNR, rel=1e-6)


def test_ssim_is_the_formula(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """Wang et al. 2004, equations 13 to 17, with a Gaussian window of 11 pixels, away from the border."""
    from scipy.ndimage import correlate1d

    x, y = (display(image, 0.5).astype(np.float64) for image in pair)
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window /= window.sum()

    def smooth(image: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            image = correlate1d(image, window, axis=axis)
        return image[5:-5, 5:-5]

    mx, my = smooth(x), smooth(y)
    vx, vy, cov = smooth(x * x) - mx * mx, smooth(y * y) - my * my, smooth(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = ((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean()
    assert metrics.ssim(*pair, exposure=0.5) == pytest.approx(expected, rel=1e-6)


def test_relative_errors_are_their_formulas(pair: tuple[np.ndarray, np.ndarray]) -> None:
    x, r = pair
    terms = (x - r) ** 2 / (r**2 + 0.01)
    assert metrics.relmse(x, r) == pytest.approx(terms.mean())
    assert metrics.relmse(x, r, epsilon=1e-3) == pytest.approx(((x - r) ** 2 / (r**2 + 1e-3)).mean())
    dropped = terms.size // 10
    assert metrics.relmse(x, r, trim=0.1) == pytest.approx(np.sort(terms.ravel())[:-dropped].mean())
    smape = (2 * abs(x - r) / (abs(r) + abs(x) + 0.02)).mean()
    assert metrics.smape(x, r) == pytest.approx(smape)


def test_trimming_drops_one_speck(pair: tuple[np.ndarray, np.ndarray]) -> None:
    x, r = pair
    speck = x.copy()
    speck[3, 4, 1] = 1e6
    share = 1.0 / x.size
    assert metrics.relmse(speck, r) > 1e6
    assert metrics.relmse(speck, r, trim=share) < metrics.relmse(x, r) * 1.001


def test_bias_is_relative_and_signed(pair: tuple[np.ndarray, np.ndarray]) -> None:
    _, r = pair
    assert metrics.bias(1.02 * r, r) == pytest.approx(0.02)
    assert metrics.bias(0.97 * r, r) == pytest.approx(-0.03)
    with pytest.raises(ValueError, match="black"):
        metrics.bias(r, 0 * r)


def test_equal_images_have_no_error(pair: tuple[np.ndarray, np.ndarray]) -> None:
    _, r = pair
    values = {measure.name: measure.value for measure in compare.compare(r, r)}
    assert values.pop("PSNR") == values.pop("PU21-PSNR") == math.inf
    assert values.pop("SSIM") == pytest.approx(1.0)
    assert values.pop("PU21-SSIM") == pytest.approx(1.0)
    assert values.pop("HDR-FLIP") == pytest.approx(0.0, abs=1e-6)
    assert values.pop("LDR-FLIP") == pytest.approx(0.0, abs=1e-6)
    assert set(values.values()) == {0.0}


def test_flip_exposures_are_fixed_by_what_it_derives(pair: tuple[np.ndarray, np.ndarray]) -> None:
    test, reference = pair
    exposures = metrics.flip_exposures(reference)
    assert exposures[0] < exposures[1]
    free = metrics.flip(test, reference)
    assert metrics.flip(test, reference, exposures=exposures) == pytest.approx(free, rel=1e-3)
    # Much darker exposures hide the difference: the range matters, so it is an argument.
    assert metrics.flip(test, reference, exposures=(-12.0, -11.0)) < 0.1 * free
    # Viewed from twice as far away, fine noise is seen less.
    assert metrics.flip(test, reference, pixels_per_degree=2 * metrics.PIXELS_PER_DEGREE) < free


def test_flip_is_that_of_the_package_as_it_comes(pair: tuple[np.ndarray, np.ndarray]) -> None:
    import flip_evaluator

    test, reference = (image.astype(np.float32) for image in pair)
    _, mean, _ = flip_evaluator.evaluate(reference, test, "HDR")
    assert metrics.flip(test, reference) == pytest.approx(mean, rel=1e-6)


def test_reference_variance_is_subtracted(pair: tuple[np.ndarray, np.ndarray]) -> None:
    x, r = pair
    variance = np.random.default_rng(3).uniform(0, 0.1, SHAPE)
    assert metrics.mse(x, r, reference_variance=variance) == pytest.approx(metrics.mse(x, r) - variance.mean())
    scaled = (variance / (r**2 + 0.01)).mean()
    assert metrics.relmse(x, r, reference_variance=variance) == pytest.approx(metrics.relmse(x, r) - scaled)
    of_luminance = variance[..., 0]
    unit = metrics.tvi_error(r + np.sqrt(of_luminance)[..., None], r)
    assert metrics.tvi_error(x, r, reference_variance=of_luminance) == pytest.approx(metrics.tvi_error(x, r) - unit)


def test_subtraction_recovers_the_error_against_the_truth() -> None:
    """False alarms 1e-6 (z of 4.9); without the subtraction, the negative control, the test must fail."""
    rng = np.random.default_rng(5)
    shape = (200, 200, 3)
    truth = rng.uniform(0.2, 2.0, shape)
    sigma = 0.05 * truth
    reference = truth + sigma * rng.standard_normal(shape)
    test = truth + 0.1 * rng.standard_normal(shape)
    expected = 0.01
    terms = (test - reference) ** 2 - sigma**2
    error = terms.std() / math.sqrt(terms.size)

    def z(variance: np.ndarray | None) -> float:
        return abs(metrics.mse(test, reference, reference_variance=variance) - expected) / error

    assert z(sigma**2) < 4.9
    assert z(None) > 4.9


def test_compare_names_each_constant(pair: tuple[np.ndarray, np.ndarray]) -> None:
    measures = {measure.name: measure for measure in compare.compare(*pair, white_luminance=50.0)}
    assert measures["tvi error"].constants == {"white_luminance_cd_m2": 50.0}
    assert measures["relMSE"].constants == {"epsilon": 0.01}
    assert measures["relMSE, trimmed"].constants["trim"] == 0.001
    assert {"start_exposure", "stop_exposure", "pixels_per_degree"} <= set(measures["HDR-FLIP"].constants)


def test_compare_leaves_out_what_does_not_exist() -> None:
    names = [measure.name for measure in compare.compare(np.ones((8, 8, 3)), np.zeros((8, 8, 3)))]
    assert "SSIM" not in names
    assert "bias" not in names
    assert "MSE" in names


@pytest.mark.parametrize(
    ("test", "reference", "words"),
    [
        (np.zeros((4, 5, 3)), np.zeros((5, 4, 3)), "5x4.*4x5"),
        (np.zeros((4, 5)), np.zeros((4, 5)), r"\(4, 5\)"),
        (np.zeros((4, 5, 4)), np.zeros((4, 5, 3)), "test image must be"),
        (np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), r"\(0, 5, 3\)"),
        (np.full((4, 5, 3), np.nan), np.zeros((4, 5, 3)), "test image holds 60 values"),
        (np.zeros((4, 5, 3)), np.full((4, 5, 3), np.inf), "reference image holds 60 values"),
    ],
)
@pytest.mark.parametrize(
    "metric",
    [
        metrics.tvi_error,
        metrics.threshold_ratio,
        metrics.visible_pixels,
        metrics.mse,
        metrics.psnr,
        metrics.ssim,
        metrics.relmse,
        metrics.smape,
        metrics.flip,
        metrics.ldr_flip,
        metrics.pu21_psnr,
        metrics.pu21_ssim,
        metrics.delta_e,
        metrics.yee,
        metrics.bias,
    ],
)
def test_bad_images_are_refused(metric: object, test: np.ndarray, reference: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        metric(test, reference)  # type: ignore[operator]


def test_bad_constants_are_refused(pair: tuple[np.ndarray, np.ndarray]) -> None:
    x, r = pair
    with pytest.raises(ValueError, match="trim"):
        metrics.relmse(x, r, trim=1.0)
    with pytest.raises(ValueError, match="white_luminance"):
        metrics.tvi_error(x, r, white_luminance=0.0)
    with pytest.raises(ValueError, match="epsilon"):
        metrics.smape(x, r, epsilon=0.0)
    with pytest.raises(ValueError, match="pixels_per_degree"):
        metrics.yee(x, r, pixels_per_degree=-1.0)
    with pytest.raises(ValueError, match="start <= stop"):
        metrics.flip(x, r, exposures=(2.0, 1.0))
    with pytest.raises(ValueError, match="black reference"):
        metrics.flip(x, 0 * r)
    with pytest.raises(ValueError, match="11x11"):
        metrics.ssim(x[:10], r[:10])
    with pytest.raises(ValueError, match="shape"):
        metrics.mse(x, r, reference_variance=np.zeros(SHAPE[:2]))
    with pytest.raises(ValueError, match="not negative"):
        metrics.mse(x, r, reference_variance=-np.ones(SHAPE))


def test_display_keeps_what_fits_and_bends_what_does_not() -> None:
    ramp = np.linspace(0, SHOULDER, 50)[:, None] * np.array([1.0, 0.4, 0.2])
    np.testing.assert_allclose(tone_map(ramp), ramp, rtol=1e-6)
    bright = np.geomspace(0.01, 1e6, 400)[:, None] * np.ones(3)
    mapped = tone_map(bright)
    assert (np.diff(mapped[:, 0]) >= 0).all()
    assert mapped.max() <= 1.0
    np.testing.assert_array_equal(tone_map(-bright), 0)
    np.testing.assert_allclose(tone_map(bright, exposure=0.25), tone_map(0.25 * bright), rtol=1e-6)
    # The slope is that of the identity where the shoulder begins.
    step = 1e-4
    at = tone_map(np.array([[SHOULDER] * 3, [SHOULDER + step] * 3]))
    assert float(at[1, 0] - at[0, 0]) == pytest.approx(step, rel=1e-2)


def test_srgb_curve_is_the_standard_one() -> None:
    # IEC 61966-2-1: middle grey 0.2140 encodes to 0.5; the two branches meet at 0.0031308.
    assert float(srgb_encode(0.214041)) == pytest.approx(0.5, abs=1e-5)
    assert float(srgb_encode(0.0031308)) == pytest.approx(0.0404499, abs=1e-5)
    values = np.linspace(0, 1, 256)
    np.testing.assert_allclose(srgb_encode(srgb_decode(values)), values, atol=2e-6)


def test_luminance_of_metrics_is_rec_709() -> None:
    assert float(luminance(np.array([1.0, 0.0, 0.0]))) == pytest.approx(0.2126, abs=1e-6)
    assert float(luminance(np.array([0.0, 1.0, 0.0]))) == pytest.approx(0.7152, abs=1e-6)
    assert float(luminance(np.array([0.0, 0.0, 1.0]))) == pytest.approx(0.0722, abs=1e-6)
