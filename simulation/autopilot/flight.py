"""A recorded flight as an autopilot would send it again: its messages, each at the boot time it was true."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.errors import InputError
from simulation.tlog import packets, read

# The autopilot makes these itself.
OWN = {"HEARTBEAT", "TIMESYNC", "COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE", "MISSION_REQUEST", "MISSION_ACK"}
REBOOT_NS = 1_000_000_000
BOOT_LIKE_US = 10**14  # a `time_usec` below this counts from boot


@dataclass(frozen=True, eq=False)
class Flight:
    """Messages in order of the boot time (ns) at which they are due; the log's clock is boot time + `log_offset_ns`."""

    due_ns: list[int]
    messages: list[Any]
    log_offset_ns: int
    vehicle_type: int
    system: int

    @classmethod
    def read(cls, path: Path | str, system: int | None = None) -> Flight:
        """An autopilot's messages of a telemetry log, up to its first reboot. Raises InputError without any."""
        decoder = mavlink.MAVLink(None)
        due, messages, least = [], [], 2**63
        newest_ns, vehicle_type = 0, mavlink.MAV_TYPE_FIXED_WING
        for packet in packets(read(Path(path))):
            try:
                message = decoder.decode(bytearray(packet.record[8:]))
            except mavlink.MAVError:
                continue
            if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
                continue
            if system is None:
                system = message.get_srcSystem()
            if message.get_srcSystem() != system:
                continue
            name = message.get_type()
            if name == "HEARTBEAT":
                vehicle_type = message.type
            boot_ms = getattr(message, "time_boot_ms", None)
            if boot_ms is not None:
                boot_ns = int(boot_ms) * 1_000_000
                if boot_ns < newest_ns - REBOOT_NS:
                    break
                newest_ns = max(newest_ns, boot_ns)
                least = min(least, int.from_bytes(packet.record[:8], "big") * 1000 - boot_ns)
            if newest_ns and name not in OWN and not name.startswith("UNKNOWN"):
                due.append(newest_ns)
                messages.append(message)
        if system is None or not messages:
            raise InputError(f"telemetry log {path}: no message with a boot time in it")
        return cls(due, messages, least, vehicle_type, system)

    def with_battery(self, volts: float, percent: int) -> Flight:
        """The same with a SYS_STATUS each second, which holds this battery."""
        times = range(self.due_ns[0], self.due_ns[-1], 1_000_000_000)
        battery = mavlink.MAVLink_sys_status_message(0, 0, 0, 300, round(volts * 1000), -1, percent, 0, 0, 0, 0, 0, 0)
        rows = sorted(
            [*zip(self.due_ns, self.messages, strict=True), *((t, battery) for t in times)], key=lambda r: r[0]
        )
        return replace(self, due_ns=[due_ns for due_ns, _ in rows], messages=[message for _, message in rows])

    def reduced(self, keep: Callable[[str], bool]) -> Flight:
        """Only the messages whose name is kept."""
        chosen = [i for i, message in enumerate(self.messages) if keep(message.get_type())]
        return Flight(
            [self.due_ns[i] for i in chosen],
            [self.messages[i] for i in chosen],
            self.log_offset_ns,
            self.vehicle_type,
            self.system,
        )


def moved(message: Any, shift_ns: int) -> Any:
    """A copy whose boot stamps are `shift_ns` later."""
    out = copy.copy(message)
    if shift_ns == 0:
        return out
    if hasattr(out, "time_boot_ms"):
        out.time_boot_ms = max(out.time_boot_ms + shift_ns // 1_000_000, 0)
    if 0 < getattr(out, "time_usec", 0) < BOOT_LIKE_US:
        out.time_usec = max(out.time_usec + shift_ns // 1000, 1)
    return out


def as_px4(message: Any) -> Any:
    """The message PX4 sends in its place: its filter reports by ESTIMATOR_STATUS, its simulated GPS has no clock."""
    name = message.get_type()
    if name == "EKF_STATUS_REPORT":
        flags = message.flags & 0x3FF
        if message.flags & mavlink.EKF_GPS_GLITCHING:
            flags |= mavlink.ESTIMATOR_GPS_GLITCH
        return mavlink.MAVLink_estimator_status_message(
            0, flags, message.velocity_variance, message.pos_horiz_variance, message.pos_vert_variance,
            message.compass_variance, 0.0, 0.0, 0.5, 0.5,
        )  # fmt: skip
    if name == "GPS_RAW_INT":
        message = copy.copy(message)
        message.time_usec = 0
    return message
