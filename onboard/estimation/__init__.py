"""The window of keyframes: factors, bundle adjustment, what is estimated of the sensors, and whether a result may be
published.

Public:

- `boresight`: `Alignment`, `PlatformEstimate`, `Unconfirmed`
- `clock_profile`: `ClockProfile`, `clock_profile`, `offsets_about`
- `error_budget`: the sources' names, `sources`
- `ground_roughness`: `plane_and_roughness`
- `keyframe`: `Ids`, `Keyframe`, `Observation`, `observation`, `seen_with`, `stamp_sigma_s`,
  `turned`, `with_attitude`
- `moved_optics`: `MOVED`
- `platform_states`: `QUANTITIES`, `present`, `BORESIGHT`, `OFFSET`, `DELAY`, the sources' names
- `prediction_error`: `prediction_sigma_px`, `turn_between`, `way_between`
- `reobservation`: `RelativeVariance`
- `resection`: `Resection`, `Sighted`, `resect`
- `rolling_shutter`: `Moving`, `Sweep`, `rates_between`
- `sensor_factors`: `travelled_sigma_m`
- `sensor_groups`: `Failing`
- `shared_errors`: `SensorPose`
- `sliding_window`: `Window`
- `solved_window`: `Solved`
- `solver_executor`: `Inline`, `Promise`, `Worker`, `timed_adjust`
- `sensor_table`: `PARTS`, `configured`
- `variance_components`: `VarianceFactors`
- `window_problem`: `MIN_KEYFRAMES`, `Outcome`
- `window_request`: `Noise`, `Request`
"""
