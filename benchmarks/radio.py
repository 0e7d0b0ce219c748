"""Clicks through a real autopilot's radio: its simulator in the middle, our two ends on both sides.

    python -m benchmarks.radio --autopilot CMD --onboard URL --ground ENDPOINT [--seconds 60] [--bit-rate 4800]

CMD starts the autopilot, for example ArduPilot's simulator with one MAVLink port for the companion and one for the
radio; URL is the companion's as `telemetry.url` has it, ENDPOINT the radio's as `--connect mavlink:` has it. Without
CMD nothing is measured, and that is said. First the autopilot's own messages are received for so many seconds, then the
same while a click is asked every second: how many clicks are answered, how soon, and how much later the autopilot's
own messages come. Lateness is a message's arrival less its boot time, above the least that was seen.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe, table, verdict
from contract.errors import LinkError
from contract.wire.codec import encode
from ground.mavlink_endpoint import SCHEME, MavlinkEndpoint
from ground.mavlink_link import MavlinkLink
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.link.autopilot_radio import AutopilotRadio
from onboard.link.reply import Answer
from onboard.telemetry.factory import open_telemetry
from tests.contract.sets import plain_set

ENDS_WITHIN_S = 10.0
LATER_MS, ANSWER_S = 50.0, 6.0  # goals
LATE_SHARE = 0.99


class Listener(MavlinkLink):
    """The ground's end, which notes when the autopilot's own messages come."""

    def __init__(self, endpoint: MavlinkEndpoint) -> None:
        super().__init__(endpoint)
        self.behind_s: list[float] = []
        self._mav.set_callback(self._note)

    def _note(self, message: Any) -> None:
        if hasattr(message, "time_boot_ms"):
            self.behind_s.append(time.monotonic() - message.time_boot_ms / 1e3)

    def listen(self, seconds: float) -> None:
        """Receive for so long."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.received()

    def taken(self) -> NDArray[np.float64]:
        """The delays behind boot time, s, of the messages since the last call."""
        taken, self.behind_s = self.behind_s, []
        return np.array(taken)


@contextmanager
def autopilot(command: str) -> Iterator[None]:
    """The simulator and all that it starts, ended with us."""
    process = subprocess.Popen(shlex.split(command), stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def companion(url: str, bit_rate: float) -> Iterator[None]:
    """Our end on board, which answers every click from one set of 100 features."""
    config = parse_config(
        f"[telemetry]\nurl = {json.dumps(url)}\n[link]\nmavlink = true\nmavlink_bit_rate = {bit_rate:g}\n"
    )
    payload = encode(plain_set(100))
    answer = Answer(payload, json.dumps({"age_s": 0.1}).encode())
    radio = AutopilotRadio(config.vehicle.id, lambda asked: answer, lambda capture_ns: 0.1, bit_rate)
    radio.thread.start()
    stop = threading.Event()
    source = open_telemetry(config, SessionClock.start(), radio)
    thread = threading.Thread(target=source.run, args=(lambda stamp_ns, event: None, stop))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(ENDS_WITHIN_S)
        radio.close()


def ask(ground: Listener, seconds: float) -> list[float]:
    """A click a second: how long each answer took, s; infinite for one that did not come."""
    took = []
    until_s = time.monotonic() + seconds
    while (begin_s := time.monotonic()) < until_s:
        try:
            ground.ask(320.0, 240.0)
            took.append(time.monotonic() - begin_s)
        except LinkError as error:
            print(error, file=sys.stderr)
            took.append(np.inf)
        ground.listen(begin_s + 1.0 - time.monotonic())
    return took


def report(alone: NDArray[np.float64], with_us: NDArray[np.float64], took_s: list[float]) -> bool:
    """Print what was measured; whether the goals are reached."""
    least_s = min(alone.min(), with_us.min())
    late_ms = [1e3 * (np.quantile(behind, LATE_SHARE) - least_s) for behind in (alone, with_us)]
    answered = np.isfinite(took_s)
    p95_s = float(np.quantile(took_s, 0.95, method="higher"))
    later_ms = late_ms[1] - late_ms[0]
    rows = [
        ("clicks answered", f"{answered.sum()} of {len(took_s)}", ""),
        ("answer, 95 %", f"{p95_s:.2f} s", verdict(p95_s <= ANSWER_S)),
        ("autopilot's messages alone", f"{len(alone)}, 99 % within {late_ms[0]:.0f} ms", ""),
        ("the same beside clicks", f"{len(with_us)}, 99 % within {late_ms[1]:.0f} ms", ""),
        ("later by", f"{later_ms:.0f} ms", verdict(later_ms <= LATER_MS)),
    ]
    print(table(("what", "measured", "goal"), rows))
    return p95_s <= ANSWER_S and later_ms <= LATER_MS


def with_simulator(parser: argparse.ArgumentParser, ground: str, about_ground: str) -> argparse.Namespace | None:
    """Read the options, with those of a simulator and its two ports, `ground` the name of the second one's; None where
    there is no simulator, and that is printed.
    """
    parser.add_argument("--autopilot", metavar="CMD", help="starts the simulator")
    parser.add_argument("--onboard", metavar="URL", help="the companion's port, as telemetry.url")
    parser.add_argument("--ground", metavar=ground, help=about_ground)
    wanted = parser.parse_args()
    print(describe())
    if wanted.autopilot is None:
        options = f"--autopilot CMD --onboard URL --ground {ground}"
        print(f"LEFT OUT: no autopilot given, so nothing was measured ({options})")
        return None
    if wanted.onboard is None or wanted.ground is None:
        parser.error("--autopilot needs --onboard and --ground")
    return wanted


def main() -> int:
    """0 if the goals are reached or there is no autopilot, 1 if not."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--bit-rate", type=float, default=4800.0)
    wanted = with_simulator(parser, "ENDPOINT", "the radio's port, as --connect mavlink:...")
    if wanted is None:
        return 0
    endpoint = MavlinkEndpoint.parse(SCHEME + wanted.ground.removeprefix(SCHEME))
    with autopilot(wanted.autopilot), Listener(endpoint) as ground, companion(wanted.onboard, wanted.bit_rate):
        ground.ask(320.0, 240.0)  # until it is there
        ground.taken()
        ground.listen(wanted.seconds)
        alone = ground.taken()
        took_s = ask(ground, wanted.seconds)
        with_us = ground.taken()
    return 0 if report(alone, with_us, took_s) else 1


if __name__ == "__main__":
    sys.exit(main())
