"""The renderer as a callable: shapes, crop, size, and that a sample's value is a function of the sample
alone."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("mitsuba")


@pytest.fixture
def probe(mi: Any) -> Any:
    """A function that makes an integrator whose red, green and blue are what `look(sampler, ray)` returns."""

    class Probe(mi.SamplingIntegrator):
        def __init__(self, look: Any) -> None:
            super().__init__(mi.Properties())
            self.look = look

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            return mi.Color3f(*self.look(sampler, ray)), mi.Bool(True), []

    return Probe


def renderer(*arguments: Any, **options: Any) -> Any:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    return MitsubaRenderer(*arguments, **options)


def sobol(batch: Any, pair: int) -> Any:
    """The numbers of a pair of dimensions that belong to a batch, shape (n, 2)."""
    from pmc_sampler.adapters.mitsuba import samplers

    bits = np.arange(32, dtype=np.uint32)

    def reverse(x: Any) -> Any:
        return (((x[..., None] >> bits) & 1) << (31 - bits)).sum(axis=-1, dtype=np.uint32)

    xy = samplers.sobol_pair(reverse, batch.scramble, batch.index, np.full_like(batch.index, pair))
    return np.stack([word >> 8 for word in xy], axis=1) * 2.0**-24


def test_what_comes_back(mi: Any, small_scene: Any, batch_of: Any) -> None:
    r = renderer(small_scene())
    assert (r.width, r.height, r.aovs, r.takes_batch) == (32, 32, 0, True)
    radiance = r(batch_of(32, 32, 2, 1))
    assert radiance.shape == (2048, 3)
    assert radiance.dtype == np.float32
    assert np.isfinite(radiance).all()
    assert (radiance >= 0).all()
    kept = radiance.copy()
    r(batch_of(32, 32, 2, 2))
    assert np.array_equal(radiance, kept)
    radiance *= 2  # the caller's to change
    empty = batch_of(32, 32, 1, 1)[:0]
    assert r(empty).shape == (0, 3)


@pytest.mark.parametrize("kind", ["sobol", "independent"])
def test_a_value_depends_on_its_sample_alone(small_scene: Any, batch_of: Any, kind: str) -> None:
    """Exact, to the bit: shuffled, cut into batches of many lengths (one of length one), and by another
    renderer."""
    r = renderer(small_scene(), sampler=kind)
    batch = batch_of(32, 32, 3, 2)
    whole = r(batch)
    order = np.random.default_rng(3).permutation(len(batch))
    assert np.array_equal(r(batch[order]), whole[order])
    cuts = np.cumsum([1, 2, 5, 16, 63, 500, 1001])
    assert np.array_equal(np.concatenate([r(batch[part]) for part in np.split(np.arange(len(batch)), cuts)]), whole)
    assert np.array_equal(renderer(small_scene(), sampler=kind)(batch), whole)


def test_one_recording_serves_all_batches(small_scene: Any, batch_of: Any) -> None:
    """Exact: neither length nor alignment of a batch's arrays makes Dr.Jit record again; length one has its
    own shape. The lengths are primes, and 16 times one, lest one be that of one of Dr.Jit's own tables, as 32 * 32 * 3
    is after some scenes: it would be recorded anew."""
    r = renderer(small_scene())
    batch = batch_of(32, 32, 3, 2)
    r(batch[:3067])
    recordings = r._evaluate.recordings
    for start, length in ((0, 16 * 181), (1, 2999), (3, 71), (2, 1499), (7, 1031)):
        r(batch[start : start + length])
    assert r._evaluate.recordings == recordings


def test_recorded_and_traced_are_the_same(small_scene: Any, batch_of: Any) -> None:
    """Exact, to the bit, also for a camera whose rays are not recorded."""
    from pmc_sampler.adapters.mitsuba.rays import Evaluator

    for sensor, frozen in (
        ({}, "all"),
        ({"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.5}, "paths"),
    ):
        r = renderer(small_scene(sensor=sensor))
        batch = batch_of(32, 32, 2, 4)
        assert r._evaluate.frozen == frozen
        recorded = r(batch)
        r._evaluate = Evaluator(r.variant, r.sampler, r.scene, r.sensor, r.integrator, frozen="nothing")
        assert np.array_equal(r(batch), recorded)


def shared(first: Any, second: Any) -> float:
    """Share of the samples that drew the same number in two batches."""
    return float((first[:, 0] == second[:, 0]).mean())


@pytest.mark.parametrize("kind", ["sobol", "independent"])
def test_two_batches_never_share_numbers(
    small_scene: Any, batch_of: Any, probe: Any, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Two samples agree by chance in 1 of 2^24 cases; more than 4 of 2048 are a false alarm in below 1 of
    1e15 cases.

    The control starts every recording from one seed, as a literal; the same check must see that.
    """
    first, second = batch_of(32, 32, 2, 5), batch_of(32, 32, 2, 6)
    later = batch_of(32, 32, 2, 5)
    later.index += 2
    draw = probe(lambda sampler, ray: (sampler.next_1d(), *sampler.next_2d()))
    r = renderer(small_scene(), integrator=draw, sampler=kind)
    values = r(first)
    for other in (second, later):
        assert shared(values, r(other)) <= 4 / 2048
    assert shared(values, r(first)) == 1

    from pmc_sampler.adapters.mitsuba.samplers import sampler_class

    cls = sampler_class(r.variant, kind)
    start = cls.start

    def frozen_seed(self: Any, scramble: Any, index: Any) -> None:
        start(self, type(scramble)(12345), index)

    monkeypatch.setattr(cls, "start", frozen_seed)
    control = renderer(small_scene(), integrator=draw, sampler=kind)
    assert shared(control(first), control(second)) > 0.5


