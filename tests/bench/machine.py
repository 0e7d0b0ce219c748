"""One guest: boots User Mode Linux, runs jobs in it over a serial line, and always ends it."""

import base64
import contextlib
import itertools
import json
import os
import queue
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.bench.image.host import BenchError, require
from tests.bench.image.kernel import kernel
from tests.bench.image.root import CHECKOUT, INSTALL, packages, root

MEMORY = "1536M"
ROOM_BYTES = 3_000_000_000
"""Of the memory, the disk's changes and the shared folder."""
BOOT_S = 120.0
"""Bound on the boot; it takes 3 to 7 s on an idle machine."""
END_S = 10.0
"""Bound on the wait for what was killed."""
LIFE_S = 1400.0
"""Bound on a guest's whole life: then it is killed, whoever still waits for it."""

PYTHON = f"{INSTALL}/bin/python"
SHARE = "/mnt/share"
GUEST_CHECKOUT = "/mnt/checkout"
GUEST_MAC = "02:00:00:99:00:02"
INSIDE = {"PYTHONPATH": GUEST_CHECKOUT, "POINTCLICK_IN_GUEST": "1", "PYTEST_ADDOPTS": "-p no:cacheprovider"}
"""The environment of a checkout's own Python in the guest."""


@dataclass(frozen=True)
class Images:
    """What a guest boots from."""

    kernel: Path
    root: Path
    packages: Path


def images() -> Images:
    """All images, built where the cache has none (about six minutes from nothing on two cores)."""
    require()
    built = kernel()
    return Images(built / "linux", root(built), packages())


@dataclass(frozen=True)
class Done:
    """A finished job: its exit code (negative: the signal) and everything it said."""

    code: int
    text: str

    def ok(self) -> str:
        """What it said, if it succeeded; BenchError otherwise."""
        if self.code != 0:
            raise BenchError(f"exit {self.code}:\n{self.text}")
        return self.text


class Job:
    """A command that runs in the guest."""

    def __init__(self, argv: Sequence[str], on_text: Callable[[str], None] | None) -> None:
        self.argv = list(argv)
        self.text = ""
        self._on_text = on_text
        self._ended: queue.Queue[int | None] = queue.Queue()

    def received(self, answer: Mapping[str, Any]) -> None:
        if "text" in answer:
            self.text += answer["text"]
            if self._on_text is not None:
                self._on_text(answer["text"])
        if "exit" in answer:
            self._ended.put(answer["exit"])

    @property
    def is_over(self) -> bool:
        return not self._ended.empty()

    def wait(self, timeout_s: float) -> Done:
        """Its end; to be asked once. BenchError when it does not come, or the guest had to kill it for its time."""
        try:
            code = self._ended.get(timeout=timeout_s)
        except queue.Empty:
            raise BenchError(f"no answer from the guest within {timeout_s:.0f} s: {self.argv}\n{self.text}") from None
        if code is None:
            raise BenchError(f"killed for its time: {self.argv}\n{self.text}")
        return Done(code, self.text)


