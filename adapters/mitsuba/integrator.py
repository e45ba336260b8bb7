"""The sampler as a Mitsuba integrator: `<integrator type="pmc"> <integrator type="path"/> </integrator>`."""

from __future__ import annotations

import functools
from typing import Any

import mitsuba as mi
import numpy as np

from pmc_sampler import Budget, Config, Sampler
from pmc_sampler.sampler import config_for, sampler_for

from . import variants
from .loading import integrator_of
from .renderer import MitsubaRenderer
from .samplers import KINDS

__all__ = ["register"]


def register() -> None:
    """Makes the plugin known to every variant: to the active one at once, to others as they become active."""
    mi.detail.add_variant_callback(lambda _, variant: _register(variant))
    if mi.variant() is not None:
        _register(mi.variant())


def _register(variant: str) -> None:
    mi.register_integrator("pmc", lambda props: _integrator_class(variant)(props))


@functools.cache
def _integrator_class(variant: str) -> Any:
    """The plugin's class in `variant`, which has to be the active one."""

    class PMCIntegrator(mi.SamplingIntegrator):  # type: ignore[misc]
        """Population Monte Carlo sampling of the image plane, over any integrator that returns radiance.

        .. pluginparameters::

         * - (nested plugin)
           - integrator
           - What gives radiance for a ray. (Default: path)
         * - sampler
           - string
           - "sobol" or "independent": the random numbers of a path. (Default: sobol)
         * - seconds, visible_noise
           - float
           - Further limits besides the samples per pixel, see `Budget`. (Default: none)
         * - preset, and each field of `Config`
           - as there; `radii` as a string, "1, 3"
           - The method's settings. `filter` and `filter_radius` come from the film unless given.

        It renders the film's crop window with `spp` samples a pixel on average, as seeded, and leaves the
        corrected mean (`Film.mean`) on the film, alpha being 1. Samples lie within the crop: `sample_border`
        is without effect, and so is the sensor's own sampler but for its sample count. Derivatives are not
        available: use the nested integrator for these.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            why = variants.refusal(variant)
            if why:
                raise ValueError(f"the pmc integrator cannot be used in the variant {variant!r}: {why}")
            given = {key: props[key] for key in props}
            nested = [value for value in given.values() if isinstance(value, mi.Integrator)]
            if len(nested) > 1:
                raise ValueError(f"the pmc integrator steers one integrator, and here are {len(nested)}")
            self.pmc_nested = nested[0] if nested else mi.load_dict({"type": "path"})
            settings = {key: value for key, value in given.items() if not isinstance(value, mi.Integrator)}
            integrator_of(None, self.pmc_nested)  # raises for one that cannot be sampled at will
            self.sampler = settings.pop("sampler", "sobol")
            if self.sampler not in KINDS:
                raise ValueError(f"sampler is {self.sampler!r}: expected one of {', '.join(KINDS)}")
            self.limits = {key: settings.pop(key) for key in ("seconds", "visible_noise") if key in settings}
            if isinstance(settings.get("radii"), str):
                settings["radii"] = _radii(settings["radii"])
            self.settings = settings
            Config.from_dict(settings)  # a setting that will not do is refused on loading
            Budget(spp=1, **self.limits)

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            """Renders the scene onto the sensor's film; the developed image, or an empty tensor."""
            radiance = MitsubaRenderer(scene, sensor, self.pmc_nested, self.sampler)
            film = radiance.sensor.film()
            limits = Budget(spp=spp or radiance.sensor.sampler().sample_count(), **self.limits)
            config = config_for(radiance, self.settings)
            number = seed if isinstance(seed, int) else int(np.asarray(seed).ravel()[0])
            sampler = sampler_for(radiance, radiance.width, radiance.height, limits, config, number)
            while not sampler.done and not self.should_stop():
                batch = sampler.ask()
                sampler.tell(batch, radiance(batch))
            if not sampler.done:
                mi.Log(mi.LogLevel.Warn, f"pmc: cancelled at {sampler.spp:.3g} samples a pixel")
            if sampler.rejected:
                mi.Log(mi.LogLevel.Warn, f"pmc: {sampler.rejected} samples were not finite or negative")
            self._put(film, sampler, radiance.aov_names)
            return film.develop() if develop else mi.TensorXf()

        def sample(self, *arguments: Any, **named: Any) -> Any:
            """What the nested integrator returns."""
            return self.pmc_nested.sample(*arguments, **named)

        def aov_names(self) -> list[str]:
            """The nested integrator's."""
            return list(self.pmc_nested.aov_names())

        def to_string(self) -> str:
            return f"PMCIntegrator[nested = {self.pmc_nested}, sampler = {self.sampler}, {self.settings}]"

        def _put(self, film: Any, sampler: Sampler, aov_names: list[str]) -> None:
            """Leaves the image on the film, whose block has channels R, G, B, perhaps alpha, weight, AOVs."""
            channels = film.prepare(aov_names)
            pixels = np.ones((sampler.height, sampler.width, channels), np.float32)
            pixels[..., :3] = sampler.film.mean
            if aov_names:
                pixels[..., channels - len(aov_names) :] = sampler.film.aovs
            film.put_block(mi.ImageBlock(mi.TensorXf(pixels), mi.ScalarPoint2i(film.crop_offset())))

    return PMCIntegrator


def _radii(text: str) -> tuple[float, ...]:
    """The setting `radii`, which a scene file can give as a string alone: "1, 3"."""
    try:
        return tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise ValueError(f'radii is {text!r}: expected 1 to 3 radii in pixels, as in "1, 3"') from None
