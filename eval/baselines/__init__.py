"""Samplers to compare with, all by the same ask and tell as :class:`pmc_sampler.Sampler`.

``uniform`` and ``pmc`` are that sampler; the others decide by rules of the literature and of production renderers how
many samples each pixel gets, and share everything else.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from pmc_sampler import Budget, Sampler
from pmc_sampler.sampler import config_for, sampler_for

from .error_threshold import ErrorThreshold
from .film import Film
from .greedy import Greedy
from .neyman import Neyman, neyman_limit_of
from .sampler import AllocatingSampler, Batch, Rule

__all__ = [
    "NAMES",
    "AllocatingSampler",
    "Batch",
    "ErrorThreshold",
    "Film",
    "Greedy",
    "Neyman",
    "Rule",
    "make",
    "neyman_limit_of",
    "settings_of",
]

_RULES: dict[str, Callable[..., Rule]] = {
    "greedy": Greedy,
    "error-threshold": ErrorThreshold,
    "neyman": Neyman.for_radiance,
}
NAMES = ("pmc", "uniform", *_RULES)
"""What ``sampler`` of a method may be."""


def make(method: Mapping[str, Any], radiance: Any, budget: Budget, seed: int) -> Any:
    """The sampler that a method names, for the renderer ``radiance``, which has a ``width`` and a ``height``.

    ``method``: ``sampler`` is one of :data:`NAMES`; all else are that sampler's settings: of "pmc" and "uniform" as
    ``Config.from_dict`` takes them, of the others the arguments of their rule (:class:`Greedy`,
    :class:`ErrorThreshold`, :class:`Neyman`) and ``initial_spp`` (:class:`AllocatingSampler`). Raises ``ValueError``
    or ``TypeError`` with a sentence that says what came and what was expected.
    """
    settings = dict(method)
    name = settings.pop("sampler", None)
    if name not in NAMES:
        raise ValueError(f"sampler is {name!r}: expected one of {', '.join(NAMES)}")
    width, height = int(radiance.width), int(radiance.height)
    if name in ("pmc", "uniform"):
        preset = {"preset": "uniform"} if name == "uniform" else {}
        return sampler_for(radiance, width, height, budget, config_for(radiance, {**preset, **settings}), seed)
    _check_filter(name, radiance, settings.pop("filter", None))
    initial_spp = settings.pop("initial_spp", None)
    try:
        rule = _RULES[name](radiance, **settings)
    except TypeError as error:
        raise TypeError(f"the settings of {name!r} are not understood: {error}") from error
    signed = bool(getattr(radiance, "signed", False))
    sampler = AllocatingSampler(width, height, budget, rule, seed, initial_spp=initial_spp, signed=signed)
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(_RULES[name]).parameters.items()
        if parameter.default is not inspect.Parameter.empty
    }
    sampler.settings = {**defaults, **settings, "initial_spp": sampler.initial_spp}
    return sampler


def settings_of(sampler: Any) -> dict[str, Any]:
    """Every setting of a sampler that :func:`make` has made, with what it stands for in place of a default."""
    if isinstance(sampler, Sampler):
        return sampler.config.resolved(sampler.width, sampler.height).to_dict()
    return dict(sampler.settings)


def _check_filter(name: str, radiance: Any, wanted: Any) -> None:
    found = getattr(radiance, "filter", {}).get("filter", "box") if wanted is None else wanted
    if found != "box":
        raise ValueError(f"filter is {found!r}: {name} samples each pixel's own box; set filter to 'box'")
