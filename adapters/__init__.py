"""Renderers behind the sampler, found by name.

A renderer is a class in the entry-point group `pmc_sampler.renderers`, made from a scene and options. Its
instances have `width` and `height`, and are called with a `Batch` for the radiance of its samples, shape (n,
3 + aovs), float32, linear RGB. A class method `probe()`, if it has one, returns a line about what it runs on,
or raises RuntimeError with what is missing; a class method `version()`, if it has one, names what its images
depend on; a method `native(**settings)`, if its instances have one, renders the whole image by a way of its own
to choose samples, for comparison, and returns `mean`, `samples` and `seconds`; an attribute `remark`, if an instance
has one, is a sentence that the command line shows its user. Those of the project are found without an entry point, too.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from .inputs import check_regular

__all__ = ["Availability", "available", "load", "names", "native_settings", "takes", "version"]

GROUP = "pmc_sampler.renderers"
_CODE = {".py", ".cl"}  # what every installation has
_OWN = {  # module within this package, class
    "analytic": "analytic:AnalyticRenderer",
    "mitsuba": "mitsuba:MitsubaRenderer",
    "opencl": "opencl:OpenCLRenderer",
    "povray": "povray:PovRayRenderer",
}


@dataclass(frozen=True)
class Availability:
    """A renderer by name: what it runs on, or why it cannot run and what to install."""

    name: str
    detail: str | None
    trouble: str | None = None

    @property
    def runs(self) -> bool:
        """Whether it can render on this machine."""
        return self.trouble is None


def names() -> list[str]:
    """The names of all renderers, sorted, whether or not they can run here."""
    return sorted({*_OWN, *(point.name for point in metadata.entry_points(group=GROUP))})


def load(renderer: str, scene: Any, **options: Any) -> Any:
    """A renderer of `scene`: a callable from a `Batch` to radiance, with `width` and `height`.

    `scene` is a built-in scene's name, a file or what else that renderer takes; `options` go to its
    constructor. Raises ValueError for an unknown renderer, RuntimeError for one that cannot run here (with
    what to install), TypeError for an option it does not have, and what the renderer raises for the scene.
    """
    kind = _found(renderer)
    _check_options(renderer, kind, options)
    check_regular(scene)
    return kind(scene, **options)


def takes(renderer: str, option: str) -> bool:
    """Whether a renderer has that option of `load`. Raises as `load` does for the renderer."""
    known = _options(_found(renderer))
    return known is None or option in known


def native_settings(renderer: str) -> list[str]:
    """The names of the settings of a renderer's own sampling, its method `native`.

    Raises ValueError for a renderer that has none, and as `load`.
    """
    method = getattr(_found(renderer), "native", None)
    if method is None:
        raise ValueError(f"the renderer {renderer!r} has no sampling of its own to compare with")
    return [name for name in inspect.signature(method).parameters if name != "self"]


def available() -> list[Availability]:
    """All renderers, by name, each with what it runs on or why it does not."""
    result = []
    for name in names():
        try:
            kind = _found(name)
            detail = kind.probe() if hasattr(kind, "probe") else getattr(kind, "__module__", name)
            result.append(Availability(name, str(detail)))
        except Exception as error:  # a listing has to outlive whatever a third party's renderer does
            trouble = " ".join(str(error).split()).removeprefix(_cannot_run(name))
            result.append(Availability(name, None, trouble or type(error).__name__))
    return result


def version(renderer: str) -> str:
    """What the images of a renderer depend on besides the scene: what its class says, else the version of the Python
    package of that name, else nothing; for one of the project's own, a digest of its adapter's code, too.

    Raises RuntimeError for a renderer that cannot run here.
    """
    kind = _found(renderer) if renderer in names() else None
    if kind is not None and hasattr(kind, "version"):
        said = str(kind.version())
    else:
        try:
            said = metadata.version(renderer)
        except metadata.PackageNotFoundError:
            said = ""
    module = inspect.getmodule(kind)
    if renderer in _OWN and module is not None and module.__name__.startswith(f"{__name__}."):
        said = f"{said}, adapter {_digest(Path(__file__).parent, renderer)}".removeprefix(", ")
    return said


def _digest(folder: Path, name: str) -> str:
    """A short name for the code in a folder's module or package: a change in it may change the images."""
    package = folder / name
    files = sorted(path for path in package.rglob("*") if path.suffix in _CODE) or [package.with_suffix(".py")]
    whole = hashlib.sha256()
    for path in files:
        whole.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()[:12]


def _found(name: str) -> Callable[..., Any]:
    """The class or function that makes the renderer called `name`."""
    if name not in names():
        near = difflib.get_close_matches(str(name), names(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"no renderer is called {name!r}; there are {', '.join(names())}{hint}")
    try:
        for point in metadata.entry_points(group=GROUP, name=name):
            loaded: Callable[..., Any] = point.load()
            return loaded
        module, _, attribute = _OWN[name].partition(":")
        own: Callable[..., Any] = getattr(importlib.import_module(f".{module}", __name__), attribute)
        return own
    except (ImportError, AttributeError) as error:
        raise RuntimeError(f"{_cannot_run(name)}{error}") from error


def _cannot_run(name: str) -> str:
    return f"the renderer {name!r} cannot run here: "


def _options(kind: Callable[..., Any]) -> list[str] | None:
    """The options that a renderer's class or function has besides the scene; None where it takes any."""
    parameters = inspect.signature(kind).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return None
    return [option for option in parameters if option != "scene"]


def _check_options(name: str, kind: Callable[..., Any], options: dict[str, Any]) -> None:
    known = _options(kind)
    for option in options:
        if known is not None and option not in known:
            raise TypeError(f"the renderer {name!r} has no option {option!r}; it has {', '.join(known)}")
