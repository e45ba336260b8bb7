"""Peers in processes of their own: their libraries meet no others, and their Python may be another one."""

import contextlib
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import images
from .scene import Description

PACKAGES = {"cycles": "bpy", "luxcore": "pyluxcore"}
"""The peers by name, and the package of each."""

_WORKERS = Path(__file__).parent / "workers"


class PeerError(RuntimeError):
    """A peer that cannot be started, or failed; the message says what to do."""


@dataclass(frozen=True)
class Picture:
    """What a peer rendered: ``rgb`` (height, width, 3) float32, linear; ``samples`` (height, width), as it counts them.

    ``seconds`` of wall time; the scene's set-up is not part of it where the renderer has it apart.
    """

    rgb: NDArray[np.float32]
    samples: NDArray[np.float32]
    seconds: float

    @property
    def spp(self) -> float:
        """Samples per pixel that were made, on average."""
        return float(self.samples.mean(dtype=np.float64))


class Peer:
    """A renderer with one scene, in a process that ends with :meth:`close`.

    Parameters: ``name`` one of ``PACKAGES``; ``python`` the interpreter that has its package, this one unless given.
    Raises :class:`PeerError` where the package is missing or the renderer cannot take the scene.
    """

    def __init__(self, name: str, description: Description, python: str = sys.executable) -> None:
        if name not in PACKAGES:
            raise ValueError(f"no peer is called {name!r}; there are {', '.join(PACKAGES)}.")
        self.name = name
        self._folder = tempfile.TemporaryDirectory(prefix="pmc-peer-")
        try:
            self._process = subprocess.Popen(
                [python, str(_WORKERS), PACKAGES[name]],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError as error:
            self._folder.cleanup()
            raise PeerError(f"{python!r} cannot be run ({error.strerror}); name a Python that can.") from error
        try:
            self.version: str = self._ask(dict(description))
        except ImportError as error:
            self.close()
            raise PeerError(
                f"{name} needs the package {PACKAGES[name]}, which {python} cannot import ({error}): "
                f"{python} -m pip install numpy {PACKAGES[name]}."
            ) from error
        except PeerError:
            self.close()
            raise

    def render(self, samples: int, seed: int, settings: Mapping[str, Any] | None = None) -> Picture:
        """Render with ``samples`` a pixel and the peer's own ``settings``, which its module in `workers` documents.

        Raises :class:`PeerError` for settings that it does not take, and where it died.
        """
        file = Path(self._folder.name) / "picture.exr"
        made = self._ask({**(settings or {}), "samples": samples, "seed": seed, "file": str(file)})
        if "channels" in made:  # in the file
            planes = images.planes(file)
            rgb = np.stack([planes[name] for name in made["channels"]["rgb"]], axis=2)
            return Picture(rgb, counts(planes[made["channels"]["samples"]], **made["count"]), made["seconds"])
        return Picture(made["rgb"], made["samples"], made["seconds"])

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(BrokenPipeError):  # it died
            self._process.communicate()
        self._folder.cleanup()

    def __enter__(self) -> "Peer":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _ask(self, value: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            pickle.dump(value, self._process.stdin)
            self._process.stdin.flush()
            reply = pickle.load(self._process.stdout)
        except (BrokenPipeError, EOFError) as error:
            raise PeerError(f"{self.name} died while it had {value if 'samples' in value else 'the scene'}.") from error
        if isinstance(reply, ImportError):
            raise reply
        if isinstance(reply, Exception):
            raise PeerError(f"{self.name} failed: {reply}.") from reply
        return reply


def counts(shares: NDArray[np.float32], most: int, step: int, first: int) -> NDArray[np.float32]:
    """Samples of each pixel from their shares of the largest count, where a renderer says no more.

    All counts are multiples of ``step``, at least ``first`` and at most ``most``: the smallest that agree with the
    shares. They are the right ones where a pixel stopped as soon as it could, as black ones do. With ``first`` equal to
    ``most`` sampling was uniform. Raises :class:`PeerError` where none agree.
    """
    if first >= most:
        return shares * np.float32(most)
    distinct = np.unique(shares).astype(np.float64)
    for largest in range(step, most + 1, step):
        steps = distinct * largest / step
        if steps[0] * step > first - 0.5 and np.abs(steps - np.rint(steps)).max() < 1e-2:
            return np.rint(shares * np.float64(largest)).astype(np.float32)
    raise PeerError(f"the renderer's counts of samples fit no multiples of {step} up to {most}.")
