"""`python -m simulation.autopilot --tlog FILE --url URL`: an autopilot on a wire, until its recording ends, or Ctrl-C.

The first line on stdout is JSON: `url` to open at the other end; `monotonic_ns` and `log_unix_ns`, one moment on the
host's CLOCK_MONOTONIC and on the log's own clock (that of a recording's truth), to play pictures in step with it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

from contract.errors import PointclickError
from simulation.autopilot.fake import FakeAutopilot, Faults
from simulation.autopilot.flight import Flight
from simulation.autopilot.styles import STYLES


def share(text: str) -> float:
    """A number, or one in parts per million: 0.0002, 200ppm."""
    return float(text.removesuffix("ppm")) * (1e-6 if text.endswith("ppm") else 1.0)


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    out = argparse.ArgumentParser(prog="python -m simulation.autopilot", description=__doc__.partition("\n")[0])
    out.add_argument("--tlog", required=True, type=Path, help="recorded telemetry to play")
    out.add_argument("--url", required=True, help="udpout:HOST:PORT, udpin:HOST:PORT, tcpin:HOST:PORT, pty or pty:LINK")
    out.add_argument("--style", choices=sorted(STYLES), default="ardupilot", help="whose behaviour (default ardupilot)")
    out.add_argument("--everything", action="store_true", help="send every recorded message without being asked")
    out.add_argument("--loss", type=share, default=0.0, help="share of packets lost, both ways")
    out.add_argument("--delay", type=float, default=0.0, help="s, both ways")
    out.add_argument("--jitter", type=float, default=0.0, help="s, mean of a random delay on top")
    out.add_argument("--corrupt", type=share, default=0.0, help="share of packets damaged")
    out.add_argument("--drift", type=share, default=0.0, help="boot clock against the host's: 0.0002 or 200ppm")
    out.add_argument("--speed", type=float, default=1.0, help="how fast everything runs, its boot clock included")
    out.add_argument("--from", dest="begin", type=float, default=0.0, help="s into the recording to begin at")
    out.add_argument("--seconds", type=float, help="s after which to end")
    out.add_argument("--at-monotonic", type=int, help="ns of CLOCK_MONOTONIC at which to begin; now if not given")
    out.add_argument("--loop", action="store_true", help="begin again at the recording's end, boot clock running on")
    out.add_argument("--reboot-at", type=float, help="s after the start at which it reboots")
    out.add_argument("--silent-at", type=float, help="s after the start at which it falls silent")
    out.add_argument("--silent-for", type=float, default=5.0, help="s of that silence (default 5)")
    out.add_argument("--unplug-at", type=float, help="s after the start at which the wire breaks")
    out.add_argument("--unplug-for", type=float, default=5.0, help="s until it is mended (default 5)")
    out.add_argument("--no-timesync", action="store_true", help="leave TIMESYNC unanswered")
    out.add_argument("--chatter", action="store_true", help="other vehicles and stations on the same line")
    out.add_argument("--key", type=Path, help="file of 32 bytes: sign, and accept signed messages only")
    out.add_argument("--seed", type=int, default=0, help="of what the link loses and damages")
    return out


def main() -> int:
    """Run it; returns the exit status."""
    wanted = parser().parse_args()
    try:
        autopilot = FakeAutopilot(
            Flight.read(wanted.tlog),
            wanted.url,
            style=wanted.style,
            faults=Faults(wanted.loss, wanted.corrupt, wanted.delay, wanted.jitter),
            drift=wanted.drift,
            speed=wanted.speed,
            begin_s=wanted.begin,
            at_monotonic_ns=wanted.at_monotonic,
            loop=wanted.loop,
            everything=wanted.everything,
            answers_timesync=not wanted.no_timesync,
            chatter=wanted.chatter,
            key=wanted.key.read_bytes()[:32] if wanted.key else None,
            seed=wanted.seed,
        )
    except (PointclickError, OSError) as error:
        print(f"autopilot: {error}", file=sys.stderr)
        return 2
    orders: list[tuple[float, Callable[[], None]]] = []
    if wanted.reboot_at is not None:
        orders.append((wanted.reboot_at, autopilot.reboot))
    if wanted.silent_at is not None:
        orders.append((wanted.silent_at, lambda: autopilot.mute(wanted.silent_for)))
    if wanted.unplug_at is not None:
        orders.append((wanted.unplug_at, autopilot.unplug))
        orders.append((wanted.unplug_at + wanted.unplug_for, autopilot.plug))
    orders.sort(key=lambda order: order[0])
    with autopilot:
        monotonic_ns, log_ns = autopilot.log_ns
        print(json.dumps({"url": autopilot.url, "monotonic_ns": monotonic_ns, "log_unix_ns": log_ns}), flush=True)
        try:
            while not autopilot.is_over:
                elapsed_s = (time.monotonic_ns() - monotonic_ns) / 1e9
                if wanted.seconds is not None and elapsed_s > wanted.seconds:
                    break
                while orders and elapsed_s >= orders[0][0]:
                    orders.pop(0)[1]()
                time.sleep(0.05)
        except KeyboardInterrupt:
            pass
    print(f"sent {autopilot.counts.total()} messages, received {len(autopilot.received)}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
