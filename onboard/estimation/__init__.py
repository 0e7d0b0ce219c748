"""The window of keyframes: factors, bundle adjustment, what is estimated of the sensors, and whether a result may be
published.

Public:

- `boresight`: `Alignment`, `Belief`, `OFFSET`, `DELAY`
- `ground_roughness`: `plane_and_roughness`
- `keyframe`: `Observation`, `observation`
- `resection`: `Resection`, `resect`
- `sensor_pose`: `SensorPose`
- `sliding_window`: `Window`
- `solver_executor`: `Inline`, `Promise`, `Worker`, `timed_adjust`
- `variance_components`: `VarianceFactors`, `NAMES`, `TILT`, `HEADING`, `TILT_WHITE`, `HEADING_WHITE`,
  `VELOCITY`, `POSITION`
- `window_solver`: `MIN_KEYFRAMES`, `Noise`, `Outcome`, `Request`, `Solved`
"""
