"""Positions and attitudes: an autopilot over MAVLink, a GNSS receiver over NMEA, or a log. Sources handle link faults
themselves.

Public:

- `autopilot_search`: `FoundAutopilot`, `candidates`, `is_slow`, `listen`
- `factory`: `open_telemetry`
- `log_files`: `looks_like_log`, `read_log`
- `mrk_reader`: `read_mrk`
- `srt_axis_order`: `Order`
- `srt_reader`: `SIGMA_PRESSURE_HEIGHT_M`
- `telemetry_log`: `MAX_GAP_S`, `NS_PER_S`, `TelemetryLog`, `quaternion`, `vouched`
"""
