"""A program that writes to us: started in a process group of its own, read without blocking, ended with all it started.

If this process dies, the kernel kills the helper (PR_SET_PDEATHSIG), and what the helper had started ends when it
writes into a pipe that is never read.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence

from contract.tied_process import tied

PIPE_BYTES = 1 << 20  # the most that the system gives without privileges
READ_BYTES = 1 << 20
MAX_WORDS = 300  # of a line on the helper's error stream
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
GRACE_S = 0.3  # between the request to end and the end


class HelperProcess:
    """A running helper. Used by one thread."""

    def __init__(
        self, command: Sequence[str], stdin: bytes = b"", environment: Mapping[str, str] | None = None
    ) -> None:
        """Start it. `stdin` (at most a pipe's 4 kB) is what it reads; raises OSError."""
        # `environment` is added to ours. Output goes through pipes only: nothing can be left in shared memory.
        launched = tied(command, signal.SIGKILL)
        self._process = subprocess.Popen(
            launched,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **(environment or {})},
            start_new_session=True,
            bufsize=0,
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        assert self._process.stderr is not None
        self._out, self._err = self._process.stdout.fileno(), self._process.stderr.fileno()
        self._line = b""
        self._is_closed = False
        self.words = ""  # the newest line of its error stream
        with contextlib.suppress(OSError):  # a smaller pipe will do
            fcntl.fcntl(self._out, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        for fd in (self._out, self._err):
            os.set_blocking(fd, False)
        with contextlib.suppress(BrokenPipeError):  # it has ended already: `read` will find out
            os.write(self._process.stdin.fileno(), stdin)
        self._process.stdin.close()
        self._poll = select.poll()
        self._poll.register(self._out, select.POLLIN)
        self._poll.register(self._err, select.POLLIN)
        self._open = {self._out, self._err}

    @property
    def pid(self) -> int:
        return self._process.pid

    def read(self, within_s: float) -> bytes | None:
        """Return its output, at the latest after `within_s`; empty if there is none, None once it has closed it."""
        data = b""
        for fd, _ in self._poll.poll(1e3 * within_s):
            try:
                got = os.read(fd, READ_BYTES)
            except BlockingIOError:
                continue
            if not got:
                self._poll.unregister(fd)
                self._open.discard(fd)
            elif fd == self._err:
                self._take_words(got)
            else:
                data = got
        return data if data or self._out in self._open else None

    def _take_words(self, got: bytes) -> None:
        *whole, rest = (self._line + got).split(b"\n")
        self._line = rest[:MAX_WORDS]
        for line in whole:
            plain = COLOUR.sub("", line[:MAX_WORDS].decode("utf-8", "replace"))
            text = "".join(c for c in plain if c.isprintable()).strip()
            self.words = text or self.words

    def last_words(self, within_s: float = 0.2) -> str:
        """The newest line of its error stream, once its output has ended: waits a little for the end of that, too."""
        deadline = time.monotonic() + within_s
        while self._err in self._open and time.monotonic() < deadline:
            self.read(max(deadline - time.monotonic(), 0.0))
        return self.words

    def close(self) -> int:
        """End it and all that is in its group; returns its exit status, negative if a signal ended it."""
        if not self._is_closed:
            self._is_closed = True
            self._end()
            for stream in (self._process.stdout, self._process.stderr):
                assert stream is not None
                stream.close()
        return self._process.wait()

    def _end(self) -> None:
        """Ask, wait, kill. The leader stays unreaped until the last signal: its number cannot be another's."""
        group, deadline = self._process.pid, time.monotonic() + GRACE_S
        self._signal(group, signal.SIGTERM)
        while time.monotonic() < deadline and not os.waitid(os.P_PID, group, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            time.sleep(0.01)
        self._signal(group, signal.SIGKILL)

    @staticmethod
    def _signal(group: int, number: int) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(group, number)
