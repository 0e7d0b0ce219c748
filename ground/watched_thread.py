"""A supervised thread that repeats its work until it is closed, also after any exception."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from contract.errors import PointclickError
from contract.supervised_thread import Policy, SupervisedThread, ThreadState, in_a_line

log = logging.getLogger("pointclick")


class WatchedThread(SupervisedThread):
    """Calls `work` every `period_s` until closed. An error does not end it: it is kept until a call succeeds.

    One that is no `PointclickError` is a fault of the program and goes into the log, once as long as it stays the same.
    `work` must look at nothing but its own state: it is called from a thread of its own, also while `close` waits.
    """

    HUNG_S = 15.0  # at one call, after which it is reported: opening a link takes a few seconds at worst

    def __init__(self, name: str, work: Callable[[], None], period_s: float) -> None:
        super().__init__(name, self._repeat, Policy.RESTART, late_after_s=self.HUNG_S)
        self._call, self._period_s = work, period_s
        self._failure = ""
        self.start()

    @property
    def trouble(self) -> str:
        """The fault of the thread, in a line; empty if there is none."""
        report = self.report()
        if report.state is ThreadState.LATE:
            return f"{self.name} has been at one attempt for {self.heartbeat_age_s:.0f} s"
        if not report.is_well:
            return f"{self.name} has ended: {report.last_error}"
        return self._failure

    def close(self, within_s: float = 5.0) -> bool:
        """Stop after the call that is under way; whether that ended in time."""
        self.end()
        if self._thread is threading.current_thread():
            return False
        return self.join(within_s)

    def _repeat(self, _: SupervisedThread) -> None:
        while not self.wait(self._period_s):
            try:
                self._call()
            except BaseException as error:  # of any kind: the next call may succeed
                self._keep(error)
            else:
                self._failure = ""

    def _keep(self, error: BaseException) -> None:
        words = " ".join(str(error).split()) or type(error).__name__
        if words != self._failure and not isinstance(error, PointclickError):
            log.error("the %s failed (%s); it goes on trying", self.name, in_a_line(error), exc_info=error)
        self._failure = words
