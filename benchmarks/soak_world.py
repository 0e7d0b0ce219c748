"""The world around the daemon of a soak: an autopilot over UDP, a ground that listens and asks, a service manager.

All use the flight's clock as the daemon's process passes it (benchmarks.soak_clock).
"""

from __future__ import annotations

import contextlib
import copy
import socket
import threading
import time
from collections import Counter
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.short_flight import Leg
from benchmarks.soak_clock import StatedClock
from benchmarks.soak_daemon import pass_ns
from contract.errors import LinkError, WireError
from contract.link_config import link_config
from contract.topics import FEATURES, STATUS
from contract.vehicle_status import decode_status
from contract.wire.codec import decode
from ground.client import ask
from simulation.autopilot.flight import Flight

UNIT = Path(__file__).resolve().parents[1] / "systemd" / "pointclick-onboard.service"
LAST_NS = 20_000_000  # the autopilot's loop begins again so long after its last message
ASK_S = 2.0  # of the wall between questions
Spans = tuple[tuple[float, float], ...]


def out_and_back(log: Flight, simulated: Leg) -> Flight:
    """A leg's telemetry as an autopilot sends it, out and back: as `benchmarks.short_flight`, in MAVLink, to be looped.

    The first message is due when the first picture is taken.
    """
    first_ns = simulated.frames[0].stamp_ns - log.log_offset_ns
    length_ns = pass_ns(simulated)
    inside = [
        (due_ns - first_ns, message)
        for due_ns, message in zip(log.due_ns, log.messages, strict=True)
        if 0 <= due_ns - first_ns < length_ns
    ]
    out = [(into_ns, _at(message, first_ns + into_ns, is_back=False)) for into_ns, message in inside]
    back = [
        (2 * length_ns - into_ns, _at(message, first_ns + 2 * length_ns - into_ns, is_back=True))
        for into_ns, message in reversed(inside)
        if into_ns > LAST_NS
    ]
    # The loop is as long as from the first message to the last: those two stand exactly there.
    ends = [
        (at_ns, mavlink.MAVLink_system_time_message(0, (first_ns + at_ns) // 1_000_000))
        for at_ns in (0, 2 * length_ns - LAST_NS)
    ]
    timed = [ends[0], *out, *(pair for pair in back if pair[0] < ends[1][0]), ends[1]]
    due_ns = [first_ns + into_ns for into_ns, _ in timed]
    return Flight(due_ns, [message for _, message in timed], log.log_offset_ns, log.vehicle_type, log.system)


def _at(message: Any, boot_ns: int, is_back: bool) -> Any:
    """A copy sent at another boot time, on the way back with motion reversed."""
    out = copy.copy(message)
    if hasattr(out, "time_boot_ms"):
        out.time_boot_ms = boot_ns // 1_000_000
    name = out.get_type()
    if name == "GPS_RAW_INT":
        out.time_usec = boot_ns // 1000
    if not is_back:
        return out
    if name == "GPS_RAW_INT":
        out.cog = (out.cog + 18000) % 36000
    turned = {
        "GLOBAL_POSITION_INT": ("vx", "vy", "vz"),
        "ATTITUDE": ("rollspeed", "pitchspeed", "yawspeed"),
    }
    for field in turned.get(name, ()):
        setattr(out, field, -getattr(out, field))
    return out


class GpsLoss:
    """Takes the GPS away for some stretches of the flight: no fix, and a filter that reports it."""

    def __init__(self, begin_ns: int, spans: Spans) -> None:
        self._begin_ns, self._spans = begin_ns, spans

    def __call__(self, now_ns: int, message: Any) -> Any:
        """The message as it is sent then."""
        into_s = (now_ns - self._begin_ns) / 1e9
        if any(begin_s <= into_s < begin_s + length_s for begin_s, length_s in self._spans):
            name = message.get_type()
            if name == "GPS_RAW_INT":
                message.fix_type, message.satellites_visible = 1, 0
            elif name == "EKF_STATUS_REPORT":
                message.flags &= ~(mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_PRED_POS_HORIZ_ABS)
        return message


class ServiceManager:
    """The other end of NOTIFY_SOCKET: the daemon's reports, and the longest pause of its watchdog, flight and wall."""

    def __init__(self, path: Path, clock: StatedClock) -> None:
        self.path, self._clock = path, clock
        self.counts: Counter[str] = Counter()
        self.longest_flight_s = self.longest_wall_s = 0.0
        self._fed: tuple[int, int] | None = None
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.2)
        self._is_over = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._is_over = True
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._is_over:
            try:
                text = self._socket.recv(4096).decode()
            except TimeoutError:
                continue
            word = text.split("\n", maxsplit=1)[0]
            self.counts[word.split("=", maxsplit=1)[0] if word.startswith("STATUS") else word] += 1
            # From READY on the manager counts; STOPPING ends it.
            if word in ("READY=1", "WATCHDOG=1", "STOPPING=1"):
                now = self._clock.now_ns(), time.monotonic_ns()
                if self._fed is not None:
                    self.longest_flight_s = max(self.longest_flight_s, (now[0] - self._fed[0]) / 1e9)
                    self.longest_wall_s = max(self.longest_wall_s, (now[1] - self._fed[1]) / 1e9)
                self._fed = now


def watchdog_s(unit: Path = UNIT) -> float:
    """WatchdogSec of the unit. Raises ValueError if it has none."""
    for line in unit.read_text(encoding="utf-8").splitlines():
        if line.startswith("WatchdogSec="):
            return float(line.partition("=")[2])
    raise ValueError(f"{unit}: no WatchdogSec")


class Ground:
    """Someone who listens to sets and status, and asks for a picture now and then, each time as a new client."""

    def __init__(self, endpoint: str, vehicle: str) -> None:
        self._endpoint, self._vehicle = endpoint, vehicle
        self.received = self.unreadable = self.asked = self.answered = 0
        self.states: Counter[str] = Counter()
        self._frame = 0
        self._next_s = time.monotonic() + ASK_S
        self._session = zenoh.open(zenoh.Config.from_json5(link_config("peer", connect=[endpoint])))
        self._subscribers = [
            self._session.declare_subscriber(FEATURES.key(vehicle), self._hear),
            self._session.declare_subscriber(STATUS.key(vehicle), self._hear_status),
        ]

    def _hear(self, sample: zenoh.Sample) -> None:
        try:
            self._frame = max(self._frame, decode(sample.payload.to_bytes()).frame)
            self.received += 1
        except WireError:
            self.unreadable += 1

    def _hear_status(self, sample: zenoh.Sample) -> None:
        self.states[decode_status(sample.payload.to_bytes()).state] += 1

    def ask_if_due(self) -> None:
        """Ask, once it is due, in turn for the newest set and for one of two seconds ago."""
        if time.monotonic() < self._next_s or not self.received:
            return
        frame = None if self.asked % 2 == 0 else max(self._frame - 60, 0)
        self.asked += 1
        with contextlib.suppress(LinkError):
            # A refusal is an answer: no set is there of a picture that the camera never took.
            self.answered += self._vehicle in ask(self._endpoint, self._vehicle, frame=frame)
        self._next_s = time.monotonic() + ASK_S

    def close(self) -> None:
        """Leave the link."""
        self._session.close()  # type: ignore[no-untyped-call]
