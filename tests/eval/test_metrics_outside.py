"""Metrics against values that other programs gave for the same two images, written down with their commands.

`t.exr` and `r.exr` are `images.write_exr` of the two fixtures' values, `t.png` and `r.png` `images.write_png` of
them: no value is above the tone curve's shoulder, so that the PNGs hold the plain sRGB encoding. Exact to the digits
that each program prints, or to 8 bits where it read the PNGs.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pmc_sampler.eval import images, metrics

from pmc_sampler import tvi

pytestmark = pytest.mark.needs("skimage", "flip_evaluator", "OpenImageIO", "colour")


@pytest.fixture
def reference() -> np.ndarray:
    y, x = np.mgrid[:48, :64]
    red = 0.35 + 0.3 * np.sin(x / 9.0) * np.cos(y / 7.0)
    green = 0.3 + 0.25 * np.cos(x / 11.0 + y / 13.0)
    return np.stack([red, green, 0.4 + 0.3 * np.sin(y / 5.0)], axis=2).astype(np.float32)


@pytest.fixture
def test_image(reference: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[:48, :64]
    pattern = (7 * x + 13 * y) % 11 / 10.0 - 0.5
    return (reference * (1 + 0.3 * pattern[..., None] * np.array([1.0, 0.8, 0.5]))).astype(np.float32)


@pytest.fixture
def encoded(test_image: np.ndarray, reference: np.ndarray, tmp_path: Path) -> list[np.ndarray]:
    """Both images as they come back from 8-bit PNGs, linear."""
    for name, image in (("t", test_image), ("r", reference)):
        images.write_png(tmp_path / f"{name}.png", image)
    return [images.read(tmp_path / f"{name}.png").rgb for name in "tr"]


def test_rmse_and_psnr_of_idiff(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`idiff r.exr t.exr` (OpenImageIO 3.2.2): RMS error = 0.0292933, Peak SNR = 30.6646."""
    assert metrics.rmse(test_image, reference) == pytest.approx(0.0292933, abs=5e-8)
    assert metrics.psnr(test_image, reference) == pytest.approx(30.6646, abs=5e-5)


