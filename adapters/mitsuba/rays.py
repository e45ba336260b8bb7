"""From positions on the film to linear RGB: camera rays, the integrator, and the film's way from spectrum to
RGB.

`Evaluator` records this once and replays it for every batch (`dr.freeze`). What is replayed is what was
traced: everything that differs from batch to batch has to come in as an argument of the batch's length, never
as a Python number and never through an array's length, or the first batch's would be used for ever.
"""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import mitsuba as mi

from .camera import Camera
from .loading import takes_mode
from .samplers import sampler_class

__all__ = ["Evaluator"]

Measured = tuple[Any, Any, list[Any]]  # spectrum, wavelengths, AOVs
_suspended: Any = dr.suspend_grad  # untyped in Dr.Jit
# The one camera of Mitsuba 3.9 that names all of its state to Dr.Jit. Rays of the others are traced anew for
# each batch.
_RECORDABLE_CAMERAS = ("PerspectiveCamera",)


class Evaluator:
    """The radiance of samples, for fixed plugins: `evaluator(positions, scramble, index) -> radiance`.

    `positions` is a `mi.UInt64` whose numbers are two single-precision floats each, x and y in pixels from the top-left
    corner of the film's crop (in memory the rows of an (n, 2) array; being of the batch's length they need no kernel of
    their own to be taken apart); `scramble` and `index` are `mi.UInt32`, all of one length. The radiance is a
    `mi.Float`, sample after sample red, green, blue, then the integrator's own channels (AOVs); that of one sample
    where all are alike. `kind` is one of `samplers.KINDS`.

    Only the dimensions that the sensor uses are drawn: a lens where it has one, a time where the shutter
    stays open, a wavelength where the variant is spectral. To be made and called with `variant` active.

    `frozen` tells what is replayed: everything ("all"), everything after the camera rays ("paths"), or
    nothing ("nothing"), which costs about 2 ms a batch and is what remains for scenes with plugins that hide
    state from Dr.Jit.
    """

    def __init__(
        self, variant: str, kind: str, scene: Any, sensor: Any, integrator: Any, frozen: str | None = None
    ) -> None:
        self._plugins = (scene, sensor, integrator)
        self._camera = Camera(sensor)
        self._sampler_type = sampler_class(variant, kind)
        self._differentiable = takes_mode(integrator)
        self.frozen = frozen or ("all" if sensor.class_name() in _RECORDABLE_CAMERAS else "paths")
        # A batch as long as some array of the scene is recorded anew, so there may be many recordings; 16 are
        # kept.
        self._replayed: Any = dr.freeze(
            self._all if self.frozen == "all" else self._paths, limit=16, warn_after=1_000_000
        )

    @property
    def recordings(self) -> int:
        """How often the evaluation has been recorded so far."""
        return int(self._replayed.n_recordings)

    def __call__(self, positions: Any, scramble: Any, index: Any) -> Any:
        """The radiance of the samples at these positions."""
        with _suspended():
            value, wavelengths, aovs = self._measure(positions, scramble, index)
            if mi.is_spectral:  # here, for Mitsuba keeps its table of the observer where a recording cannot see it
                value = mi.spectrum_to_srgb(value, wavelengths)
            elif mi.is_monochromatic:
                value = mi.Color3f(value[0])
            # Not in the recording: replayed for more samples, it would scatter to an array as short as at first.
            return dr.ravel(mi.ArrayXf(value[0], value[1], value[2], *aovs))

    def _measure(self, positions: Any, scramble: Any, index: Any) -> Measured:
        if self.frozen == "nothing":
            return self._all(*self._plugins, positions, scramble, index)
        arguments: tuple[Any, ...] = (positions,)
        if self.frozen == "paths":
            arguments = self._camera(self._plugins[1], self._sampler(scramble, index), *_coordinates(positions))
            dr.eval(arguments)
        first = not self._replayed.n_cached_recordings
        try:
            measured: Measured = self._replayed(*self._plugins, *arguments, scramble, index)
            return measured
        except RuntimeError:  # what is no matter of recording is raised again without it, below
            if not first:
                raise
        warnings.warn("Dr.Jit cannot record this scene, so that each batch costs about 2 ms more", stacklevel=4)
        self.frozen = "nothing"
        return self._measure(positions, scramble, index)

    def _sampler(self, scramble: Any, index: Any) -> Any:
        sampler = self._sampler_type()
        sampler.start(scramble, index)
        return sampler

    def _all(self, scene: Any, sensor: Any, integrator: Any, positions: Any, scramble: Any, index: Any) -> Measured:
        sampler = self._sampler(scramble, index)
        ray, weight = self._camera(sensor, sampler, *_coordinates(positions))
        return self._radiance(scene, sensor, integrator, sampler, ray, weight)

    def _paths(
        self, scene: Any, sensor: Any, integrator: Any, ray: Any, weight: Any, scramble: Any, index: Any
    ) -> Measured:
        sampler = self._sampler(scramble, index)
        self._camera.draw(sampler)  # the camera rays used these
        return self._radiance(scene, sensor, integrator, sampler, ray, weight)

    def _radiance(self, scene: Any, sensor: Any, integrator: Any, sampler: Any, ray: Any, weight: Any) -> Measured:
        """What arrives along the rays, as in Mitsuba's `SamplingIntegrator::render_sample`."""
        if self._differentiable:
            value, _, aovs, _ = integrator.sample(
                mode=dr.ADMode.Primal,
                scene=scene,
                sampler=sampler,
                ray=ray,
                depth=mi.UInt32(0),
                state_in=None,
                active=mi.Bool(True),
                **{"δL": None, "δaovs": None},
            )
        else:
            value, _, aovs = integrator.sample(scene, sampler, ray, sensor.get_medium(), mi.Bool(True))
        return value * weight, ray.wavelengths, list(aovs)


def _coordinates(positions: Any) -> tuple[Any, Any]:
    """x and y as `mi.Float`."""
    x, y = mi.UInt32(positions & 0xFFFFFFFF), mi.UInt32(positions >> 32)
    single = dr.float32_array_t(mi.Float)
    return mi.Float(dr.reinterpret_array(single, x)), mi.Float(dr.reinterpret_array(single, y))
