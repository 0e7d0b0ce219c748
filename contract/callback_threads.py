"""The end of a process waits for the threads in which zenoh calls back.

zenoh's Python binding starts a thread for each callback, a daemon where the thread that declared it is one. The
interpreter does not wait for daemons, and one that wakes while it ends, below the binding's frames, aborts the process
("exception not rethrown", status 134), though all was done. After its session is closed such a thread ends by itself.
"""

from __future__ import annotations

import atexit
import threading
import time
from functools import cache

NAME = "pyo3-closure"  # as the binding names their function
PATIENCE_S = 3.0  # of a session that was not closed they do not end


@cache
def awaited_at_exit() -> None:
    """Have the process wait for them, from the first call on."""
    atexit.register(_await)


def _await() -> None:
    until_s = time.monotonic() + PATIENCE_S
    for thread in threading.enumerate():
        if thread.daemon and NAME in thread.name:
            thread.join(max(until_s - time.monotonic(), 0.0))
