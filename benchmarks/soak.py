"""An hour of flight in the real daemon, with everything on and what happens on the way: does it stay as it began?

    python -m benchmarks.soak [--minutes 60] [--calm]

A process flies the daemon (benchmarks.soak_daemon) with a camera at thirty 640x480 pictures a second, out and back over
one leg, and an autopilot over UDP; this one is autopilot, ground and service manager (benchmarks.soak_world). Sets and
status go over loopback zenoh, a ground listens and asks, the recording rotates. The flight's clock runs as fast as no
picture has to wait for long: that factor is stated, and seconds are seconds of flight unless marked "wall". Every ten
minutes, unless calm, telemetry is cut for 5 s, the camera is lost for 20 s and the GPS for 15 s: leaks hide in
recoveries. Exit code 1 if a verdict fails.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.machine import describe, load

# isort: split
from mcap.reader import make_reader

from benchmarks.short_flight import CACHE, Leg, leg
from benchmarks.soak_clock import StatedClock
from benchmarks.soak_daemon import MINUTE_NS, Plan
from benchmarks.soak_verdict import Faults, Minute, Soak
from benchmarks.soak_world import GpsLoss, Ground, ServiceManager, out_and_back, watchdog_s
from contract.topics import FEATURES
from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight
from tests.onboard.link.ports import free_endpoint, free_udp_port

ROOT = Path(__file__).resolve().parents[1]
TOP_SPEED = 12.0
START_S, PATIENCE_S, END_S = 60.0, 120.0, 30.0  # wall: to begin, between two minutes of flight, to end
LAST_QUESTION_S = 10.0  # before the end: there is no answer after it
_PAGE = os.sysconf("SC_PAGE_SIZE")
Say = Callable[[str], None]


def soak(
    simulated: Leg,
    where: Path,
    *,
    minutes: float,
    faults: Faults,
    leg_seconds: float,
    rate_hz: float,
    cache: Path = CACHE,
    top_speed: float = TOP_SPEED,
    rotate_mb: float = 10.0,
    say: Say = lambda _: None,
) -> Soak:
    """Fly it, everything that is written below `where`. Raises RuntimeError if the daemon does not begin."""
    out = Soak(faults)
    endpoint, port = free_endpoint(), free_udp_port()
    plan = Plan(
        str(where), endpoint, port, minutes, top_speed, rotate_mb, leg_seconds, rate_hz, str(cache), faults.unplugged
    )
    plan.write(where / "plan.json")
    plan.clock.write_bytes(b"")
    clock = StatedClock(plan.clock)
    limit_us = round(watchdog_s() * 1e6)
    with ServiceManager(where / "notify", clock) as manager:
        environment = {**os.environ, "NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": str(limit_us)}
        command = [sys.executable, "-m", "benchmarks.soak_daemon", str(where / "plan.json")]
        with subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            reader = threading.Thread(target=_read, args=(process, out.log), daemon=True)
            reader.start()
            try:
                begin_ns = _begun(plan, process, manager, out.log)
                _around(simulated, plan, faults, clock, begin_ns, process, out, say)
                out.code = process.wait(END_S)
            finally:
                process.kill()
            reader.join(5.0)
    out.notified, out.gap_s, out.gap_wall_s = dict(manager.counts), manager.longest_flight_s, manager.longest_wall_s
    out.recorded_sets = recorded_sets(plan.recordings, simulated.config.vehicle.id)
    clock.close()
    return out


def _around(
    simulated: Leg,
    plan: Plan,
    faults: Faults,
    clock: StatedClock,
    begin_ns: int,
    process: subprocess.Popen[str],
    out: Soak,
    say: Say,
) -> None:
    """Simulate the surroundings until the daemon ends by itself, and check it every minute."""
    log = Flight.read(_folder(plan) / "telemetry.tlog")
    ground = Ground(plan.endpoint, simulated.config.vehicle.id)
    cuts = list(faults.cut)
    held_mb = sum(image.nbytes for image in simulated.images) / 1e6
    began_s = seen_s = time.monotonic()
    simulated_s = 0.0
    with FakeAutopilot(
        out_and_back(log, simulated),
        f"udpout:127.0.0.1:{plan.telemetry_port}",
        at_monotonic_ns=begin_ns,
        loop=True,
        clock=clock,
        spoil=GpsLoss(begin_ns, faults.no_gps),
    ) as autopilot:
        while process.poll() is None:
            into_s = (clock.now_ns() - begin_ns) / 1e9
            if cuts and into_s >= cuts[0][0]:
                autopilot.mute(cuts.pop(0)[1])
            lines = plan.figures.read_text().splitlines() if plan.figures.exists() else []
            if len(lines) > len(out.minutes) and lines[-1].endswith("}"):
                now_s = time.monotonic()
                speed = (into_s - simulated_s) / (now_s - seen_s)
                seen_s, simulated_s = now_s, into_s
                figures = json.loads(lines[-1])
                out.ok_sets = figures["ok"]
                out.minutes.append(_minute(plan, process.pid, figures, held_mb, ground.received, speed))
                say(f"{out.minutes[-1]}")
                continue
            if time.monotonic() - seen_s > PATIENCE_S:
                raise RuntimeError("the daemon stands still:\n" + "\n".join(out.log[-20:]))
            if into_s < 60.0 * plan.minutes - LAST_QUESTION_S:
                ground.ask_if_due()
            time.sleep(0.05)
    out.wall_s, out.flight_s = time.monotonic() - began_s, plan.minutes * MINUTE_NS / 1e9
    out.asked, out.answered, out.unreadable = ground.asked, ground.answered, ground.unreadable
    out.states = dict(ground.states)
    ground.close()


def _minute(plan: Plan, pid: int, figures: dict[str, Any], held_mb: float, received: int, speed: float) -> Minute:
    """Look at the process from outside, and at what it wrote."""
    proc = Path("/proc") / str(pid)
    resident = int((proc / "statm").read_text().split()[1]) * _PAGE / 1e6
    files = sorted(plan.recordings.glob("*.mcap"))
    return Minute(
        figures["minute"],
        resident - held_mb,
        len(list((proc / "task").iterdir())),
        len(list((proc / "fd").iterdir())),
        figures["queue"],
        figures["delay_s"],
        figures["longest_s"],
        figures["pictures"],
        figures["dropped"],
        figures["sets"],
        figures["sent"],
        received,
        sum(file.stat().st_size for file in files) / 1e6,
        len(files),
        speed,
    )


def _folder(plan: Plan) -> Path:
    return Path(plan.cache) / f"leg_{plan.leg_seconds:g}s_{plan.rate_hz:g}hz"


def _begun(plan: Plan, process: subprocess.Popen[str], manager: ServiceManager, log: list[str]) -> int:
    """Wait until the daemon reports that it is ready; the moment when the first picture is due."""
    deadline = time.monotonic() + START_S
    while not (plan.begin.exists() and manager.counts["READY=1"]):
        if process.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError("the daemon did not begin:\n" + "\n".join(log[-20:]))
        time.sleep(0.02)
    return int(plan.begin.read_text())


def _read(process: subprocess.Popen[str], lines: list[str]) -> None:
    assert process.stdout is not None
    lines.extend(line.rstrip("\n") for line in process.stdout)


def recorded_sets(folder: Path, vehicle: str) -> int:
    """Sets in a folder's recordings, by their own summaries: every one was closed well."""
    total = 0
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        if summary is not None and summary.statistics is not None:
            counts = summary.statistics.channel_message_counts
            total += sum(n for c, n in counts.items() if summary.channels[c].topic == FEATURES.key(vehicle))
    return total


