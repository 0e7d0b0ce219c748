"""The groups of `make test` that take longest, the longest first: one that began last would end alone.

A group is what `xdist_group` names, or else a file. By processor time, or by half of the time that it takes next to two
others where it mostly waits.
"""

COSTLY_FIRST = (
    "web", "web: a flight in motion", "end to end", "pipeline", "install", "open", "test_daemon",
    "processes in real time", "web: served alone", "test_autopilot", "test_faults", "test_link_faults",
    "scenarios: ground", "test_helper_camera", "scenarios: slow pictures", "failing sensors", "test_router",
    "recorded logs", "test_sharing", "test_intrinsics", "test_live_command", "rotating recorder", "test_makefile",
    "benchmarks", "test_gimbal_component", "scenarios: motion", "scenarios: telemetry", "test_gimbal_survey",
    "test_degraded_pictures", "ordinary", "test_standing_parts", "test_supervision", "test_moved_optics",
    "range finder", "calibrate in flight", "test_track_book", "test_spot_book", "test_mcap_records",
    "test_correlated_sensor_errors", "test_sliding_window", "test_rolling_shutter", "test_platform_errors",
)  # fmt: skip
