"""A plain GPS receiver on a serial line: NMEA sentences -> positions and quality. `telemetry.url = "nmea:DEVICE:BAUD"`.

Sentences of one epoch come in a burst, in an order of the receiver's own; an epoch is passed on when everything that
came in the epochs before has come, when the line falls silent after a burst, or when the next epoch begins.

Stamps: a sentence's time of day, unwrapped at midnight, is a clock like an autopilot's boot clock and is mapped to ours
by its least delayed arrivals. Its date is never used, so that a receiver whose week number has rolled over (and calls
this 2007) serves as well. What remains is the receiver's own delay, which nothing here can see: `gps.latency_s`.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import closing
from dataclasses import dataclass, field
from datetime import time as clock_time
from typing import Any

from pynmeagps import NMEAMessageError, NMEAParseError, NMEAReader, NMEAStreamError, NMEATypeError

from onboard.clocks.boot_clock import BootClock
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.events.types import GpsQuality, NavEvent, PositionFix
from onboard.telemetry.transports import Address, Wire

NS_PER_S = 1_000_000_000
DAY_NS = 86_400 * NS_PER_S
KNOT_M_S = 1852.0 / 3600.0
KINDS = {"GGA", "RMC", "GST", "VTG"}
QUIET_NS = 150_000_000
READ_S = 0.05
REOPEN_S = 0.5
MAX_LINE = 256  # the standard specifies 82; receivers with more digits exceed it
MEMORY_NS = 120 * NS_PER_S
LATE_NS = 700_000_000  # arrivals this late, several in a row, mean that the receiver has set its clock back
MAX_LATE = 4
HUNG_NS = 10 * NS_PER_S
# GGA's quality -> GPS_FIX_TYPE. Dead reckoning (6), entered by hand (7) and simulated (8) are no fixes.
FIX_TYPES = {1: 3, 2: 4, 3: 3, 4: 6, 5: 5}
NO_FIX = 1
# Without deviations from the receiver, one sigma of a range (m) is scaled by the dilution; heights are twice as bad.
RANGE_SIGMA_M, MAX_DILUTION = 2.5, 50.0


@dataclass
class _Epoch:
    """The sentences of one moment, by kind, and when the first of them began to arrive."""

    day_ns: int
    arrival_ns: int
    sentences: dict[str, Any] = field(default_factory=dict)


class NmeaReceiver:
    """Sentences -> events. No line, no thread, no clock of its own."""

    def __init__(self) -> None:
        self.errors = 0  # lines with a wrong checksum or without sense
        self.epochs = 0
        self.has_heights = False
        self._partial = b""
        self._partial_ns = 0
        self._clock = BootClock("auto", MEMORY_NS)
        self._epoch: _Epoch | None = None
        self._kinds: deque[set[str]] = deque(maxlen=3)  # of the newest epochs: what is to be waited for
        self._day_ns: int | None = None
        self._unwrapped_ns = 0
        self._late = 0
        self._quiet_since_ns = 0

    def take(self, data: bytes, now_ns: int) -> list[NavEvent]:
        """Take what has come in, maybe nothing, at `now_ns`; returns events of the epochs that are complete."""
        out: list[NavEvent] = []
        if data:
            if not self._partial:
                self._partial_ns = now_ns
            *lines, rest = (self._partial + data).split(b"\n")
            began_ns = self._partial_ns
            for line in lines:
                out += self._line(line.strip(), began_ns)
                began_ns = now_ns
            self._partial = rest if len(rest) <= MAX_LINE else b""
            self._partial_ns = began_ns if rest and not lines else now_ns
            self._quiet_since_ns = now_ns
        elif self._epoch is not None and now_ns - self._quiet_since_ns > QUIET_NS:
            out += self._finish()
        return out

    def _line(self, line: bytes, began_ns: int) -> list[NavEvent]:
        sentence = sentence_of(line)
        if sentence is None:
            self.errors += bool(line)
            return []
        kind = getattr(sentence, "msgID", "")
        return self._sentence(kind, sentence, began_ns) if kind in KINDS else []

    def _sentence(self, kind: str, sentence: Any, began_ns: int) -> list[NavEvent]:
        out: list[NavEvent] = []
        if kind != "VTG":
            moment = getattr(sentence, "time", None)
            if not isinstance(moment, clock_time):
                return []  # before the first fix there is no time
            day_ns = day_ns_of(moment)
            if self._epoch is None or self._epoch.day_ns != day_ns:
                out += self._finish()
                self._epoch = _Epoch(day_ns, began_ns)
        if self._epoch is None:
            return []
        self._epoch.sentences[kind] = sentence
        if self._kinds and set().union(*self._kinds) <= set(self._epoch.sentences):
            out += self._finish()
        return out

    def _finish(self) -> list[NavEvent]:
        """The epoch under way, whole as it can be -> its events."""
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return []
        kinds = set(epoch.sentences)
        if kinds == {"VTG"}:
            return []
        if epoch.day_ns == self._day_ns:
            self._kinds[-1] |= kinds
            return []  # more of an epoch that was passed on, or a receiver that stands still
        self._kinds.append(kinds)
        self.epochs += 1
        stamp_ns = self._stamp(epoch)
        events = epoch_events(epoch.sentences, stamp_ns)
        self.has_heights |= any(isinstance(event, PositionFix) for event in events)
        return events

    def _stamp(self, epoch: _Epoch) -> int:
        step = 0 if self._day_ns is None else (epoch.day_ns - self._day_ns + DAY_NS // 2) % DAY_NS - DAY_NS // 2
        self._day_ns = epoch.day_ns
        self._unwrapped_ns += step
        self._clock.add(self._unwrapped_ns, epoch.arrival_ns)
        stamp_ns = self._clock.to_host_ns(self._unwrapped_ns)
        self._late = self._late + 1 if epoch.arrival_ns - stamp_ns > LATE_NS else 0
        if self._late >= MAX_LATE:  # leap seconds learned late, a warm start's wrong time corrected
            self._late = 0
            self._clock = BootClock("auto", MEMORY_NS)
            self._clock.add(self._unwrapped_ns, epoch.arrival_ns)
            stamp_ns = self._clock.to_host_ns(self._unwrapped_ns)
        return stamp_ns


def sentence_of(line: bytes) -> Any:
    """Return the sentence in a line, whatever stands before it; None where there is none that is whole."""
    start = line.rfind(b"$")
    # The parser lets a line without a checksum pass: half a sentence would be one.
    if start < 0 or line[-3:-2] != b"*":
        return None
    try:
        return NMEAReader.parse(line[start:] + b"\r\n")
    except (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError, ValueError, ArithmeticError):
        return None


def day_ns_of(moment: clock_time) -> int:
    """Return a time of day, ns since midnight."""
    seconds = (moment.hour * 60 + moment.minute) * 60 + moment.second
    return seconds * NS_PER_S + moment.microsecond * 1000


def _number(sentence: Any, name: str) -> float | None:
    value = getattr(sentence, name, None)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def epoch_events(sentences: dict[str, Any], stamp_ns: int) -> list[NavEvent]:
    """Return the events of one moment's sentences by kind: the receiver's report, and a position where it has one."""
    gga, rmc, gst = (sentences.get(kind) for kind in ("GGA", "RMC", "GST"))
    fix_type = NO_FIX
    if gga is not None:
        fix_type = FIX_TYPES.get(int(_number(gga, "quality") or 0), NO_FIX)
    elif rmc is not None and getattr(rmc, "status", "") == "A":
        fix_type = 2  # it reports the place, but not the height
    mode = getattr(rmc, "posMode", "") if rmc is not None else ""
    if rmc is not None and (getattr(rmc, "status", "V") != "A" or mode in ("N", "E", "M", "S")):
        fix_type = NO_FIX
    height, separation = (_number(gga, name) if gga is not None else None for name in ("alt", "sep"))
    has_fix = fix_type >= 3 and height is not None
    if fix_type >= 3 and height is None:
        fix_type = 2
    satellites = _number(gga, "numSV") if gga is not None else None
    sigma_horizontal, sigma_vertical = _sigmas(gga, gst)
    quality = GpsQuality(
        stamp_ns,
        fix_type,
        None if satellites is None else int(satellites),
        sigma_horizontal,
        sigma_vertical,
        None,
        separation if has_fix else None,
    )
    out: list[NavEvent] = [quality]
    lat, lon = (_number(gga, name) if gga is not None else None for name in ("lat", "lon"))
    if has_fix and lat is not None and lon is not None and height is not None and abs(lat) <= 90 and abs(lon) <= 180:
        out.append(PositionFix(stamp_ns, lat, lon, height, _velocity(sentences)))
    return out


def _sigmas(gga: Any, gst: Any) -> tuple[float | None, float | None]:
    """One sigma, horizontal (of one axis) and vertical: the receiver's own, else from its dilution of precision."""
    if gst is not None:
        north, east, up = (_number(gst, name) for name in ("stdLat", "stdLong", "stdAlt"))
        if north and east:
            return math.sqrt((north**2 + east**2) / 2.0), up or None
    return dilution_sigmas_m(_number(gga, "HDOP") if gga is not None else None) or (None, None)


