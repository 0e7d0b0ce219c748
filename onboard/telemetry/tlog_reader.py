"""Telemetry logs (.tlog) as ground stations and autopilots' companions write them -> events.

A tlog is a sequence of (8-byte big-endian Unix microseconds of arrival, MAVLink packet). The framing is read here, so
that garbage between packets costs only itself; packets are checked and decoded by pymavlink.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.errors import InputError
from onboard.clocks.boot_clock import BootClock, Mode
from onboard.events.types import NavEvent, PositionFix
from onboard.telemetry.gimbal_senders import PAYLOADS, GimbalChoice
from onboard.telemetry.mavlink_events import (
    AUTOPILOT_COMPONENT,
    GIMBAL_EVENTS,
    WANTED,
    ZOOM_EVENTS,
    MessageToEvent,
    Sources,
    boot_ns_of,
)
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.vehicle_choice import KEY, is_autopilot, kind_of

REPORTS = {*GIMBAL_EVENTS, *ZOOM_EVENTS}  # by gimbals and cameras for themselves
READ = {*WANTED, mavlink.MAVLINK_MSG_ID_CAMERA_FEEDBACK}
FAR_NS = 5_000_000_000
IN_PASSING = 0.1  # of the most heartbeats that a vehicle has: another with fewer was met
SINCE_1970_US = 10**15  # from which on microseconds count from there, not from the boot


def read_tlog(path: Path | str, clock: Mode = "auto", gimbal: int = 0, chosen: int = 0) -> TelemetryLog:
    """Read a whole telemetry log, every event stamped on the log's clock by its sender's least-delayed messages.

    Only the autopilot's component of one system is read, as in `log_messages`, and that system's gimbals and cameras;
    of several gimbals, or where `gimbal` is not 0, one (`gimbal_senders`). Damaged stretches and a cut end are passed
    over. Raises InputError, one line, for a file that is missing, empty, not a log, or without positions.
    """
    messages, system = log_messages(path, chosen)
    own = [(t, m) for t, m in messages if m.get_srcComponent() == AUTOPILOT_COMPONENT]
    sources = Sources.by_counts(Counter(message.get_type() for _, message in own))
    found, segments = _events(own, sources, clock)
    of_gimbals = []
    if not any(isinstance(event, PositionFix) for _, event, _ in found):
        raise InputError(
            f"telemetry {path}: system {system} sends no position (GLOBAL_POSITION_INT, or GPS_RAW_INT with a 3D fix)"
        )
    for component in sorted({m.get_srcComponent() for _, m in messages} & PAYLOADS):
        own_messages = [(t, m) for t, m in messages if m.get_srcComponent() == component and m.get_type() in REPORTS]
        of_gimbals.append(_events(own_messages, sources, clock)[0])
    choice = GimbalChoice(gimbal)
    merged = heapq.merge(found, *of_gimbals, key=lambda each: each[0])
    kept = [(t, e) for t, e, message in merged if message.get_type() not in GIMBAL_EVENTS or choice.takes(message, t)]
    return TelemetryLog([e for _, e in kept], [t for t, _ in kept], system, segments, shots_ns=_shots(own))


def _shots(own: list[tuple[int, Any]]) -> tuple[int, ...]:
    """Return when a camera was triggered (CAMERA_FEEDBACK, on UTC), on the log's clock.

    UTC is mapped to it by its least delayed message; without one, or of a stamp that is no UTC, the arrival counts.
    """
    ahead_ns = [t - m.time_unix_usec * 1000 for t, m in own if m.get_type() == "SYSTEM_TIME" and m.time_unix_usec]
    shots = {m.time_usec: t for t, m in own if m.get_type() == "CAMERA_FEEDBACK"}
    return tuple(
        us * 1000 + min(ahead_ns) if us > SINCE_1970_US and ahead_ns else arrival_ns for us, arrival_ns in shots.items()
    )


def _events(own: list[tuple[int, Any]], sources: Sources, clock: Mode) -> tuple[list[tuple[int, NavEvent, Any]], int]:
    """(arrival, event, its message) of one component's messages, by a clock of its own, and how often that began."""
    boot_clock = BootClock(clock)
    segments: list[int] = []
    for arrival_ns, message in own:
        boot_ns = boot_ns_of(message)
        segments.append(boot_clock.add(boot_ns, arrival_ns) if boot_ns else (segments or [0])[-1])
    out: list[tuple[int, NavEvent, Any]] = []
    for segment, group in itertools.groupby(zip(segments, own, strict=True), key=lambda pair: pair[0]):
        converter = MessageToEvent(sources)  # a new one after a reboot: it remembers boot stamps
        to_host_ns = functools.partial(boot_clock.to_host_ns, segment=segment)
        for _, (arrival_ns, message) in group:
            is_unset = boot_ns_of(message) == 0  # some gimbals do not fill the stamp in
            moment = (lambda _, at=arrival_ns: at) if is_unset else to_host_ns
            out += [(arrival_ns, event, message) for event in converter.convert(message, arrival_ns, moment)]
    return out, boot_clock.segments


def log_messages(path: Path | str, chosen: int = 0) -> tuple[list[tuple[int, Any]], int]:
    """(arrival ns, message) of a log's autopilot and its gimbals, in order, and its system number.

    That is `chosen`, else (0) the only one whose autopilot is in it for longer than in passing. Raises InputError, one
    line, for a file that is missing, empty or not a log, for several vehicles of which none is chosen, and where the
    chosen one is not among them.
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
    system = _autopilot_system(path, messages, chosen)
    speakers = PAYLOADS | {AUTOPILOT_COMPONENT}
    own = [(t, m) for t, m in messages if m.get_srcSystem() == system and m.get_srcComponent() in speakers]
    return own, system


def _without_stray_stamps(messages: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
    """Drop packets whose arrival stamp alone is damaged: far from the median of the five around them."""
    if len(messages) < 5:
        return messages
    arrival = np.array([min(t, 2**63 - 1) for t, _ in messages])
    around = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(arrival, 2, mode="edge"), 5), axis=1)
    keep = np.abs(arrival - around) < FAR_NS
    return [message for message, kept in zip(messages, keep, strict=True) if kept]


def _autopilot_system(path: Path | str, messages: list[tuple[int, Any]], chosen: int) -> int:
    """The system that is read: of those whose autopilots have a heartbeat if any has one."""
    autopilots = [m for _, m in messages if m.get_srcComponent() == AUTOPILOT_COMPONENT]
    beats = [m for m in autopilots if is_autopilot(m)]
    counts = Counter(m.get_srcSystem() for m in beats or autopilots or [m for _, m in messages])
    if chosen:
        if chosen not in counts:
            there = ", ".join(map(str, sorted(counts)))
            raise InputError(f"telemetry {path}: no messages of system {chosen} (but of {there})")
        return chosen
    most = max(counts, key=lambda system: counts[system])
    rivals = sorted(system for system in counts if counts[system] > IN_PASSING * counts[most])
    if len(rivals) > 1 and beats:
        kinds = {m.get_srcSystem(): kind_of(m) for m in beats}
        names = ", ".join(f"{system} {kinds[system]}" for system in rivals)
        raise InputError(f"telemetry {path}: several vehicles in it ({names}): {KEY}")
    return int(most)


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
        # An unwanted packet is accepted by its framing alone; a wanted one, by its checksum.
        if message_id in READ:
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
    """Return whether another stamped packet, or the end of the file, follows."""
    return position + 9 > len(data) or data[position + 8] in (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