class Machine:
    """A booted guest. Use `boot`, which ends it."""

    def __init__(self, process: subprocess.Popen[bytes], line: socket.socket, folder: Path) -> None:
        self.share = folder / "share"
        self.console = folder / "console.log"
        self.session = process.pid
        self._process = process
        self._line = line
        self._jobs: dict[int, Job] = {}
        self._numbers = itertools.count()
        self._ready = threading.Event()
        self._ready_unix_s = 0.0
        self._clock: queue.Queue[int] = queue.Queue()
        self._sending = threading.Lock()
        threading.Thread(target=self._listen, daemon=True).start()

    def wait_ready(self) -> None:
        """Return when the guest's agent has spoken. BenchError with the console's end otherwise."""
        for _ in range(int(BOOT_S / 0.1)):
            if self._ready.wait(0.1):
                self._ready_unix_s = time.time()
                return
            if self._process.poll() is not None:
                break
        raise BenchError(f"the guest did not boot:\n{self.console_tail()}")

    def start(
        self,
        argv: Sequence[str],
        *,
        timeout_s: float = 60.0,
        cwd: str = "/",
        env: Mapping[str, str] | None = None,
        on_text: Callable[[str], None] | None = None,
    ) -> Job:
        """Start a command; the guest kills it after `timeout_s`."""
        number = next(self._numbers)
        job = self._jobs[number] = Job(argv, on_text)
        request = {"job": number, "argv": job.argv, "cwd": cwd, "env": dict(env or {}), "timeout_s": timeout_s}
        self._send(request)
        return job

    def run(self, *argv: str, timeout_s: float = 30.0, **how: Any) -> Done:
        return self.start(argv, timeout_s=timeout_s, **how).wait(timeout_s + 10.0)

    def shell(self, script: str, timeout_s: float = 30.0) -> str:
        return self.run("/bin/sh", "-euc", script, timeout_s=timeout_s).ok()

    def clock_offset_ns(self) -> int:
        """Guest's CLOCK_MONOTONIC minus the host's, from the quickest of several round trips."""
        best = (10**12, 0)
        for _ in range(15):
            sent_ns = time.monotonic_ns()
            self._send({"job": -1, "clock": True})
            guest_ns = self._clock.get(timeout=10.0)
            trip_ns = time.monotonic_ns() - sent_ns
            best = min(best, (trip_ns, guest_ns - sent_ns - trip_ns // 2))
        return best[1]

    def unix_offset_ns(self) -> int:
        """The guest's Unix clock minus its CLOCK_MONOTONIC."""
        return int(self.run(PYTHON, "-c", "import time; print(time.time_ns() - time.monotonic_ns())").ok())

    def put(self, path: str, content: str | bytes) -> None:
        raw = content.encode() if isinstance(content, str) else content
        coded = base64.b64encode(raw).decode()
        self.shell(f"mkdir -p $(dirname {path}) && echo {coded} | base64 -d >{path}")

    def journal(self, lines: int = 200) -> str:
        """The end of the guest's journal since it was ready, or why there is none."""
        since = f"--since=@{self._ready_unix_s:.3f}"
        try:
            return self.run("journalctl", since, "--no-pager", "--output=short-monotonic", f"-n{lines}").text
        except BenchError as error:
            return f"no journal: {error}\n{self.console_tail()}"

    def console_tail(self) -> str:
        """The last lines of the guest's console."""
        return "\n".join(self.console.read_text(errors="replace").splitlines()[-40:])

    def _send(self, request: Mapping[str, Any]) -> None:
        with self._sending:
            self._line.sendall(json.dumps(request).encode() + b"\n")

    def _listen(self) -> None:
        pending = b""
        while chunk := self._received():
            pending += chunk
            *whole, pending = pending.split(b"\n")
            for raw in whole:
                self._take(json.loads(raw))

    def _received(self) -> bytes:
        try:
            return self._line.recv(65536)
        except OSError:  # closed: the guest has ended
            return b""

    def _take(self, answer: Mapping[str, Any]) -> None:
        if "ready" in answer:
            self._ready.set()
        elif "monotonic_ns" in answer:
            self._clock.put(answer["monotonic_ns"])
        else:
            self._jobs[answer["job"]].received(answer)


@contextlib.contextmanager
def boot(
    *,
    checkout: Path = CHECKOUT,
    serial: Path | None = None,
    interface: str | None = None,
    kernel_words: Sequence[str] = (),
) -> Iterator[Machine]:
    """A booted guest for as long as the block lasts.

    `checkout` is at /mnt/checkout in the guest (read-only), an empty folder of the host's at /mnt/share. `serial` is a
    pty that becomes /dev/ttyS0, `interface` the end of a veth pair that becomes vec0.
    """
    built = images()
    folder = _new_folder()
    (folder / "share").mkdir()
    ours, theirs = socket.socketpair()
    words = [
        *("setpriv", "--pdeathsig", "KILL", str(built.kernel)),
        *("umid=uav", f"uml_dir={folder}/", f"mem={MEMORY}", "seccomp=auto", "quiet"),
        *(f"ubd0={folder}/disk,{built.root}", f"ubd1r={built.packages}", "root=/dev/ubda", "rw"),
        *("con=null", "con0=null,fd:1", "con1=null", "ssl=null", f"ssl1=fd:{theirs.fileno()}"),
        *("systemd.show_status=0", "net.ifnames=0", f"bench.checkout={checkout}", f"bench.share={folder}/share"),
        *([f"ssl0=tty:{serial}"] if serial else []),
        *([f"vec0:transport=raw,ifname={interface},mac={GUEST_MAC}"] if interface else []),
        *kernel_words,
    ]
    with (folder / "console.log").open("wb") as console:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
            pass_fds=[theirs.fileno()],
            env={**os.environ, "TMPDIR": str(folder)},
            start_new_session=True,
        )
    theirs.close()
    bound = threading.Timer(LIFE_S, _end, args=(process,))
    bound.daemon = True
    bound.start()
    try:
        machine = Machine(process, ours, folder)
        machine.wait_ready()
        yield machine
    finally:
        bound.cancel()
        _end(process)
        ours.close()
        shutil.rmtree(folder)


def _new_folder() -> Path:
    """For one guest, named after this process; those of processes that were killed go."""
    where = _roomy_folder()
    for old in Path(where or tempfile.gettempdir()).glob("pointclick-bench-*-*"):
        if not Path("/proc", old.name.split("-")[2]).exists():
            shutil.rmtree(old, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=f"pointclick-bench-{os.getpid()}-", dir=where))


def _roomy_folder() -> str | None:
    """Where the guest's memory and disk go: RAM, if there is enough that may hold programs (in containers not)."""
    there = os.statvfs("/dev/shm") if Path("/dev/shm").is_dir() else None
    fits = there is not None and there.f_bavail * there.f_frsize > ROOM_BYTES and not there.f_flag & os.ST_NOEXEC
    return "/dev/shm" if fits else None


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill the guest: its kernel, and the host processes in which its programs ran (its session, no one else's)."""
    process.kill()
    process.wait()
    # A busy host takes a moment over it, and a process may have begun another meanwhile.
    deadline = time.monotonic() + END_S
    while (left := processes_of(process.pid)) and time.monotonic() < deadline:
        for number in left:
            with contextlib.suppress(OSError):
                os.kill(number, signal.SIGKILL)
        time.sleep(0.02)


def processes_of(session: int) -> list[int]:
    """The host's processes of a session that are not over."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # gone meanwhile
            # After the last ")": state, parent, group, session.
            fields = entry.read_text().rsplit(")", 1)[1].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(entry.parent.name))
    return found
