"""Images through the adapter against `mi.render`: one mean, by a t-test on the image and its 16x16 tiles over
16 seeds.

Each test raises a false alarm in about 1 of 10000 cases, were its seeds not fixed; the controls must be told
from the truth by the same test.
"""

from __future__ import annotations

from typing import Any

import pytest

pytestmark = pytest.mark.needs("mitsuba")

ALPHA = 1e-4


def renderer(*arguments: Any, **options: Any) -> Any:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    return MitsubaRenderer(*arguments, **options)


@pytest.mark.parametrize("kind", ["sobol", "independent"])
def test_cornell_box(agreement: Any, kind: str) -> None:
    assert agreement(renderer("cornell-box", size=(48, 32), sampler=kind), spp=64) > ALPHA


def test_cornell_box_with_mirrors(agreement: Any) -> None:
    assert agreement(renderer("cornell-box-mirrors", size=(48, 32)), spp=64) > ALPHA


def test_other_glass_is_seen(mi: Any, agreement: Any, small_scene: Any) -> None:
    """Control: a ball of another refractive index."""
    other = small_scene()
    other["ball"]["bsdf"]["int_ior"] = 1.2
    assert agreement(renderer(small_scene()), spp=64) > ALPHA
    assert agreement(renderer(small_scene()), scene=mi.load_dict(other), spp=64) < ALPHA


def test_thin_lens(mi: Any, agreement: Any) -> None:
    """Control: the lens stopped down. Tiles of 4x4: blur leaves the mean of larger ones as it is."""
    r = renderer("thin-lens", size=(48, 32))
    assert agreement(r, tile=4) > ALPHA
    stopped = renderer("thin-lens", size=(48, 32))
    parameters = mi.traverse(stopped.sensor)
    parameters["aperture_radius"] = 0.01
    parameters.update()
    assert agreement(r, sensor=stopped.sensor, tile=4) < ALPHA


def test_shutter(agreement: Any, small_scene: Any) -> None:
    assert agreement(renderer(small_scene(sensor={"shutter_open": 1.0, "shutter_close": 2.0}))) > ALPHA


