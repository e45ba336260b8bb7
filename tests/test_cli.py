"""The command line: what it writes, what it says and what it refuses. Exact throughout.

Most tests put a renderer that costs nothing in the place of the real ones; the last ones drive Mitsuba.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import types
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval import images, recorded

import pmc_sampler
from pmc_sampler import Budget, Config, adapters, render
from pmc_sampler.cli import main

pytestmark = pytest.mark.needs("OpenImageIO")

WIDTH, HEIGHT = 80, 60  # a batch holds one sample a pixel


class Lamp:
    """Radiance that grows to the right, lit one time in four; `before` gets the number of each batch."""

    takes_batch = True

    def __init__(
        self,
        width: int = WIDTH,
        height: int = HEIGHT,
        before: Callable[[int], None] | None = None,
        aovs: int = 0,
    ) -> None:
        self.width, self.height, self.before, self.aovs = width, height, before, aovs
        self.aov_names = [f"extra{k}" for k in range(aovs)]
        self.calls = 0

    def __call__(self, batch: Any) -> np.ndarray:
        if self.before is not None:
            self.before(self.calls)
        self.calls += 1
        lit = (batch.scramble ^ (batch.index * np.uint32(0x9E3779B9))) * np.uint32(0x7FEB352D) < 2**30
        value = np.where(lit, 4.0, 0.0) * (0.1 + batch.positions[:, 0] / self.width)
        return np.repeat(value[:, None].astype(np.float32), 3 + self.aovs, axis=1)


class Clock:
    """The clock of `render`, gone by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        from pmc_sampler.cli import render as command

        self._now, self._patch = 0.0, monkeypatch
        monkeypatch.setattr(command, "time", types.SimpleNamespace(perf_counter=lambda: self._now))

    def advance(self, seconds: float) -> None:
        self._now += seconds

    def loading_takes(self, seconds: float) -> None:
        """From now on, for the renderer that is in place."""
        load = adapters.load

        def slow(*words: Any, **options: Any) -> Any:
            self.advance(seconds)
            return load(*words, **options)

        self._patch.setattr(adapters, "load", slow)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@pytest.fixture
def lamp(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., list[dict[str, Any]]]:
    """Call it to put a Lamp in the place of every renderer; gives the list of what was asked for."""
    monkeypatch.chdir(tmp_path)

    def install(**settings: Any) -> list[dict[str, Any]]:
        asked: list[dict[str, Any]] = []

        def load(renderer: str, scene: str, **options: Any) -> Lamp:
            asked.append({"renderer": renderer, "scene": scene, **options})
            width, height = options.get("size") or (WIDTH, HEIGHT)
            return Lamp(width, height, **settings)

        monkeypatch.setattr(adapters, "load", load)
        return asked

    return install


def metadata(path: str | Path) -> dict[str, Any]:
    return {
        name.removeprefix("pmc:"): value
        for name, value in images.read(path).metadata.items()
        if name.startswith("pmc:")
    }


def test_render_writes_the_library_s_image(lamp: Callable[..., Any], tmp_path: Path) -> None:
    """The EXR holds the bits that `render` gives, the layers, and everything needed to make it again."""
    lamp()
    assert main(["render", "here", "--spp", "8", "--seed", "5", "-o", "a.exr"]) == 0
    film = render(Lamp(), WIDTH, HEIGHT, Budget(spp=8), seed=5).film
    image = images.read("a.exr")
    np.testing.assert_array_equal(image.rgb, film.mean)
    assert set(image.layers) == {"samples", "error", "strategy"}
    np.testing.assert_array_equal(image.layers["samples"], film.samples)
    np.testing.assert_array_equal(image.layers["error"], film.standard_error)
    np.testing.assert_array_equal(image.layers["strategy"], film.strategy)
    known = metadata("a.exr")
    assert json.loads(known["config"]) == Config().resolved(WIDTH, HEIGHT).to_dict()
    assert json.loads(known["budget"]) == {"spp": 8.0, "seconds": None, "visible_noise": None}
    assert (known["seed"], known["samples"]) == ("5", str(8 * WIDTH * HEIGHT))
    assert (known["scene"], known["method"], known["done"]) == ("here", "pmc", "spp")
    assert known["seconds.total"] >= known["seconds.renderer"] + known["seconds.sampler"] > 0
    assert json.loads(known["versions"])["pmc_sampler"] == pmc_sampler.__version__
    assert images.read("a.png").rgb.shape == (HEIGHT, WIDTH, 3)
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "a.png"]


def test_json_is_one_object_and_nothing_else(lamp: Callable[..., Any], capfd: pytest.CaptureFixture[str]) -> None:
    lamp()
    assert main(["render", "here", "--spp", "4", "--json"]) == 0
    out, err = capfd.readouterr()
    summary = json.loads(out)
    assert err == ""  # standard error is no terminal here
    assert summary["samples"] == 4 * WIDTH * HEIGHT
    assert summary["spp"] == 4.0
    assert set(summary["seconds"]) == {"setup", "total", "renderer", "sampler"}
    assert summary["rejected"] == 0
    assert 0.0 <= summary["visible_noise"] <= 1.0
    assert summary["done"] == "spp"
    assert (summary["output"], summary["preview"]) == ("here.exr", "here.png")


