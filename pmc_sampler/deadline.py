"""Functions that are given up where they take too long."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from pmc_sampler.inputs import number

_Answer = tuple[bool, Any]  # whether it returned, and what; else what it raised
_given_up: list[threading.Thread] = []


class Deadline:
    """A function of one argument, called in a thread of its own that is given up after `seconds`.

    Raises TimeoutError then, and what the function raises otherwise. Python cannot end a thread: one that is given up
    goes on, with all it holds, until its function returns or the process ends. Nothing ends it, and the call does not
    return in time, where it keeps Python's global lock. It is one thread for all calls as long as none is given up,
    for renderers that keep state by thread.
    """

    def __init__(self, function: Callable[[Any], Any], seconds: float) -> None:
        if not 0.0 < number("timeout", seconds) <= threading.TIMEOUT_MAX:
            raise ValueError(f"timeout is {seconds!r}: expected seconds above 0, or None")
        self._function, self._seconds = function, seconds
        self._calls: queue.SimpleQueue[tuple[Any, queue.SimpleQueue[_Answer]] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def __call__(self, argument: Any) -> Any:
        """What the function returns."""
        if self._thread is None:
            # Not one of concurrent.futures: the interpreter waits for those at its end.
            self._thread = threading.Thread(target=_serve, args=(self._function, self._calls), daemon=True)
            self._thread.start()
        answer: queue.SimpleQueue[_Answer] = queue.SimpleQueue()
        self._calls.put((argument, answer))
        try:
            returned, value = self._wait(answer)
        except BaseException as error:  # an interrupt gives it up, too
            _given_up.append(self._thread)
            self.close()
            if isinstance(error, queue.Empty):
                raise TimeoutError(f"the renderer gave no answer within {self._seconds:g} s") from None
            raise
        if not returned:
            raise value
        return value

    def _wait(self, answer: queue.SimpleQueue[_Answer]) -> _Answer:
        # Not all at once: a signal that comes just before the wait is only noticed after it.
        end = time.monotonic() + self._seconds
        while True:
            left = end - time.monotonic()
            try:
                return answer.get(timeout=min(max(left, 0.0), 1.0))
            except queue.Empty:
                if left <= 1.0:
                    raise

    def close(self) -> None:
        """Lets the thread end, once its function has returned; another call starts another."""
        self._calls.put(None)
        self._calls, self._thread = queue.SimpleQueue(), None


def hung() -> bool:
    """Whether a call that was given up is still under way."""
    return any(thread.is_alive() for thread in _given_up)


def _serve(
    function: Callable[[Any], Any], calls: queue.SimpleQueue[tuple[Any, queue.SimpleQueue[_Answer]] | None]
) -> None:
    while (call := calls.get()) is not None:
        argument, answer = call
        try:
            answer.put((True, function(argument)))
        except BaseException as error:
            answer.put((False, error))
        del call, argument, answer  # a batch is not kept while the next is waited for
