"""Adjustment of windows, at once or in a thread of its own. The pipeline knows only this interface.

`concurrent.futures.ThreadPoolExecutor(1)` is a `Worker` as it stands; `Inline` needs no thread. The result does not
depend on the choice, because a request never changes and the pipeline adopts an outcome at a time that the data define.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust


@dataclass(frozen=True, eq=False)
class Done:
    """An outcome and the processor time it took; also the promise of itself."""

    outcome: Outcome
    processor_s: float

    def result(self) -> Done:
        return self


class Promise(Protocol):
    """The result of a call that is being worked on."""

    def result(self) -> Done:
        """Wait for it; raises what the work raised."""


class Worker(Protocol):
    """Takes work and promises its result."""

    def submit(self, fn: Callable[[Request], Done], request: Request, /) -> Promise:
        """Begin, or at least remember, one call."""


class Inline:
    """Works at once and in the same thread."""

    def submit(self, fn: Callable[[Request], Done], request: Request, /) -> Promise:
        return fn(request)


def timed_adjust(request: Request) -> Done:
    """`adjust`, and how long this thread worked on it."""
    began = time.thread_time()
    outcome = adjust(request)
    return Done(outcome, time.thread_time() - began)
