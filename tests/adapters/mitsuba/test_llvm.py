"""Which LLVM is taken, and what is said where none will do.

Exact; the libraries are empty files and their trial is made up, but where the real thing is meant.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.needs("mitsuba")


@pytest.fixture
def llvm(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module on x86-64, nothing named by the environment, and trials that fail below version 17."""
    from pmc_sampler.adapters.mitsuba import llvm as module

    def trial(path: str) -> str | None:
        version = module.Library.at(path).version
        return "it aborts the process with signal 6" if version is not None and version < 17 else None

    monkeypatch.delenv(module.ENVIRONMENT, raising=False)
    monkeypatch.setattr(module.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(module, "_trial", trial)
    return module


def installed(folder: Path, *names: str) -> list[Path]:
    for name in names:
        (folder / name).touch()
    return [folder]


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-13.so.1", 13),
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM.so.19.1", 19),
        ("libLLVM-19.so", 19),
        ("libLLVM.so", None),
        ("libLLVM.dylib", None),
    ],
)
def test_versions_are_read_from_names(llvm: Any, tmp_path: Path, name: str, version: int | None) -> None:
    (tmp_path / name).touch()
    assert llvm.Library.at(tmp_path / name).version == version


def test_a_link_counts_as_what_it_leads_to(llvm: Any, tmp_path: Path) -> None:
    folders = installed(tmp_path, "libLLVM.so.20.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.20.1")
    assert [library.version for library in llvm.candidates(folders)] == [20]


def test_the_newest_known_one_is_taken(llvm: Any, tmp_path: Path) -> None:
    """Versions known to work come first, then the others, newest first."""
    names = ("libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM.so.21.1", "libLLVM.so.31.0", "libLLVM-18.so.1")
    folders = installed(tmp_path, *names)
    assert [library.version for library in llvm.candidates(folders)] == [21, 19, 31, 18, 15]
    assert llvm.find(folders).path.endswith("libLLVM.so.21.1")


def test_others_are_taken_after_a_trial(llvm: Any, tmp_path: Path) -> None:
    assert llvm.find(installed(tmp_path, "libLLVM-15.so.1", "libLLVM-18.so.1")).version == 18


def test_none_that_works(llvm: Any, tmp_path: Path) -> None:
    with pytest.raises(
        llvm.LibraryError,
        match=r"found none.*install LLVM 19 or newer \(Debian: `apt-get install libllvm19`\)",
    ):
        llvm.find([tmp_path])
    with pytest.raises(llvm.LibraryError, match=r"found only LLVM 15 .*: it aborts the process.*libllvm19"):
        llvm.find(installed(tmp_path, "libLLVM-15.so.1"))


