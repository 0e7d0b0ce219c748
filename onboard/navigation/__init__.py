"""Position, velocity and attitude at an exposure, or the reason why there is none.

Public:

- `attitude_interpolation`: `Attitudes`, `Orientation`, `RATE_WINDOW_NS`
- `gimbal`: `Gimbal`, `MountHypothesis`
- `limits`: `MEMORY_NS`, `LATE_NS`, `RECENT_NS`, `PATIENCE_NS`, `LONG_NS`, `LIKELY_SIGMAS`, `SURE_SIGMAS`,
  `FALSE_ALARM`, `CLEAR`, `RARE`, `MOST_OF`, `FORGOTTEN`
- `navigator`: `NavState`, `Navigation`
- `position_interpolation`: `Displacement`
- `position_jumps`: `EXPLAINED_SHARE`, `GLITCH_SIGMAS`
- `position_slip`: `DYNAMIC_TIME_S`
"""
