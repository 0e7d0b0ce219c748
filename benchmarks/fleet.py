"""Many aircraft and operators at one router, with certificates, on this machine.

    python -m benchmarks.fleet [--aircraft 50] [--operators 20] [--seconds 30]

Aircraft publish sets of 100 features at 2 Hz and a status a second, five of them pictures of 6 kB every two seconds,
each with the publisher that flies. Operators listen to all of it and note when each set came. Router, aircraft and
operators are processes of their own and share the processor. Phases of so many seconds each: all well; one operator
more that is stopped (SIGSTOP) and reads nothing; one aircraft that leaves and comes back each second; the router killed
and started again. Loss and latency are of all others: sets published in the phase that an operator did not hear, and
from publishing to hearing. Processor (of one core) and memory are the router's.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe, load, table, verdict
from contract.fleet import FLEET_FILE
from onboard.__main__ import main as onboard
from tests.onboard.link.ports import free_endpoint

ROOT = Path(__file__).resolve().parents[1]
PICTURES = 5
STARTED_WITHIN_S = 120.0
ON_ITS_WAY_S = 1.0  # of a phase's end that is not counted: its sets may be received in the next
DOWN_S = 2.0
SETTLED_S = 5.0
LOSS_SHARE, NEWEST_S = 0.01, 3.0  # goals
TICKS = os.sysconf("SC_CLK_TCK")

Rows = NDArray[np.int64]  # operator, aircraft, frame, captured, received


@dataclass(frozen=True)
class Phase:
    """Between which moments (Unix ns), and what the router used: processor seconds, and memory at the end."""

    name: str
    begin_ns: int
    end_ns: int
    processor_s: float
    memory_mb: float


class Program:
    """A process that is ended by the end of its input, or killed."""

    def __init__(self, *words: str, waits_for: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", *words], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert waits_for in line, line

    def tell(self, line: str) -> None:
        """A line on its input."""
        assert self.process.stdin is not None
        print(line, file=self.process.stdin, flush=True)

    def end(self) -> None:
        """Close its input, so that it writes what it has, and wait for its end."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        assert self.process.wait(120.0) == 0

    def used(self) -> tuple[float, float]:
        """Processor seconds so far, and resident memory in MB."""
        place = Path("/proc") / str(self.process.pid)
        fields = (place / "stat").read_text().rpartition(")")[2].split()
        pages = int((place / "statm").read_text().split()[1])
        return (int(fields[11]) + int(fields[12])) / TICKS, pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Station:
    """Router, aircraft and operators in a folder, and the phases so far."""

    def __init__(self, folder: Path, aircraft: int, operators: int) -> None:
        self._folder = folder
        self._keys = folder / "keys"
        self._endpoint = free_endpoint().replace("tcp/", "tls/")
        planes = [f"uav-{k}" for k in range(1, aircraft + 1)]
        people = [f"anna-{k}" for k in range(1, operators + 2)]  # the last one is stopped
        words = ["make-credentials", str(self._keys), "--router", "base"]
        words += [w for name in planes for w in ("--vehicle", name)] + [
            w for name in people for w in ("--operator", name)
        ]
        with contextlib.redirect_stdout(io.StringIO()):
            assert onboard(words) == 0
        self.router = self._route()
        self.operators = self._side("operators", people[:-1], "heard.npy")
        self.slow = self._side("operators", people[-1:], "slow.npy")
        self.aircraft = self._side(
            "aircraft", [*planes[:-1], f"{planes[-1]}!"], "said.npy", "--pictures", str(PICTURES)
        )
        self.phases: list[Phase] = []

    def _route(self) -> Program:
        config = str(self._keys / FLEET_FILE)
        return Program("ground", "router", "--config", config, "--listen", self._endpoint, waits_for="pc-ground router")

    def _side(self, role: str, names: list[str], out: str, *more: str) -> Program:
        at = ["--endpoint", self._endpoint, "--keys", str(self._keys), "--out", str(self._folder / out)]
        return Program("benchmarks.fleet_side", role, ",".join(names), *at, *more, waits_for="ready")

    def pass_time(self, name: str, seconds: float) -> None:
        """One phase."""
        begin_ns, (before_s, _) = time.time_ns(), self.router.used()
        time.sleep(seconds)
        after_s, memory_mb = self.router.used()
        self.phases.append(Phase(name, begin_ns, time.time_ns(), after_s - before_s, memory_mb))

    def restart_router(self) -> int:
        """Killed, as a power cut ends it, and started again DOWN_S later; the moment when it serves again."""
        self.router.process.kill()
        self.router.process.wait(10.0)
        time.sleep(DOWN_S)
        self.router = self._route()
        return time.time_ns()

    def close(self) -> tuple[Rows, Rows]:
        """End all programs; the rows of what was sent, and of what the operators that were never stopped received."""
        for program in (self.aircraft, self.operators, self.slow):
            program.end()
        self.router.process.terminate()
        self.router.process.wait(10.0)
        return np.load(self._folder / "said.npy"), np.load(self._folder / "heard.npy")

    def kill(self) -> None:
        """Whatever still runs, as after an error."""
        for program in (self.aircraft, self.operators, self.slow, self.router):
            program.process.kill()
            program.process.wait(10.0)


