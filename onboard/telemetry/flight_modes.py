"""The flight mode in an autopilot's HEARTBEAT, by its name. No link, no clock.

ArduPilot's names are those of the MAVLink dialect; pymavlink's `mavutil` has them again, and PX4's, but loads a second
dialect of 20 MB for it. PX4's are its user guide's, by the numbers of its `px4_custom_mode.h`.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

COPTERS = (
    *(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_TYPE_HELICOPTER, mavlink.MAV_TYPE_HEXAROTOR),
    *(mavlink.MAV_TYPE_OCTOROTOR, mavlink.MAV_TYPE_TRICOPTER, mavlink.MAV_TYPE_DODECAROTOR, mavlink.MAV_TYPE_DECAROTOR),
)
VTOLS = range(19, 26)  # MAV_TYPE_VTOL_...; their names differ between versions of the dialect
ARDUPILOT = {
    **dict.fromkeys((mavlink.MAV_TYPE_FIXED_WING, *VTOLS), "PLANE_MODE"),
    **dict.fromkeys(COPTERS, "COPTER_MODE"),
    **dict.fromkeys((mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT), "ROVER_MODE"),
}
"""Its table of modes (an enumeration of the dialect) by the type of the vehicle."""

PX4 = {
    **{(1, 0): "MANUAL", (2, 0): "ALTITUDE", (3, 0): "POSITION", (3, 1): "ORBIT", (3, 2): "POSITION SLOW"},
    **{(4, 2): "TAKEOFF", (4, 3): "HOLD", (4, 4): "MISSION", (4, 5): "RETURN", (4, 6): "LAND", (4, 8): "FOLLOW ME"},
    **{(4, 9): "PRECISION LAND", (4, 10): "VTOL TAKEOFF", (5, 0): "ACRO", (6, 0): "OFFBOARD", (7, 0): "STABILIZED"},
    **{(8, 0): "RATTITUDE", (10, 0): "TERMINATION", (11, 0): "ALTITUDE CRUISE"},
}
"""Names by main mode and sub-mode, the third and fourth byte of `custom_mode`."""


def mode_of(heartbeat: Any) -> str:
    """Return the name of the mode in an autopilot's HEARTBEAT; empty for one that is in no table."""
    number = int(heartbeat.custom_mode)
    if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return PX4.get((number >> 16 & 0xFF, number >> 24), "")
    is_named = heartbeat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    table = ARDUPILOT.get(heartbeat.type)
    if heartbeat.autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA or not is_named or table is None:
        return ""
    entry = mavlink.enums[table].get(number)
    name = "" if entry is None else entry.name.removeprefix(f"{table}_")
    return "" if name == "ENUM_END" else name.replace("_", " ")
