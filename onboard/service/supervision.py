"""All threads of a session seen together: how each is, whether one failed or hangs, whether the watchdog may be fed.

The type itself is `contract.supervised_thread`: sinks have threads too, and may not import the service.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from contract.supervised_thread import Policy, SupervisedThread, ThreadReport, ThreadState

__all__ = ["Supervisor", "ThreadReport", "ThreadState"]


class Supervisor:
    """Looks at threads, never touches them. `threads` is asked each time: a session may have more of them later."""

    def __init__(self, threads: Callable[[], Sequence[SupervisedThread]]) -> None:
        self._threads = threads

    def reports(self) -> tuple[ThreadReport, ...]:
        return tuple(thread.report() for thread in self._threads())

    @property
    def failure(self) -> tuple[str, BaseException | None] | None:
        """A thread without which the service cannot continue and that has ended, with its error if there was one."""
        for thread in self._vital():
            if thread.has_failed:
                return thread.name, thread.error
        return None

    def hung(self, after_s: float) -> str:
        """The name of a thread without which the service cannot continue, silent for `after_s`; empty if none is."""
        for thread in self._vital():
            if thread.is_late and thread.heartbeat_age_s > after_s:
                return thread.name
        return ""

    @property
    def is_alive(self) -> bool:
        """True if every thread without which the service cannot continue has reported in time."""
        return not any(thread.is_late or thread.has_failed for thread in self._vital())

    def _vital(self) -> list[SupervisedThread]:
        return [thread for thread in self._threads() if thread.policy is Policy.END]
