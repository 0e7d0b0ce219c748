"""MAVLink messages -> events, from a telemetry log (.tlog) today and from a live link by the same `MessageToEvent`.

A tlog is a sequence of (8-byte big-endian Unix microseconds of arrival, MAVLink packet). The framing is read here, so
that garbage between packets costs only itself; packets are checked and decoded by pymavlink.
"""

from __future__ import annotations

import functools
import itertools
import math
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from contract.errors import InputError
from onboard.clock import BootClock, Mode
from onboard.events import Attitude, GpsQuality, NavEvent, PositionFix

WANTED = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
}
AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1

# A receiver whose own stamp stands still this long has stopped, whatever fix it still claims.
FROZEN_GPS_NS = 2_000_000_000
# GPS_RAW_INT stamps are microseconds since boot or since 1970; no autopilot stays up for three years.
MAX_BOOT_US = 10**14
STRAY_NS = 5_000_000_000
UNKNOWN_U16 = 65535


@dataclass(frozen=True)
class Sources:
    """Which message serves where an autopilot sends two that say the same."""

    position: str = "GLOBAL_POSITION_INT"  # or GPS_RAW_INT
    attitude: str = "ATTITUDE"  # or ATTITUDE_QUATERNION

    @classmethod
    def by_counts(cls, counts: Counter[str]) -> Sources:
        """The navigation filter's position if there is one; the attitude message with the higher rate."""
        quaternion = counts["ATTITUDE_QUATERNION"] > counts["ATTITUDE"]
        return cls(
            "GLOBAL_POSITION_INT" if counts["GLOBAL_POSITION_INT"] else "GPS_RAW_INT",
            "ATTITUDE_QUATERNION" if quaternion else "ATTITUDE",
        )


def boot_ns_of(message: Any) -> int | None:
    """The boot stamp a message carries, or None."""
    boot_ms = getattr(message, "time_boot_ms", None)
    return None if boot_ms is None else int(boot_ms) * 1_000_000


class MessageToEvent:
    """One autopilot's decoded messages, in order of arrival, -> events stamped on our clock."""

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self._latest_boot_ns: int | None = None
        self._gps_stamp_us = 0
        self._gps_moved_ns = 0

    def convert(self, message: Any, arrival_ns: int, to_host_ns: Callable[[int], int]) -> list[NavEvent]:
        """A pymavlink message -> the events it carries, often none. `to_host_ns` maps boot time (ns) to our clock."""
        boot_ns = boot_ns_of(message)
        if boot_ns is not None:
            self._latest_boot_ns = boot_ns
        name = message.get_type()
        event: NavEvent | None = None
        if name == "GPS_RAW_INT":
            # Its stamp stands still with the receiver, so when it was said is taken from the boot stamp before it.
            now_ns = arrival_ns if self._latest_boot_ns is None else to_host_ns(self._latest_boot_ns)
            fix = _receiver_position(message, now_ns, to_host_ns) if self.sources.position == name else None
            quality = self._quality(message, now_ns)
            return [quality] if fix is None else [quality, fix]
        if boot_ns is None:
            return []
        if name == "GLOBAL_POSITION_INT" and self.sources.position == name:
            event = _filter_position(message, to_host_ns(boot_ns))
        elif name == self.sources.attitude:
            event = _attitude(message, to_host_ns(boot_ns))
        return [] if event is None else [event]

    def _quality(self, message: Any, now_ns: int) -> GpsQuality:
        stamp_us = int(message.time_usec)
        if stamp_us != self._gps_stamp_us or stamp_us == 0:
            self._gps_stamp_us, self._gps_moved_ns = stamp_us, now_ns
        frozen = now_ns - self._gps_moved_ns > FROZEN_GPS_NS
        fix_type = 0 if frozen else int(message.fix_type)
        ellipsoid_mm = getattr(message, "alt_ellipsoid", 0)
        known = ellipsoid_mm != 0 and fix_type >= 3
        return GpsQuality(
            now_ns,
            fix_type,
            None if message.satellites_visible == 255 else int(message.satellites_visible),
            _claim(message, "h_acc"),
            _claim(message, "v_acc"),
            _claim(message, "vel_acc"),
            (ellipsoid_mm - message.alt) / 1000.0 if known else None,
        )


