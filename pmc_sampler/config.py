"""Settings of the sampler and of its budget.

"Paper" is Y.-C. Lai and C. Dyer, "Population Monte Carlo Path Tracing", UW-Madison CS TR 1614, 2007.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pmc_sampler import _core, inputs


@dataclass(frozen=True, kw_only=True)
class Config:
    """How the sampler chooses pixels and what image it makes of the samples. Checked on construction.

    The batch
        batch: samples in a batch, in [1, 2^31]; None: one for each pixel before anything adapts, and after that from
            one for every eighth pixel to one for each, the more the thinner beta is spread; 4096 at least. A
            `population` that is given sets the size of the batches that adapt.
        initial_spp: samples a pixel from the stratified pool before anything adapts, in [0, 1e9], at least 1 for the
            unbiased estimator; None: a sixteenth of the budget, held to 4 to 16.
        pool_share: share of each batch from the stratified pool, in [0, 1]; 1 is uniform sampling.
        direct_share: share of the rest drawn from `beta` and evaluated where drawn, outside the population, in [0, 1].
        lookahead: batch k is drawn from what batches up to k - 1 - lookahead told, in [0, 64]; so many batches may be
            open besides the one asked for, none by default, and as many more populations take turns. For renderers
            that work on several batches at once; others only learn later from it.

    The population (paper, 4.1 and 4.3)
        population: members n, at most the pixels of the image; None: what fills the batch.
        moves: T_R, kernel moves of a member in each iteration, in [0, 1024] (Figure 2).
        radii: d_k, radii of the kernel's disks in pixels, one to three (Eq. 4); None: 0.5, 1.5 and 4, or the larger
            side of the image where that is less.
        eliminate: share of the members replaced in each iteration by var / N_used, in [0, 1] (4.3.1).
        regenerate_pool: share of the replacements placed by the pool; the others are drawn from `beta`, in [0, 1]
            (4.3.2).
        regenerate_jitter: pixels by which a member regenerated from `beta` is moved at most in x and in y, in [0, 64]
            (4.3.2).
        evaluate_regenerated: whether a regenerated member is evaluated before it moves (4.1, last paragraph).

    Adaptation (paper, 4.3.3)
        adapt_alpha_every: iterations between adaptations of the members' kernel weights alpha, at least 1.
        adapt_beta_every: iterations between adaptations of `beta`, at least 1.
        alpha_floor: epsilon in alpha_k = epsilon / K + (1 - epsilon) share_k, the share of 1 / var_k; in [0, 1].
        alpha_memory: how far the alpha remembered at a place moves to that of a member there, in [0, 1]; a regenerated
            member starts from what is remembered. With 0 it starts from equal shares; `Film.alpha` then follows the
            members by 0.25.
        beta: "gain": var / (tvi(I)^2 n^2), the squared perceptual error that one more sample removes, with var the
            variance of a pixel's n samples of luminance and I their mean; "variance": var / tvi(I), the paper's
            (4.3.2).
        beta_power: pixels are drawn in proportion to beta to this power, in [0.25, 2].

    The image
        white_luminance: cd/m2 that a radiance luminance of 1.0 stands for, above 0; tvi is absolute.
        filter: "box", "tent", "gaussian" (standard deviation a quarter of the radius) or "blackman-harris", by filter
            importance sampling (doi:10.1109/RT.2006.280223).
        filter_radius: pixels, above 0 and at most 16; None: 0.5 for the box, 1 for the tent, 2 for the others.
        estimator: "consistent": right in the limit; "unbiased": of the right expectation at every count of samples,
            with less gain (docs/method.md). It has no population and no correction, and no budget of visible noise.
        correction: strength of the energy correction of `Film.mean`, in [0, 1]; 0 leaves the plain mean.
        correction_sigma: standard deviation of its smoother, 0.5 to 256 pixels.
        correction_knee: radiance, as a share of its surroundings', at which it is half applied, above 0 and at most 1.

    Raises ValueError or TypeError with a sentence that names the setting, what came and what was expected.
    """

    batch: int | None = None
    initial_spp: float | None = None
    pool_share: float = 0.15
    direct_share: float = 0.75
    lookahead: int = 0
    population: int | None = None
    moves: int = 2
    radii: tuple[float, ...] | None = None
    eliminate: float = 0.6
    regenerate_pool: float = 0.0
    regenerate_jitter: float = 0.0
    evaluate_regenerated: bool = True
    adapt_alpha_every: int = 10
    adapt_beta_every: int = 1
    alpha_floor: float = 0.1
    alpha_memory: float = 0.25
    beta: str = "gain"
    beta_power: float = 2.0
    white_luminance: float = 100.0
    filter: str = "box"
    filter_radius: float | None = None
    estimator: str = "consistent"
    correction: float = 1.0
    correction_sigma: float = 12.0
    correction_knee: float = 0.05

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _converted(field, getattr(self, field.name)))
        self._native().check()

    @classmethod
    def paper(cls, width: int = 640, height: int = 480, **changes: Any) -> Config:
        """The paper's parameters for its first scene (its section 5): the plain mean, one population at a time.

        width, height: of the image, in pixels, 1 to 65535 each. The paper's is 640x480; for another the population of
        5000 is scaled by the number of pixels, so that a run of as many samples a pixel takes as many iterations and
        adapts as often. The paper does not give epsilon; it is the default's `alpha_floor`.
        """
        pixels = inputs.side("width", width) * inputs.side("height", height)
        settings: dict[str, Any] = {
            "population": max(1, round(5000 * pixels / (640 * 480))),
            "moves": 16,
            "radii": (5.0, 10.0, 50.0),
            "eliminate": 0.4,
            "regenerate_pool": 0.5,
            "regenerate_jitter": 1.0,
            "adapt_alpha_every": 100,
            "adapt_beta_every": 100,
            "alpha_memory": 0.0,
            "beta": "variance",
            "beta_power": 1.0,
            "initial_spp": 0.0,
            "pool_share": 0.0,
            "direct_share": 0.0,
            "correction": 0.0,
        }
        return cls(**{**settings, **changes})

    @classmethod
    def uniform(cls, **changes: Any) -> Config:
        """The same number of samples for every pixel: ordinary path tracing, from the same stratified pool."""
        return cls(**{"pool_share": 1.0, "correction": 0.0, **changes})

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any], size: tuple[int, int] = (640, 480)) -> Config:
        """From a mapping such as a TOML table; `preset` may name "default", "paper" or "uniform" as the start.

        size: width and height of the image in pixels, by which the preset "paper" scales its population.
        """
        if not isinstance(settings, Mapping):
            raise TypeError(f"settings are {settings!r}: expected a mapping such as a TOML table")
        names = [field.name for field in dataclasses.fields(cls)]
        values = dict(settings)
        preset = values.pop("preset", "default")
        presets: dict[str, Callable[..., Config]] = {
            "default": cls,
            "paper": partial(cls.paper, *size),
            "uniform": cls.uniform,
        }
        if not isinstance(preset, str) or preset not in presets:
            raise ValueError(f"preset is {preset!r}: expected one of {', '.join(presets)}")
        unknown = sorted(set(values) - set(names), key=str)
        if unknown:
            raise ValueError(f"unknown setting {unknown[0]!r}: expected one of preset, {', '.join(names)}")
        return presets[preset](**values)

    def to_dict(self) -> dict[str, Any]:
        """Every setting, as from_dict takes them."""
        return {**dataclasses.asdict(self), "radii": None if self.radii is None else list(self.radii)}

    def resolved(self, width: int, height: int) -> Config:
        """The same settings with what a sampler of that size makes of them: the radii, and what the unbiased estimator
        settles.

        Raises ValueError where they do not fit the image.
        """
        native = self._native().resolved(width, height)
        settled = {name: getattr(native, name) for name in ("direct_share", "adapt_beta_every", "correction")}
        return dataclasses.replace(self, radii=tuple(native.radii), **settled)

    def _native(self) -> _core.Config:
        native = _core.Config()
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name in _ENUMS:
                value = _ENUMS[field.name][value]
            elif value is None:
                value = {"initial_spp": -1.0, "filter_radius": _FILTER_RADIUS[self.filter], "radii": ()}.get(
                    field.name, 0
                )
            setattr(native, field.name, list(value) if field.name == "radii" else value)
        return native


@dataclass(frozen=True, kw_only=True)
class Budget:
    """When sampling ends; whichever limit is met first. The pool is laid out for `spp`, so it is given at construction.

    spp: samples a pixel, above 0; round(spp * pixels) samples are drawn, to the sample.
    seconds: wall-clock seconds from the first `ask`, above 0.
    visible_noise: share of the pixels, in (0, 1), that may be unsettled (see `Sampler.visible_noise`); give `spp` or
        `seconds`, too, since rare bright paths can keep pixels unsettled for very long.

    Raises ValueError or TypeError with a sentence that says what came and what was expected.
    """

    spp: float | None = None
    seconds: float | None = None
    visible_noise: float | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                object.__setattr__(self, field.name, inputs.number(f"budget {field.name}", value, allow_infinity=False))
        self._native().check()

    def _native(self) -> _core.Budget:
        native = _core.Budget()
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                if field.name == "visible_noise" and value < 0:  # the core takes -1 for "no limit"
                    raise ValueError(
                        f"budget visible_noise is {value:g}: expected a share of the pixels between 0 and 1"
                    )
                setattr(native, field.name, value)
        return native


_ENUMS: dict[str, dict[str, Any]] = {
    "beta": {"gain": _core.Beta.gain, "variance": _core.Beta.variance},
    "estimator": {"consistent": _core.Estimator.consistent, "unbiased": _core.Estimator.unbiased},
    "filter": {
        "box": _core.Filter.box,
        "tent": _core.Filter.tent,
        "gaussian": _core.Filter.gaussian,
        "blackman-harris": _core.Filter.blackman_harris,
    },
}
_FILTER_RADIUS = {"box": 0.5, "tent": 1.0, "gaussian": 2.0, "blackman-harris": 2.0}
_LARGEST = {"batch": 2**31, "population": 2**29, "lookahead": 2**31}


def _converted(field: dataclasses.Field[Any], value: Any) -> Any:
    """The value of a setting in its own type; nothing is rounded or guessed."""
    name, kind = field.name, str(field.type)
    if value is None and "None" in kind:
        return None
    if name in _ENUMS:
        if not isinstance(value, str) or value not in _ENUMS[name]:
            raise ValueError(f"{name} is {value!r}: expected one of {', '.join(_ENUMS[name])}")
        return value
    if name == "radii":
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise TypeError(f"radii is {value!r}: expected one to three numbers of pixels")
        radii = tuple(inputs.number("radii", radius) for radius in value)
        if not radii:
            raise ValueError("radii holds no values: expected 1 to 3 radii in pixels, or None")
        return radii
    if kind == "bool":
        return inputs.flag(name, value)
    number = inputs.number(name, value)
    if kind.startswith("int"):
        low, high = (1 if "None" in kind else 0), _LARGEST.get(name, 2**31)
        if not number.is_integer() or not low <= number <= high:
            raise ValueError(f"{name} is {value!r}: expected a whole number from {low} to {high}")
        return int(number)
    if name == "initial_spp" and number < 0:  # the core takes -1 for "automatic"
        raise ValueError(f"initial_spp is {value!r}: expected 0 to 1e9, or None")
    return number
