"""Luminance and tvi against published values. Exact but for rounding."""

from __future__ import annotations

import numpy as np
import pytest

from pmc_sampler import _core, luminance, tvi


def test_luminance_is_rec_709() -> None:
    assert luminance([1.0, 0.0, 0.0]) == 0.2126
    assert luminance([0.0, 1.0, 0.0]) == 0.7152
    assert luminance([0.0, 0.0, 1.0]) == 0.0722
    assert luminance([2.0, 2.0, 2.0]) == pytest.approx(2.0, rel=1e-15)


def test_luminance_keeps_shape_and_type() -> None:
    image = np.random.default_rng(0).random((4, 5, 3), np.float32)
    assert luminance(image).shape == (4, 5)
    assert luminance(image).dtype == np.float32
    assert luminance(np.ones((7, 3), int)).dtype == np.float64
    assert luminance(np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize("shape", [(), (4,), (3, 4), (3, 0)])
def test_luminance_refuses_other_channels(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"got an array of shape .* expected \(\.\.\., 3\)"):
        luminance(np.zeros(shape))


@pytest.mark.parametrize(
    ("cd_m2", "threshold"), [(0.01, 0.00547), (0.1, 0.0403), (1.0, 0.391), (10.0, 1.072), (100.0, 5.559)]
)
def test_tvi_at_published_values(cd_m2: float, threshold: float) -> None:
    """To the digits given."""
    assert tvi(cd_m2) == pytest.approx(threshold, abs=0.5 * 10 ** (np.floor(np.log10(threshold)) - 2))


def test_tvi_piece_by_piece() -> None:
    """Ferwerda et al. 1996 as joined by Ward Larson et al. 1997, written anew."""
    a = np.linspace(-6, 6, 5001)
    with np.errstate(invalid="ignore"):
        pieces = [
            np.full_like(a, -2.86),
            (0.405 * a + 1.6) ** 2.18 - 2.86,
            a - 0.395,
            (0.249 * a + 0.65) ** 2.7 - 0.72,
            a - 1.255,
        ]
    expected = 10 ** np.choose(np.digitize(a, [-3.94, -1.44, -0.0184, 1.9]), pieces)
    np.testing.assert_allclose(tvi(10.0**a), expected, rtol=1e-12)


def test_tvi_rises_but_for_its_two_jumps() -> None:
    """By -2.7 % where the rods' pieces meet and by -0.7 % where the cones' do."""
    a = np.linspace(-5, 5, 100_001)
    ratio = np.diff(np.log10(tvi(10.0**a)))
    falls = np.flatnonzero(ratio < -1e-12)
    assert np.allclose(a[falls + 1], [-1.44, 1.9], atol=1e-3)
    assert np.allclose(10 ** ratio[falls] - 1, [-0.027, -0.007], atol=6e-4)


def test_tvi_of_the_unusual() -> None:
    darkness = 10**-2.86
    values = tvi(np.array([0.0, -0.0, -5.0, -np.inf, 5e-324, np.inf, np.nan]))
    np.testing.assert_allclose(values[:5], darkness)
    assert values[5] == np.inf
    assert np.isnan(values[6])


def test_tvi_keeps_its_shape() -> None:
    assert tvi(np.ones((2, 3, 4), np.float32)).shape == (2, 3, 4)
    assert tvi(np.ones((2, 3, 4), np.float32)).dtype == np.float64
    assert tvi(np.ones((4, 6))[::2, ::3]).shape == (2, 2)
    assert tvi([]).shape == (0,)
    assert tvi(1).shape == ()


def test_table_is_close_to_tvi() -> None:
    """What steers the sampler, 1 / tvi^2 from a table: within 0.3 % of it but next to the two jumps, within 6 % there,
    and bounded for every float.
    """
    a = np.linspace(-8, 8, 4001)
    table = np.array([_core.inverse_square_tvi(float(value)) for value in (10.0**a)])
    smooth = (abs(a + 1.44) > 0.02) & (abs(a - 1.9) > 0.02)
    np.testing.assert_allclose(table[smooth], tvi(10.0 ** a[smooth]) ** -2, rtol=3e-3)
    np.testing.assert_allclose(table, tvi(10.0**a) ** -2, rtol=0.06)
    darkest = _core.inverse_square_tvi(0.0)
    assert _core.inverse_square_tvi(-1.0) == _core.inverse_square_tvi(1e-40) == darkest
    assert darkest == pytest.approx(10**5.72, rel=1e-3)
    for huge in (1e19, 1e30, 3e38, np.inf):
        assert 0 <= _core.inverse_square_tvi(huge) < 1e-35