@pytest.mark.parametrize(
    ("sensor", "pairs"),
    [
        ({}, 0),
        ({"shutter_open": 1.0, "shutter_close": 3.0}, 1),
        ({"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.5}, 1),
        ({"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.5, "shutter_close": 1.0}, 2),
    ],
    ids=["pinhole", "shutter", "lens", "lens and shutter"],
)
def test_only_what_the_sensor_needs_is_drawn(
    small_scene: Any, batch_of: Any, probe: Any, sensor: dict[str, Any], pairs: int
) -> None:
    """Exact: the integrator's first number is of the pair after those of lens and time, which start at pair
    1."""
    integrator = probe(lambda sampler, ray: (sampler.next_1d(), ray.time, 0))
    batch = batch_of(32, 32, 2, 7)
    values = renderer(small_scene(sensor=sensor), integrator=integrator)(batch)
    assert np.array_equal(values[:, 0], sobol(batch, pairs + 1)[:, 0].astype(np.float32))
    opens, closes = sensor.get("shutter_open", 0.0), sensor.get("shutter_close", 0.0)
    time = opens + (closes - opens) * sobol(batch, pairs)[:, 0]
    assert np.allclose(values[:, 1], time, atol=1e-6)


def test_pinhole_rays_are_mitsubas(mi: Any, small_scene: Any, batch_of: Any, probe: Any) -> None:
    """Exact but for rounding of the position: directions are those of the sensor's own rays."""
    batch = batch_of(32, 32, 2, 8)
    r = renderer(small_scene(), integrator=probe(lambda sampler, ray: ray.d))
    place = mi.Point2f(*(batch.positions.T / np.float32(32)))
    ray, weight = r.sensor.sample_ray(0, 0, place, mi.Point2f(0.5))
    assert np.array(weight).max() == 1
    assert np.allclose(r(batch), np.array(ray.d).T, atol=1e-6)


def test_crop(small_scene: Any, batch_of: Any, probe: Any) -> None:
    """Exact but for rounding: a crop's positions count from its corner, and see what the whole film sees
    there."""
    integrator = probe(lambda sampler, ray: ray.d)
    crop = {"crop_width": 12, "crop_height": 8, "crop_offset_x": 5, "crop_offset_y": 17}
    whole, cropped = (renderer(small_scene(film=film), integrator=integrator) for film in ({}, crop))
    assert (cropped.width, cropped.height) == (12, 8)
    batch = batch_of(12, 8, 4, 9)
    seen = cropped(batch)
    batch.positions += np.float32([5, 17])
    assert np.allclose(seen, whole(batch), atol=1e-5)


def test_size(mi: Any, small_scene: Any, batch_of: Any) -> None:
    """A scene loaded here takes the size; one of the caller's keeps its own and is not changed."""
    assert [(r.width, r.height) for r in (renderer("cornell-box"), renderer("cornell-box", size=(40, 30)))] == [
        (640, 480),
        (40, 30),
    ]
    r = renderer(small_scene(), size=(20, 10))
    assert np.array(mi.render(r.scene, spp=1)).shape[:2] == (10, 20)
    assert r(batch_of(20, 10, 1, 1)).shape == (200, 3)
    scene = mi.load_dict(small_scene())
    assert renderer(scene, size=(32, 32)).width == 32
    with pytest.raises(ValueError, match="32x32 pixels, not 20x10"):
        renderer(scene, size=(20, 10))
    assert tuple(scene.sensors()[0].film().size()) == (32, 32)
    with pytest.raises(ValueError, match="has a crop window"):
        renderer(small_scene(film={"crop_width": 8, "crop_height": 8}), size=(20, 10))


def test_changes_of_the_scene_are_seen(mi: Any, small_scene: Any, batch_of: Any) -> None:
    """Exact: parameters of the scene are read anew for each batch, recorded or not."""
    r = renderer(small_scene())
    batch = batch_of(32, 32, 2, 10)
    before = r(batch)
    parameters = mi.traverse(r.scene)
    key = next(key for key in parameters.keys() if key.endswith("emitter.radiance.value"))  # noqa: SIM118
    parameters[key] = parameters[key] * 2
    parameters.update()
    assert np.allclose(r(batch), 2 * before, rtol=1e-5)


def test_aovs(small_scene: Any, batch_of: Any) -> None:
    """Extra channels follow RGB, under the integrator's names."""
    integrator = {
        "type": "aov",
        "aovs": "depth:depth,normal:sh_normal",
        "image": {"type": "path", "max_depth": 3},
    }
    r = renderer(small_scene(), integrator=integrator)
    names = ["image.R", "image.G", "image.B", "image.A", "depth.T", "normal.X", "normal.Y", "normal.Z"]
    assert r.aov_names == names
    values = r(batch_of(32, 32, 2, 11))
    assert values.shape == (2048, 11)
    assert np.array_equal(values[:, 3:6], values[:, :3])
    back_wall = values[(values[:, 10] > 0.99)]
    assert np.allclose(np.linalg.norm(back_wall[:, 8:], axis=1), 1, atol=1e-4)
    assert back_wall[:, 7].min() > 2


def test_other_integrators(small_scene: Any, batch_of: Any) -> None:
    """All of Mitsuba's that return radiance are called as they want to be, and recorded: they see the same light, by
    paths of up to two segments. `aov`, `depth` and `stokes` see none, and `volprim_rf_basic` that of its own shapes."""
    batch = batch_of(32, 32, 4, 12)
    nested = {"type": "path", "max_depth": 2}
    names = ("volpath", "volpathmis", "prb", "prb_basic", "prb_projective", "prbvolpath")
    plugins = [nested, *({"type": name, "max_depth": 2} for name in names), {"type": "moment", "nested": nested}]
    plugins += [{"type": "direct"}, {"type": "direct_projective"}]
    values = {plugin["type"]: renderer(small_scene(), integrator=plugin) for plugin in plugins}
    means = {name: r(batch)[:, :3].mean() for name, r in values.items()}
    assert all(r._evaluate.frozen == "all" for r in values.values())
    assert np.allclose(list(means.values()), means["path"], rtol=0.2), means


def test_renderers_side_by_side_and_in_threads(small_scene: Any, batch_of: Any) -> None:
    """Exact: two scenes, called by turns and from several threads, do not disturb each other."""
    one, two = renderer(small_scene()), renderer("diffuse", size=(32, 32))
    batches = [batch_of(32, 32, 1, seed) for seed in range(4)]
    expected = [(one(batch), two(batch)) for batch in batches]
    results: dict[int, Any] = {}

    def work(k: int) -> None:
        results[k] = (one(batches[k]), two(batches[k]))

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, (a, b) in enumerate(expected):
        assert np.array_equal(results[k][0], a)
        assert np.array_equal(results[k][1], b)


def test_what_cannot_be_recorded_is_traced_and_said(small_scene: Any, batch_of: Any, probe: Any, mi: Any) -> None:
    """A plugin with state that Dr.Jit does not see: a warning, once, and right values for every batch."""
    import drjit as dr

    hidden = [dr.opaque(mi.Float, 2.0)]
    r = renderer(small_scene(), integrator=probe(lambda sampler, ray: (sampler.next_1d() * hidden[0], 0, 0)))
    batch = batch_of(32, 32, 2, 13)
    with pytest.warns(UserWarning, match="cannot record this scene"):
        values = r(batch)
    assert np.allclose(values[:, 0], 2 * sobol(batch, 1)[:, 0])
    assert np.allclose(r(batch[:100])[:, 0], values[:100, 0])
