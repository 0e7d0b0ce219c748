"""Positions and attitudes: an autopilot over MAVLink, a GNSS receiver over NMEA, or a log. Sources handle link faults
themselves.

Public:

- `factory`: `open_telemetry`
- `tlog_reader`: `TelemetryLog`, `read_tlog`
"""
