"""The program `povray`: found, run in a folder of its own, ended in every case, and its errors as sentences."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

__all__ = [
    "LastingFolder",
    "Process",
    "Result",
    "find",
    "private_folder",
    "processors",
    "read_text",
    "run",
    "sandbox",
    "version",
    "write_text",
]

TIMEOUT = 3600.0  # seconds
_INSTALL = "install it (on Debian: apt install povray; elsewhere: https://www.povray.org/download/)"
_INSTALL_SANDBOX = "install it (on Debian: apt install bubblewrap)"
_SCENE = "scene.pov"
_MESSAGES = "messages.txt"
_KEPT = 1 << 20  # bytes of messages that are read, from their beginning and from their end
_FILE_BLOCKS = 1 << 24  # of 512 bytes: 8 GiB; a scene may write files, and may do so for ever
# The standard input of the shell is a pipe from us. A watcher reads it and so learns when we end, however that is:
# then POV-Ray, which takes the shell's place and its number with it, is killed.
_WATCHED = (
    f"ulimit -f {_FILE_BLOCKS}; exec 3<&0; {{ read -r _ <&3; kill -KILL $$; }} >/dev/null 2>&1 & "
    'exec 3<&-; exec "$@" </dev/null'
)
# As deep, so that no name of a scene's that leads upwards ends where others may write.
_DEPTH = Path(*["pmc"] * 8)


@dataclass(frozen=True)
class Result:
    """How a run of POV-Ray ended.

    Attributes
    ----------
    status
        Its exit status: 0, 1 for an error, negative for the signal that ended it.
    messages
        What it wrote to standard error.
    seconds, cpu
        Wall time and processor time.
    names
        What stands in its messages for the user's files and folders.
    """

    status: int
    messages: str
    seconds: float
    cpu: float
    names: dict[str, str] = field(default_factory=dict)

    @property
    def error(self) -> str:
        """POV-Ray's first error, with file and line where it says so, on one line; empty if there was none."""
        if self.status < 0:
            reason = " (out of memory?)" if self.status == -signal.SIGKILL else ""
            reason = " (a file of more than 8 GiB)" if self.status == -signal.SIGXFSZ else reason
            return f"POV-Ray was ended by the signal {signal.Signals(-self.status).name}{reason}"
        if self.status == 0:
            return ""
        found = _first_error(self.messages)
        for ours, theirs in self.names.items():
            literal = theirs.replace("\\", r"\\")
            found = re.sub(rf"(?<![\w/]){re.escape(ours)}(?!\w)", literal, found)
        if "std::bad_alloc" in found:
            found += " (out of memory)"
        if found.startswith("Fatal error in parser:"):  # follows the error itself, which is lost where memory runs out
            return "POV-Ray cannot parse it and ended before it said why (out of memory?)"
        return found or f"POV-Ray ended with status {self.status} and no message"

    def check(self, what: str) -> None:
        """Raises ValueError with POV-Ray's own words if it failed to render `what`."""
        if self.status:
            raise ValueError(f"POV-Ray cannot render {what}: {self.error.rstrip('.')}")