@contextlib.contextmanager
def stopped(program: Program) -> Iterator[None]:
    """A process that reads nothing for a while."""
    program.process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        program.process.send_signal(signal.SIGCONT)


def fly(station: Station, seconds: float) -> int:
    """All phases; the moment at which the router served again after it was killed."""
    time.sleep(SETTLED_S)  # all have found each other
    station.pass_time("all well", seconds)
    with stopped(station.slow):
        station.pass_time("an operator stopped", seconds)
    station.aircraft.tell("flap")
    station.pass_time("an aircraft flaps", seconds)
    station.aircraft.tell("steady")
    time.sleep(SETTLED_S)
    served_ns = station.restart_router()
    station.pass_time("after the router's restart", seconds)
    return served_ns


def lost_and_late(
    phase: Phase, said: Rows, received: Rows, operators: int, flapping: int
) -> tuple[float, NDArray[np.float64]]:
    """Share of sets not received, over all operators; and milliseconds from publishing to the first hearing of each."""
    wanted = said[
        (said[:, 1] != flapping) & (said[:, 3] >= phase.begin_ns) & (said[:, 3] < phase.end_ns - ON_ITS_WAY_S * 1e9)
    ]
    expected = {(vehicle, frame) for vehicle, frame in wanted[:, 1:3].tolist()}
    first: dict[tuple[int, int, int], float] = {}
    for operator, vehicle, frame, captured, at in received[np.argsort(received[:, 4], kind="stable")].tolist():
        if (vehicle, frame) in expected:
            first.setdefault((operator, vehicle, frame), (at - captured) / 1e6)
    return 1.0 - len(first) / (len(expected) * operators), np.array(list(first.values()))


def newest_within_s(received: Rows, served_ns: int, aircraft: int, operators: int) -> float:
    """Seconds from when the router served again until every operator had a newly published set of every aircraft.

    Infinite if one never had.
    """
    since = received[(received[:, 3] >= served_ns)]
    first: dict[tuple[int, int], int] = {}
    for operator, vehicle, _, _, at in since[np.argsort(since[:, 4], kind="stable")].tolist():
        first.setdefault((operator, vehicle), at)
    if len(first) < aircraft * operators:
        return float("inf")
    return (max(first.values()) - served_ns) / 1e9


def main() -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aircraft", type=int, default=50)
    parser.add_argument("--operators", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=30.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fleet-") as folder:
        station = Station(Path(folder), args.aircraft, args.operators)
        try:
            served_ns = fly(station, args.seconds)
            said, received = station.close()
        finally:
            station.kill()
    print(f"{describe()}\n{load()}\n")
    print(f"{args.aircraft} aircraft, {args.operators} operators, one router, TLS with rights by name\n")
    rows = []
    for phase in station.phases:
        loss, ms = lost_and_late(phase, said, received, args.operators, args.aircraft)
        seconds = (phase.end_ns - phase.begin_ns) / 1e9
        goal = phase.name.startswith("after") or loss <= LOSS_SHARE
        rows.append(
            [phase.name, f"{100.0 * loss:.2f} %", *(f"{np.percentile(ms, share):.1f}" for share in (50, 99)),
             f"{100.0 * phase.processor_s / seconds:.0f} %", f"{phase.memory_mb:.0f}", verdict(bool(goal))]
        )  # fmt: skip
    print(
        table(["phase", "lost", "median, ms", "99 %, ms", "router's processor", "memory, MB", "loss under 1 %"], rows)
    )
    newest_s = newest_within_s(received, served_ns, args.aircraft, args.operators)
    print(f"\nafter the restart every operator has a new set of every aircraft in {newest_s:.1f} s ", end="")
    print(f"(goal {NEWEST_S:g}: {verdict(newest_s <= NEWEST_S)})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
