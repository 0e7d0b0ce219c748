"""Positions and attitudes: an autopilot over MAVLink, a GNSS receiver over NMEA, or a log. Sources handle link faults
themselves.

Public:

- `factory`: `open_telemetry`
- `log_files`: `read_log`
- `telemetry_log`: `TelemetryLog`, `quaternion`, `vouched`
"""