class Process:
    """POV-Ray under way in `folder`, with standard input closed, in a session of its own.

    It ends with us at the latest, even if we are killed. `wait` or `kill` has to be called.

    Parameters
    ----------
    folder
        Where it runs: nobody else's, since a `povray.ini` there is obeyed, and what a scene writes goes there.
    scene
        The scene's text, or its file. `folder` gets it as `scene.pov`.
    arguments
        Switches such as "+W640", after `-D -V -P` and `+WT1`.
    libraries
        Folders in which the scene finds its files; that of a scene file comes first by itself.
    sandboxed
        Whether it runs without network and may write to `folder` alone; see `sandbox`. Its processor time is then not
        known.

    Raises RuntimeError if there is no POV-Ray, or no sandbox if one is wanted.
    """

    def __init__(
        self,
        folder: Path,
        scene: str | Path,
        arguments: Sequence[str] = (),
        libraries: Sequence[Path] = (),
        sandboxed: bool = False,
    ) -> None:
        self._folder = folder
        self._sandboxed = sandboxed
        self.names: dict[str, str] = {}
        libraries = list(libraries)
        if isinstance(scene, Path):
            libraries.insert(0, scene.absolute().parent)
            self.names[_SCENE] = str(scene)
            (folder / _SCENE).symlink_to(scene.absolute())
        else:
            write_text(folder / _SCENE, scene)
        paths = []
        # By names of our own, since POV-Ray's switches take no spaces and nothing beyond ASCII.
        for number, library in enumerate(dict.fromkeys(library.absolute() for library in libraries)):
            name = f"library{number}"
            (folder / name).symlink_to(library)
            self.names[name] = str(library)
            paths.append(f"+L{name}")
        command = [find(), f"+I{_SCENE}", "-D", "-V", "-P", "+WT1", *paths, *arguments]
        if sandboxed:
            command = [*sandbox(folder), *command]
        environment = {name: value for name, value in os.environ.items() if name != "POVINI"}
        self._cpu = 0.0
        self._began = time.perf_counter()
        with (folder / _MESSAGES).open("wb") as messages:
            self._process = subprocess.Popen(
                ["/bin/sh", "-c", _WATCHED, "sh", *command],
                cwd=folder,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=messages,
                start_new_session=True,
            )

    @property
    def ended(self) -> bool:
        """Whether it is no longer running; `wait` then returns at once."""
        return os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def wait(self, timeout: float = TIMEOUT, enough: Callable[[], bool] = lambda: False) -> Result:
        """Waits for its end, or ends it once there is `enough`, which counts as success.

        POV-Ray has made what it makes a third of a second before it ends by itself. Raises TimeoutError after `timeout`
        seconds since now; POV-Ray is ended then, as by any other exception here.
        """
        until, pause, made = time.perf_counter() + timeout, 0.001, False
        try:
            while not self.ended and not (made := enough()):
                if time.perf_counter() > until:
                    raise TimeoutError(
                        f"POV-Ray did not finish within {timeout:g} seconds and was ended; a scene that needs longer "
                        "needs a larger timeout, if it does not loop for ever"
                    )
                time.sleep(pause)
                pause = min(2 * pause, 0.01)
        finally:
            self.kill()
        seconds = time.perf_counter() - self._began
        status = 0 if made else self._process.returncode
        return Result(status, self._messages(), seconds, self._cpu, self.names)

    def kill(self) -> float:
        """Ends it, if it has not ended; nothing of it is left running. Returns its processor time in seconds."""
        if self._process.returncode is None:
            self._end()
        return self._cpu

    def _end(self) -> None:
        """Kills the whole group, which the watcher keeps in being."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if not self.ended:
                os.kill(self._process.pid, signal.SIGKILL)
        _, status, usage = os.wait4(self._process.pid, 0)
        code = os.waitstatus_to_exitcode(status)
        # As shells do, bwrap adds the signal that ended its program to 128.
        self._process.returncode = 128 - code if self._sandboxed and code > 128 else code
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._cpu = usage.ru_utime + usage.ru_stime

    def _messages(self) -> str:
        with (self._folder / _MESSAGES).open("rb") as file:
            data = file.read(_KEPT)
            size = file.seek(0, os.SEEK_END)
            if size > _KEPT:
                file.seek(max(_KEPT, size - _KEPT))
                data += file.read()
        return data.decode("utf-8", "replace")


def find() -> str:
    """The path of the program. Raises RuntimeError with what to install if there is none."""
    path = shutil.which("povray")
    if path is None:
        raise RuntimeError(f"there is no program povray on the path; {_INSTALL}")
    return path


def sandbox(folder: Path) -> list[str]:
    """The beginning of a command that may write to `folder` alone, reads all files and has no network, by bubblewrap.

    Raises RuntimeError if there is no bubblewrap, or if the system lets it make no sandbox.
    """
    path = shutil.which("bwrap")
    if path is None:
        raise RuntimeError(f"a sandbox needs the program bwrap, which is not on the path; {_INSTALL_SANDBOX}")
    place = str(folder.resolve())
    # Not in a session of its own: what ends the group of processes has to end what is in it.
    command = [path, "--ro-bind", "/", "/", "--dev", "/dev", "--bind", place, place, "--chdir", place]
    command += ["--unshare-net", "--unshare-ipc", "--die-with-parent", "--"]
    _try_sandbox(path)
    return command


@functools.cache
def _try_sandbox(path: str) -> None:
    done = subprocess.run(
        [path, "--ro-bind", "/", "/", "--dev", "/dev", "--unshare-net", "--unshare-ipc", "--", "true"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=60,
    )
    if done.returncode:
        raise RuntimeError(
            f"bwrap can make no sandbox here ({done.stderr.strip() or f'status {done.returncode}'}): containers and "
            "some systems forbid user namespaces; allow them, or render without a sandbox what you trust"
        )


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def version() -> str:
    """The version, such as "3.7.0.10.unofficial".

    Raises RuntimeError if there is no POV-Ray, or none of version 3.7 or later.
    """
    done = subprocess.run(
        [find(), "--version"], stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=60
    )
    match = re.search(r"POV-Ray (?:v|version )?((\d+)\.(\d+)\S*)", done.stdout + done.stderr)
    if match is None:
        raise RuntimeError(f"{find()} does not say its version as POV-Ray does; {_INSTALL}")
    if (int(match[2]), int(match[3])) < (3, 7):
        raise RuntimeError(f"POV-Ray is of version {match[1]}, and 3.7 is needed; {_INSTALL}")
    return match[1]


def run(
    folder: Path,
    scene: str | Path,
    arguments: Sequence[str] = (),
    timeout: float = TIMEOUT,
    libraries: Sequence[Path] = (),
) -> Result:
    """POV-Ray from start to end, as `Process` has it; a failure is in the result, see `Result.check`.

    `folder` should come from `private_folder` and is used for one run. The switches of `arguments` say where the image
    goes, relative to `folder`.

    Raises TimeoutError after `timeout` seconds, RuntimeError if there is no POV-Ray.
    """
    return Process(folder, scene, arguments, libraries).wait(timeout)


@contextlib.contextmanager
def private_folder() -> Iterator[Path]:
    """An empty folder that is removed afterwards, with all that is in it; even if this process is killed."""
    place = _place()
    with tempfile.TemporaryDirectory(dir=place.inner, ignore_cleanup_errors=True) as name:
        yield Path(name)


class LastingFolder:
    """An empty folder, `path`. It is removed with all that is in it by `close`, which happens by itself when the object
    goes or Python ends; and even if this process is killed, see `_Place`.
    """

    def __init__(self) -> None:
        place = _place()
        self.path = Path(tempfile.mkdtemp(dir=place.inner))
        self.close = weakref.finalize(self, _remove, self.path, place, os.getpid())


class _Place:
    """Where all folders of this process are, for as long as there is one of them.

    Another process waits for the end of ours, however it comes, and then removes it.
    """

    def __init__(self) -> None:
        top = Path(tempfile.mkdtemp(prefix="pmc-povray-"))
        self.inner = top / _DEPTH
        self.inner.mkdir(parents=True)
        # Once more after a second, for what processes that end at the same time have still written.
        command = ["/bin/sh", "-c", 'read -r _; rm -rf -- "$0"; sleep 1; rm -rf -- "$0"', str(top)]
        # In a session of its own, so that Ctrl-C does not reach it.
        guard = subprocess.Popen(
            command,
            cwd="/",
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._close = weakref.finalize(self, _leave, top, guard, os.getpid())


_places: weakref.WeakValueDictionary[tuple[int, str], _Place] = weakref.WeakValueDictionary()


def _place() -> _Place:
    key = (os.getpid(), tempfile.gettempdir())
    return _places.get(key) or _places.setdefault(key, _Place())


def _remove(folder: Path, place: _Place, owner: int) -> None:
    """A forked child, which has the object but not the folder, keeps off. Until then `place` is there."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def _leave(top: Path, guard: subprocess.Popen[bytes], owner: int) -> None:
    if os.getpid() != owner:
        return
    shutil.rmtree(top, ignore_errors=True)
    guard.kill()
    guard.wait()
    if guard.stdin is not None:
        guard.stdin.close()


def read_text(file: Path) -> str:
    """The text of an SDL file, whatever its encoding: `write_text` gives the same bytes again."""
    return file.read_bytes().decode("utf-8", "surrogateescape")


def write_text(file: Path, text: str) -> None:
    """Writes SDL; see `read_text`."""
    file.write_bytes(text.encode("utf-8", "surrogateescape"))


def _first_error(messages: str) -> str:
    """The first line with an error, put together again where POV-Ray breaks it at 80 columns."""
    _, parsing, rest = messages.partition("[Parsing...]")
    lines: list[str] = []
    for line in (rest if parsing else messages).splitlines():
        if line.startswith(" ") and lines:
            lines[-1] += line
        else:
            lines.append(line)
    for line in lines:
        if re.search(r"\b[Ee]rror\b.*:|^Problem with|^Cannot ", line):
            return " ".join(line.split())
    return ""
