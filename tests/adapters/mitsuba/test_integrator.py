"""The plugin `pmc` in scene files, with `mi.render`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("mitsuba")

ALPHA = 1e-4


@pytest.fixture
def scene_with(mi: Any) -> Any:
    """A function from the XML of an integrator and of a film's parts to a loaded scene, 32x32, 8 samples a
    pixel."""

    def load(integrator: str, film: str = '<rfilter type="box"/>') -> Any:
        from pmc_sampler import scenes

        text = scenes.path("thin-lens").read_text(encoding="utf-8")
        start, end = text.index("<integrator"), text.index("</integrator>") + len("</integrator>")
        text = text[:start] + integrator + text[end:]
        text = text.replace('<rfilter type="box"/>', film).replace('<default name="max_depth" value="12"/>', "")
        return mi.load_string(text, width="32", height="32", spp="8")

    return load


NESTED = '<integrator type="path"><integer name="max_depth" value="12"/></integrator>'


def pmc(settings: str = "", nested: str = NESTED) -> str:
    return f'<integrator type="pmc">{settings}{nested}</integrator>'


def test_image_seed_and_spp(mi: Any, scene_with: Any) -> None:
    """Exact: the image is the sampler's, a function of seed and spp, and lies on the film."""
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    from pmc_sampler import Budget, Config, render

    scene = scene_with(pmc())
    image = np.array(mi.render(scene, seed=3))
    radiance = MitsubaRenderer(scene)
    assert radiance.integrator.class_name() == "PathIntegrator"
    expected = render(radiance, 32, 32, Budget(spp=8), Config(), seed=3).film.mean
    assert np.array_equal(image, expected)
    assert np.array_equal(np.array(mi.TensorXf(scene.sensors()[0].film().bitmap())), image)
    more = render(radiance, 32, 32, Budget(spp=16), Config(), seed=4).film.mean
    assert np.array_equal(np.array(mi.render(scene, seed=4, spp=16)), more)
    assert not np.array_equal(image, np.array(mi.render(scene, seed=4)))


def test_settings(mi: Any, scene_with: Any) -> None:
    """Exact: properties are fields of Config, and the sampler of random numbers."""
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    from pmc_sampler import Budget, Config, render

    settings = (
        '<string name="preset" value="uniform"/><string name="sampler" value="independent"/>'
        '<string name="radii" value="2, 7.5"/><float name="white_luminance" value="50"/>'
        '<integer name="batch" value="3000"/>'
    )
    scene = scene_with(pmc(settings))
    config = Config.uniform(radii=(2, 7.5), white_luminance=50, batch=3000)
    radiance = MitsubaRenderer(scene, sampler="independent")
    expected = render(radiance, 32, 32, Budget(spp=8), config, seed=0).film.mean
    assert np.array_equal(np.array(mi.render(scene)), expected)


def test_crop_and_alpha(mi: Any, small_scene: Any) -> None:
    """A cropped film gets the crop; alpha is 1. Integrators come from dictionaries, too."""
    film = {
        "crop_width": 16,
        "crop_height": 8,
        "crop_offset_x": 10,
        "crop_offset_y": 20,
        "pixel_format": "rgba",
    }
    scene = mi.load_dict(small_scene(film=film, integrator={"type": "pmc", "nested": {"type": "direct"}}))
    image = np.array(mi.render(scene, spp=4))
    assert image.shape == (8, 16, 4)
    assert (image[..., 3] == 1).all()


def test_channels_of_the_nested_integrator(mi: Any, scene_with: Any) -> None:
    scene = scene_with(pmc(nested='<integrator type="aov"><string name="aovs" value="d:depth"/></integrator>'))
    image = np.array(mi.render(scene, spp=4))
    assert image.shape == (32, 32, 4)
    assert [field.name for field in scene.sensors()[0].film().bitmap().struct_()] == ["R", "G", "B", "d.T"]
    distance = np.array(mi.render(scene, integrator=scene.integrator().pmc_nested, spp=64)).squeeze()
    seen = distance > 0
    assert abs(image[..., 3][seen].mean() / distance[seen].mean() - 1) < 0.05


def test_reconstruction_filter(mi: Any, scene_with: Any, p_value_of: Any) -> None:
    """A Gaussian against `mi.render` with the same; 16 seeds, tiles of 4x4 off the border, false alarms 1 in
    10000.

    At the border they differ by design: Mitsuba's film has no samples from beyond it. The control is the box.
    """
    uniform = '<string name="preset" value="uniform"/>'
    film = '<rfilter type="gaussian"/>'
    ours, theirs, control = scene_with(pmc(uniform), film), scene_with(NESTED, film), scene_with(NESTED)

    def images(scene: Any, seed: int) -> Any:
        return np.array([np.array(mi.render(scene, spp=32, seed=seed + k))[4:28, 4:28] for k in range(16)])

    rendered = images(ours, 0)
    assert p_value_of(rendered, images(theirs, 100), 4) > ALPHA
    assert p_value_of(rendered, images(control, 200), 4) < ALPHA


@pytest.mark.parametrize(
    ("integrator", "message"),
    [
        (pmc('<float name="pool_sharre" value="0.1"/>'), "unknown setting 'pool_sharre'"),
        (pmc('<float name="pool_share" value="1.5"/>'), "pool_share is 1.5"),
        (
            pmc('<string name="sampler" value="halton"/>'),
            "sampler is 'halton': expected one of sobol, independent",
        ),
        (
            pmc('<string name="radii" value="a,b"/>'),
            r"ValueError: radii is 'a,b': expected 1 to 3 radii in pixels, as in \"1, 3\"\s*$",
        ),
        (pmc('<string name="radii" value=""/>'), "radii holds no values: expected 1 to 3 radii in pixels"),
        (pmc('<float name="seconds" value="-1"/>'), "seconds"),
        (pmc(nested='<integrator type="ptracer"/>'), "does not return radiance for a ray"),
        (
            pmc(nested='<integrator type="path"/><integrator type="direct"/>'),
            "steers one integrator, and here are 2",
        ),
    ],
)
def test_bad_settings_are_refused_on_loading(scene_with: Any, integrator: str, message: str) -> None:
    with pytest.raises(RuntimeError, match=message):
        scene_with(integrator)


def test_filters_with_negative_lobes_are_refused(scene_with: Any) -> None:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    r = MitsubaRenderer(scene_with(pmc(), '<rfilter type="mitchell"/>'))
    with pytest.raises(
        ValueError, match=r"MitchellNetravaliFilter, which has negative lobes.*use box, tent or gaussian"
    ):
        _ = r.filter
    assert MitsubaRenderer(scene_with(pmc(), '<rfilter type="gaussian"/>')).filter == {
        "filter": "gaussian",
        "filter_radius": 2.0,
    }


def test_other_variants_know_the_plugin(mi: Any, scene_with: Any) -> None:
    with mi.util.variant_context("llvm_ad_spectral"):
        assert np.array(mi.render(scene_with(pmc()), spp=4)).shape == (32, 32, 3)
    with (
        mi.util.variant_context("scalar_rgb"),
        pytest.raises(RuntimeError, match="cannot be used in the variant 'scalar_rgb'"),
    ):
        scene_with(pmc())
