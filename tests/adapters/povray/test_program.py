"""POV-Ray as a process: where it runs, how it ends, what it says. Exact, but where a time is named."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.needs("povray", "OpenImageIO")

TINY = ["+W8", "+H6", "+FE", "+Oimage.exr", "-A"]
ENDLESS = "#while (1) #end\n"


def test_a_scene_is_rendered_wherever_it_is(
    program: Any, plain_text: str, tmp_path: Path, clean: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Spaces and letters beyond ASCII in paths; a `povray.ini` beside the scene and in the working folder is not
    obeyed; what the scene includes is found; what it writes goes to the private folder."""
    from pmc_sampler.adapters.povray import images

    folder = tmp_path / "Szene mit Ümläuten 日本"
    (folder / "teile").mkdir(parents=True)
    (folder / "teile" / "ball.inc").write_text("#declare Colour = rgb 0.25;\n", encoding="utf-8")
    (folder / "povray.ini").write_text("Width=3\nOutput_File_Type=P\nInput_File_Name=nothing.pov\n")
    scene = folder / "Kugel é.pov"
    text = plain_text + '\n#include "ball.inc"\n#fopen F "left.txt" write #write(F, "x") #fclose F\n'
    scene.write_text(text, encoding="utf-8")
    monkeypatch.chdir(folder)
    with program.private_folder() as place:
        result = program.run(place, scene, TINY, 60, [folder / "teile"])
        assert result.error == ""
        assert (place / "left.txt").read_text() == "x"
        assert images.whole(place / "image.exr")
        assert images.read(place / "image.exr").shape == (6, 8, 3)
        assert 0 < result.cpu < result.seconds < 60
    assert sorted(path.name for path in folder.iterdir()) == ["Kugel é.pov", "povray.ini", "teile"]


def test_what_does_not_parse_gets_its_file_and_line(program: Any, tmp_path: Path, clean: None) -> None:
    (tmp_path / "part.inc").write_text("\n\nbox { Unknown }\n")
    cases = {
        "\nsphere { 0, 1 pigment { color Whte } }\n": r"File '{}' line 2: Parse Error: .* 'Whte' found instead",
        '#include "nothing.inc"\n': r"File '{}' line 1: .*Cannot find file 'nothing.inc', even after trying",
        '#include "part.inc"\n': r"File '.*/part.inc' line 3: Parse Error: .*undeclared identifier 'Unknown'",
        '#error "no such luck"\n': r"File '{}' line 1: Parse Error: .*no such luck",
    }
    with contextlib.ExitStack() as stack:
        processes = []
        for number, text in enumerate(cases):
            (scene := tmp_path / f"my scene {number}.pov").write_text(text)
            processes.append(program.Process(stack.enter_context(program.private_folder()), scene, TINY))
        for number, (process, message) in enumerate(zip(processes, cases.values(), strict=True)):
            result = process.wait(60)
            assert result.status == 1
            message = message.format(tmp_path / f"my scene {number}.pov")
            with pytest.raises(ValueError, match=r"^POV-Ray cannot render it: " + message):
                result.check("it")


def test_a_wrong_switch_is_an_error(program: Any, plain_text: str, clean: None) -> None:
    with program.private_folder() as folder:
        assert "Failed to parse command-line option" in program.run(folder, plain_text, ["+Nonsense"], 60).messages


def test_an_endless_scene_is_ended(program: Any, clean: None) -> None:
    began = time.perf_counter()
    with program.private_folder() as folder, pytest.raises(TimeoutError, match=r"within 0.7 seconds and was ended"):
        program.run(folder, ENDLESS, TINY, 0.7)
    assert time.perf_counter() - began < 10


def test_one_that_is_killed_is_an_error(program: Any, appears: Callable[[], bool], clean: None) -> None:
    with program.private_folder() as folder:
        process = program.Process(folder, ENDLESS, TINY)
        assert appears()  # the negative control of what `clean` asserts
        threading.Timer(0.3, os.kill, (process._process.pid, signal.SIGKILL)).start()
        result = process.wait(30)
        assert result.error == "POV-Ray was ended by the signal SIGKILL (out of memory?)"
        with pytest.raises(ValueError, match="SIGKILL"):
            result.check("it")


def test_memory_that_runs_out_is_an_error(program: Any, clean: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "_WATCHED", "ulimit -v 600000; " + program._WATCHED)
    text = (
        "#declare A = array[100000000]; #declare I = 0; #while (1) #declare A[I] = <1, 2, 3>; #declare I = I + 1; #end"
    )
    with program.private_folder() as folder:
        # As a rule it says so; for its messages, too, memory may be wanting.
        error = program.run(folder, text, TINY, 60).error
        assert re.search(r"std::bad_alloc \(out of memory\)$|before it said why \(out of memory\?\)$", error)