def test_relmse_of_oiiotool(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`oiiotool t.exr r.exr --sub --dup --mul r.exr r.exr --mul --addc 0.01 --div --printstats` (3.2.2), its Avg."""
    found = metrics.relmse_map(test_image, reference).mean(axis=(0, 1))
    np.testing.assert_allclose(found, [0.007779, 0.004384, 0.002016], atol=6e-7)
    assert metrics.relmse(test_image, reference) == pytest.approx(found.mean())


def test_smape_of_oiiotool(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`oiiotool t.exr r.exr --absdiff --mulc 2 t.exr --abs r.exr --abs --add --addc 0.02 --div --printstats`, 3.2.2."""
    found = metrics.smape_map(test_image, reference).mean(axis=(0, 1))
    np.testing.assert_allclose(found, [0.079069, 0.062011, 0.039727], atol=6e-7)
    assert metrics.smape(test_image, reference) == pytest.approx(found.mean())


def test_yee_of_idiff(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`idiff -p r.exr t.exr` (OpenImageIO 3.2.2), which assumes a field of view of 45 degrees: 70 pixels failed."""
    across_45_degrees = 64 / (2 * math.degrees(math.tan(math.radians(22.5))))
    assert metrics.yee(test_image, reference, pixels_per_degree=across_45_degrees) == 70 / (48 * 64)


def test_hdr_flip_of_its_program(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`flip -r r.exr -t t.exr` (1.7): start exposure 1.9618, stop exposure 2.6825, mean 0.018342, maximum 0.082437."""
    assert metrics.flip_exposures(reference) == pytest.approx((1.9618, 2.6825), abs=6e-5)
    assert metrics.flip(test_image, reference) == pytest.approx(0.018342, abs=6e-7)
    assert metrics.flip_map(test_image, reference).max() == pytest.approx(0.082437, abs=6e-7)


def test_ldr_flip_of_its_program(encoded: list[np.ndarray]) -> None:
    """`flip -r r.png -t t.png` (1.7): mean 0.024580, maximum 0.177899."""
    assert metrics.ldr_flip(*encoded) == pytest.approx(0.024580, abs=2e-6)
    assert metrics.ldr_flip_map(*encoded).max() == pytest.approx(0.177899, abs=2e-5)


def test_delta_e_of_vips(encoded: list[np.ndarray]) -> None:
    """`vips dE00 t.png r.png e.v && vips avg e.v` (libvips 8.14.1): 1.578307, with tables for the sRGB curve."""
    assert metrics.delta_e(*encoded) == pytest.approx(1.578307, rel=1e-4)


def test_pu21_of_its_authors(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`encode` of pu21_encoder.m (github.com/gfxdisp/pu21, commit 6667295) in GNU Octave 7.3, with a `clamp` for it.

    `pu = pu21_encoder(); pu.encode([0.005 0.1 1 10 100 1000 10000])`, and for luminances t and r in cd/m2 of both
    images `d = pu.encode(t) - pu.encode(r); 10*log10(256^2/mean(d(:).^2))`.
    """
    given = [0.005, 0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0]
    np.testing.assert_allclose(
        metrics.pu21_encode(given),
        [0.0, 5.717074, 36.543911, 123.647484, 256.383897, 420.096921, 595.393920],
        atol=1e-6,
    )
    assert metrics.pu21_psnr(test_image, reference) == pytest.approx(35.220493, abs=1e-5)
    # Outside of what the fit covers, values are clamped.
    np.testing.assert_array_equal(metrics.pu21_encode([-1.0, 0.0, 1e6]), metrics.pu21_encode([0.005, 0.005, 1e4]))


@pytest.mark.parametrize(
    ("rgb", "other", "expected"),
    [([1.0, 1.0, 1.0], [0.0, 0.0, 0.0], 100.0), ([0.5, 0.5, 0.5], [0.5, 0.5, 0.5], 0.0)],
)
def test_delta_e_of_white_and_black(rgb: list[float], other: list[float], expected: float) -> None:
    """The tone curve bends a radiance of 1; the display's own white is reached from far above."""
    bright = 1e9 * np.array(rgb) if expected else np.array(rgb)
    found = metrics.delta_e(np.broadcast_to(bright, (4, 5, 3)), np.broadcast_to(other, (4, 5, 3)))
    assert found == pytest.approx(expected, abs=0.02)


def test_ssim_of_its_author(encoded: list[np.ndarray]) -> None:
    """`ssim_index(t, r, [0.01 0.03], fspecial('gaussian', 11, 1.5), 255)` for the three channels of t.png and r.png.

    ssim_index.m of Z. Wang, version 1.0 (as in github.com/gpeyre/matlab-toolboxes, commit 0cd622c), in GNU Octave 7.3
    with its package image 2.14: mean 0.8561810.
    """
    assert metrics.ssim(*encoded) == pytest.approx(0.8561810, abs=6e-8)


def test_pu21_ssim_of_their_authors(test_image: np.ndarray, reference: np.ndarray) -> None:
    """`ssim_index(pu.encode(t), pu.encode(r), [0.01 0.03], fspecial('gaussian', 11, 1.5), 256)`: 0.8486658.

    For luminances t and r in cd/m2, white being 100, by the two programs named above.
    """
    assert metrics.pu21_ssim(test_image, reference, white_luminance=100.0) == pytest.approx(0.8486658, abs=6e-8)
    assert metrics.pu21_ssim(test_image, reference, white_luminance=50.0) != pytest.approx(0.8486658, abs=1e-4)


def test_thresholds_of_pcond() -> None:
    """`pcond -l -s -x map.txt L.hdr` (Radiance, of pyradiance 1.3.1) of images of one luminance L in cd/m2.

    By -l and -s it scales an image by the threshold at the display's luminance over that at the image's (Ward Larson
    et al. 1997), and writes both luminances to map.txt, with seven digits: their ratio is the inverse of the threshold,
    but for a factor common to all. Below 0.0137 cd/m2 pcond gives no number.
    """
    world = [0.01369929, 0.02739859, 0.05479717, 0.2191887, 0.8767548, 1.75351, 7.014038, 28.05615, 112.2246, 897.7969]
    scale = [281.6151, 163.2916, 86.94611, 21.73653, 5.434132, 4.029588, 2.168508, 0.9424158, 0.3075533, 0.03844415]
    products = tvi(np.array(world)) * scale
    np.testing.assert_allclose(products, products[0], rtol=1e-6)
    for level in world:  # the metric takes them as they are
        grey = np.full((4, 4, 3), level / 100.0)
        error = metrics.tvi_error(grey * 1.01, grey, white_luminance=100.0)
        assert error == pytest.approx((0.01 * level / float(tvi(level))) ** 2, rel=1e-5)
