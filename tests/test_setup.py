"""`.ci/system-packages`: what it says is missing, what it asks apt-get for, and its exit status.

Exact. The script sees a folder of stand-ins in the place of the system's programs: the package manager of the machine
is never called.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

# The script looks into these folders, too; where they have what is in /usr/bin, no program can be missing.
SYSTEM = "/usr/sbin:/sbin"
pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="the script is for Linux"),
    pytest.mark.skipif(shutil.which("sed", path=SYSTEM) is not None, reason="/usr/sbin is /usr/bin on this system"),
]

PROGRAMS = {
    # Answers each question of the script with yes.
    "python3": "case $* in *--version*) echo Python 3.11.2;; esac",
    "c++": "",
    "povray": "",
    "bwrap": "",
    "ldconfig": "echo '	libLLVM.so.19.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libLLVM.so.19.1'",
    "id": "echo 1000",
    "sudo": "exit 1",
    "apt-get": 'echo "$*" >>"$LOG"; echo "E: $* failed" >&2; exit 100',
    "apt-cache": "printf '%s\\n' libllvm14 libllvm21 libllvm20t64",
}
USED = ("env", "grep", "head", "sed")  # the system's own


@dataclass
class Machine:
    """A machine that lacks nothing, of a user who may not install packages."""

    folder: Path

    def __post_init__(self) -> None:
        self.programs.mkdir()
        for name in USED:
            found = shutil.which(name)
            assert found is not None
            (self.programs / name).symlink_to(found)
        for name, commands in PROGRAMS.items():
            self.add(name, commands)
        self.has_processor("AuthenticAMD", 25)
        (self.folder / "vendors").mkdir()
        self.environment = {
            "PATH": str(self.programs),
            "LOG": str(self.folder / "log"),
            "CPUINFO": str(self.folder / "cpuinfo"),
            "OPENCL_VENDORS": str(self.folder / "vendors"),
        }

    @property
    def programs(self) -> Path:
        return self.folder / "programs"

    def add(self, name: str, commands: str) -> None:
        """Puts a program of a shell's commands in place."""
        path = self.programs / name
        path.write_text(f"#!/bin/sh\n{commands}\n")
        path.chmod(0o755)

    def remove(self, *names: str) -> None:
        for name in names:
            (self.programs / name).unlink()

    def has_processor(self, maker: str, family: int) -> None:
        (self.folder / "cpuinfo").write_text(f"processor\t: 0\nvendor_id\t: {maker}\ncpu family\t: {family}\n")

    def asked(self) -> list[str]:
        """What apt-get was called with."""
        log = self.folder / "log"
        return log.read_text().splitlines() if log.exists() else []


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.fixture
def check(machine: Machine, checkout: Path) -> Callable[..., None]:
    """check(status, *errors, out=...): runs the script and compares its exit status and lines; some are apt-get's."""

    def run(status: int, *errors: str, out: tuple[str, ...] = ()) -> None:
        bash = shutil.which("bash")
        assert bash is not None
        script = str(checkout / ".ci" / "system-packages")
        done = subprocess.run([bash, script], env=machine.environment, capture_output=True, text=True, timeout=60)
        assert done.stderr.splitlines() == [
            error if error.startswith("E: ") else f"system-packages: {error}" for error in errors
        ]
        assert done.stdout.splitlines() == [f"system-packages: {line}" for line in out]
        assert done.returncode == status

    return run


NO_PYTHON = (
    "no '/nope' was found: install Python 3.10 or newer with the packages python3-venv and python3-dev, "
    "or name yours, as in 'make PYTHON=python3.12 test'."
)
NO_COMPILER = "no C++ compiler was found: install g++ 11 or newer (package g++), or name yours with CXX."
NO_LLVM = (
    "no LLVM library of version 19 or newer was found, so Mitsuba cannot render on the CPU: "
    "install the package libllvm19."
)
NO_POVRAY = "POV-Ray was not found: install the package povray to render with it."
NO_SANDBOX = "bwrap was not found: install the package bubblewrap to render POV-Ray scenes in a sandbox."
NO_OPENCL = (
    "pip's OpenCL device does not know this processor: install the package pocl-opencl-icd to render with OpenCL."
)


def test_where_nothing_is_missing_nothing_is_said(machine: Machine, check: Callable[..., None]) -> None:
    """Nor is apt-get called, even by one who may; the second time with the interpreter of this test."""
    machine.add("id", "echo 0")
    check(0)
    machine.environment["PYTHON"] = sys.executable
    check(0)
    assert machine.asked() == []


def test_an_interpreter_that_is_none(machine: Machine, check: Callable[..., None]) -> None:
    machine.environment["PYTHON"] = "/nope"
    check(1, NO_PYTHON)


