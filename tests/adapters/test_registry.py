"""Renderers by name: the project's own, third parties', and those that cannot run. Exact."""

from __future__ import annotations

import os
import re
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


def entry_points(*points: metadata.EntryPoint) -> Any:
    """A stand-in for `metadata.entry_points` that knows these of our group."""

    def find(*, group: str, name: str | None = None) -> list[metadata.EntryPoint]:
        return [point for point in points if point.group == group and name in (None, point.name)]

    return find


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> type:
    """A renderer of somebody's, called `theirs`."""

    class Theirs:
        width, height, takes_batch = 4, 3, True

        def __init__(self, scene: str, quality: int = 1) -> None:
            self.scene, self.quality = scene, quality

        @classmethod
        def probe(cls) -> str:
            return "Theirs 2.0 on this machine"

    module = ModuleType("their_module")
    module.Theirs = Theirs  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "their_module", module)
    point = metadata.EntryPoint("theirs", "their_module:Theirs", "pmc_sampler.renderers")
    monkeypatch.setattr(metadata, "entry_points", entry_points(point))
    return Theirs


def test_our_own_need_no_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler import adapters

    monkeypatch.setattr(metadata, "entry_points", entry_points())
    assert "mitsuba" in adapters.names()


def test_a_third_partys_renderer(third_party: type) -> None:
    from pmc_sampler import adapters

    assert adapters.names() == sorted({"mitsuba", "theirs", *adapters._OWN})
    made = adapters.load("theirs", "a scene", quality=3)
    assert isinstance(made, third_party)
    assert (made.scene, made.quality) == ("a scene", 3)
    entry = next(entry for entry in adapters.available() if entry.name == "theirs")
    assert entry.runs
    assert entry.detail == "Theirs 2.0 on this machine"


def test_options_that_a_renderer_takes(third_party: type, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler import adapters

    assert [adapters.takes("theirs", name) for name in ("quality", "speed")] == [True, False]
    monkeypatch.setattr(third_party, "__init__", lambda self, scene, **options: None)
    assert adapters.takes("theirs", "speed")
    with pytest.raises(ValueError, match="no renderer is called 'nobody'"):
        adapters.takes("nobody", "speed")


def test_a_pipe_is_no_scene_file(third_party: type, tmp_path: Path) -> None:
    """Nobody writes into it, so that a renderer that opened it would wait for ever. A folder may be one."""
    from pmc_sampler import adapters

    os.mkfifo(tmp_path / "pipe")
    for scene in (tmp_path / "pipe", str(tmp_path / "pipe"), "/dev/null"):
        with pytest.raises(ValueError, match="is no regular file: copy what it gives into one, and name that"):
            adapters.load("theirs", scene)
    assert adapters.load("theirs", tmp_path).scene == tmp_path


def test_versions(third_party: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the class says, else the package of that name, else nothing."""
    from pmc_sampler import adapters

    assert adapters.version("theirs") == ""
    assert adapters.version("numpy") == metadata.version("numpy")
    monkeypatch.setattr(third_party, "version", classmethod(lambda cls: "2.0"), raising=False)
    assert adapters.version("theirs") == "2.0"


def test_a_version_is_of_the_adapters_code_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reference, a recording or a run that was made by other code is not taken for this one's."""
    from pmc_sampler import adapters

    assert re.fullmatch(r"adapter [0-9a-f]{12}", adapters.version("analytic"))
    for name, files in {"package": ("package/a.py", "package/kernels/b.cl"), "single": ("single.py",)}.items():
        for file in files:
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_text("one")
        for file in files:
            before = adapters._digest(tmp_path, name)
            assert adapters._digest(tmp_path, name) == before
            (tmp_path / file).write_text("two")
            assert adapters._digest(tmp_path, name) != before
    monkeypatch.setattr(adapters, "_digest", lambda folder, name: "other")
    assert adapters.version("analytic") == "adapter other"


def test_unknown_names_and_options(third_party: type) -> None:
    from pmc_sampler import adapters

    with pytest.raises(ValueError, match=r"no renderer is called 'mitsba'; there are .*did you mean 'mitsuba'\?"):
        adapters.load("mitsba", "cornell-box")
    with pytest.raises(TypeError, match="the renderer 'theirs' has no option 'qualty'; it has quality"):
        adapters.load("theirs", "a scene", qualty=3)


def test_a_renderer_that_cannot_run_is_listed_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler import adapters

    point = metadata.EntryPoint("broken", "no_such_module:Broken", "pmc_sampler.renderers")
    monkeypatch.setattr(metadata, "entry_points", entry_points(point))
    entry = next(entry for entry in adapters.available() if entry.name == "broken")
    assert not entry.runs
    assert entry.trouble == "No module named 'no_such_module'"
    with pytest.raises(RuntimeError, match="'broken' cannot run here"):
        adapters.load("broken", "cornell-box")


def test_mitsuba_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler import adapters

    for name in [name for name in sys.modules if name.startswith("pmc_sampler.adapters.mitsuba")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(adapters, "mitsuba", raising=False)
    monkeypatch.setitem(sys.modules, "mitsuba", None)  # type: ignore[arg-type]
    monkeypatch.setattr(metadata, "entry_points", entry_points())
    with pytest.raises(
        RuntimeError, match=r"'mitsuba' cannot run here: Mitsuba is not installed.*pmc-sampler\[mitsuba\]"
    ):
        adapters.load("mitsuba", "cornell-box")
    entry = next(entry for entry in adapters.available() if entry.name == "mitsuba")
    assert "pip install" in str(entry.trouble)


@pytest.mark.needs("mitsuba")
def test_mitsuba_is_listed_with_what_it_runs_on() -> None:
    from pmc_sampler import adapters

    entry = next(entry for entry in adapters.available() if entry.name == "mitsuba")
    assert entry.runs
    assert "llvm_ad_rgb" in str(entry.detail)
    assert "on LLVM" in str(entry.detail)
