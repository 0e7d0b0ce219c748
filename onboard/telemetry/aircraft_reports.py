"""An autopilot's reports of its aircraft for people to read: mode and battery. No link, no clock.

The battery is that of SYS_STATUS: of several ArduPilot reports its first there and PX4 the one with the least left, and
both send it unasked to ground stations.
"""

from __future__ import annotations

from typing import Any

from onboard.events.source import AircraftReport
from onboard.telemetry.flight_modes import mode_of
from onboard.telemetry.vehicle_choice import is_autopilot

MODE_OLD_NS = 5_000_000_000  # heartbeats come each second
BATTERY_OLD_NS = 15_000_000_000  # it comes every 5 s where it had to be asked for (`message_rates.BATTERY_HZ`)
UNKNOWN_MV = (0, 65535)  # ArduPilot sends 0 without a monitor


class AircraftReports:
    """The newest reports of one autopilot. `receive` is called by one thread, `at` by any."""

    def __init__(self) -> None:
        self._mode: tuple[int, str] | None = None  # with its arrival, ns
        self._battery: tuple[int, int | None, float | None] | None = None

    def receive(self, message: Any, arrival_ns: int) -> None:
        """Take one message of the autopilot's, of any kind."""
        if is_autopilot(message):
            self._mode = arrival_ns, mode_of(message)
        elif message.get_type() == "SYS_STATUS":
            percent, millivolts = int(message.battery_remaining), int(message.voltage_battery)
            self._battery = (
                arrival_ns,
                percent if 0 <= percent <= 100 else None,
                None if millivolts in UNKNOWN_MV else millivolts / 1000.0,
            )

    def at(self, now_ns: int) -> AircraftReport:
        """Return what is known at a moment: nothing that came too long before it."""
        mode, battery = self._mode, self._battery
        _, name = mode if mode is not None and now_ns - mode[0] <= MODE_OLD_NS else (0, "")
        is_new = battery is not None and now_ns - battery[0] <= BATTERY_OLD_NS
        _, percent, volts = battery if battery is not None and is_new else (0, None, None)
        return AircraftReport(name, percent, volts)
