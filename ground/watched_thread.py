"""One thread that repeats its work for good, whatever that raises, and can say how it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class WatchedThread:
    """Calls `work` every `period_s` until closed. An error does not end it: it is kept until a call goes well again.

    `work` must look at nothing but its own state: it is called from a thread of its own, also while `close` waits.
    """

    HUNG_S = 15.0  # at one call, after which it is said: opening a link takes a few seconds at worst

    def __init__(self, name: str, work: Callable[[], None], period_s: float) -> None:
        self.name = name
        self._work, self._period_s = work, period_s
        self._error = ""
        self._busy_since_s: float | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def error(self) -> str:
        """What is wrong with it, in a line; empty if nothing is."""
        busy_since_s = self._busy_since_s
        if not self._thread.is_alive() and not self._closed.is_set():
            return f"{self.name} has ended: {self._error or 'no reason known'}"
        if busy_since_s is not None and (busy_s := time.monotonic() - busy_since_s) > self.HUNG_S:
            return f"{self.name} has been at one attempt for {busy_s:.0f} s"
        return self._error

    def close(self, within_s: float = 5.0) -> bool:
        """Stop after the call that is under way; whether that ended in time."""
        self._closed.set()
        if self._thread is not threading.current_thread():
            self._thread.join(within_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._closed.wait(self._period_s):
            self._busy_since_s = time.monotonic()
            try:
                self._work()
            except BaseException as error:  # nobody else would hear of it, and the next call may go well
                self._error = " ".join(str(error).split()) or type(error).__name__
            else:
                self._error = ""
            finally:
                self._busy_since_s = None
