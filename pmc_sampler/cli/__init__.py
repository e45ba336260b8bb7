"""The command line ``pmc-sampler``. Finds renderers, scenes, image files and metrics by name at run time."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from pmc_sampler import deadline

from .arguments import parse
from .errors import CommandError, plain_warnings

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 for a failed run, 2 for bad input, 130 when interrupted.

    ``arguments`` are the words after the program's name; by default those the process was started with.
    """
    options = parse(arguments)
    try:
        with plain_warnings(options.command):
            status = _run(options.command)(options)
    except CommandError as error:
        print(f"pmc-sampler {options.command}: {error}", file=sys.stderr)
        status = error.status
    except KeyboardInterrupt:
        print(f"pmc-sampler {options.command}: interrupted, nothing was written.", file=sys.stderr)
        status = 130
    except BrokenPipeError:
        # Whoever read our output has gone; Python must not fail again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    if arguments is None and deadline.hung():
        # What a library does at the interpreter's end may wait for a renderer that never answers.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def _run(command: str) -> Callable[[argparse.Namespace], int]:
    # Imported when needed: listing scenes should not wait for what rendering imports.
    if command == "render":
        from .render import render as run
    elif command == "compare":
        from .compare import compare as run
    elif command == "bench":
        from .bench import bench as run
    elif command == "record":
        from .record import record as run
    elif command == "report":
        from .report import report as run
    elif command == "scenes":
        from .listing import scenes as run
    else:
        from .listing import renderers as run
    return run
