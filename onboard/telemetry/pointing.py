"""Commands to the autopilot that turn its camera, or have it circle: sent until it acknowledges them, one at a time.

MAV_CMD_DO_SET_ROI_LOCATION and MAV_CMD_DO_SET_ROI_NONE, addressed to the autopilot, which is the gimbal's manager or
passes them on to it. To circle, MAV_CMD_DO_REPOSITION for a plane, which loiters about the place that it is sent to,
and MAV_CMD_DO_ORBIT for a multicopter, which would hover there. ArduPilot's VTOLs call themselves planes by default,
so a plane is first asked whether it is one, and whether it flies (EXTENDED_SYS_STATE). As COMMAND_INT: a
COMMAND_LONG's 32-bit floats are metres off, and have no frame of the height. No link, no thread.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.events.pointing import (
    ACCEPTED,
    NO_AUTOPILOT,
    NO_CIRCLE,
    NOT_ACKNOWLEDGED,
    ON_GROUND,
    LookAhead,
    LookAt,
    Order,
)
from onboard.telemetry.flight_modes import COPTERS
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


PLANES = {mavlink.MAV_TYPE_FIXED_WING}
FRESH_S = 2.0  # the age of the newest height up to which it is the one of now


@dataclass(frozen=True)
class _Command:
    """A COMMAND_INT, but for its place: its number and its first four parameters."""

    number: int
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def _command_for(order: Order, kind: int | None) -> _Command | None:
    """Return the command to a vehicle of a kind (MAV_TYPE); None where there is none. Circles are clockwise."""
    if isinstance(order, LookAt):
        return _Command(mavlink.MAV_CMD_DO_SET_ROI_LOCATION)
    if isinstance(order, LookAhead):
        return _Command(mavlink.MAV_CMD_DO_SET_ROI_NONE)
    if kind in PLANES:  # at its own speed; it changes to its guided mode
        flags = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        return _Command(mavlink.MAV_CMD_DO_REPOSITION, (-1.0, flags, order.radius_m, 0.0))
    if kind in COPTERS:  # speed, heading and number of turns are the vehicle's own
        return _Command(mavlink.MAV_CMD_DO_ORBIT, (order.radius_m, math.nan, math.nan, math.nan))
    return None


@dataclass(eq=False)
class _Given:
    order: Order
    command: _Command
    is_for_it: bool  # the vehicle is known to be of the command's kind, and to fly; before, it is asked
    asked: int = 0
    sent: int = 0
    sent_ns: int = 0
    is_begun: bool = False  # the autopilot has reported that it is at it
    result: str = ""
    is_done: threading.Event = field(default_factory=threading.Event)

    def message(self, system: int) -> Any:
        o, c = self.order, self.command
        x, y, z = 0, 0, 0.0
        if not isinstance(o, LookAhead):
            x, y, z = round(o.lat_deg * 1e7), round(o.lon_deg * 1e7), o.height_amsl_m
        frame = mavlink.MAV_FRAME_GLOBAL_INT  # its height counts from mean sea level
        return mavlink.MAVLink_command_int_message(
            system, AUTOPILOT_COMPONENT, frame, c.number, 0, 0, *c.parameters, x, y, z
        )


def _question(system: int) -> Any:
    """Return the request for EXTENDED_SYS_STATE, which states whether a plane is a VTOL, and whether it flies."""
    number, asked = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
    return mavlink.MAVLink_command_long_message(system, AUTOPILOT_COMPONENT, number, 0, asked, 0, 0, 0, 0, 0, 0)


class Pointing:
    """A `PointingEnd`. `receive` and `due` are called in the telemetry's thread; `component` is ours."""

    def __init__(
        self, component: int, limit_s: float = LIMIT_S, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._component, self._limit_s, self._monotonic_s = component, limit_s, monotonic_s
        self._kind: int | None = None  # MAV_TYPE of the vehicle
        self._height: tuple[float, float] | None = None  # above mean sea level, m, and when it came
        self._lock = threading.Lock()
        self._turn = threading.Lock()  # whose command is under way
        self._given: _Given | None = None

    def command(self, order: Order) -> str:
        """Serve `PointingEnd`."""
        command = _command_for(order, self._kind)
        if command is None:
            return NO_AUTOPILOT if self._kind is None else NO_CIRCLE
        with self._turn:
            given = _Given(order, command, is_for_it=command.number != mavlink.MAV_CMD_DO_REPOSITION)
            with self._lock:
                self._given = given
            given.is_done.wait(self._limit_s)
            with self._lock:  # from here on it is neither sent nor answered
                self._given = None
            unsent = NO_CIRCLE if given.asked else NO_AUTOPILOT  # asked, it has not reported what it is
            return given.result or (NOT_ACKNOWLEDGED if given.sent else unsent)

    def height_amsl_m(self) -> float | None:
        """Serve `PointingEnd`."""
        height = self._height
        return None if height is None or self._monotonic_s() - height[1] > FRESH_S else height[0]

    def receive(self, message: Any, system: int | None) -> None:
        """One message from the line; `system`: the vehicle's number, as far as it is known."""
        if (message.get_srcSystem(), message.get_srcComponent()) != (system, AUTOPILOT_COMPONENT):
            return
        name = message.get_type()
        if name == "HEARTBEAT":
            self._kind = message.type
        elif name == "GLOBAL_POSITION_INT":
            self._height = message.alt / 1000.0, self._monotonic_s()
        elif name == "EXTENDED_SYS_STATE":
            self._reported(message)
        elif name == "COMMAND_ACK":
            self._acknowledged(message, system)

    def _reported(self, state: Any) -> None:
        with self._lock:
            given = self._given
            if given is None or given.is_for_it:
                return
            if state.vtol_state != mavlink.MAV_VTOL_STATE_UNDEFINED:
                given.result = NO_CIRCLE
            elif state.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND:
                given.result = ON_GROUND
            else:
                given.is_for_it = True
                return
            given.is_done.set()

    def _acknowledged(self, message: Any, system: int | None) -> None:
        # MAVLink 1 acknowledgements name no receiver: 0.
        is_for_us = message.target_system in (0, system) and message.target_component in (0, self._component)
        with self._lock:
            given = self._given
            if given is None or not (is_for_us and given.sent and message.command == given.command.number):
                return
            if message.result == IN_PROGRESS:
                given.is_begun = True
                return
            given.result = RESULTS.get(message.result, f"result {message.result}")
            given.is_done.set()

    def due(self, now_ns: int, system: int) -> list[Any]:
        """Return the messages to send now, to an autopilot that is being received."""
        with self._lock:
            given = self._given
            if given is None or given.result or given.is_begun:
                return []
            count = given.sent if given.is_for_it else given.asked
            if count >= MOST_SENT or (count and now_ns - given.sent_ns < AGAIN_NS):
                return []
            given.sent_ns = now_ns
            if not given.is_for_it:
                given.asked += 1
                return [_question(system)]
            given.sent += 1
            return [given.message(system)]
