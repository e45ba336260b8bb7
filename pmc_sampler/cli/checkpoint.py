"""The checkpoint of a render: the sampler's state, and in it what was being rendered.

The state knows its own settings, seed and budget, but not the scene; resuming another scene's state would
mix two images without a sign. So its note holds what the command line asked for, and a checkpoint is
taken up only for the same.
"""

import contextlib
import glob
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmc_sampler import Sampler, _core

from .errors import CommandError


@dataclass
class Checkpoint:
    """Where the state is kept; ``identity`` names what is rendered, ``seconds`` what it has taken.

    chosen: whether the user named the file; else it is made once a render has taken ``every`` seconds.
    """

    path: Path
    identity: Mapping[str, Any]
    chosen: bool
    every: float
    seconds: dict[str, float] = field(default_factory=dict)

    def check_writable(self) -> None:
        """Raise :class:`CommandError` where no file can be made at the path."""
        if self.path.is_dir() or not self.path.parent.is_dir():
            raise CommandError(
                f"the checkpoint {str(self.path)!r} must be a file in a folder that exists; name another."
            )
        probe = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        try:
            probe.touch(exist_ok=False)
            probe.unlink()
        except OSError as error:
            raise CommandError(f"no file can be written in {str(self.path.parent)!r}: {error.strerror}.") from error

    def resume(self, threads: _core.Executor | None) -> Sampler | None:
        """The sampler as it was saved, to work on these threads, or nothing where there is no checkpoint yet.

        Raises :class:`CommandError` for a checkpoint of another render, and for a damaged one.
        """
        if not self.path.exists():
            return None
        try:
            sampler = Sampler.load(self.path, threads)
            then, seconds = sampler.note["identity"], sampler.note["seconds"]
            self.seconds = {name: float(s) for name, s in seconds.items()}
            # What the state itself says goes before what was noted of it: that is what would be rendered.
            then = dict(then) | _own(sampler)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise CommandError(
                f"the checkpoint {str(self.path)!r} cannot be read ({error}); delete it to begin anew."
            ) from error
        now = json.loads(json.dumps(self.identity))
        differing = [name for name in now if then.get(name) != now[name]]
        if differing:
            name = differing[0]
            raise CommandError(
                f"the checkpoint {str(self.path)!r} is of another render: {name} was "
                f"{then.get(name)!r} and is now {now[name]!r}; give the same options, another file, or delete it."
            )
        return sampler

    def save(self, sampler: Sampler, seconds: Mapping[str, float]) -> None:
        """Save the state, and the ``seconds`` that were spent on it."""
        sampler.note = {"identity": self.identity, "seconds": dict(seconds)}
        try:
            sampler.save(self.path)
        except OSError as error:
            raise CommandError(
                f"the checkpoint {str(self.path)!r} cannot be written: {error.strerror or error}.", status=1
            ) from error

    def remove(self) -> None:
        """Delete the checkpoint, for what it was for is finished, and what a process that was killed left beside it."""
        for left in (self.path, *self.path.parent.glob(f"{glob.escape(self.path.name)}.*.part")):
            with contextlib.suppress(OSError):
                left.unlink(missing_ok=True)


def _own(sampler: Sampler) -> dict[str, Any]:
    return {
        "seed": sampler.seed,
        "size": [sampler.width, sampler.height],
        "budget": vars(sampler.budget),
        "config": sampler.config.to_dict(),
    }
