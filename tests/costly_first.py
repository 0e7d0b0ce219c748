"""The groups of `make test` that take longest, the longest first: one that began last would end alone.

A group is what `xdist_group` names, or else a file. By processor time, but for the page's tests, which wait in between.
"""

COSTLY_FIRST = (
    "web", "end to end", "test_faults", "install", "open", "test_moved_optics", "test_platform_errors", "pipeline",
    "test_spin_in_hover", "failing sensors", "test_degenerate_ground", "test_live_command", "test_degenerate_motion",
    "test_makefile", "benchmarks", "processes in real time", "test_correlated_sensor_errors", "test_gimbal_component",
    "test_degraded_sensors", "test_slow_pictures", "test_degraded_pictures", "test_gimbal_survey",
    "test_rolling_shutter", "calibrate in flight", "test_intrinsics", "rotating recorder",
    "test_daemon", "test_unknown_datum", "range finder", "ordinary", "test_mcap_records", "test_sparse_positions",
    "test_standing_parts", "test_reduced_tracker", "test_ordinary_autopilot", "test_track_book",
    "test_spot_book",
)  # fmt: skip