def test_words_name_the_files_and_the_times(lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]) -> None:
    lamp()
    assert main(["render", "some/scene.xml", "--spp", "2"]) == 0
    out = capsys.readouterr().out
    assert "2 samples per pixel" in out
    assert "s of setup" in out
    assert "scene.exr and scene.png are written." in out


def test_warnings_are_one_line(
    lamp: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lamp()
    load = adapters.load

    def wary(*words: Any, **options: Any) -> Any:
        warnings.warn("here: the sun\nis left out", stacklevel=2)
        return load(*words, **options)

    monkeypatch.setattr(adapters, "load", wary)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        shown = warnings.showwarning
        assert main(["render", "here", "--spp", "2"]) == 0
        assert warnings.showwarning is shown
    assert capsys.readouterr().err == "pmc-sampler render: warning: here: the sun is left out\n"


def test_setup_is_timed_by_itself(lamp: Callable[..., Any], clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """A clock that goes by hand: 5 s while the scene is loaded, 3 s in each batch."""
    lamp(before=lambda batch: clock.advance(3.0))
    clock.loading_takes(5.0)
    assert main(["render", "here", "--spp", "2", "--json"]) == 0
    seconds = json.loads(capsys.readouterr().out)["seconds"]
    assert seconds["setup"] == 5.0
    assert seconds["total"] == seconds["renderer"] > 0.0
    assert seconds["renderer"] % 3.0 == seconds["sampler"] == 0.0


@pytest.mark.parametrize(
    ("method", "config"),
    [("pmc", Config()), ("pt", Config.uniform()), ("pmc-paper", Config.paper(population=4000))],
)
def test_methods_are_the_library_s(method: str, config: Config, lamp: Callable[..., Any], tmp_path: Path) -> None:
    lamp()
    (tmp_path / "c.toml").write_text("population = 4000" if method == "pmc-paper" else "")
    words = ["render", "here", "--method", method, "--spp", "30", "--config", "c.toml", "-o", "a.exr"]
    assert main(words) == 0
    assert json.loads(metadata("a.exr")["config"]) == config.resolved(WIDTH, HEIGHT).to_dict()
    film = render(Lamp(), WIDTH, HEIGHT, Budget(spp=30), config).film
    np.testing.assert_array_equal(images.read("a.exr").rgb, film.mean)


def test_a_config_file_replaces_settings(lamp: Callable[..., Any], tmp_path: Path) -> None:
    lamp()
    (tmp_path / "c.toml").write_text("pool_share = 0.5\nradii = [2, 4]\n")
    assert main(["render", "here", "--spp", "6", "--config", "c.toml", "-o", "a.exr"]) == 0
    assert (
        json.loads(metadata("a.exr")["config"])
        == Config(pool_share=0.5, radii=(2, 4)).resolved(WIDTH, HEIGHT).to_dict()
    )
    (tmp_path / "c.toml").write_text('preset = "uniform"\n')
    assert main(["render", "here", "--spp", "6", "--config", "c.toml", "-o", "a.exr"]) == 0
    assert json.loads(metadata("a.exr")["config"]) == Config.uniform().resolved(WIDTH, HEIGHT).to_dict()


def test_the_renderer_gets_what_was_asked_for(lamp: Callable[..., Any]) -> None:
    asked = lamp()
    words = [
        "render",
        "x.xml",
        "--renderer",
        "some",
        "--sampler",
        "independent",
        "--size",
        "70x65",
        "--spp",
        "1",
    ]
    assert main(words) == 0
    assert asked == [{"renderer": "some", "scene": "x.xml", "sampler": "independent", "size": (70, 65)}]
    assert images.read("x.exr").rgb.shape == (65, 70, 3)


def test_the_seed_is_the_image(lamp: Callable[..., Any]) -> None:
    lamp()
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert main(["render", "here", "--spp", "4", "--seed", seed, "-o", f"{name}.exr"]) == 0
    a, b, c = (images.read(f"{name}.exr").rgb for name in "abc")
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_budgets(lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]) -> None:
    """64 samples per pixel unless a limit is given; the first that is met ends the render."""
    lamp()
    done = {}
    for words in (
        (),
        ("--seconds", "1e-9"),
        ("--visible-noise", "0.9999", "--spp", "10000", "--size", "16x12"),
        ("--spp", "2.5"),
    ):
        assert main(["render", "here", "--json", *words]) == 0
        summary = json.loads(capsys.readouterr().out)
        done[words[:1]] = (summary["done"], summary["spp"])
    assert done[()] == ("spp", 64.0)
    assert done[("--seconds",)][0] == "seconds"
    assert done[("--visible-noise",)][0] == "visible_noise"
    assert done[("--spp",)] == ("spp", 2.5)


def test_seconds_include_the_set_up(lamp: Callable[..., Any], clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """A clock that goes by hand says that loading took all of a budget: one batch is left, and a resumed one adds its
    own. With a second less than a budget of days the render ends by its samples.
    """
    lamp()
    clock.loading_takes(1e6)
    for seconds, spp, done in (("1e6", 1.0, "seconds"), ("2e6", 3.0, "spp")):
        assert main(["render", "here", "--seconds", seconds, "--spp", "3", "--json"]) == 0
        summary = json.loads(capsys.readouterr().out)
        assert (summary["spp"], summary["done"], summary["seconds"]["setup"]) == (spp, done, 1e6)


def test_extra_channels_become_layers(lamp: Callable[..., Any]) -> None:
    lamp(aovs=2)
    assert main(["render", "here", "--spp", "4", "-o", "a.exr"]) == 0
    layers = images.read("a.exr").layers
    assert set(layers) == {"samples", "error", "strategy", "extra0", "extra1"}
    assert layers["extra0"].shape == (HEIGHT, WIDTH)


def test_rejected_samples_are_counted(
    lamp: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lamp()
    honest = Lamp.__call__

    def sick(self: Lamp, batch: Any) -> np.ndarray:
        values = honest(self, batch)
        values[:7] = np.nan
        return values

    monkeypatch.setattr(Lamp, "__call__", sick)
    assert main(["render", "here", "--spp", "2"]) == 0
    assert "14 samples were rejected" in capsys.readouterr().out
    assert metadata("here.exr")["rejected"] == "14"


BAD = [
    ("render", "required: SCENE"),
    ("render ''", "'' is no scene; give a built-in scene's name or a scene file"),
    ("render .", "'.' is no scene"),
    ("record '' --per-pixel 4 -o a.h5", "'' is no scene"),
    ("render here --size 0x4", "'0x4' is no size"),
    ("render here --size 4", "640x480"),
    ("render here --size 4x4x4", "640x480"),
    ("render here --size 99999x9", "the image is 99999x9: expected 1 to 65535"),
    ("render here --spp 0", "not a number above 0"),
    ("render here --spp nan", "not a number above 0"),
    ("render here --spp many", "not a number above 0"),
    ("render here --seconds -1", "above 0"),
    ("render here --visible-noise 2", "share"),
    ("render here --visible-noise 0", "not a share above 0 and below 1"),
    ("render here --seed -1", "no seed"),
    ("render here --seed 18446744073709551616", "no seed"),
    ("render here --seed 1.5", "no seed"),
    ("render here --method best", "best"),
    ("render here --sampler halton", "halton"),
    ("render here --config none.toml", "cannot be read"),
    ("render here --config bad.toml", "no TOML"),
    ("render here --config binary.toml", "no TOML"),
    ("render here --config unknown.toml", "unknown setting 'radius'"),
    ("render here --config wrong.toml", "pool_share"),
    (
        "render here --config large.toml",
        "a smaller population; give a larger image by --size, or population by --config",
    ),
    (
        "render here --method pmc-paper --size 40x30",
        "radii holds 50 pixels, beyond the image of 40x30: expected at most 40; give a larger image by --size, or "
        "radii by --config",
    ),
    ("render here --config pipe.toml", "'pipe.toml' cannot be read: it is no regular file"),
    ("render here --config folder.exr", "'folder.exr' cannot be read: it is no regular file"),
    ("render here --renderer mitsuba -- +K0.5", "the renderer 'mitsuba' takes no options after --: '+K0.5'"),
    ("render here -o a.png", ".exr file"),
    ("render here -o none/a.exr", "does not exist"),
    ("render here -o folder.exr", "is a folder"),
    ("render here -o taken.exr", "is a folder"),
    ("render here -o /proc/a.exr", "no file can be written"),
    ("render here --checkpoint none/state", "folder that exists"),
    ("render here --checkpoint folder.exr", "folder that exists"),
    ("render here --checkpoint /proc/state", "no file can be written"),
    ("render here --checkpoint bad.toml", "cannot be read"),
    ("render here --spp 1 --bogus", "--bogus"),
    ("compare a.exr", "REFERENCE"),
    ("compare none.exr none.exr", "no image file 'none.exr'"),
    ("compare bad.toml bad.toml", "none"),
    ("dance", "dance"),
    ("", "COMMAND"),
]


@pytest.mark.parametrize(("words", "sentence"), BAD, ids=[words or "nothing" for words, _ in BAD])
def test_bad_input_gets_one_sentence_and_status_2(
    words: str,
    sentence: str,
    lamp: Callable[..., Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def never(batch: int) -> None:
        pytest.fail("a sample was rendered before the input was refused")

    lamp(before=never)
    (tmp_path / "bad.toml").write_text("pool_share = = 1")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "unknown.toml").write_text("radius = 1")
    (tmp_path / "wrong.toml").write_text("pool_share = 2")
    (tmp_path / "large.toml").write_text("population = 999999")
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "taken.png").mkdir()
    os.mkfifo(tmp_path / "pipe.toml")
    before = sorted(os.listdir(tmp_path))
    try:
        status = main(shlex.split(words))
    except SystemExit as stop:
        status = int(stop.code or 0)
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert err.startswith("pmc-sampler")
    assert err.count("\n") == 1, f"one line was expected: {err}"
    assert sentence in err
    assert sorted(os.listdir(tmp_path)) == before


def test_what_a_renderer_says_of_a_scene_is_passed_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def load(renderer: str, scene: str, **options: Any) -> Any:
        raise RuntimeError("no LLVM here;\ninstall libllvm19")

    monkeypatch.setattr(adapters, "load", load)
    assert main(["render", "here"]) == 2
    assert capsys.readouterr().err == "pmc-sampler render: no LLVM here; install libllvm19\n"


def interrupt_at(batch: int, number: int = signal.SIGINT) -> Callable[[int], None]:
    def before(calls: int) -> None:
        if calls == batch:
            os.kill(os.getpid(), number)

    return before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_finishes_the_batch_and_writes(
    number: int, lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    lamp(before=interrupt_at(2, number))
    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    assert main(["render", "here", "--spp", "9"]) == 130
    err = capsys.readouterr().err
    assert "interrupted. here.exr holds the 3 samples per pixel until then." in err
    assert metadata("here.exr")["done"] == "interrupted"
    assert images.read("here.exr").layers["samples"].sum() == 3 * WIDTH * HEIGHT
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers


def test_ctrl_c_before_the_first_batch_writes_nothing(
    lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def before(calls: int) -> None:
        raise KeyboardInterrupt

    lamp(before=before)
    assert main(["render", "here", "--spp", "9"]) == 130
    assert "before the first sample" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("hard", [False, True], ids=["once", "twice"])
def test_an_interrupted_render_resumes_to_the_same_bits(
    hard: bool, lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second Ctrl-C stops within a batch; that batch is drawn again."""

    def before(calls: int) -> None:
        if calls == 4:
            for _ in range(2 if hard else 1):
                os.kill(os.getpid(), signal.SIGINT)

    words = ["render", "here", "--spp", "12", "--checkpoint", "state"]
    lamp()
    assert main([*words[:-2], "-o", "whole.exr"]) == 0
    lamp(before=before)
    assert main([*words, "-o", "a.exr"]) == 130
    assert "the same command goes on from state" in capsys.readouterr().err
    adaptive = 4096  # the first four batches give every pixel a sample each, the fifth is the least there is
    assert images.read("a.exr").layers["samples"].sum() == 4 * WIDTH * HEIGHT + (0 if hard else adaptive)
    assert {"state"} <= set(os.listdir(tmp_path))
    lamp()
    assert main([*words, "-o", "a.exr"]) == 0
    np.testing.assert_array_equal(images.read("a.exr").rgb, images.read("whole.exr").rgb)
    assert not {"state"} & set(os.listdir(tmp_path))


@pytest.mark.parametrize("chosen", [True, False], ids=["chosen", "by itself"])
def test_checkpoints_are_written_by_time(chosen: bool, lamp: Callable[..., Any], tmp_path: Path) -> None:
    """A process that is killed loses what came after the last one: here, with no time between, one batch."""

    class Killed(BaseException):
        pass

    def before(calls: int) -> None:
        if calls == 4:
            raise Killed

    words = ["render", "here", "--spp", "12", "--checkpoint-every", "1e-9", "-o", "a.exr"]
    words += ["--checkpoint", "state"] if chosen else []
    lamp(before=before)
    with pytest.raises(Killed):
        main(words)
    kept = tmp_path / ("state" if chosen else "a.exr.checkpoint")
    assert os.listdir(tmp_path) == [kept.name]
    state = pmc_sampler.Sampler.load(kept)
    assert state.samples == 4 * WIDTH * HEIGHT
    left = kept.with_name(f"{kept.name}.x.part")  # as by one that is killed while it writes
    left.touch()
    lamp()
    assert main(words) == 0
    film = render(Lamp(), WIDTH, HEIGHT, Budget(spp=12)).film
    np.testing.assert_array_equal(images.read("a.exr").rgb, film.mean)
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "a.png"]


def test_a_short_render_keeps_no_state_by_itself(lamp: Callable[..., Any], tmp_path: Path) -> None:
    lamp(before=interrupt_at(2))
    assert main(["render", "here", "--spp", "9"]) == 130
    assert sorted(os.listdir(tmp_path)) == ["here.exr", "here.png"]


def test_a_checkpoint_that_cannot_be_written_ends_no_render(
    lamp: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A disk that is full for three batches of five: each is told of, the older state stays, the image is the same."""
    fsync, calls = os.fsync, []

    def full(file: int) -> None:
        calls.append(file)
        if 2 <= len(calls) <= 4:
            raise OSError(28, "No space left on device")
        fsync(file)

    kept: list[int] = []

    def before(calls: int) -> None:
        if calls:
            kept.append(pmc_sampler.Sampler.load(tmp_path / "state").samples // (WIDTH * HEIGHT))

    lamp(before=before)
    monkeypatch.setattr(os, "fsync", full)
    words = ["render", "here", "--method", "pt", "--spp", "6", "--checkpoint-every", "1e-9", "--checkpoint", "state"]
    assert main(words) == 0
    err = capsys.readouterr().err
    assert err.count("'state' cannot be written: No space left on device; rendering goes on, and tries again in") == 3
    assert kept == [1, 1, 1, 1, 5]
    assert images.read("here.exr").layers["samples"].min() == 6


def test_an_image_that_cannot_be_written_is_kept_as_state(
    lamp: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same command, once there is room, writes it without rendering anything."""
    lamp()
    replace = os.replace

    def full(source: Any, target: Any) -> None:
        if str(target).endswith(".exr"):
            raise OSError(28, "No space left on device")
        replace(source, target)

    words = ["render", "here", "--spp", "3"]
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        assert main(words) == 1
    err = capsys.readouterr().err
    assert "No space left on device; the same command goes on from here.exr.checkpoint." in err
    assert os.listdir(tmp_path) == ["here.exr.checkpoint"]

    def never(batch: int) -> None:
        pytest.fail("a sample was rendered again")

    lamp(before=never)
    assert main(words) == 0
    np.testing.assert_array_equal(images.read("here.exr").rgb, render(Lamp(), WIDTH, HEIGHT, Budget(spp=3)).film.mean)
    assert sorted(os.listdir(tmp_path)) == ["here.exr", "here.png"]


def test_a_state_whose_settings_are_not_what_was_noted_is_refused(
    lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The note may say what it likes: what would be rendered counts."""
    lamp(before=interrupt_at(1))
    words = ["render", "here", "--spp", "12", "--checkpoint", "state"]
    assert main(words) == 130
    note = pmc_sampler.Sampler.load(tmp_path / "state").note
    other = pmc_sampler.Sampler(WIDTH, HEIGHT, Budget(spp=12), Config(batch=2**31), seed=0)
    other.note = note
    other.save(tmp_path / "state")
    lamp()
    assert main(words) == 2
    assert "of another render: config was" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (["other", "--spp", "12"], "scene"),
        (["here", "--spp", "13"], "budget"),
        (["here", "--spp", "12", "--seed", "1"], "seed"),
        (["here", "--spp", "12", "--size", "81x60"], "size"),
        (["here", "--spp", "12", "--method", "pt"], "config"),
        (["here", "--spp", "12", "--sampler", "independent"], "sampler"),
        (["here", "--spp", "12", "--renderer", "other"], "renderer"),
    ],
)
def test_a_checkpoint_of_another_render_is_refused(
    changed: list[str],
    name: str,
    lamp: Callable[..., Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lamp(before=interrupt_at(1))
    assert main(["render", "here", "--spp", "12", "--checkpoint", "state"]) == 130
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    capsys.readouterr()
    lamp()
    assert main(["render", *changed, "--checkpoint", "state"]) == 2
    assert f"of another render: {name} was" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("changed", ["a.xml", "mesh.ply"])
def test_a_checkpoint_of_a_changed_scene_file_is_refused(
    changed: str, lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.xml").write_text('<string name="filename" value="mesh.ply"/>')
    (tmp_path / "mesh.ply").write_text("one")
    lamp(before=interrupt_at(1))
    words = ["render", "a.xml", "--spp", "12", "--checkpoint", "state"]
    assert main(words) == 130
    (tmp_path / changed).write_text("two")
    lamp()
    assert main(words) == 2
    assert "contents of the scene was" in capsys.readouterr().err


def test_a_damaged_checkpoint_is_refused(
    lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lamp(before=interrupt_at(1))
    words = ["render", "here", "--spp", "12", "--checkpoint", "state"]
    assert main(words) == 130
    state = tmp_path / "state"
    state.write_bytes(state.read_bytes()[:-200])
    lamp()
    capsys.readouterr()
    assert main(words) == 2
    assert "delete it to begin anew" in capsys.readouterr().err


def test_a_renderer_that_fails_leaves_what_was_sampled(
    lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    def before(calls: int) -> None:
        if calls == 3:
            raise RuntimeError("the device was lost")

    lamp(before=before)
    assert main(["render", "here", "--spp", "9"]) == 1
    err = capsys.readouterr().err
    assert "the device was lost" in err
    assert "here.exr holds the 3 samples per pixel until then" in err
    assert metadata("here.exr")["done"] == "failed"
    assert images.read("here.exr").layers["samples"].sum() == 3 * WIDTH * HEIGHT


class Mute:
    """What is no radiance."""


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (lambda values: values[:-1], "got radiance of shape"),
        (lambda values: values[:, :2], "got radiance of shape"),
        (lambda values: None, "got radiance of shape ()"),
        (lambda values: Mute(), "got radiance of shape ()"),
        (lambda values: values.astype(int), "got radiance of type int64"),
        (lambda values: values * np.nan, "samples of batch 3 are NaN"),
    ],
    ids=["short", "narrow", "None", "object", "integers", "NaN"],
)
def test_a_renderer_that_answers_amiss_leaves_what_was_sampled(
    answer: Callable[[np.ndarray], Any],
    sentence: str,
    lamp: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    honest = Lamp.__call__

    def sick(self: Lamp, batch: Any) -> Any:
        values = honest(self, batch)
        return answer(values) if self.calls == 4 else values

    lamp()
    words = ["render", "here", "--spp", "9", "--checkpoint", "state"]
    with monkeypatch.context() as patch:
        patch.setattr(Lamp, "__call__", sick)
        assert main(words) == 1
    err = capsys.readouterr().err
    assert sentence in err
    assert "here.exr holds the 3 samples per pixel until then; the same command goes on from state." in err
    assert main(words) == 0
    np.testing.assert_array_equal(images.read("here.exr").rgb, render(Lamp(), WIDTH, HEIGHT, Budget(spp=9)).film.mean)


def test_a_renderer_that_hangs_is_given_up(lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]) -> None:
    """It answers once the test lets it; the time-out is long beside what a batch of a Lamp takes."""
    go_on = threading.Event()

    def before(calls: int) -> None:
        if calls == 3:
            go_on.wait()

    words = ["render", "here", "--spp", "9", "--checkpoint", "state", "--timeout"]
    lamp(before=before)
    try:
        assert main([*words, "1"]) == 1
    finally:
        go_on.set()
    err = capsys.readouterr().err
    assert "rendering failed: the renderer gave no answer within 1 s. here.exr holds the 3 samples per pixel" in err
    lamp()
    assert main([*words, "60"]) == 0
    np.testing.assert_array_equal(images.read("here.exr").rgb, render(Lamp(), WIDTH, HEIGHT, Budget(spp=9)).film.mean)


def test_a_hung_renderer_does_not_keep_the_process(tmp_path: Path) -> None:
    """A thread that never ends, and work at the interpreter's end that waits for it: the command ends by itself."""
    program = f"""
import atexit, sys, threading
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pmc_sampler import adapters
from pmc_sampler.cli import main
from test_cli import Lamp
never = threading.Event()
def before(calls):
    if calls == 1:
        atexit.register(never.wait)
        never.wait()
adapters.load = lambda *words, **options: Lamp(before=before)
sys.argv[1:] = ["render", "here", "--spp", "9", "--timeout", "1"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert (done.returncode, "holds the 1 samples per pixel" in done.stderr) == (1, True), done.stderr
    assert sorted(os.listdir(tmp_path)) == ["here.exr", "here.png"]


def test_a_failed_render_resumes_too(lamp: Callable[..., Any], capsys: pytest.CaptureFixture[str]) -> None:
    def before(calls: int) -> None:
        if calls == 3:
            raise RuntimeError("the device was lost")

    words = ["render", "here", "--spp", "9", "--checkpoint", "state"]
    lamp(before=before)
    assert main(words) == 1
    assert "the same command goes on from state" in capsys.readouterr().err
    lamp()
    assert main(words) == 0
    np.testing.assert_array_equal(images.read("here.exr").rgb, render(Lamp(), WIDTH, HEIGHT, Budget(spp=9)).film.mean)


def test_a_renderer_that_fails_at_once_leaves_nothing(
    lamp: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def before(calls: int) -> None:
        raise RuntimeError("the device was lost")

    lamp(before=before)
    assert main(["render", "here", "--spp", "9"]) == 1
    assert "the device was lost" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_a_failed_write_leaves_the_old_image(
    lamp: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lamp()
    assert main(["render", "here", "--spp", "2"]) == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert main(["render", "here", "--spp", "3"]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("words", [["render", "here"], ["compare", "a.exr", "b.exr"]])
def test_a_missing_library_names_the_extra(
    words: list[str],
    lamp: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lamp()
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    assert main(words) == 2
    assert "pip install 'pmc-sampler[eval]'" in capsys.readouterr().err


def test_progress_is_drawn_on_a_terminal(
    lamp: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lamp()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert main(["render", "here", "--spp", "3", "--json"]) == 0
    out, err = capsys.readouterr()
    json.loads(out)
    assert "here, pmc" in err
    assert "loading" in err
    assert "100%" in err
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    assert main(["render", "here", "--spp", "3"]) == 0
    assert "pip install 'pmc-sampler[cli]'" in capsys.readouterr().err


def test_compare_prints_every_metric(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    image = np.random.default_rng(1).random((16, 20, 3))
    images.write_exr("a.exr", image)
    images.write_exr("b.exr", 1.1 * image)
    assert main(["compare", "b.exr", "a.exr"]) == 0
    table = {line[:22].strip(): line for line in capsys.readouterr().out.splitlines()}
    assert {"tvi error", "MSE", "PSNR", "SSIM", "relMSE", "SMAPE", "HDR-FLIP", "bias"} <= set(table)
    assert "white_luminance_cd_m2 100" in table["tvi error"]
    assert "epsilon 0.01" in table["relMSE"]
    assert float(table["bias"].split()[1]) == pytest.approx(0.1, rel=1e-5)
    assert main(["compare", "b.exr", "a.exr", "--json", "--white-luminance", "10"]) == 0
    found = json.loads(capsys.readouterr().out)
    values = {row["name"]: row for row in found["metrics"]}
    assert values["tvi error"]["constants"] == {"white_luminance_cd_m2": 10.0}
    assert values["bias"]["value"] == pytest.approx(0.1, rel=1e-5)
    assert main(["compare", "a.exr", "a.exr", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["metrics"]
    assert {row["name"]: row["value"] for row in rows}["PSNR"] is None  # infinity is no JSON


def test_compare_subtracts_the_noise_that_a_reference_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of squared errors, and of no other; it says how much."""
    monkeypatch.chdir(tmp_path)
    ones = np.ones((16, 16, 3), np.float32)
    layers = {"variance": 0.25 * ones, "luminance_variance": np.full((16, 16), 0.125, np.float32)}
    for name, value, more in (("test", 2.0, {}), ("plain", 1.0, {}), ("noisy", 1.0, layers)):
        images.write_exr(tmp_path / f"{name}.exr", value * ones, more)
    values = {}
    for name in ("plain", "noisy"):
        assert main(["compare", "test.exr", f"{name}.exr", "--json"]) == 0
        summary = json.loads(capsys.readouterr().out)
        values[name] = {row["name"]: row["value"] for row in summary["metrics"]}
    assert values["noisy"]["MSE"] == pytest.approx(values["plain"]["MSE"] - 0.25)
    assert values["noisy"]["tvi error"] == pytest.approx(0.875 * values["plain"]["tvi error"])
    assert values["noisy"]["SSIM"] == values["plain"]["SSIM"]
    assert summary["subtracted"]["MSE"] == pytest.approx(0.25)
    assert main(["compare", "test.exr", "noisy.exr"]) == 0
    assert "The reference's own noise is subtracted: 0.25 of the MSE, " in capsys.readouterr().out


def test_compare_refuses_images_that_do_not_match(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    images.write_exr("a.exr", np.ones((4, 5, 3)))
    images.write_exr("b.exr", np.ones((4, 6, 3)))
    images.write_exr("c.exr", np.full((4, 5, 3), np.nan))
    assert main(["compare", "a.exr", "b.exr"]) == 2
    assert "5x4" in capsys.readouterr().err
    assert main(["compare", "c.exr", "a.exr"]) == 2
    assert "not finite" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["compare", "a.exr", "a.exr", "--maps", "file"]) == 2
    assert "'file' for maps cannot be made" in capsys.readouterr().err


def test_compare_writes_maps_and_says_what_it_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    image = np.random.default_rng(1).random((16, 20, 3))
    images.write_exr("a.exr", image)
    images.write_png("b.png", image)
    assert main(["compare", "b.png", "a.exr", "--maps", "maps"]) == 0
    out = capsys.readouterr().out
    assert "b.png holds display-encoded values: they were decoded as sRGB" in out
    assert "a.exr holds" not in out
    assert "written in 'maps'" in out
    assert (tmp_path / "maps" / "tvi_error.exr").is_file()
    assert main(["compare", "b.png", "a.exr", "--json", "--maps", "maps"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["decoded_from_srgb"] == ["b.png"]
    assert sorted(found["maps"]) == sorted(str(Path("maps") / name) for name in os.listdir("maps"))


def test_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {"cornell-box", "cornell-box-mirrors", "diffuse", "thin-lens"} <= {line.split()[0] for line in lines}
    assert main(["scenes", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["scenes"]
    assert [row["name"] for row in found] == [line.split()[0] for line in lines]
    assert all(row["description"].endswith(".") for row in found)


def test_renderers_are_listed_with_what_they_lack(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [
        adapters.Availability("one", "One 1.0 on a CPU"),
        adapters.Availability("two", None, "no LLVM; install libllvm19"),
    ]
    monkeypatch.setattr(adapters, "available", lambda: found)
    assert main(["renderers"]) == 0
    out = capsys.readouterr().out
    assert "one  One 1.0 on a CPU\n" in out
    assert "two  cannot run here: no LLVM; install libllvm19\n" in out
    assert main(["renderers", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["renderers"]
    assert [(row["name"], row["runs"]) for row in rows] == [("one", True), ("two", False)]


def test_help_and_version_go_to_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--help"], ["render", "--help"], ["--version"]):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 0
        out, err = capsys.readouterr()
        assert out
        assert err == ""
    assert pmc_sampler.__version__ in out


@pytest.mark.needs("mitsuba", "pyopencl")
@pytest.mark.parametrize("renderer", ["mitsuba", "opencl"])
def test_a_scene_by_every_method(
    renderer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A built-in scene by name and the same as a file are one image; the methods are three."""
    from pmc_sampler import scenes

    monkeypatch.chdir(tmp_path)
    (tmp_path / "copy.xml").write_bytes(scenes.path("cornell-box").read_bytes())
    (tmp_path / "paper.toml").write_text("population = 1000\n")
    common = ["--renderer", renderer, "--size", "64x48", "--spp", "8", "--json"]
    for name, words in {
        "pmc": ["cornell-box"],
        "file": ["copy.xml"],
        "pt": ["cornell-box", "--method", "pt"],
        "independent": ["cornell-box", "--method", "pt", "--sampler", "independent"],
        "paper": ["cornell-box", "--method", "pmc-paper", "--config", "paper.toml"],
    }.items():
        assert main(["render", *words, *common, "-o", f"{name}.exr"]) == 0
        summary = json.loads(capsys.readouterr().out)
        assert summary["samples"] == 8 * 64 * 48
        assert summary["seconds"]["renderer"] > 0
    image = {name: images.read(f"{name}.exr") for name in ("pmc", "file", "pt", "independent", "paper")}
    np.testing.assert_array_equal(image["pmc"].rgb, image["file"].rgb)
    assert (image["pt"].layers["samples"] == 8).all()
    assert image["pmc"].layers["samples"].std() > 0
    assert (image["pt"].rgb != image["independent"].rgb).any()
    assert renderer in json.loads(metadata("pmc.exr")["versions"])


@pytest.mark.needs("mitsuba", "pyopencl")
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("render cornell-bix", "did you mean 'cornell-box'"),
        ("render none.xml", "none.xml"),
        ("render broken.xml", "broken.xml"),
        ("render picture.gif", "picture.gif"),
        ("render pipe.xml", "'pipe.xml' is no regular file"),
        ("render pipe.xml --renderer mitsuba", "'pipe.xml' is no regular file"),
        ("render pipe.pov", "'pipe.pov' is no regular file"),
        ("render pipe.ini[final]", "'pipe.ini' is no regular file"),
        ("render cornell-box --renderer mitsuba3", "mitsuba"),
        ("render cornell-box --device teapot", "no OpenCL device is called 'teapot'"),
        ("render cornell-box --renderer mitsuba --device 0", "has no option 'device'"),
    ],
)
def test_bad_scenes_get_one_sentence(
    words: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.xml").write_text('<scene version="3.0.0"><shape type="cube">')
    (tmp_path / "picture.gif").write_text("")
    for suffix in ("xml", "pov", "ini"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
    before = sorted(os.listdir(tmp_path))
    assert main(words.split()) == 2
    err = capsys.readouterr().err
    assert sentence in err
    assert err.count("\n") == 1
    assert sorted(os.listdir(tmp_path)) == before


def test_the_installed_command_runs(tmp_path: Path) -> None:
    """The entry point, in a process of its own, its output a pipe that nobody reads to the end."""
    command = Path(sys.executable).with_name("pmc-sampler")
    result = subprocess.run([command, "scenes"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "cornell-box" in result.stdout
    assert result.stderr == ""
    refused = subprocess.run([command, "render", "here", "-o", "a.jpg"], cwd=tmp_path, capture_output=True, text=True)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert os.listdir(tmp_path) == []


def test_the_film_s_filter_is_the_image_s(lamp: Callable[..., Any], tmp_path: Path, monkeypatch: Any) -> None:
    """As the scene says, unless the settings say otherwise."""
    lamp()
    monkeypatch.setattr(Lamp, "filter", {"filter": "tent", "filter_radius": 1.5}, raising=False)
    assert main(["render", "here", "--spp", "2", "-o", "a.exr"]) == 0
    config = json.loads(metadata("a.exr")["config"])
    assert (config["filter"], config["filter_radius"]) == ("tent", 1.5)
    (tmp_path / "c.toml").write_text('filter = "box"\n')
    assert main(["render", "here", "--spp", "2", "--config", "c.toml", "-o", "b.exr"]) == 0
    config = json.loads(metadata("b.exr")["config"])
    assert (config["filter"], config["filter_radius"]) == ("box", None)


# --- Recording -------------------------------------------------------------------------------------------------------
RECORD = ["record", "cornell-box", "--size", "12x10", "--per-pixel", "8", "-o", "a.h5"]


def test_record_stores_samples_and_says_what_it_cost(lamp: Callable[..., Any], capsys: Any) -> None:
    asked = lamp()
    assert main([*RECORD, "--seed", "3"]) == 0
    assert asked == [{"renderer": "opencl", "scene": "cornell-box", "sampler": "sobol", "size": (12, 10)}]
    out = capsys.readouterr().out
    assert "cornell-box at 12x10, 8 samples a pixel: 960 samples in" in out
    assert "a.h5 holds" in out
    replay = recorded.Recording("a.h5")
    assert (replay.width, replay.height, replay.per_pixel, replay.settings["scene"]) == (12, 10, 8, "cornell-box")
    before = Path("a.h5").read_bytes()
    assert main([*RECORD, "--seed", "3"]) == 0
    assert "0 samples in" in capsys.readouterr().out
    assert main(RECORD) == 2
    assert "is another recording, whose seed is 3 and not 0" in capsys.readouterr().err
    assert Path("a.h5").read_bytes() == before


def test_record_resumes_after_an_interruption_or_a_failure(lamp: Callable[..., Any], capsys: Any) -> None:
    lamp()
    assert main(RECORD) == 0
    whole = Path("a.h5").read_bytes()
    Path("a.h5").unlink()

    def interrupt(call: int) -> None:
        if call == 2:
            raise KeyboardInterrupt

    def fail(call: int) -> None:
        if call == 3:
            raise RuntimeError("the lamp\nis out.")

    lamp(before=interrupt)
    capsys.readouterr()
    assert main(RECORD) == 130
    assert capsys.readouterr().err == "pmc-sampler record: interrupted; the same command goes on from a.h5.part.\n"
    lamp(before=fail)
    assert main(RECORD) == 1
    assert "recording failed: the lamp is out; the same command goes on from a.h5.part." in capsys.readouterr().err
    lamp()
    assert main(RECORD) == 0
    assert "360 samples in" in (out := capsys.readouterr().out)
    assert "5 a pixel were there before" in out
    assert Path("a.h5").read_bytes() == whole
    assert [path.name for path in Path().iterdir()] == ["a.h5"]