def test_orthographic_camera_and_environment(mi: Any, agreement: Any, small_scene: Any) -> None:
    view = mi.ScalarTransform4f().look_at([1, 1, 3], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
    sensor = {"type": "orthographic", "to_world": view, "film": film}
    scene = small_scene(sky={"type": "constant", "radiance": 0.5})
    scene["sensor"] = sensor
    assert agreement(renderer(scene)) > ALPHA


def test_crop(agreement: Any, small_scene: Any) -> None:
    crop = {
        "width": 64,
        "height": 48,
        "crop_width": 32,
        "crop_height": 16,
        "crop_offset_x": 20,
        "crop_offset_y": 30,
    }
    assert agreement(renderer(small_scene(film=crop))) > ALPHA


def test_cameras_side_by_side(mi: Any, agreement: Any, small_scene: Any) -> None:
    """Two on one film. Control: the second of them elsewhere."""

    def scene(x: float) -> dict[str, Any]:
        one, two = ({k: v for k, v in small_scene()["sensor"].items() if k not in ("film", "sampler")} for _ in "12")
        two["to_world"] = mi.ScalarTransform4f().look_at([x, 0.3, 3.5], [0, 0, 0], [0, 1, 0])
        film = {"type": "hdrfilm", "width": 32, "height": 16, "rfilter": {"type": "box"}}
        return {**small_scene(), "sensor": {"type": "batch", "one": one, "two": two, "film": film}}

    r = renderer(scene(0.5))
    assert agreement(r, tile=8) > ALPHA
    assert agreement(r, sensor=mi.load_dict(scene(2.0)).sensors()[0], tile=8) < ALPHA


@pytest.mark.parametrize("kind", ["radiancemeter", "irradiancemeter"])
def test_meters(mi: Any, agreement: Any, small_scene: Any, kind: str) -> None:
    """On the floor of the box, or looking at it, lit by the lamp alone. Control: a lamp brighter by half."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    scene = small_scene(sensor=None, integrator={"type": "direct"})
    if kind == "radiancemeter":
        scene["sensor"] = {"type": kind, "origin": [0, 0, 0.5], "direction": [-0.5, -1, 0], "film": film}
    else:
        del scene["sensor"]
        place = mi.ScalarTransform4f().translate([-0.5, -0.9, 0.3]).rotate([1, 0, 0], -90).scale(0.2)
        scene["plate"] = {"type": "rectangle", "to_world": place, "meter": {"type": kind, "film": film}}
    r = renderer(scene)
    assert (r.width, r.height) == (1, 1)
    assert agreement(r, spp=4096, tile=1) > ALPHA
    brighter = mi.load_dict(scene)
    parameters = mi.traverse(brighter)
    key = next(key for key in parameters.keys() if key.endswith("emitter.radiance.value"))  # noqa: SIM118
    parameters[key] = parameters[key] * 1.5
    parameters.update()
    assert agreement(r, scene=brighter, sensor=brighter.sensors()[0], spp=4096, tile=1) < ALPHA


@pytest.mark.parametrize(
    "integrator", ["direct", "direct_projective", "prb", "prb_basic", "prb_projective", "depth", "moment"]
)
def test_integrators(agreement: Any, small_scene: Any, integrator: str) -> None:
    """Of `moment` the second moments, too, which are channels of their own."""
    nested = {"nested": {"type": "path", "max_depth": 6}} if integrator == "moment" else {}
    r = renderer(small_scene(), integrator={"type": integrator, **nested}, size=(16, 16))
    assert r.aovs == (6 if nested else 0)
    assert agreement(r, tile=8) > ALPHA


@pytest.fixture
def fog(small_scene: Any) -> Any:
    """A function that gives the scene with a ball of fog of some density, without a surface, 16x16."""

    def make(density: float) -> dict[str, Any]:
        medium = {"type": "homogeneous", "albedo": 0.7, "sigma_t": density}
        ball = {**small_scene()["ball"], "bsdf": {"type": "null"}, "interior": medium}
        return small_scene(
            ball=ball, film={"width": 16, "height": 16}, integrator={"type": "prbvolpath", "max_depth": 6}
        )

    return make


@pytest.mark.parametrize("integrator", ["volpath", "volpathmis", "prbvolpath"])
def test_integrators_of_media(agreement: Any, fog: Any, integrator: str) -> None:
    assert agreement(renderer(fog(3.0), integrator={"type": integrator, "max_depth": 6}), tile=8) > ALPHA


def test_thinner_fog_is_seen(mi: Any, agreement: Any, fog: Any) -> None:
    """Control of the test before."""
    assert agreement(renderer(fog(3.0)), scene=mi.load_dict(fog(1.0)), tile=8) < ALPHA


def test_camera_in_a_medium(agreement: Any, small_scene: Any) -> None:
    medium = {"type": "homogeneous", "albedo": 0.7, "sigma_t": 0.2}
    scene = small_scene(sensor={"medium": medium}, integrator={"type": "volpath", "max_depth": 6})
    assert agreement(renderer(scene), spp=16) > ALPHA


@pytest.mark.parametrize(
    "variant", ["llvm_ad_spectral", "llvm_ad_mono", "cuda_ad_rgb", "cuda_ad_spectral", "cuda_ad_mono"]
)
def test_variants(
    mi: Any, agreement: Any, small_scene: Any, variant: str, monkeypatch: pytest.MonkeyPatch, lacking: Any
) -> None:
    """The control drops the weight that makes up for the sensor's choice of wavelengths (monochrome has
    none). CUDA variants take part where there is a device; nobody can be asked to install one."""
    from pmc_sampler.adapters.mitsuba import variants

    if variant not in mi.variants():
        lacking(f"needs a Mitsuba that was built with {variant}: pip install '.[all]'")
    if variant.startswith("cuda") and (trouble := variants.backend_trouble(variant)):
        pytest.skip(trouble)
    pixel_format = "luminance" if variant.endswith("mono") else "rgb"
    r = renderer(small_scene(film={"pixel_format": pixel_format}), variant=variant)
    assert agreement(r, spp=16) > ALPHA
    if variant.endswith("spectral"):
        camera = type(r._evaluate._camera)
        true = camera.__call__
        monkeypatch.setattr(camera, "__call__", lambda *arguments: (true(*arguments)[0], 1.0))
        assert agreement(renderer(small_scene(), variant=variant), spp=16) < ALPHA


def test_no_spectral_sample_is_lost() -> None:
    """One wavelength's colour may lie outside the gamut of RGB: below zero, and right in the mean."""
    from pmc_sampler import Budget, Config, render

    radiance = renderer("cornell-box", variant="llvm_ad_spectral", size=(32, 24))
    assert radiance.signed
    assert render(radiance, 32, 24, Budget(spp=32), Config.uniform()).rejected == 0
    assert not renderer("cornell-box", size=(32, 24)).signed
