"""From a picture's exposure to an answer on the ground, end to end, in parts.

    python -m benchmarks.latency [--seconds 60] [--bit-rates 100000 32000]

The real daemon in a process of its own at real time: a played camera at thirty 640x480 pictures a second, an autopilot
over UDP (the recorded one; its rates are printed), sets over loopback zenoh within the bit rate of the link. This
process is autopilot and ground: it decodes each set as it comes and answers a click at the picture's middle. Counted is
every set that brings a newer picture than the ground has; what the link sends in between, better sets of older
pictures, is not, nor are the first seconds, before the window has a solution. Parts: `taken up` is until the pipeline's
thread has the picture (it is passed on at its exposure: nothing of a camera's driver is in here); `waits for
telemetry` until the message comes that covers its exposure; `made` is tracking and placing it and those that waited
with it; `budget` is from its set to the link's turn (by the age that goes with a set, to 10 ms); `transport` what zenoh
and the loopback take; `answered` decoding, and the click. A machine that is busy with other things delays all of them:
its load is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict

# isort: split
import numpy as np
import zenoh
from numpy.typing import NDArray

from benchmarks.latency_daemon import Plan
from benchmarks.short_flight import CACHE, leg
from benchmarks.soak_world import out_and_back
from contract.answer import Fix
from contract.link_config import link_config
from contract.locate import locate
from contract.topics import FEATURES
from contract.wire.codec import decode
from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight
from tests.onboard.link.ports import free_endpoint, free_udp_port

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
LEG_S, RATE_HZ = 14.0, 30.0
STARTING_S = 8.0  # of flight, that do not count
PATIENCE_S = 60.0
GOALS_S = {100_000.0: 0.25, 32_000.0: 0.6}
PARTS = ("taken up", "waits for telemetry", "made", "budget", "transport", "answered")


@dataclass(frozen=True)
class Arrival:
    """A set on the ground: when it came, when its click was answered, how old it was when it left the aircraft (s)."""

    frame: int
    capture_ns: int
    came_ns: int
    answered_ns: int
    left_s: float
    is_ok: bool


class Ground:
    """Listens, and answers a click at the middle of every picture that is newer than those it has."""

    def __init__(self, endpoint: str, vehicle: str) -> None:
        self.arrivals: dict[int, Arrival] = {}  # by frame, each newer than those before
        self.received = 0
        self._newest = -1
        self._session = zenoh.open(zenoh.Config.from_json5(link_config("peer", connect=[endpoint])))
        self._subscriber = self._session.declare_subscriber(FEATURES.key(vehicle), self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        came_ns = time.time_ns()
        s = decode(sample.payload.to_bytes())
        self.received += 1
        if s.frame <= self._newest or not s.is_ok or sample.attachment is None:
            return
        self._newest = s.frame
        width, height = s.camera.size_px
        answer = locate(s, (width / 2.0, height / 2.0))
        left_s = float(sample.attachment.to_string())
        self.arrivals[s.frame] = Arrival(
            s.frame, s.capture_unix_ns, came_ns, time.time_ns(), left_s, isinstance(answer, Fix)
        )

    def close(self) -> None:
        """Leave the link."""
        self._session.close()  # type: ignore[no-untyped-call]


@dataclass(frozen=True)
class Run:
    """Latencies (N,) s and their parts (N, 6) s of N pictures, and messages, new pictures and sets a second."""

    latency_s: Array
    parts_s: Array
    rates_hz: dict[str, float]
    pictures_hz: float
    sets_hz: float


def fly(seconds: float, bit_rate: float, leg_s: float = LEG_S, rate_hz: float = RATE_HZ, cache: Path = CACHE) -> Run:
    """One flight over one link. Raises RuntimeError if the daemon does not begin, or nothing reaches the ground."""
    simulated = leg(leg_s, rate_hz, cache)
    log = Flight.read(cache / f"leg_{leg_s:g}s_{rate_hz:g}hz" / "telemetry.tlog")
    with tempfile.TemporaryDirectory(prefix="pointclick-") as folder:
        endpoint, port = free_endpoint(), free_udp_port()
        plan = Plan(folder, endpoint, port, seconds, bit_rate, leg_s, rate_hz, str(cache))
        command = [sys.executable, "-m", "benchmarks.latency_daemon", str(plan.write())]
        with subprocess.Popen(
            command,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as daemon:
            try:
                begin_ns = _begun(plan, daemon)
                autopilot = FakeAutopilot(
                    out_and_back(log, simulated), f"udpout:127.0.0.1:{port}", at_monotonic_ns=begin_ns, loop=True
                )
                with autopilot:
                    time.sleep(max((begin_ns - time.monotonic_ns()) / 1e9, 0.0))
                    ground = Ground(endpoint, simulated.config.vehicle.id)
                    time.sleep(max(begin_ns / 1e9 + seconds - time.monotonic(), 0.0))
                    ground.close()
                    rates = {name: n / seconds for name, n in _sent(autopilot).items()}
                daemon.wait(PATIENCE_S)
            finally:
                daemon.kill()
        moments = {m["frame"]: m for m in map(json.loads, plan.moments.read_text().splitlines())}
    return _joined(ground, moments, rates, seconds)


def _joined(ground: Ground, moments: dict[int, dict[str, int]], rates_hz: dict[str, float], seconds: float) -> Run:
    arrivals = ground.arrivals
    if not arrivals:
        raise RuntimeError("no set reached the ground")
    first_ns = min(a.capture_ns for a in arrivals.values())
    rows, latency_s = [], []
    for a in arrivals.values():
        if a.frame not in moments or a.capture_ns - first_ns < STARTING_S * 1e9 or not a.is_ok:
            continue
        m = moments[a.frame]
        until_s = [m["taken"] / 1e9, m["covered"] / 1e9, m["made"] / 1e9, a.left_s]
        until_s += [(t - a.capture_ns) / 1e9 for t in (a.came_ns, a.answered_ns)]
        rows.append(np.diff([0.0, *until_s]))
        latency_s.append(until_s[-1])
    return Run(
        np.array(latency_s), np.array(rows), rates_hz, len(rows) / (seconds - STARTING_S), ground.received / seconds
    )


def _sent(autopilot: FakeAutopilot) -> Counter[str]:
    return Counter(message.get_type() for _, message in list(autopilot.sent))


def _begun(plan: Plan, daemon: subprocess.Popen[str]) -> int:
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and daemon.poll() is None:
        if plan.begin.exists():
            return int(plan.begin.read_text())
        time.sleep(0.02)
    raise RuntimeError(f"the daemon did not begin: {daemon.stderr.read() if daemon.stderr else ''}")


def report(bit_rate: float, run: Run) -> str:
    """p50 and p95, in all and by part."""
    rows = [
        [name, *(f"{1e3 * np.quantile(s, q):.0f}" for q in (0.5, 0.95)), f"{1e3 * s.mean():.0f}"]
        for name, s in (*zip(PARTS, run.parts_s.T, strict=True), ("in all", run.latency_s))
    ]
    p95_s, goal_s = float(np.quantile(run.latency_s, 0.95)), GOALS_S.get(bit_rate)
    goal = "" if goal_s is None else f", goal {1e3 * goal_s:.0f}: {verdict(p95_s <= goal_s)}"
    stated = ", ".join(f"{name} {run.rates_hz.get(name, 0.0):.0f} Hz" for name in ("GLOBAL_POSITION_INT", "ATTITUDE"))
    return "\n".join(
        [
            f"{bit_rate / 1e3:.0f} kbit/s: p95 {1e3 * p95_s:.0f} ms{goal}; {len(run.latency_s)} pictures, "
            f"{run.pictures_hz:.1f} a second of {run.sets_hz:.1f} sets; {stated}",
            "",
            table(["ms", "p50", "p95", "mean"], rows),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of flight, each (default 60)")
    parser.add_argument("--bit-rates", type=float, nargs="+", default=list(GOALS_S), help="of the link, bit/s")
    args = parser.parse_args()
    print(f"{describe()}; {load()}")
    for bit_rate in args.bit_rates:
        print("\n" + report(bit_rate, fly(args.seconds, bit_rate)))
    print(f"\n{load()}")


if __name__ == "__main__":
    main()
