"""The thread that solves windows: an executor of one, under supervision."""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from contract.supervised_thread import Policy, SupervisedThread

IDLE_S = 0.5
LATE_S = 10.0  # a window takes some tenths of a second


class SolverThread:
    """A thread for one call at a time: as much of `concurrent.futures.ThreadPoolExecutor(1)` as the pipeline needs.

    What a call raises is raised again where its result is asked for, which is in the pipeline's thread.
    """

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[Any], Any], Any]] = queue.SimpleQueue()
        self.thread = SupervisedThread("solver", self._run, Policy.END, late_after_s=LATE_S)
        self.thread.start()

    def submit(self, fn: Callable[[Any], Any], request: Any, /) -> Future[Any]:
        """Call `fn` with the request when all earlier calls are done."""
        future: Future[Any] = Future()
        self._calls.put((future, fn, request))
        return future

    def close(self) -> None:
        """Take no further call; returns at once, for a call may hang."""
        self.thread.end()

    def _run(self, thread: SupervisedThread) -> None:
        while not thread.is_set():
            try:
                future, fn, request = self._calls.get(timeout=IDLE_S)
            except queue.Empty:
                continue
            thread.beat()
            try:
                future.set_result(fn(request))
            except BaseException as error:  # not swallowed: `result` raises it
                future.set_exception(error)
