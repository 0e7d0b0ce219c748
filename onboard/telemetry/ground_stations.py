"""The MAVLink system numbers that an autopilot takes for its ground stations. No link, no thread.

ArduPilot declares its ground station lost when no packet of these numbers comes any more. A program on the ground that
sends under one of them hides that loss, so their range is asked for, and other programs stay out of it.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

LOW, HIGH, OLD = "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "SYSID_MYGCS"  # ArduPilot's parameters; the last before 4.7
AGAIN_NS = 2_000_000_000
MAX_TRIES, OLD_AFTER = 5, 2
USUAL = 255


class GroundStations:
    """Asks an ArduPilot for its parameters, some times each, and keeps what it answered.

    PX4 knows its ground stations by the type of their heartbeat, and reports each unknown parameter to the pilot.
    """

    def __init__(self) -> None:
        self._values: dict[str, int] = {}
        self._is_asked = False
        self._has_given_up = False
        self._tries, self._due_ns = 0, 0

    @property
    def is_open(self) -> bool:
        """Return whether the autopilot may still report others than `range`: until then no ground may be spoken to."""
        return self._is_asked and not self._is_known and not self._has_given_up

    @property
    def _is_known(self) -> bool:
        return (LOW in self._values and HIGH in self._values) or OLD in self._values

    @property
    def range(self) -> tuple[int, int]:
        """The lowest and the highest number; 255 and 255 until the autopilot reports others."""
        low = self._values.get(LOW, self._values.get(OLD, USUAL))
        return low, max(low, self._values.get(HIGH, 0))

    def receive(self, message: Any) -> bool:
        """A HEARTBEAT or a PARAM_VALUE of the autopilot; whether `range` may be another now."""
        if message.get_type() == "HEARTBEAT":
            self._is_asked = message.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        elif message.param_id in (LOW, HIGH, OLD) and 0 <= message.param_value <= USUAL:
            self._values[message.param_id] = int(message.param_value)
            return True
        return False

    def due(self, now_ns: int, system: int) -> list[Any]:
        """Requests for what is not known yet; for the older name where the newer is not answered."""
        if not self.is_open or now_ns < self._due_ns:
            return []
        if self._tries >= MAX_TRIES:
            self._has_given_up = True
            return []
        self._tries, self._due_ns = self._tries + 1, now_ns + AGAIN_NS
        is_old = self._tries > OLD_AFTER and LOW not in self._values
        wanted = [name for name in (LOW, HIGH, *([OLD] if is_old else [])) if name not in self._values]
        return [
            mavlink.MAVLink_param_request_read_message(system, AUTOPILOT_COMPONENT, name.encode(), -1)
            for name in wanted
        ]
