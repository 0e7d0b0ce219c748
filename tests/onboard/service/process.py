"""`pc-onboard run` as a process, with a played camera and a fake autopilot that keep step on the host's clock."""

import csv
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from contract.vehicle_status import VehicleStatus
from onboard.link.status_query import ask
from onboard.service.reports import Report
from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight
from simulation.session import SessionSpec
from tests.onboard.link.ports import free_endpoint
from tests.scenarios.flights import simulated
from tests.waiting import PATIENCE_S, eventually

ROOT = Path(__file__).resolve().parents[3]
BEGIN_IN_S = 4.0  # the first picture at the earliest: the daemon needs about two seconds to be there


@cache
def begin_in_s() -> float:
    """Seconds to the first picture: twice what a program of ours takes here to load, and what a daemon does besides."""
    began_s = time.monotonic()
    command = [sys.executable, "-c", "import onboard.commands.run, onboard.link.publisher, onboard.pipeline.pipeline"]
    subprocess.run(command, cwd=ROOT, check=True)
    return max(BEGIN_IN_S, 2.0 + 2.0 * (time.monotonic() - began_s))


@dataclass
class Aircraft:
    """A running daemon and what is around it. Times are seconds since the first picture."""

    where: Path
    folder: Path
    endpoint: str
    autopilot: FakeAutopilot
    first_unix_s: float
    shift_s: float
    process: subprocess.Popen[str] | None = None
    log: list[str] = field(default_factory=list)
    max_file_bytes: int | None = None  # what any file it writes may grow to: a full disk, one file at a time

    @property
    def config(self) -> Path:
        return self.where / "config.toml"

    @property
    def now_s(self) -> float:
        """Of the flight: monotonic time, whatever the host's clock does."""
        return time.monotonic() + self.unix_minus_monotonic_s - self.first_unix_s

    unix_minus_monotonic_s: float = 0.0

    def start(self) -> None:
        command = [sys.executable, "-m", "onboard", "run", "--config", str(self.config)]
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            preexec_fn=self._limit,  # noqa: PLW1509  set before any thread of the child
        )  # fmt: skip
        threading.Thread(target=self._read, args=(self.process,), daemon=True).start()

    def _limit(self) -> None:
        if self.max_file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.max_file_bytes, self.max_file_bytes))

    def _read(self, process: subprocess.Popen[str]) -> None:
        for line in process.stdout:
            self.log.append(line.rstrip("\n"))

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def ended(self) -> int:
        """Its exit code; a kill is what the service manager does where it has not ended within TimeoutStopSec."""
        return self.process.wait(PATIENCE_S)

    def report(self) -> Report | None:
        answer = ask("uav", [self.endpoint])
        return None if answer is None else Report.from_json(answer)

    def status(self) -> VehicleStatus | None:
        report = self.report()
        return None if report is None else report.status

    def reported_since(self, unix_s: float, within_s: float = PATIENCE_S) -> VehicleStatus:
        """The first status said at or after a moment of the daemon's clock."""
        deadline = time.monotonic() + within_s
        while (seen := self.status()) is None or seen.unix_s < unix_s:
            assert time.monotonic() < deadline, f"no status since {unix_s} within {within_s} s but {seen}"
            time.sleep(0.1)
        return seen

    def logged(self, word: str, within_s: float = PATIENCE_S) -> list[str]:
        """The lines of the log with a word in them, once there is one."""
        deadline = time.monotonic() + within_s
        while not (found := [line for line in self.log if word in line]):
            assert time.monotonic() < deadline, f"no {word} within {within_s} s; log:\n" + "\n".join(self.log[-20:])
            time.sleep(0.05)
        return found

    def stated(self, *words: str, since: int) -> None:
        """Until the log says after its first `since` lines that the state is one of these, if only for a moment.

        What is asked for next is no older: a status is said once a second.
        """
        assert eventually(lambda: any(f"state: {word}" in line for line in self.log[since:] for word in words)), (
            f"never {words}; log:\n" + "\n".join(self.log[-20:])
        )
        before = self.status()
        self.reported_since(0.0 if before is None else before.unix_s + 1e-3)

    def wait_for(self, *words: str, within_s: float = PATIENCE_S) -> float:
        """Until the state is one of these; seconds waited."""
        began, seen = time.monotonic(), None
        while time.monotonic() - began < within_s:
            seen = self.status()
            if seen is not None and seen.state in words:
                return time.monotonic() - began
            time.sleep(0.1)
        raise AssertionError(f"not {words} but {seen} within {within_s} s; log:\n" + "\n".join(self.log[-20:]))

    def sleep_until(self, moment_s: float) -> None:
        time.sleep(max(moment_s - self.now_s, 0.0))

    @property
    def recordings(self) -> list[Path]:
        return sorted((self.where / "state" / "recordings").glob("*.mcap"))


@contextmanager
def aircraft(where: Path, spec: SessionSpec, config: str = "", style: str = "ardupilot") -> Iterator[Aircraft]:
    """Everything but the daemon itself: `start` it. `config` adds to the configuration."""
    folder = simulated(spec)
    shutil.copytree(folder / "frames", where / "frames")
    with (folder / "stamps.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    first_s = float(rows[0]["unix_time_s"])
    log = Flight.read(folder / "telemetry.tlog")
    # Recorded Unix time -> boot time -> the host's monotonic clock, so that pictures and telemetry keep step.
    until_first_s = begin_in_s()
    offset_s = time.time() - time.monotonic()
    begin_mono_s = time.monotonic() + until_first_s
    lead_s = min(until_first_s - 0.5, first_s - log.log_offset_ns / 1e9 - log.due_ns[0] / 1e9)
    begin_s = first_s - lead_s - log.log_offset_ns / 1e9 - log.due_ns[0] / 1e9
    at_ns = round((begin_mono_s - lead_s) * 1e9)
    shift_s = begin_mono_s + offset_s - first_s
    lines = ["file,unix_time_s", *(f"{row['file']},{float(row['unix_time_s']) + shift_s:.6f}" for row in rows)]
    (where / "frames" / "stamps.csv").write_text("\n".join(lines) + "\n")
    shutil.copy(folder / "camera.json", where)
    endpoint = free_endpoint()
    with FakeAutopilot(log, "pty", style=style, begin_s=begin_s, at_monotonic_ns=at_ns) as autopilot:
        (where / "config.toml").write_text(
            (folder / "config.toml").read_text()
            + f'\n[camera]\ndevice = "replay:{where / "frames"}"\nfile = "{where / "camera.json"}"\n'
            + f"rate_hz = {spec.rate_hz}\n"
            + f'\n[telemetry]\nurl = "{autopilot.url}"\nsystem = {autopilot.system}\n'
            + f'\n[link]\nlisten = ["{endpoint}"]\nmax_bit_rate = 1e7\n'
            + f'\n[service]\nstate_dir = "{where / "state"}"\n\n[recording]\nkeep_free_mb = 1\n{config}'
        )
        plane = Aircraft(where, folder, endpoint, autopilot, first_s + shift_s, shift_s)
        plane.unix_minus_monotonic_s = offset_s
        try:
            yield plane
        finally:
            if plane.process is not None and plane.process.poll() is None:
                plane.process.kill()
                plane.process.wait()