def _claim(message: Any, key: str) -> float | None:
    """A receiver's own one-sigma claim, mm (or mm/s) -> m (m/s); MAVLink 1 lacks it and 0 means unknown."""
    return getattr(message, key, 0) / 1000.0 or None


def _receiver_position(message: Any, now_ns: int, to_host_ns: Callable[[int], int]) -> PositionFix | None:
    if message.fix_type < 3 or (message.lat == 0 and message.lon == 0):
        return None
    boot_like = 0 < message.time_usec < MAX_BOOT_US
    velocity = None
    if UNKNOWN_U16 not in (message.vel, message.cog):
        speed, course = message.vel / 100.0, math.radians(message.cog / 100.0)
        velocity = speed * math.cos(course), speed * math.sin(course), math.nan
    return PositionFix(
        to_host_ns(int(message.time_usec) * 1000) if boot_like else now_ns,
        message.lat / 1e7,
        message.lon / 1e7,
        message.alt / 1000.0,
        velocity,
    )


def _filter_position(message: Any, stamp_ns: int) -> PositionFix | None:
    if message.lat == 0 and message.lon == 0:  # sent before the filter has an origin
        return None
    return PositionFix(
        stamp_ns,
        message.lat / 1e7,
        message.lon / 1e7,
        message.alt / 1000.0,
        (message.vx / 100.0, message.vy / 100.0, message.vz / 100.0),
        message.relative_alt / 1000.0,
    )


def _attitude(message: Any, stamp_ns: int) -> Attitude | None:
    if message.get_type() == "ATTITUDE":
        q = _quaternion_from_euler(message.roll, message.pitch, message.yaw)
    else:
        q = message.q1, message.q2, message.q3, message.q4
    norm = math.hypot(*q)
    if not 0.5 < norm < 2.0:  # also false for nan
        return None
    w, x, y, z = (part / norm for part in q)
    rate = message.rollspeed, message.pitchspeed, message.yawspeed
    known = any(rate) and math.isfinite(sum(rate))  # a gyro is never still to the last bit: three zeros are unset
    return Attitude(stamp_ns, (w, x, y, z), rate if known else None)


def _quaternion_from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Scalar form of (1.2) as a quaternion: this runs for every message of a log. Not finite angles give nan."""
    if not math.isfinite(roll + pitch + yaw):
        return math.nan, 0.0, 0.0, 0.0
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@dataclass(frozen=True, eq=False)
class TelemetryLog:
    """A log's events in order of arrival, with their arrival times (ns, same length)."""

    events: list[NavEvent]
    arrival_ns: list[int]
    system: int
    boot_segments: int

    @property
    def span_ns(self) -> tuple[int, int]:
        """Capture times of the first and the last position."""
        stamps = [event.stamp_ns for event in self.events if isinstance(event, PositionFix)]
        return min(stamps), max(stamps)


