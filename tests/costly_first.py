"""The groups of `make test` that take longest, the longest first: one that began last would end alone.

A group is what `xdist_group` names, or else a file. By processor time, or by half of the time that it takes next to two
others where it mostly waits.
"""

COSTLY_FIRST = (
    "web", "web: a flight in motion", "pipeline", "end to end", "test_daemon", "web: served alone", "test_mavlink_link",
    "open", "test_helper_camera", "processes in real time", "scenarios: ground", "test_autopilot", "test_link_faults",
    "log files", "import photos", "test_intrinsics", "test_router", "test_mavlink_session", "recorded logs",
    "test_spot_book", "test_sharing", "rotating recorder", "install", "test_publisher", "test_track_book",
    "test_gimbal_component", "test_supervision", "failing sensors", "the code's own text",
    "test_gstreamer_helper", "test_makefile", "test_degraded_pictures",
    "benchmarks", "test_faults", "test_sliding_window", "test_old_sets",
)  # fmt: skip
