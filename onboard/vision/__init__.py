"""Features: contrast normalisation, KLT tracking and its verification.

Public:

- `contrast_normalisation`: `Picture`, `prepare`
- `descriptor_matching`: `Described`, `describe`, `motion_between`
- `klt_tracker`: `MIN_TRACKS`, `PREDICTED_PX`, `PREDICTED_SHARE`, `Tracker`, `Tracks`
- `reduced_tracker`: `tracker_for`
"""
