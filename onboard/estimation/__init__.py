"""The window of keyframes: factors, bundle adjustment, what is estimated of the sensors, and whether a result may be
published.

Public:

- `boresight`: `Alignment`, `Belief`, `Unconfirmed`, `BORESIGHT`, `OFFSET`, `DELAY`
- `ground_roughness`: `plane_and_roughness`
- `keyframe`: `Ids`, `Keyframe`, `Observation`, `observation`, `seen_with`
- `camera_states`: `READOUT`
- `moved_optics`: `MOVED`
- `reobservation`: `RelativeVariance`
- `resection`: `Resection`, `resect`
- `rolling_shutter`: `Moving`, `Sweep`, `rates_between`
- `rotation_timing`: `Course`, `Pair`, `Timing`, `timing`, `FEATURES`, `REACH_S`
- `sensor_groups`: `Failing`, `FORGOTTEN`
- `sensor_pose`: `SensorPose`
- `sliding_window`: `Window`
- `solved_window`: `Solved`
- `solver_executor`: `Inline`, `Promise`, `Worker`, `timed_adjust`
- `variance_components`: `VarianceFactors`, `NAMES`, `TILT`, `HEADING`, `TILT_WHITE`, `HEADING_WHITE`,
  `VELOCITY`, `POSITION`
- `window_solver`: `MIN_KEYFRAMES`, `Noise`, `Outcome`, `Request`
"""