def main() -> int:
    """Exit code: 0 every goal reached, 1 not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of flight (default 60)")
    parser.add_argument("--calm", action="store_true", help="nothing is lost on the way")
    parser.add_argument("--top-speed", type=float, default=TOP_SPEED, help=f"at most so much faster ({TOP_SPEED:g})")
    parser.add_argument("--out", type=Path, help="keep what the daemon wrote in this new folder")
    parser.add_argument("--verbose", action="store_true", help="each minute on stderr as it passes")
    args = parser.parse_args()
    seconds, rate_hz = 14.0, 30.0
    simulated = leg(seconds, rate_hz)
    print(f"{describe()}; {load()}\n", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        where = Path(scratch)
        if args.out is not None:
            where = args.out
            where.mkdir(parents=True)
        done = soak(
            simulated,
            where.resolve(),
            minutes=args.minutes,
            faults=Faults() if args.calm else Faults.of(args.minutes),
            leg_seconds=seconds,
            rate_hz=rate_hz,
            top_speed=args.top_speed,
            say=(lambda line: print(line, file=sys.stderr, flush=True)) if args.verbose else (lambda _: None),
        )
        if args.out is not None:
            (where / "daemon.log").write_text("\n".join(done.log) + "\n")
    print(done.report())
    missed = [text for text, is_good in done.verdicts() if not is_good]
    if missed:
        print("; ".join(missed), file=sys.stderr)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
