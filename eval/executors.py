"""Where runs are done: in this process, one after the other, or on the workers of a Dask cluster.

An executor is a function of a task, what all its calls share, and the calls' arguments; it yields pairs of an
argument's place and its result, as they come. Tasks return what went wrong instead of raising; an exception that is
yielded is the executor's own, of a call that it could not do.
"""

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from pmc_sampler import cluster

Argument = TypeVar("Argument")
Outcome = TypeVar("Outcome")
Task = Callable[[Any, Argument], Outcome]
Executor = Callable[[Task[Argument, Outcome], Any, Sequence[Argument]], Iterator[tuple[int, Outcome | Exception]]]


def in_process(
    task: Task[Argument, Outcome], shared: Any, arguments: Sequence[Argument]
) -> Iterator[tuple[int, Outcome | Exception]]:
    """``task(shared, argument)`` for each argument, in their order."""
    for place, argument in enumerate(arguments):
        yield place, task(shared, argument)


@contextlib.contextmanager
def on_cluster(address: str) -> Iterator[Executor[Any, Any]]:
    """An executor on the cluster whose scheduler is at ``address``, such as ``tcp://host:8786``.

    ``shared`` is sent once. A call whose worker dies is done again on another, and gives an exception once it has taken
    several workers with it (Dask's `distributed.scheduler.allowed-failures`). Calls that are not finished when the
    caller leaves the loop are cancelled. Raises :class:`pmc_sampler.cluster.ClusterError` where there is no scheduler,
    or no more, and without the package `distributed`.
    """
    client = cluster.connect(address)
    import distributed

    def execute(task: Any, shared: Any, arguments: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        # A task of its own, not scattered data: that would be lost with the worker that has it.
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sending large graph")
            sent = client.submit(_same, shared, pure=False)
        futures = {
            client.submit(task, sent, argument, pure=False, retries=0): place
            for place, argument in enumerate(arguments)
        }
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                if future.status == "finished":
                    yield futures[future], future.result()
                elif future.status == "error":
                    yield futures[future], future.exception()
                else:
                    raise cluster.ClusterError(f"the Dask scheduler at {address!r} was lost; the same command goes on.")
                future.release()
        finally:
            client.cancel(list(futures))

    with client:
        yield execute


def _same(shared: Any) -> Any:
    return shared
