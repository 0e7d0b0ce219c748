"""Commands to the autopilot that turn its camera: sent until it acknowledges them, one at a time. No link, no thread.

MAV_CMD_DO_SET_ROI_LOCATION and MAV_CMD_DO_SET_ROI_NONE, addressed to the autopilot, which is the gimbal's manager or
passes them on to it. As COMMAND_INT: a COMMAND_LONG's 32-bit floats are metres off, and have no frame of the height.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.events.pointing import ACCEPTED, NO_AUTOPILOT, NOT_ACKNOWLEDGED, Target
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

AGAIN_NS = 700_000_000  # after which what is not acknowledged is sent again
MOST_SENT = 3
LIMIT_S = 3.0  # for the whole of it
IN_PROGRESS = int(mavlink.MAV_RESULT_IN_PROGRESS)
# Of MAV_RESULT, by its numbers: pymavlink's dialect lacks the later ones.
RESULTS = {
    0: ACCEPTED, 1: "temporarily_rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled",
    7: "command_long_only", 8: "command_int_only", 9: "command_unsupported_mav_frame", 10: "not_in_control",
}  # fmt: skip


@dataclass(eq=False)
class _Order:
    target: Target | None
    sent: int = 0
    sent_ns: int = 0
    is_begun: bool = False  # the autopilot has reported that it is at it
    result: str = ""
    is_done: threading.Event = field(default_factory=threading.Event)

    @property
    def command(self) -> int:
        is_end = self.target is None
        return int(mavlink.MAV_CMD_DO_SET_ROI_NONE if is_end else mavlink.MAV_CMD_DO_SET_ROI_LOCATION)

    def message(self, system: int) -> Any:
        t = self.target
        x, y, z = (0, 0, 0.0) if t is None else (round(t.lat_deg * 1e7), round(t.lon_deg * 1e7), t.height_amsl_m)
        frame = mavlink.MAV_FRAME_GLOBAL_INT  # its height counts from mean sea level
        return mavlink.MAVLink_command_int_message(
            system, AUTOPILOT_COMPONENT, frame, self.command, 0, 0, 0.0, 0.0, 0.0, 0.0, x, y, z
        )


class Pointing:
    """A `PointingEnd`. `receive` and `due` are called in the telemetry's thread; `component` is ours."""

    def __init__(self, component: int, limit_s: float = LIMIT_S) -> None:
        self._component, self._limit_s = component, limit_s
        self._lock = threading.Lock()
        self._turn = threading.Lock()  # whose command is under way
        self._order: _Order | None = None

    def point(self, target: Target | None) -> str:
        """Serve `PointingEnd`."""
        with self._turn:
            order = _Order(target)
            with self._lock:
                self._order = order
            order.is_done.wait(self._limit_s)
            with self._lock:  # from here on it is neither sent nor answered
                self._order = None
            return order.result or (NOT_ACKNOWLEDGED if order.sent else NO_AUTOPILOT)

    def receive(self, message: Any, system: int | None) -> None:
        """One message from the line; `system`: the vehicle's number, as far as it is known."""
        if message.get_type() != "COMMAND_ACK":
            return
        is_its_own = (message.get_srcSystem(), message.get_srcComponent()) == (system, AUTOPILOT_COMPONENT)
        # MAVLink 1 acknowledgements name no receiver: 0.
        is_for_us = message.target_system in (0, system) and message.target_component in (0, self._component)
        with self._lock:
            order = self._order
            if order is None or not (is_its_own and is_for_us and order.sent and message.command == order.command):
                return
            if message.result == IN_PROGRESS:
                order.is_begun = True
                return
            order.result = RESULTS.get(message.result, f"result {message.result}")
            order.is_done.set()

    def due(self, now_ns: int, system: int) -> list[Any]:
        """Return the messages to send now, to an autopilot that is being received."""
        with self._lock:
            order = self._order
            if order is None or order.result or order.is_begun or order.sent >= MOST_SENT:
                return []
            if order.sent and now_ns - order.sent_ns < AGAIN_NS:
                return []
            order.sent, order.sent_ns = order.sent + 1, now_ns
            return [order.message(system)]
