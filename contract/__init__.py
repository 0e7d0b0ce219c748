"""The common ground of aircraft and ground station: geometry, feature set, wire format. Python and NumPy, no I/O.

No thread and no clock but in `supervised_thread` and `mavlink_camera`.
"""
