"""Recordings, kept estimates, elevation files.

Public:

- `alignment_file`: `StateFile`
- `elevation_files`: `TerrainFiles`
- `mcap_reader`: `RecordedFlight`
- `mcap_writer`: `SessionRecorder`
- `recorded_pictures`: `RecordedPictures`
- `rotating_recorder`: `Recorded`, `software_version`
- `session_number`: `next_session`
"""
