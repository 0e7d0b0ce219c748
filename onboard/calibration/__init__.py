"""Views of a board to a camera file with its sigmas, and a verdict.

Public:

- `board`: `Board`, `Grey`
- `intrinsics`: `Fit`, `View`, `calibrate`
- `verdict`: `RAY_SIGMA_SHARE`, `Verdict`, `bare_places`, `coverage_picture`, `judge`, `report`
"""
