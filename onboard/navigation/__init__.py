"""Position, velocity and attitude at an exposure, or the reason why there is none.

Public:

- `gimbal`: `MountHypothesis`
- `navigator`: `NavState`, `Motion`, `Navigation`
- `position_interpolation`: `Flown`
- `position_slip`: `DYNAMIC_TIME_S`
"""
