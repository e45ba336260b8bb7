"""Camera rays, drawing only the random numbers that the sensor uses."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

__all__ = ["Camera"]


class Camera:
    """Rays through positions on the film of `sensor`: `camera(sensor, sampler, x, y) -> (ray, weight)`.

    `x` and `y` are pixels from the top-left corner of the film's crop. A pair of dimensions is drawn for the
    lens where the sensor has one; of the next pair one half is the time where the shutter stays open, the
    other the wavelength where the variant is spectral. The weight is the sensor's response.
    """

    def __init__(self, sensor: Any) -> None:
        width, height = sensor.film().crop_size()
        self._pixel = (1 / width, 1 / height)
        self._exposure = float(sensor.shutter_open_time())
        self._has_lens = bool(sensor.needs_aperture_sample())

    def draw(self, sampler: Any) -> tuple[Any, Any, Any]:
        """The random numbers of a ray: place on the lens, share of the exposure, wavelength."""
        lens = sampler.next_2d() if self._has_lens else mi.Point2f(0.5)
        if self._exposure > 0 and mi.is_spectral:
            moment, wavelength = sampler.next_2d()
        else:
            moment = sampler.next_1d() if self._exposure > 0 else mi.Float(0)
            wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        return lens, moment, wavelength

    def __call__(self, sensor: Any, sampler: Any, x: Any, y: Any) -> tuple[Any, Any]:
        """The rays (with differentials) and their weights."""
        lens, moment, wavelength = self.draw(sampler)
        time = sensor.shutter_open() + moment * self._exposure
        place = mi.Point2f(x * self._pixel[0], y * self._pixel[1])
        ray, weight = sensor.sample_ray_differential(time, wavelength, place, lens)
        return ray, weight