def test_a_scene_that_writes_without_end_is_ended(program: Any, clean: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the size that a file may have: 64 KiB here. Below it, it is left alone."""
    blocks = f"ulimit -f {program._FILE_BLOCKS};"
    assert program._WATCHED.startswith(blocks)
    monkeypatch.setattr(program, "_WATCHED", program._WATCHED.replace(blocks, "ulimit -f 128;"))
    line = '#write (F, "' + 63 * "x" + '\n")'
    text = '#fopen F "big.txt" write #declare I = 0; #while (I < {}) ' + line + " #declare I = I + 1; #end #fclose F\n"
    with program.private_folder() as folder:
        result = program.run(folder, text.format(10**9), TINY, 60)
        assert result.error == "POV-Ray was ended by the signal SIGXFSZ (a file of more than 8 GiB)"
        assert (folder / "big.txt").stat().st_size <= 1 << 16
    with program.private_folder() as folder:
        assert program.run(folder, text.format(100), TINY, 60).error == ""


def test_a_message_that_is_lost_is_said_to_be(program: Any) -> None:
    said = "[Parsing...]\nFatal error in parser: Cannot parse input.\nRender failed\n"
    assert program.Result(1, said, 1.0, 1.0).error.endswith("ended before it said why (out of memory?)")


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_it_ends_with_us(appears: Callable[[], bool], clean: None, ending: signal.Signals) -> None:
    """However our own process ends, soon POV-Ray has ended, too, and its files are gone: see `clean`."""
    text = f"""
        import signal
        from pmc_sampler.adapters.povray import program
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts what is in the background without it
        with program.private_folder() as folder:
            process = program.Process(folder, {ENDLESS!r}, {TINY!r})
            print("started", flush=True)
            process.wait()
    """
    ours = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(text)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert ours.stdout is not None
    assert ours.stdout.readline() == b"started\n"
    assert appears()
    ours.send_signal(ending)
    ours.wait(60)
    ours.stdout.close()


def test_a_lasting_folder_ends_with_us(clean: None, temporary: Path) -> None:
    """Even if we are killed between two runs of POV-Ray; and by itself."""
    text = """
        import os, signal
        from pmc_sampler.adapters.povray.program import LastingFolder
        gone, lasting = LastingFolder(), LastingFolder()
        (lasting.path / "left").write_text("x")
        del gone
        print(len(os.listdir(lasting.path.parent)), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    ours = subprocess.run([sys.executable, "-c", textwrap.dedent(text)], capture_output=True, timeout=60, check=False)
    assert ours.stdout == b"1\n"
    assert ours.returncode == -signal.SIGKILL


def test_no_program_and_an_old_one(program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert program.version().startswith("3.")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        RuntimeError, match=r"no program povray on the path; install it \(on Debian: apt install povray"
    ):
        program.find()
    for says, message in (("POV-Ray 3.6.1", "is of version 3.6.1, and 3.7 is needed"), ("Hello", "does not say")):
        stand_in = tmp_path / "povray"
        stand_in.write_text(f"#!/bin/sh\necho '{says}'\n")
        stand_in.chmod(0o755)
        with pytest.raises(RuntimeError, match=message):
            program.version()


@pytest.mark.needs("bwrap")
def test_a_sandbox_keeps_files(program: Any, plain_text: str, tmp_path: Path, clean: None) -> None:
    """To write elsewhere, to a file that is there or not, is an error; without a sandbox it is none."""
    for name in ("new.txt", "kept.txt"):
        (tmp_path / "new.txt").unlink(missing_ok=True)
        (tmp_path / "kept.txt").write_text("mine")
        text = f'{plain_text}#fopen F "{tmp_path / name}" write #write(F, "x") #fclose F\n'
        for sandboxed in (True, False):
            with program.private_folder() as folder:
                result = program.Process(folder, text, TINY, sandboxed=sandboxed).wait(60)
                assert (result.status != 0) == sandboxed
                # As a rule it cannot open the file; now and then POV-Ray ends before it has said so.
                assert bool(re.search(r"Cannot open|before it said why", result.error)) == sandboxed
            found = {file.name: file.read_text() for file in tmp_path.glob("*.txt")}
            assert found == {"kept.txt": "mine"} | ({} if sandboxed else {name: "x"})


@pytest.mark.needs("bwrap")
def test_a_process_in_a_sandbox_is_ended(program: Any, clean: None) -> None:
    with program.private_folder() as folder, pytest.raises(TimeoutError, match=r"within 0.7 seconds and was ended"):
        program.Process(folder, ENDLESS, TINY, sandboxed=True).wait(0.7)


def test_no_sandbox(program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"needs the program bwrap, .*on Debian: apt install bubblewrap"):
        program.sandbox(tmp_path)
    stand_in = tmp_path / "bwrap"
    stand_in.write_text("#!/bin/sh\necho 'No permissions to create new namespace' >&2\nexit 1\n")
    stand_in.chmod(0o755)
    with pytest.raises(
        RuntimeError, match=r"no sandbox here \(No permissions .*\): containers .* forbid user namespaces"
    ):
        program.sandbox(tmp_path)


def test_text_keeps_its_bytes(program: Any, tmp_path: Path) -> None:
    """Whatever the encoding, and line ends with it."""
    data = "é\r\nb\n".encode() + "é".encode("latin-1") + bytes(range(256))
    (tmp_path / "a").write_bytes(data)
    program.write_text(tmp_path / "b", program.read_text(tmp_path / "a"))
    assert (tmp_path / "b").read_bytes() == data