def dilution_sigmas_m(dilution: float | None) -> tuple[float, float] | None:
    """One sigma, horizontal (of one axis) and vertical, by the horizontal dilution of precision; None without one."""
    if dilution is None or not 0.0 < dilution <= MAX_DILUTION:
        return None
    return RANGE_SIGMA_M * dilution, 2.0 * RANGE_SIGMA_M * dilution


def _velocity(sentences: dict[str, Any]) -> tuple[float, float, float] | None:
    """North, east and an unknown down, from VTG or RMC; None without a course, unless it stands."""
    for kind, speed_name, course_name in (("VTG", "sogn", "cogt"), ("RMC", "spd", "cog")):
        sentence = sentences.get(kind)
        speed, course = (
            _number(sentence, name) if sentence is not None else None for name in (speed_name, course_name)
        )
        if speed is None:
            continue
        if course is not None:
            angle = math.radians(course)
            return speed * KNOT_M_S * math.cos(angle), speed * KNOT_M_S * math.sin(angle), math.nan
    return None


class NmeaTelemetry:
    """A telemetry source from a receiver alone. See `onboard.events.source.TelemetrySource`."""

    def __init__(self, config: Config, clock: SessionClock, address: Address) -> None:
        self._lost_after_ns = round(config.telemetry.lost_after_s * 1e9)
        self._clock = clock
        self._address = address
        self._receiver = NmeaReceiver()
        self._fault = ""
        self._received_ns: int | None = None
        self._epoch_ns: int | None = None
        self._has_position = False
        self._fix_type = 0
        self._opened = 0
        self._is_over = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Until `stop`: open, read, and open again."""
        while not stop.is_set():
            try:
                wire = self._address.open()
                self._opened += 1
                self._fault = ""
                with closing(wire):
                    self._listen(wire, emit, stop)
            except OSError as error:
                self._fault = f"{self._address.place}: {error.strerror or error}"
            if not stop.is_set():
                stop.wait(REOPEN_S)
        self._is_over = True

    def _listen(self, wire: Wire, emit: Emit, stop: Stop) -> None:
        opened_ns = self._clock.now_ns()
        while not stop.is_set():
            data = wire.read(READ_S)
            now_ns = self._clock.now_ns()
            if data:
                self._received_ns = now_ns
            epochs = self._receiver.epochs
            for event in self._receiver.take(data, now_ns):
                if isinstance(event, GpsQuality):
                    self._fix_type = event.fix_type
                elif isinstance(event, PositionFix):
                    self._has_position = True
                emit(now_ns, event)
            if self._receiver.epochs > epochs:
                self._epoch_ns = now_ns
            if now_ns - max(self._received_ns or 0, opened_ns) > HUNG_NS:
                return

    def health(self) -> SourceStatus:
        """Return the receiver's status; from any thread. At 1 Hz it needs `telemetry.lost_after_s` above one second."""
        now_ns, receiver = self._clock.now_ns(), self._receiver
        figures = {
            "epochs": float(receiver.epochs),
            "bad_sentences": float(receiver.errors),
            "reopened": float(max(self._opened - 1, 0)),
        }
        if self._is_over:
            return SourceStatus(State.LOST, "stopped", figures)
        if self._fault:
            return SourceStatus(State.LOST, self._fault, figures)
        received_ns, epoch_ns = self._received_ns, self._epoch_ns
        if received_ns is None:
            return SourceStatus(State.STARTING, "the receiver has sent nothing yet", figures)
        if now_ns - received_ns > self._lost_after_ns:
            return SourceStatus(
                State.LOST, f"the receiver has been silent for {(now_ns - received_ns) / 1e9:.0f} s", figures
            )
        if epoch_ns is None:
            why = "another baud rate?" if receiver.errors > 20 else "no time yet"
            return SourceStatus(State.STARTING, f"no sentence of use from the receiver: {why}", figures)
        if now_ns - epoch_ns > self._lost_after_ns:
            return SourceStatus(State.FROZEN, "the receiver repeats itself or sends nothing of use", figures)
        if not receiver.has_heights and self._fix_type >= 2:
            return SourceStatus(State.DEGRADED, "no heights: the receiver must send GGA", figures)
        if not self._has_position:
            return SourceStatus(State.STARTING, "the receiver has no fix yet", figures)
        return SourceStatus(State.OK, "", figures)

    def send_text(self, severity: Severity, text: str) -> None:
        """A receiver takes no messages: nothing happens."""