@pytest.mark.parametrize(
    ("refused", "sentence"),
    [
        (
            "version_info",
            "'python3' is Python 3.9.2, Python 3.10 or newer is needed: install one and name it, "
            "as in 'make PYTHON=python3.12 test'.",
        ),
        ("ensurepip", "'python3' cannot make virtual environments: install the package python3-venv."),
        ("Python.h", "'python3' has no C headers (Python.h): install the package python3-dev."),
    ],
)
def test_an_interpreter_that_will_not_do(
    machine: Machine, check: Callable[..., None], refused: str, sentence: str
) -> None:
    machine.add("python3", f"case $* in *--version*) echo Python 3.9.2;; *{refused}*) exit 1;; esac")
    check(1, sentence)


def test_no_compiler(machine: Machine, check: Callable[..., None]) -> None:
    machine.remove("c++")
    check(1, NO_COMPILER)
    machine.environment["CXX"] = "/nope"
    check(1, NO_COMPILER)
    machine.environment["CXX"] = str(machine.programs / "mine")
    machine.add("mine", "")
    check(0)
    del machine.environment["CXX"]
    machine.add("clang++", "")
    check(0)


@pytest.mark.parametrize("libraries", ["", "libLLVM-15.so.1", "libLLVM.so.18.1"])
def test_no_llvm(machine: Machine, check: Callable[..., None], libraries: str) -> None:
    machine.add("ldconfig", f"echo '	{libraries} (libc6,x86-64) => /lib/{libraries}'")
    check(0, NO_LLVM)
    machine.environment["DRJIT_LIBLLVM_PATH"] = "/nope/libLLVM.so"
    check(0, NO_LLVM)
    machine.environment["DRJIT_LIBLLVM_PATH"] = str(machine.programs / "c++")  # any file
    check(0)


def test_no_povray_and_no_sandbox(machine: Machine, check: Callable[..., None]) -> None:
    machine.remove("povray")
    check(0, NO_POVRAY)
    machine.remove("bwrap")
    check(0, NO_POVRAY, NO_SANDBOX)


def test_a_processor_that_pips_opencl_does_not_know(machine: Machine, check: Callable[..., None]) -> None:
    machine.has_processor("GenuineIntel", 99)
    check(0)
    for maker, family in (("AuthenticAMD", 26), ("Other", 6)):
        machine.has_processor(maker, family)
        check(0, NO_OPENCL)
    (machine.folder / "vendors" / "pocl.icd").touch()
    check(0)


def test_a_machine_that_has_nothing(machine: Machine, check: Callable[..., None]) -> None:
    """No apt-get either, and each part is a sentence of its own."""
    machine.remove("c++", "povray", "bwrap", "apt-get", "apt-cache", "python3")
    machine.add("ldconfig", "exit 1")
    machine.environment["PYTHON"] = "/nope"
    machine.has_processor("AuthenticAMD", 26)
    # Were there an apt-get in the system's own folders, this user could not use it.
    check(1, NO_PYTHON, NO_COMPILER, NO_LLVM, NO_POVRAY, NO_SANDBOX, NO_OPENCL)
    assert machine.asked() == []


INSTALL = "-o DPkg::Lock::Timeout=120 install -y -qq --no-install-recommends"
UPDATE = "-o DPkg::Lock::Timeout=120 update -qq"


@pytest.mark.parametrize("as_root", [True, False], ids=["root", "sudo"])
def test_what_is_missing_is_installed_by_one_who_may(
    machine: Machine, check: Callable[..., None], as_root: bool
) -> None:
    """One package at a time; of LLVM the oldest on offer that will do. Then nothing is left to say."""
    if as_root:
        machine.add("id", "echo 0")
    else:
        machine.add("sudo", '[ "$1" = -n ] || exit 1; shift; [ "$1" = true ] || exec "$@"')
    machine.remove("povray", "c++")
    machine.add(
        "ldconfig", f"[ -e {machine.folder}/libllvm20t64 ] && echo '	libLLVM.so.20.1 => /lib/libLLVM.so.20.1'"
    )
    machine.add(
        "apt-get",
        f"""echo "$*" >>"$LOG"
for package in "$@"; do :; done
case $package in
  g++ | povray) printf '#!/bin/sh\\n' >{machine.programs}/$package; /bin/chmod +x {machine.programs}/$package;;
  libllvm*) : >{machine.folder}/$package;;
esac""",
    )
    check(0, out=("installing g++ libllvm20t64 povray",))
    packages = ("g++", "libllvm20t64", "povray")
    assert machine.asked() == [UPDATE, *(f"{INSTALL} {package}" for package in packages)]


def test_an_apt_get_that_fails(machine: Machine, check: Callable[..., None]) -> None:
    """A package that cannot be had does not take the others along, and what it is for is said as without apt-get."""
    machine.add("id", "echo 0")
    machine.remove("povray", "c++")
    errors = (
        f"E: {UPDATE} failed",
        "apt-get update had errors; going on with the lists there are.",
        "could not install g++:",
        f"E: {INSTALL} g++ failed",
        "could not install povray:",
        f"E: {INSTALL} povray failed",
        NO_COMPILER,
        NO_POVRAY,
    )
    check(1, *errors, out=("installing g++ povray",))
    assert machine.asked() == [UPDATE, f"{INSTALL} g++", f"{INSTALL} povray"]
