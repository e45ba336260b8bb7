"""Settings and budgets: what is taken, what is refused, and with which sentence. Exact."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Budget, Config, Sampler, _core

NAMES = [field.name for field in dataclasses.fields(Config)]

# --- What is refused -------------------------------------------------------------------------------------------------
BAD: list[tuple[str, Any, type[Exception], str]] = [
    ("batch", 0, ValueError, "expected a whole number from 1"),
    ("batch", -5, ValueError, "expected a whole number from 1"),
    ("batch", 2.5, ValueError, "expected a whole number from 1"),
    ("batch", math.inf, ValueError, "expected a whole number from 1"),
    ("batch", 2**40, ValueError, "expected a whole number from 1 to 2147483648"),
    ("batch", "64", TypeError, "expected a number"),
    ("initial_spp", -1, ValueError, "expected 0 to 1e9, or None"),
    ("initial_spp", -0.5, ValueError, "expected 0 to 1e9, or None"),
    ("initial_spp", 1e10, ValueError, "expected 0 to 1e+09"),
    ("pool_share", -0.1, ValueError, "expected 0 to 1"),
    ("pool_share", 1.1, ValueError, "expected 0 to 1"),
    ("pool_share", math.nan, ValueError, "expected a finite number"),
    ("pool_share", True, TypeError, "expected a number"),
    ("pool_share", None, TypeError, "expected a number"),
    ("pool_share", "0.5", TypeError, "expected a number"),
    ("pool_share", b"0.5", TypeError, "expected a number"),
    ("pool_share", [0.5], TypeError, "expected a number"),
    ("direct_share", 2, ValueError, "expected 0 to 1"),
    ("lookahead", -1, ValueError, "expected a whole number from 0"),
    ("lookahead", 65, ValueError, "expected 0 to 64"),
    ("lookahead", 1.5, ValueError, "expected a whole number"),
    ("population", 0, ValueError, "expected a whole number from 1"),
    ("population", 2**30, ValueError, "expected a whole number from 1 to 536870912"),
    ("moves", 1025, ValueError, "expected 0 to 1024"),
    ("moves", 0.5, ValueError, "expected a whole number"),
    ("moves", math.nan, ValueError, "expected a finite number"),
    ("radii", (), ValueError, "expected 1 to 3 radii in pixels"),
    ("radii", (1, 2, 3, 4), ValueError, "expected 1 to 3 radii in pixels"),
    ("radii", (1, 0), ValueError, "expected pixels above 0"),
    ("radii", (1, -2), ValueError, "expected pixels above 0"),
    ("radii", (math.inf,), ValueError, "expected pixels above 0 and at most 65536"),
    ("radii", (math.nan,), ValueError, "expected a finite number"),
    ("radii", 5.0, TypeError, "expected one to three numbers of pixels"),
    ("radii", "5", TypeError, "expected one to three numbers of pixels"),
    ("radii", ("a",), TypeError, "expected a number"),
    ("eliminate", -0.01, ValueError, "expected 0 to 1"),
    ("regenerate_pool", 1.01, ValueError, "expected 0 to 1"),
    ("regenerate_jitter", 65, ValueError, "expected 0 to 64"),
    ("evaluate_regenerated", 1, TypeError, "expected True or False"),
    ("evaluate_regenerated", "yes", TypeError, "expected True or False"),
    ("adapt_alpha_every", 0, ValueError, "expected 1 to"),
    ("adapt_beta_every", 0, ValueError, "expected 1 to"),
    ("alpha_floor", 1.5, ValueError, "expected 0 to 1"),
    ("alpha_memory", -1, ValueError, "expected 0 to 1"),
    ("beta", "Gain", ValueError, "expected one of gain, variance"),
    ("beta", 1, ValueError, "expected one of gain, variance"),
    ("beta_power", 0.2, ValueError, "expected 0.25 to 2"),
    ("beta_power", 2.1, ValueError, "expected 0.25 to 2"),
    ("white_luminance", 0, ValueError, "expected cd/m2 above 0"),
    ("white_luminance", math.inf, ValueError, "expected cd/m2 above 0 and below 1e12"),
    ("estimator", "exact", ValueError, "expected one of consistent, unbiased"),
    ("filter", "mitchell", ValueError, "expected one of box, tent, gaussian, blackman-harris"),
    ("filter", ["box"], ValueError, "expected one of box, tent, gaussian, blackman-harris"),
    ("filter_radius", 0, ValueError, "expected pixels above 0 and at most 16"),
    ("filter_radius", 17, ValueError, "expected pixels above 0 and at most 16"),
    ("correction", 1.5, ValueError, "expected 0 to 1"),
    ("correction_sigma", 0.1, ValueError, "expected 0.5 to 256"),
    ("correction_knee", 0, ValueError, "expected 1e-06 to 1"),
]


@pytest.mark.parametrize(("name", "value", "error", "expected"), BAD, ids=[f"{b[0]}={b[1]!r}" for b in BAD])
def test_bad_settings(name: str, value: Any, error: type[Exception], expected: str) -> None:
    """One sentence: the setting, what came, what was expected; from keywords and from a TOML table alike."""
    for make in (lambda: Config(**{name: value}), lambda: Config.from_dict({name: value})):
        with pytest.raises(error) as caught:
            make()
        text = str(caught.value)
        assert text.startswith(name)
        assert expected in text
        assert "\n" not in text
        if not isinstance(value, tuple):
            assert f"is {value!r}:" in text or f"is {value:g}:" in text


def test_every_setting_has_a_bad_value() -> None:
    assert {name for name, *_ in BAD} == set(NAMES)


@pytest.mark.parametrize(
    "settings",
    [
        {"population": 100, "moves": 0, "evaluate_regenerated": False},
        {"population": 100, "moves": 0, "eliminate": 0.0},
        {"moves": 0, "evaluate_regenerated": False, "direct_share": 0.5},
    ],
)
def test_settings_that_draw_no_samples(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="draws no samples: set moves to at least 1"):
        Config(**settings)


def test_unknown_settings() -> None:
    with pytest.raises(ValueError, match="unknown setting 'radius': expected one of preset, batch, initial_spp"):
        Config.from_dict({"radius": 3})
    with pytest.raises(ValueError, match="unknown setting 3"):
        Config.from_dict({3: 3, "radius": 3})
    with pytest.raises(TypeError, match="radius"):
        Config(radius=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="settings are 5: expected a mapping"):
        Config.from_dict(5)  # type: ignore[arg-type]
    for preset in ("best", 3, ["paper"], None):
        with pytest.raises(ValueError, match="expected one of default, paper, uniform"):
            Config.from_dict({"preset": preset})


@pytest.mark.parametrize(
    ("size", "error", "sentence"),
    [
        ((0, 0), ValueError, "width is 0: expected 1 to 65535"),
        ((-3, 5), ValueError, "width is -3: expected 1 to 65535"),
        ((5, 65536), ValueError, "height is 65536: expected 1 to 65535"),
        (("a", 5), TypeError, "width is 'a': expected a whole number"),
        ((5, 2.5), TypeError, "height is 2.5: expected a whole number"),
    ],
)
def test_sizes_that_the_paper_s_population_cannot_be_scaled_to(
    size: tuple[Any, Any], error: type[Exception], sentence: str
) -> None:
    for make in (lambda: Config.paper(*size), lambda: Config.from_dict({"preset": "paper"}, size)):
        with pytest.raises(error, match=re.escape(sentence)):
            make()


# --- What is taken ---------------------------------------------------------------------------------------------------
CHANGED: dict[str, Any] = {
    "batch": 1234,
    "initial_spp": 2.5,
    "pool_share": 0.25,
    "direct_share": 0.125,
    "lookahead": 3,
    "population": 77,
    "moves": 5,
    "radii": (0.5, 2.0, 40.0),
    "eliminate": 0.75,
    "regenerate_pool": 0.375,
    "regenerate_jitter": 1.5,
    "evaluate_regenerated": False,
    "adapt_alpha_every": 7,
    "adapt_beta_every": 9,
    "alpha_floor": 0.0625,
    "alpha_memory": 0.5,
    "beta": "variance",
    "beta_power": 0.75,
    "white_luminance": 250.0,
    "filter": "gaussian",
    "estimator": "unbiased",
    "filter_radius": 1.5,
    "correction": 0.5,
    "correction_sigma": 3.0,
    "correction_knee": 0.5,
}


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_reaches_the_core(name: str) -> None:
    config = Config(**{name: CHANGED[name]})
    assert getattr(config, name) == CHANGED[name] != getattr(Config(), name)
    native = getattr(config._native(), name)
    if name in ("beta", "estimator", "filter"):
        assert native == getattr(getattr(_core, name.capitalize()), CHANGED[name])
    else:
        assert (tuple(native) if name == "radii" else native) == CHANGED[name]


def test_presets_and_tables() -> None:
    """to_dict and from_dict undo each other, and every preset takes changes."""
    changed = CHANGED | {"population": None}  # the unbiased estimator has none
    for config in (Config(), Config(**changed), Config.paper(), Config.uniform(), Config.paper(100, 80, moves=3)):
        assert Config.from_dict(config.to_dict()) == config
    assert Config.from_dict({}) == Config.from_dict({"preset": "default"}) == Config()
    assert Config.from_dict({"preset": "uniform", "filter": "tent"}) == Config.uniform(filter="tent")
    assert Config.from_dict({"preset": "paper", "moves": 4}) == Config.paper(moves=4)
    assert Config.uniform().pool_share == 1.0
    table = {"radii": [1, 2], "filter": "tent", "lookahead": 2}
    Config.from_dict(table)
    assert table == {"radii": [1, 2], "filter": "tent", "lookahead": 2}  # the caller's, untouched


def test_paper_is_the_paper() -> None:
    """TR 1614, section 5: n, T_R, radii, 40 % eliminated, half of the regenerated from the pool, jitter of a pixel."""
    paper = Config.paper()
    assert (paper.population, paper.moves, paper.radii) == (5000, 16, (5.0, 10.0, 50.0))
    assert (paper.eliminate, paper.regenerate_pool, paper.regenerate_jitter) == (0.4, 0.5, 1.0)
    assert (paper.adapt_alpha_every, paper.adapt_beta_every) == (100, 100)
    assert (paper.beta, paper.beta_power, paper.correction, paper.pool_share) == ("variance", 1.0, 0.0, 0.0)
    assert paper.evaluate_regenerated


def test_numbers_in_other_types() -> None:
    config = Config(moves=3.0, pool_share=np.float32(0.5), radii=np.array([1, 2]), batch=np.int64(9))  # type: ignore[arg-type]
    assert (config.moves, config.pool_share, config.radii, config.batch) == (3, 0.5, (1.0, 2.0), 9)
    assert isinstance(config.moves, int)


def test_frozen_and_by_name() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().moves = 3  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError):
        Budget(spp=1).spp = 3  # type: ignore[misc]
    with pytest.raises(TypeError, match="positional"):
        Config(4096)  # type: ignore[misc]
    with pytest.raises(TypeError, match="positional"):
        Budget(64)  # type: ignore[misc]


def test_default_suits_every_image() -> None:
    for width, height in ((1, 1), (1, 2), (3, 1), (7, 5), (500, 2)):
        assert len(Sampler(width, height, Budget(spp=1)).ask()) == width * height


# --- Budgets ---------------------------------------------------------------------------------------------------------
BAD_BUDGETS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({}, ValueError, "the budget has no limit: give spp, seconds or visible_noise"),
    ({"spp": 0}, ValueError, "budget spp is 0: expected samples a pixel above 0"),
    ({"spp": -2.5}, ValueError, "budget spp is -2.5: expected samples a pixel above 0"),
    ({"spp": 1e10}, ValueError, "budget spp is 1e+10: expected samples a pixel above 0 and at most 1e9"),
    ({"spp": math.nan}, ValueError, "budget spp is nan: expected a finite number"),
    ({"spp": math.inf}, ValueError, "budget spp is inf: expected a finite number"),
    ({"spp": "64"}, TypeError, "budget spp is '64': expected a number"),
    ({"spp": True}, TypeError, "budget spp is True: expected a number"),
    ({"spp": [64]}, TypeError, "budget spp is [64]: expected a number"),
    ({"seconds": 0}, ValueError, "budget seconds is 0: expected seconds above 0"),
    ({"seconds": -1}, ValueError, "budget seconds is -1: expected seconds above 0"),
    ({"seconds": math.nan}, ValueError, "budget seconds is nan"),
    ({"visible_noise": 0}, ValueError, "budget visible_noise is 0: expected a share of the pixels between 0 and 1"),
    ({"visible_noise": 1}, ValueError, "budget visible_noise is 1: expected a share of the pixels between 0 and 1"),
    ({"visible_noise": -1}, ValueError, "budget visible_noise is -1: expected a share of the pixels between 0 and 1"),
    ({"visible_noise": -0.5}, ValueError, "budget visible_noise is -0.5"),
    ({"spp": 4, "seconds": 0}, ValueError, "budget seconds is 0"),
]


@pytest.mark.parametrize(("limits", "error", "sentence"), BAD_BUDGETS, ids=[str(b[0]) for b in BAD_BUDGETS])
def test_bad_budgets(limits: dict[str, Any], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=re.escape(sentence)):
        Budget(**limits)


def test_budgets() -> None:
    budget = Budget(spp=64, seconds=np.float32(2.5), visible_noise=0.01)  # type: ignore[arg-type]
    assert (budget.spp, budget.seconds, budget.visible_noise) == (64.0, 2.5, 0.01)
    assert Budget(spp=64) == Budget(spp=64.0)
