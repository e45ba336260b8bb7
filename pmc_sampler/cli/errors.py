"""What the user is told when a command cannot be done, or not quite as asked."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class CommandError(Exception):
    """One sentence for the user, and the exit status: 2 for bad input, 1 for a failed run."""

    def __init__(self, message: str, status: int = 2) -> None:
        super().__init__(message)
        self.status = status


@contextmanager
def plain_warnings(command: str) -> Iterator[None]:
    """Warnings as one line each, without the line of code they come from."""

    def show(message: Warning | str, *where: Any, **more: Any) -> None:
        print(f"pmc-sampler {command}: warning: {' '.join(str(message).split())}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
