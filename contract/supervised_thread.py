"""One kind of thread on both sides, aircraft and ground: with a name, a heartbeat and a policy.

The only module of `contract` with threads and a clock: neither side may import the other.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from types import TracebackType
from typing import Protocol, Self

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0  # before a thread that failed is begun again; doubled each time
END_S = 5.0  # that work which was woken to end may take

log = logging.getLogger("pointclick")


class Policy(Enum):
    """The consequence of a thread's failure, or of its end without having been asked to."""

    RESTART = "restart"  # begun again, after a pause that grows
    DEGRADE = "degrade"  # the service goes on without it and reports that
    END = "end"  # the service ends, and its manager restarts it


class ThreadState(Enum):
    """The state of a thread. Values are the words users see."""

    NOT_STARTED = "not started"
    RUNNING = "running"
    LATE = "late"  # no heartbeat for longer than it should take: it hangs, or nearly
    RESTARTING = "restarting"  # failed, and waits for its next beginning
    FAILED = "failed"  # and is not begun again
    ENDED = "ended"  # as asked


@dataclass(frozen=True)
class ThreadReport:
    """The condition of a thread at one moment."""

    name: str
    state: ThreadState
    heartbeat_age_s: float | None  # since its last heartbeat; None before its start and for one that has no beat
    restarts: int
    last_error: str  # one line; empty if it never failed

    @property
    def is_well(self) -> bool:
        """True while it does its work, or once it has ended as asked."""
        return self.state in (ThreadState.RUNNING, ThreadState.ENDED)


class Stop(Protocol):
    """The part of `threading.Event` that work in a thread needs."""

    def is_set(self) -> bool:
        """Return True once the work is to end."""

    def wait(self, timeout: float | None = None) -> bool:
        """Sleep until it is set or `timeout` seconds have passed; returns whether it is set."""


class StopEvent(Stop, Protocol):
    """The part of `threading.Event` that a supervised thread needs."""

    def set(self) -> None:
        """Ask for the end."""


class SupervisedThread:
    """Runs `work`, which is given the thread itself: a `Stop` that takes each question as a heartbeat.

    `late_after_s` is the longest that `work` may take between two heartbeats; None for work that cannot give any.
    `stop` may be shared between threads. A daemon thread: the interpreter does not wait for one that hangs.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[SupervisedThread], None],
        policy: Policy,
        *,
        late_after_s: float | None = 10.0,
        stop: StopEvent | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.policy, self.late_after_s = name, policy, late_after_s
        self.error: BaseException | None = None  # the newest
        self._work, self._monotonic_s = work, monotonic_s
        self._stop: StopEvent = threading.Event() if stop is None else stop
        self._state = ThreadState.NOT_STARTED
        self._restarts = 0
        self._last_error = ""
        self._beat_s = 0.0
        self._is_waiting = False  # for its end, in `wait`: that is no hanging, however long it takes
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin."""
        self.beat()
        self._state = ThreadState.RUNNING
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Ask for the end; returns at once."""
        self._stop.set()

    def join(self, timeout_s: float | None = None) -> bool:
        """Wait for the end; whether it came. A thread that was never started has ended."""
        if self._thread is not None:
            self._thread.join(timeout_s)
        return not self.is_alive()

    def is_alive(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def beat(self) -> None:
        self._beat_s = self._monotonic_s()

    def is_set(self) -> bool:
        """Serve `Stop`: return True once the work is to end. Counts as a heartbeat."""
        self.beat()
        return self._stop.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Serve `Stop`: sleep until it is set or `timeout` seconds have passed. A heartbeat while it lasts."""
        self._is_waiting = True
        try:
            return self._stop.wait(timeout)
        finally:
            self.beat()
            self._is_waiting = False

    @property
    def heartbeat_age_s(self) -> float:
        return 0.0 if self._is_waiting else max(self._monotonic_s() - self._beat_s, 0.0)

    @property
    def has_failed(self) -> bool:
        """Ended by itself, for good; `error` gives the reason, if anything was raised."""
        return self._state is ThreadState.FAILED

    @property
    def is_late(self) -> bool:
        """Runs, and has given no heartbeat for too long."""
        if self._state is not ThreadState.RUNNING or self.late_after_s is None:
            return False
        return self.heartbeat_age_s > self.late_after_s

    def report(self) -> ThreadReport:
        """Return the thread's condition now; may be called from any thread."""
        has_beat = self._state is ThreadState.RUNNING and self.late_after_s is not None
        state = ThreadState.LATE if self.is_late else self._state
        return ThreadReport(
            self.name, state, self.heartbeat_age_s if has_beat else None, self._restarts, self._last_error
        )

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while True:
            self.beat()
            self._state, began_s = ThreadState.RUNNING, self._monotonic_s()
            error = self._run_once()
            if error is None and self._stop.is_set():
                self._state = ThreadState.ENDED
                return
            self.error = error
            self._last_error = "ended by itself" if error is None else in_a_line(error)
            may_restart = error is None or isinstance(error, Exception)
            if self.policy is not Policy.RESTART or not may_restart or self._stop.is_set():
                self._state = ThreadState.FAILED
                if self.policy is not Policy.END:  # the daemon reports the others, as it ends
                    log.error("the %s failed (%s); the service goes on without it", self.name, self._last_error)
                return
            self._state = ThreadState.RESTARTING
            if self._monotonic_s() - began_s > LONGEST_PAUSE_S:
                pause_s = FIRST_PAUSE_S  # it ran well for a while: this is another failure, not the same again
            log.error(
                "the %s failed (%s); it is begun again in %g s",
                self.name,
                self._last_error,
                pause_s,
                exc_info=error if self._restarts == 0 else None,
            )
            if self._stop.wait(pause_s):
                self._state = ThreadState.ENDED
                return
            self._restarts += 1
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _run_once(self) -> BaseException | None:
        try:
            self._work(self)
        except BaseException as error:  # kept: what becomes of it is the policy's decision
            return error
        return None


class WokenWork(ABC):
    """Work in a thread of its own that sleeps until others have something for it: `_changed` guards what they leave
    there, and wakes it. A context manager: begun on entry, ended on exit.
    """

    def __init__(self, name: str, *, late_after_s: float = 10.0) -> None:
        self._changed = threading.Condition()
        self.thread = SupervisedThread(name, self._run, Policy.RESTART, late_after_s=late_after_s)

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.thread.end()
        with self._changed:
            self._changed.notify()
        self.thread.join(END_S)

    @abstractmethod
    def _run(self, thread: SupervisedThread) -> None:
        """Until `thread` is set."""


def in_a_line(error: BaseException) -> str:
    """Its kind and its words, for a line of a log."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
