"""Features: contrast normalisation, KLT tracking and its verification.

Public:

- `klt_tracker`: `MIN_TRACKS`, `PREDICTED_PX`, `PREDICTED_SHARE`, `Tracker`, `Tracks`
- `reduced_tracker`: `tracker_for`
"""
