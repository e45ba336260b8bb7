"""Progress on standard error, by rich; silent where standard error is not a terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Report = Callable[[float, str], None]


@contextmanager
def progress(title: str) -> Iterator[Report]:
    """A function ``report(fraction, note)`` that draws a bar while the context lasts; at first its note is loading."""
    if not sys.stderr.isatty():
        yield lambda fraction, note: None
        return
    try:
        import rich.progress as bars
        from rich.console import Console
    except ImportError:
        print("no progress is shown: that needs rich, pip install 'pmc-sampler[cli]'.", file=sys.stderr)
        yield lambda fraction, note: None
        return
    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.TaskProgressColumn(),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.fields[note]}"),
    )
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(title, total=1.0, note="loading")
        yield lambda fraction, note: shown.update(task, completed=fraction, note=note)
