"""Names inside a session's MCAP file, for its writer and its readers. docs/wire-format.md, section 9."""

from __future__ import annotations

SET_ENCODING = "pointclick"
METADATA_NAME = "pointclick"

FRAMES = "pc/{vehicle}/frames"
POSITIONS = "pc/{vehicle}/position"
GPS_QUALITY = "pc/{vehicle}/gps_quality"
ATTITUDES = "pc/{vehicle}/attitude"
FILTER_STATUS = "pc/{vehicle}/filter_status"
GIMBAL_ATTITUDES = "pc/{vehicle}/gimbal_attitude"
RANGES = "pc/{vehicle}/range"
