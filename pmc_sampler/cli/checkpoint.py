"""The checkpoint of a render: the sampler's state, and beside it what was being rendered.

The state knows its own settings, seed and budget, but not the scene; resuming another scene's state would
mix two images without a sign. So ``FILE.json`` holds what the command line asked for, and a checkpoint is
taken up only for the same.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmc_sampler import Sampler

from .errors import CommandError


@dataclass
class Checkpoint:
    """Where the state is kept; ``identity`` names what is rendered, ``seconds`` what it has taken."""

    path: Path
    identity: Mapping[str, Any]
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def _note(self) -> Path:
        return self.path.with_name(self.path.name + ".json")

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

    def resume(self) -> Sampler | None:
        """The sampler as it was saved, or nothing where there is no checkpoint yet.

        Raises :class:`CommandError` for a checkpoint of another render, and for a damaged one.
        """
        if not self.path.exists():
            return None
        try:
            note = json.loads(self._note.read_text(encoding="utf-8"))
            then, seconds = note["identity"], {name: float(s) for name, s in note["seconds"].items()}
            sampler = Sampler.load(self.path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            raise CommandError(
                f"the checkpoint {str(self.path)!r} cannot be read ({error}); delete it to begin anew."
            ) from error
        now = json.loads(json.dumps(self.identity))
        differing = [name for name in now if then.get(name) != now[name]]
        if differing:
            name = differing[0]
            raise CommandError(
                f"the checkpoint {str(self.path)!r} is of another render: {name} was "
                f"{then.get(name)!r} and is now {now[name]!r}; give the same options, or another file."
            )
        self.seconds = seconds
        return sampler

    def save(self, sampler: Sampler, seconds: Mapping[str, float]) -> None:
        """Save the state, and the ``seconds`` that were spent on it."""
        note = {"identity": self.identity, "seconds": dict(seconds)}
        partial = self._note.with_name(f".{self._note.name}.{os.getpid()}.part")
        try:
            partial.write_text(json.dumps(note), encoding="utf-8")
            os.replace(partial, self._note)
            sampler.save(self.path)
        except OSError as error:
            raise CommandError(
                f"the checkpoint {str(self.path)!r} cannot be written: {error.strerror}.", status=1
            ) from error
        finally:
            partial.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the checkpoint: what it was for is finished."""
        self.path.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)