def test_the_users_choice_is_checked(llvm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = installed(tmp_path, "libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM.so.21.1")
    monkeypatch.setenv(llvm.ENVIRONMENT, str(tmp_path / "libLLVM.so.19.1"))
    assert llvm.find(folders).version == 19
    monkeypatch.setenv(llvm.ENVIRONMENT, str(tmp_path / "libLLVM-15.so.1"))
    with pytest.raises(llvm.LibraryError, match=r"DRJIT_LIBLLVM_PATH names LLVM 15 .* cannot use \(it aborts"):
        llvm.find(folders)
    monkeypatch.setenv(llvm.ENVIRONMENT, str(tmp_path / "libLLVM.so.40"))
    with pytest.raises(llvm.LibraryError, match=r"names .*libLLVM\.so\.40, and there is no such file"):
        llvm.find(folders)


def test_a_name_without_a_folder_is_tried(llvm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system's loader knows where it leads to, if anywhere."""
    monkeypatch.setattr(llvm, "_trial", lambda path: "Dr.Jit turns it down")
    monkeypatch.setenv(llvm.ENVIRONMENT, "libLLVM.so.21.1")
    with pytest.raises(llvm.LibraryError, match=r"names LLVM 21 \(libLLVM\.so\.21\.1\), which Dr\.Jit cannot use"):
        llvm.find()


def run(program: str, library: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """The program in a process of its own, where DRJIT_LIBLLVM_PATH names the library."""
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(library)}
    command = [sys.executable, "-c", program]
    return subprocess.run(
        command, env=environment, cwd=folder, capture_output=True, text=True, timeout=100, check=False
    )


@pytest.mark.needs("OpenImageIO")
def test_a_wrong_choice_is_one_sentence(tmp_path: Path) -> None:
    """The real thing: Dr.Jit has nothing to add to it, and nothing is rendered."""
    program = """
import sys
from pmc_sampler.cli import main
sys.argv[1:] = ["render", "cornell-box", "--renderer", "mitsuba", "--spp", "1", "--size", "8x6"]
sys.exit(main())
"""
    library = tmp_path / "none" / "libLLVM.so"
    done = run(program, library, tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "pmc-sampler render: Mitsuba variant 'llvm_ad_rgb' cannot run here: "
        f"DRJIT_LIBLLVM_PATH names {library}, and there is no such file; install LLVM 19 or newer "
        "(Debian: `apt-get install libllvm19`), or name one in DRJIT_LIBLLVM_PATH\n"
    )
    assert os.listdir(tmp_path) == []


def test_a_wrong_choice_is_no_matter_without_llvm(tmp_path: Path) -> None:
    """The real thing: variants that need no LLVM work, and nothing is said. The file is there, and no library."""
    (tmp_path / "libLLVM.so").write_text("none")
    program = """
import pmc_sampler.adapters.mitsuba, mitsuba
mitsuba.set_variant("scalar_rgb")
print(mitsuba.load_dict({"type": "sphere"}).class_name())
"""
    done = run(program, tmp_path / "libLLVM.so", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "Sphere\n", "")


def test_other_lines_on_standard_error_come_through(
    llvm: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(llvm.ENVIRONMENT, "/none/libLLVM.so")
    with llvm._without_dr_jits_lines():
        os.write(2, b'one\njit_find_library(): Unable to load "/none/libLLVM.so": no such file\n')
        os.write(2, b'jitc_llvm_init(): failed\njit_find_library(): Unable to load "libcuda.so": no such file\ntwo')
        assert capfd.readouterr().err == ""
    assert capfd.readouterr().err == 'one\njit_find_library(): Unable to load "libcuda.so": no such file\ntwo'
    os.write(2, b"three")
    assert capfd.readouterr().err == "three"


def test_an_old_library_that_is_loaded_is_refused(llvm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is compiled with it, and by the renderer, too."""
    import drjit as dr
    from pmc_sampler.adapters import available, load

    monkeypatch.setattr(dr.detail, "llvm_version", lambda: (15, 0, 6))
    monkeypatch.setattr(llvm, "_trial", lambda path: "it aborts the process with signal 6")
    sentence = r"Dr.Jit has loaded LLVM 15, which it cannot use \(it aborts the process.*libllvm19"
    with pytest.raises(llvm.LibraryError, match=sentence):
        llvm.require()
    with pytest.raises(RuntimeError, match=rf"'llvm_ad_rgb' cannot run here: {sentence}"):
        load("mitsuba", "cornell-box", variant="llvm_ad_rgb")
    entry = next(entry for entry in available() if entry.name == "mitsuba")
    assert "libllvm19" in (entry.trouble or entry.detail or "")


def test_a_process_without_a_library(llvm: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    monkeypatch.setattr(llvm, "_folders", lambda: [tmp_path])
    with pytest.raises(llvm.LibraryError, match="found none"):
        llvm.require()
    installed(tmp_path, "libLLVM.so.19.1")
    with pytest.raises(llvm.LibraryError, match=r"LLVM 19 .* would have done; start anew and import"):
        llvm.require()


def test_trials(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The real thing, in processes of their own: the library in use works, an empty file does not."""
    import drjit as dr
    from pmc_sampler.adapters.mitsuba import llvm

    assert llvm.require().split(".") == [str(part) for part in dr.detail.llvm_version()]
    assert llvm._trial(os.environ.get(llvm.ENVIRONMENT)) is None
    (tmp_path / "libLLVM.so.19.1").touch()
    assert llvm._trial(str(tmp_path / "libLLVM.so.19.1")) == "Dr.Jit turns it down"
    for library in llvm.candidates():
        if library.version is not None and library.version < 17:  # a machine may have one; Debian's OpenCL pulls in 15
            assert llvm._trial(library.path) is not None
