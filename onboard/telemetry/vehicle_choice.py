"""The vehicle on the line that is ours: the configured one, else the only one that is received. No link, no thread.

A second vehicle's positions must never become ours. So none is accepted before others had the time to be received;
where several are, none is, until one is configured. What is ours stays ours, whoever comes later and whoever goes: an
autopilot that has fallen silent next to another one is no reason to follow the other.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

NS_PER_S = 1_000_000_000
LISTEN_NS = 2_200_000_000  # two heartbeats of everyone else
GONE_NS = 30 * NS_PER_S  # of silence, longer than a reboot takes: a vehicle that was received has left
KINDS = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}
TYPE = "MAV_TYPE_"
KEY = "set telemetry.system"


def is_autopilot(message: Any) -> bool:
    """Return whether a message is an autopilot's own heartbeat."""
    is_heartbeat = message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT_COMPONENT
    return bool(is_heartbeat and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def kind_of(heartbeat: Any) -> str:
    """The kind of vehicle, for people: "ArduPilot fixed wing"."""
    entry = mavlink.enums["MAV_TYPE"].get(heartbeat.type)
    what = "" if entry is None else entry.name.removeprefix(TYPE).replace("_", " ").lower()
    return f"{KINDS.get(heartbeat.autopilot, 'autopilot')} {what}".strip()


class VehicleChoice:
    """Fed with every heartbeat of every autopilot; `system` is ours, None while that is open. 0 configures none."""

    def __init__(self, configured: int = 0) -> None:
        self.system: int | None = configured or None
        self._is_configured = configured != 0
        self._received: dict[int, tuple[str, int]] = {}  # what it is, and when it was last received
        self._only: int | None = None  # received last, and no other since
        self._only_since_ns = 0
        self._contested: list[str] = []  # all that were received before one was left

    def heartbeat(self, message: Any, arrival_ns: int) -> None:
        """An autopilot's heartbeat."""
        system = int(message.get_srcSystem())
        self._received[system] = kind_of(message), arrival_ns
        if system != self._only:
            if self._only is not None and self.system is None:
                self._contested = self._recent(arrival_ns)
            self._only, self._only_since_ns = system, arrival_ns

    def look(self, now_ns: int) -> None:
        """Take the only one that was received for long enough."""
        if self.system is None and self._only is not None:
            needed_ns = GONE_NS if self._contested else LISTEN_NS
            last_ns = self._received[self._only][1]
            if now_ns - self._only_since_ns >= needed_ns and now_ns - last_ns < LISTEN_NS:
                self.system = self._only

    def refusal(self, now_ns: int) -> str:
        """Return the reason why nothing from a vehicle of ours has been received yet."""
        others = self._recent(now_ns)
        if self.system is not None:
            there = f", but {_listed(others)}: is telemetry.system right?" if others else ""
            return f"no autopilot with system number {self.system} found yet{there}"
        if not others:
            return "no autopilot found yet"
        if len(others) > 1 or self._contested:
            return f"several vehicles on this line ({_listed(others if len(others) > 1 else self._contested)}): {KEY}"
        return f"{others[0]} found: listening for others on this line"

    @property
    def is_refused(self) -> bool:
        """Return whether several were received, none of them is configured, and so none is accepted."""
        return self.system is None and bool(self._contested)

    def doubt(self, now_ns: int) -> str:
        """The doubt about the vehicle that is followed; empty where it is configured, or no other was received."""
        if self._is_configured or self.system is None:
            return ""
        others = self._recent(now_ns)
        if len(others) > 1:
            return f"several vehicles on this line ({_listed(others)}), {self.system} is followed: {KEY}"
        if self._contested:
            return f"{_listed(self._contested)} were on this line, {self.system} is left and followed: {KEY}"
        return ""

    def instead(self, now_ns: int) -> str:
        """The others that are received, for a reason that ours is silent; empty if no one is."""
        others = self._recent(now_ns, but=self.system)
        return f"; received instead: {_listed(others)}. If that is this aircraft, {KEY}" if others else ""

    def _recent(self, now_ns: int, but: int | None = None) -> list[str]:
        """The vehicles received recently, each with what it is."""
        return [
            f"{system} {kind}"
            for system, (kind, at_ns) in sorted(self._received.items())
            if now_ns - at_ns < GONE_NS and system != but
        ]


def _listed(names: list[str]) -> str:
    return ", ".join(names)
