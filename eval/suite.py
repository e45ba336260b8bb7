"""Suites: what a benchmark runs, read from TOML and checked before anything is rendered.

A suite has scenes, methods, budgets and seeds; a run is one of each. :func:`read` has the file's form.
"""

import difflib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmc_sampler import scenes, toml

from . import measures

SHIPPED = Path(__file__).parent / "suites"

_SUITE = {"name", "about", "seeds", "white_luminance", "metrics", "baseline", "scene", "method"}
_BUDGETS = {"spp": float, "seconds": float}
_OF_SCENES = {"size", "spp", "seconds", "renderer", "reference_spp", "reference_noise", "recorded_spp"}
_SCENE = {"name", "file", "recording", "options", "crops"} | _OF_SCENES
_METHOD = {"name", "numbers", "config", "sweep", "scenes", "on"}
_NUMBERS = ("sobol", "independent")
LARGEST = 100_000
"""Runs of a suite, and methods of a sweep, at most."""


class BadSuiteError(ValueError):
    """A suite that cannot be run; the message names the suite, what came and what was expected."""


@dataclass(frozen=True)
class Budget:
    """When a run ends: ``kind`` is "spp" or "seconds", ``value`` how many; see also :data:`OWN`."""

    kind: str
    value: float

    def __str__(self) -> str:
        if self == OWN:
            return self.kind
        return f"{self.value:g}{'spp' if self.kind == 'spp' else 's'}"


OWN = Budget("own", 1.0)
"""Of a renderer that ends by itself, see :attr:`Method.native`."""


@dataclass(frozen=True)
class Scene:
    """A scene, who renders it and at which budgets.

    ``source`` is a built-in scene's name or an absolute path; of a recording, where ``renderer`` is None, or of
    a scene file. ``size`` is (width, height) in pixels; None for a recording, which has its own.
    ``recorded_spp`` samples of each pixel are recorded first and replayed; None renders anew in each run.
    ``options`` go to the renderer, as sorted pairs. ``crops`` are parts of the image that the report shows: a name, and
    left, top, right and bottom as shares of the image.
    """

    name: str
    source: str
    renderer: str | None
    size: tuple[int, int] | None
    budgets: tuple[Budget, ...]
    reference_spp: int
    reference_noise: float | None
    recorded_spp: int | None
    options: tuple[tuple[str, Any], ...] = ()
    crops: tuple[tuple[str, tuple[float, float, float, float]], ...] = ()


@dataclass(frozen=True)
class Method:
    """A way to spend samples: settings for :func:`pmc_sampler.eval.baselines.make`.

    ``numbers`` are the renderer's random numbers, "sobol" or "independent". ``scenes`` names those it runs on,
    None for all; ``on`` has settings that replace the method's on a scene.
    """

    name: str
    settings: Mapping[str, Any]
    numbers: str = "sobol"
    scenes: tuple[str, ...] | None = None
    on: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def native(self) -> bool:
        """Whether it is the renderer's own way to choose samples, its method ``native``, to which settings go."""
        return bool(self.settings["sampler"] == "native")

    def settings_on(self, scene: str) -> dict[str, Any]:
        """The settings on a scene."""
        return {**self.settings, **self.on.get(scene, {})}


@dataclass(frozen=True)
class Run:
    """One image to be made and measured."""

    scene: Scene
    method: Method
    budget: Budget
    seed: int


@dataclass(frozen=True)
class Suite:
    """What to run: each of ``methods`` on each of ``scenes``, at the scene's budgets, with seeds 1 to ``seeds``.

    ``baseline`` is the method that ratios are taken over; ``metrics`` are names in
    :data:`pmc_sampler.eval.measures.MEASURES`; ``white_luminance`` cd/m2 of a luminance of 1.
    """

    name: str
    about: str
    scenes: tuple[Scene, ...]
    methods: tuple[Method, ...]
    seeds: int
    baseline: str
    metrics: tuple[str, ...]
    white_luminance: float

    def runs(self, scene: Scene) -> Iterator[Run]:
        """The runs on a scene in the order of running.

        Each seed has all budgets and methods before the next begins, and the methods of a budget begin with
        another one each time, so that a machine's drift hits all alike. Native ones run once a seed.
        """
        chosen = [method for method in self.methods if method.scenes is None or scene.name in method.scenes]
        methods = [method for method in chosen if not method.native]
        for seed in range(1, self.seeds + 1):
            for place, budget in enumerate(scene.budgets):
                turn = (seed - 1 + place) % max(len(methods), 1)
                for method in methods[turn:] + methods[:turn]:
                    yield Run(scene, method, budget, seed)
            for method in chosen:
                if method.native:
                    yield Run(scene, method, OWN, seed)

    def counts_setup(self, scene: Scene) -> bool:
        """Whether a renderer's set-up is part of the seconds: where they are compared with those of its own way to
        choose samples, which begins from nothing each time.
        """
        return any(run.method.native for run in self.runs(scene))

    def budgets(self, scene: Scene) -> tuple[Budget, ...]:
        """The budgets of the runs on a scene."""
        return tuple(dict.fromkeys(run.budget for run in self.runs(scene)))

    def to_dict(self) -> dict[str, Any]:
        """The suite with nothing left to defaults, sweeps or other files, as :func:`parse` takes it."""
        return {
            **{name: getattr(self, name) for name in ("name", "about", "seeds", "white_luminance", "baseline")},
            "metrics": list(self.metrics),
            "scene": [_scene_dict(scene) for scene in self.scenes],
            "method": [_method_dict(method) for method in self.methods],
        }