def read_tlog(path: Path | str, clock: Mode = "auto") -> TelemetryLog:
    """Read a whole telemetry log, every event stamped on the log's clock by its least-delayed messages.

    Only the autopilot's component of the system with most of its heartbeats is read. Damaged stretches and a cut end
    are passed over. Raises InputError, one line, for a file that is missing, empty, not a log, or without positions.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"telemetry {path}: {error.strerror}") from error
    if not data:
        raise InputError(f"telemetry {path}: the file is empty")
    messages = _without_stray_stamps(list(_decoded(data)))
    if not messages:
        raise InputError(
            f"telemetry {path}: not a MAVLink telemetry log (.tlog): no packet of an autopilot found in it"
        )
    system = _autopilot_system(messages)
    own = [(t, m) for t, m in messages if m.get_srcSystem() == system and m.get_srcComponent() == AUTOPILOT_COMPONENT]
    sources = Sources.by_counts(Counter(message.get_type() for _, message in own))
    boot_clock = BootClock(clock)
    segments: list[int] = []
    for arrival_ns, message in own:
        boot_ns = boot_ns_of(message)
        segments.append(boot_clock.add(boot_ns, arrival_ns) if boot_ns is not None else (segments or [0])[-1])
    events: list[NavEvent] = []
    arrivals: list[int] = []
    for segment, group in itertools.groupby(zip(segments, own, strict=True), key=lambda pair: pair[0]):
        converter = MessageToEvent(sources)  # a new one after a reboot: it remembers boot stamps
        to_host_ns = functools.partial(boot_clock.to_host_ns, segment=segment)
        for _, (arrival_ns, message) in group:
            new = converter.convert(message, arrival_ns, to_host_ns)
            events += new
            arrivals += [arrival_ns] * len(new)
    if not any(isinstance(event, PositionFix) for event in events):
        raise InputError(
            f"telemetry {path}: system {system} sends no position (GLOBAL_POSITION_INT, or GPS_RAW_INT with a 3D fix)"
        )
    return TelemetryLog(events, arrivals, system, boot_clock.segments)


def _without_stray_stamps(messages: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
    """Drop packets whose arrival stamp alone is damaged: far from the median of the five around them."""
    if len(messages) < 5:
        return messages
    arrival = np.array([min(t, 2**63 - 1) for t, _ in messages])
    around = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(arrival, 2, mode="edge"), 5), axis=1)
    keep = np.abs(arrival - around) < STRAY_NS
    return [message for message, kept in zip(messages, keep, strict=True) if kept]


def _autopilot_system(messages: list[tuple[int, Any]]) -> int:
    """The system whose autopilot sent most heartbeats; without any heartbeat, the one that sent most messages."""
    autopilots = [m for _, m in messages if m.get_srcComponent() == AUTOPILOT_COMPONENT]
    beats = Counter(
        m.get_srcSystem()
        for m in autopilots
        if m.get_type() == "HEARTBEAT" and m.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    )
    counts = beats or Counter(m.get_srcSystem() for m in autopilots or [m for _, m in messages])
    return int(counts.most_common(1)[0][0])


def _decoded(data: bytes) -> Iterator[tuple[int, Any]]:
    """Arrival (ns) and decoded message of every wanted, undamaged packet of a tlog."""
    decoder = mavlink.MAVLink(None)
    position, end = 0, len(data)
    while position + 16 <= end:
        packet = _packet_at(data, position + 8)
        if packet is None:
            position += 1
            continue
        message_id, length = packet
        after = position + 8 + length
        message = None
        # An unwanted packet is believed by its framing alone; a wanted one, by its checksum.
        if message_id in WANTED:
            try:
                message = decoder.decode(bytearray(data[position + 8 : after]))
            except (mavlink.MAVError, struct.error):
                position += 1
                continue
        elif not _starts_packet(data, after):
            position += 1
            continue
        if message is not None:
            (arrival_us,) = struct.unpack_from(">Q", data, position)
            yield arrival_us * 1000, message
        position = after


def _packet_at(data: bytes, start: int) -> tuple[int, int] | None:
    """Message id and whole length of the packet framed at `start`, or None."""
    magic = data[start]
    if magic == mavlink.PROTOCOL_MARKER_V1:
        length, message_id = data[start + 1] + 8, data[start + 5]
    elif magic == mavlink.PROTOCOL_MARKER_V2 and start + 10 <= len(data):
        signature = 13 if data[start + 2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
        length, message_id = data[start + 1] + 12 + signature, int.from_bytes(data[start + 7 : start + 10], "little")
    else:
        return None
    return (message_id, length) if start + length <= len(data) else None


def _starts_packet(data: bytes, position: int) -> bool:
    """Whether another stamped packet, or the end of the file, follows."""
    return position + 9 > len(data) or data[position + 8] in (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
