"""Positions and attitudes: an autopilot over MAVLink, a GNSS receiver over NMEA, or a log. Sources handle link faults
themselves.

Public:

- `autopilot_search`: `FoundAutopilot`, `candidates`, `is_slow`, `listen`
- `factory`: `open_telemetry`
- `geo_reader`: `GeoPlace`, `read_geo`
- `log_clocks`: `BLOCKS`, `REACH_S`
- `log_files`: `format_of`, `logs_among`, `read_log`, `read_logs`
- `log_formats`: `SUFFIXES`
- `mavlink_passage`: `SIGNATURE_BYTES`
- `mp4_container`: `creation_ns`
- `mrk_reader`: `read_mrk`
- `own_video`: `another_length`, `began_ns`, `cut_sigma_s`, `extent_s`
- `pointing`: `Pointing`
- `read_options`: `ReadOptions`
- `row_events`: `SIGMA_GEOID_M`, `SIGMA_PRESSURE_HEIGHT_M`
- `srt_axis_order`: `Order`
- `telemetry_log`: `MAX_GAP_S`, `NS_PER_S`, `TelemetryLog`, `quaternion`, `vouched`
- `tlog_playback`: `PlayedTelemetry`
- `transport_stream`: `has_metadata`
- `two_logs`: `loosened`
- `video_reader`: `has_telemetry`, `other_telemetry`
"""