def slug(name: str) -> str:
    """A name as it stands in file names: lower case, all but letters, digits and dots as hyphens."""
    return re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.")


def shipped() -> list[str]:
    """The names of the suites that come with the package."""
    return sorted(file.stem for file in SHIPPED.glob("*.toml"))


def find(name: str) -> Path:
    """The file of a suite: a shipped one's name, or a path ending in ``.toml``."""
    if name in shipped():
        return SHIPPED / f"{name}.toml"
    path = Path(name)
    if path.suffix == ".toml":
        return path
    near = difflib.get_close_matches(name, shipped(), n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise BadSuiteError(
        f"no suite is called {name!r}: give a .toml file or one that is shipped, {', '.join(shipped())}{hint}"
    )


def read(path: str | Path) -> Suite:
    """Read and check a suite.

    The file has at its top ``name``, ``about`` (a sentence), ``seeds``, ``baseline`` (a method's name), and, if
    other than the defaults, ``metrics`` and ``white_luminance``. ``size``, ``spp`` and ``seconds`` (lists of
    budgets), ``renderer``, ``reference_spp``, ``reference_noise`` and ``recorded_spp`` stand at the top for all
    scenes or in one of the tables ``[[scene]]``, which has ``name`` (of a built-in scene, or a label beside
    ``file``, a scene file, or ``recording``), ``options`` of the renderer and ``crops`` for the report. A table
    ``[[method]]`` has ``name``, ``numbers`` and settings for :func:`pmc_sampler.eval.baselines.make`; ``config``, a
    TOML file of more settings; ``scenes``, those it runs on; ``[method.on.SCENE]``, settings for one scene; and
    ``[method.sweep]``, lists of values: one method for each combination, named by the ``{setting}`` in ``name``.
    With ``sampler = "native"`` a method is the renderer's own way to choose samples, and ends by itself. Paths are
    relative to the suite. Raises :class:`BadSuiteError`.
    """
    try:
        return parse(toml.read(path), Path(path).resolve().parent)
    except (ValueError, ImportError) as error:
        prefix = "" if str(path) in str(error) else f"{str(path)!r}: "
        raise BadSuiteError(f"{prefix}{error}") from error


def parse(given: Mapping[str, Any], folder: Path = Path()) -> Suite:
    """A suite from what its file holds; ``folder`` is that of its paths. Raises :class:`BadSuiteError`."""
    _known(given, _SUITE | _OF_SCENES, "the suite")
    name = _text(given, "name", "the suite")
    tables = _tables(given, "scene")
    common = {key: given[key] for key in _OF_SCENES if key in given}
    parsed = tuple(_scene(common, table, folder) for table in tables)
    methods = tuple(itertools.chain.from_iterable(_methods(table, folder) for table in _tables(given, "method")))
    names = [scene.name for scene in parsed]
    _distinct("scenes", names)
    _distinct("methods", [method.name for method in methods])
    for method in methods:
        for scene in (*(method.scenes or ()), *method.on):
            _one_of(f"method {method.name!r}: scene", scene, names)
    for scene in names:
        if not any(method.scenes is None or scene in method.scenes for method in methods):
            raise BadSuiteError(f"no method runs on scene {scene!r}: leave the scene out, or a method's `scenes`.")
    baseline = _text(given, "baseline", "the suite")
    _one_of("baseline", baseline, [method.name for method in methods])
    wanted = given.get("metrics", list(measures.DEFAULT))
    if not isinstance(wanted, list) or not wanted:
        raise BadSuiteError(f"metrics is {wanted!r}: expected a list of names, of {', '.join(measures.MEASURES)}")
    for metric in wanted:
        _one_of("a metric", metric, list(measures.MEASURES))
    seeds = _whole(given, "seeds", 1, "the suite")
    if seeds * len(methods) * sum(len(scene.budgets) for scene in parsed) > LARGEST:
        raise BadSuiteError(f"the suite has more than {LARGEST} runs: expected fewer seeds, methods or budgets")
    return Suite(
        name,
        _text(given, "about", "the suite"),
        parsed,
        methods,
        seeds,
        baseline,
        tuple(wanted),
        _positive("white_luminance", given.get("white_luminance", 100.0), "the suite"),
    )


def _scene(common: Mapping[str, Any], table: Mapping[str, Any], folder: Path) -> Scene:
    _known(table, _SCENE, "a scene")
    sources = [key for key in ("file", "recording") if key in table]
    if len(sources) > 1:
        raise BadSuiteError("a scene has both `file` and `recording`: give one.")
    if not sources:
        name = source = _text(table, "name", "a scene")
        try:
            scenes.path(name)
        except ValueError as error:
            raise BadSuiteError(f"{error}; for a scene file write `file`.") from error
    else:
        path = folder / _text(table, sources[0], "a scene")
        source, name = str(path), str(table.get("name", path.stem))
    own = {**common, **table}
    what = f"scene {name!r}"
    budgets = tuple(Budget(kind, _positive(kind, value, what)) for kind in _BUDGETS for value in _list(own, kind, what))
    if not budgets:
        raise BadSuiteError(f"{what} has no budget: give `spp` or `seconds`, lists of numbers above 0.")
    _distinct(f"budgets of {what}", [str(budget) for budget in budgets])
    recorded = _whole(own, "recorded_spp", 1, what) if "recorded_spp" in own and "recording" not in table else None
    if recorded is not None and recorded & (recorded - 1):
        raise BadSuiteError(f"{what}: `recorded_spp` is {recorded}: expected a power of two")
    replayed = recorded is not None or "recording" in table
    if not replayed and "reference_spp" not in own:
        raise BadSuiteError(f"{what} has no `reference_spp`: give the samples per pixel of its reference.")
    options = table.get("options", {})
    if not isinstance(options, Mapping):
        raise BadSuiteError(f"{what}: options is {options!r}: expected a table of the renderer's options")
    return Scene(
        name,
        source,
        None if "recording" in table else _text(own, "renderer", what),
        None if "recording" in table else _size(own, what),
        budgets,
        0 if replayed else _whole(own, "reference_spp", 32, what),
        _positive("reference_noise", own["reference_noise"], what)
        if "reference_noise" in own and not replayed
        else None,
        recorded,
        tuple(sorted((key, _frozen(value)) for key, value in options.items())),
        tuple(_crop(name, sides, what) for name, sides in _crops(table, what).items()),
    )


def _crops(table: Mapping[str, Any], what: str) -> Mapping[str, Any]:
    crops = table.get("crops", {})
    if not isinstance(crops, Mapping):
        raise BadSuiteError(f"{what}: crops is {crops!r}: expected a table of names and [left, top, right, bottom]")
    return crops


def _crop(name: str, sides: Any, what: str) -> tuple[str, tuple[float, float, float, float]]:
    try:
        left, top, right, bottom = (float(side) for side in sides)
        whole = 0.0 <= left < right <= 1.0 and 0.0 <= top < bottom <= 1.0
    except (TypeError, ValueError):
        whole = False
    if not whole:
        raise BadSuiteError(
            f"{what}: the crop {name!r} is {sides!r}: expected left, top, right and bottom as shares of the image, "
            "such as [0.4, 0.6, 0.8, 0.9]"
        )
    return name, (left, top, right, bottom)


def _methods(table: Mapping[str, Any], folder: Path) -> Iterator[Method]:
    pattern = _text(table, "name", "a method")
    what = f"method {pattern!r}"
    numbers = table.get("numbers", "sobol")
    _one_of(f"{what}: numbers", numbers, _NUMBERS)
    limited = table.get("scenes")
    if limited is not None and (not isinstance(limited, list) or not limited):
        raise BadSuiteError(f"{what}: scenes is {limited!r}: expected a list of the scenes it runs on")
    on = table.get("on", {})
    if not isinstance(on, Mapping) or not all(isinstance(settings, Mapping) for settings in on.values()):
        raise BadSuiteError(f"{what}: on is {on!r}: expected tables [method.on.SCENE] of settings")
    settings = {key: value for key, value in table.items() if key not in _METHOD}
    if "config" in table:
        settings = {**toml.read(folder / _text(table, "config", what)), **settings}
    _text(settings, "sampler", what)
    sweep = table.get("sweep", {})
    if not isinstance(sweep, Mapping) or not all(isinstance(values, list) and values for values in sweep.values()):
        raise BadSuiteError(f"{what}: sweep is {sweep!r}: expected a table with a list of values for each setting")
    if math.prod(len(values) for values in sweep.values()) > LARGEST:
        raise BadSuiteError(f"{what}: its sweep has more than {LARGEST} combinations of values: expected fewer")
    for values in itertools.product(*sweep.values()):
        chosen = dict(zip(sweep, values, strict=True))
        name = _filled_in(pattern, chosen, what)
        yield Method(name, {**settings, **chosen}, numbers, None if limited is None else tuple(limited), {**on})


def _filled_in(pattern: str, values: Mapping[str, Any], what: str) -> str:
    """A pattern with its ``{setting}``s filled in. Not by ``str.format``, whose fields may be as wide as they like."""

    def fill(match: re.Match[str]) -> str:
        found = match[0]
        if found in ("{{", "}}"):
            return found[0]
        if found[1:-1] not in values:
            raise BadSuiteError(f"{what}: the name may hold {{setting}} for a setting of its sweep alone.")
        return str(values[found[1:-1]])

    return re.sub(r"\{\{|\}\}|\{[^{}]*\}|[{}]", fill, pattern)


def _frozen(value: Any) -> Any:
    return tuple(_frozen(part) for part in value) if isinstance(value, list) else value


def _scene_dict(scene: Scene) -> dict[str, Any]:
    table: dict[str, Any] = {"name": scene.name}
    if scene.renderer is None:
        table["recording"] = scene.source
    else:
        if scene.source != scene.name or scene.source not in scenes.names():
            table["file"] = scene.source
        table |= {"renderer": scene.renderer, "size": list(scene.size or ())}
    for kind in _BUDGETS:
        values = [budget.value for budget in scene.budgets if budget.kind == kind]
        if values:
            table[kind] = values
    if scene.reference_spp:
        table["reference_spp"] = scene.reference_spp
    for name in ("reference_noise", "recorded_spp"):
        if getattr(scene, name) is not None:
            table[name] = getattr(scene, name)
    if scene.options:
        table["options"] = dict(scene.options)
    if scene.crops:
        table["crops"] = {name: list(sides) for name, sides in scene.crops}
    return table


def _method_dict(method: Method) -> dict[str, Any]:
    limited = {} if method.scenes is None else {"scenes": list(method.scenes)}
    on = {"on": {scene: dict(settings) for scene, settings in method.on.items()}} if method.on else {}
    # A name that was filled in once is not to be filled in again.
    name = method.name.replace("{", "{{").replace("}", "}}")
    return {"name": name, "numbers": method.numbers, **method.settings, **limited, **on}


def _tables(given: Mapping[str, Any], key: str) -> Sequence[Mapping[str, Any]]:
    tables = given.get(key)
    if not isinstance(tables, list) or not tables or not all(isinstance(table, Mapping) for table in tables):
        raise BadSuiteError(f"the suite has no {key}s: expected one or more tables [[{key}]]")
    return tables


def _known(table: Mapping[str, Any], known: set[str], what: str) -> None:
    for key in table:
        _one_of(f"{what} has an unknown key; a key", key, sorted(known))


def _one_of(what: str, value: Any, allowed: Sequence[str]) -> None:
    if value not in allowed:
        near = difflib.get_close_matches(str(value), allowed, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise BadSuiteError(f"{what} is {value!r}: expected one of {', '.join(allowed)}{hint}")


def _distinct(what: str, names: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for name in names:
        if not slug(name):
            raise BadSuiteError(f"{what}: {name!r} has no letter or digit to name a file by.")
        if slug(name) in seen:
            raise BadSuiteError(
                f"{what}: {seen[slug(name)]!r} and {name!r} would share files: give them names that differ in "
                "letters or digits."
            )
        seen[slug(name)] = name


def _text(table: Mapping[str, Any], key: str, what: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or not value.strip():
        came = "is missing" if key not in table else f"is {value!r}"
        raise BadSuiteError(f"{what}: `{key}` {came}: expected a text")
    return value


def _list(table: Mapping[str, Any], key: str, what: str) -> list[Any]:
    value = table.get(key, [])
    if not isinstance(value, list):
        raise BadSuiteError(f"{what}: `{key}` is {value!r}: expected a list of numbers above 0")
    return value


def _positive(key: str, value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise BadSuiteError(f"{what}: `{key}` is {value!r}: expected a number above 0")
    return float(value)


def _whole(table: Mapping[str, Any], key: str, low: int, what: str) -> int:
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        came = "is missing" if key not in table else f"is {value!r}"
        raise BadSuiteError(f"{what}: `{key}` {came}: expected a whole number from {low}")
    return value


def _size(table: Mapping[str, Any], what: str) -> tuple[int, int]:
    value = table.get("size")
    if (
        not isinstance(value, list)
        or len(value) != 2
        or not all(isinstance(side, int) and not isinstance(side, bool) and 0 < side < 65536 for side in value)
    ):
        came = "is missing" if "size" not in table else f"is {value!r}"
        raise BadSuiteError(f"{what}: `size` {came}: expected [width, height] in pixels, such as [320, 240]")
    return value[0], value[1]
