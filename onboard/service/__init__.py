"""The daemon: threads, health, watchdog, metrics, journal.

Public:

- `daemon`: `Daemon`, `SignalOrders`
- `host`: `cpu_temperature_c`, `free_mb`
- `journal`
- `look_thread`: `LookThread`
- `measure_thread`: `MeasureThread`, `QuestionThread`
- `prometheus`: `PrometheusServer`
- `readable`: `Reader`
- `reports`: `Brightness`, `Report`, `gps_report`
- `sd_notify`: `Notifier`
- `second_camera`: `SecondCameraThread`
- `session`: `Parts`, `Reporter`, `restore`
- `solver_thread`: `SolverThread`
- `spot_thread`: `SpotThread`
- `track_thread`: `TrackThread`
- `supervision`: `Supervisor`, `ThreadReport`, `ThreadState`
- `vehicle_state`: `Subject`, `VehicleState`, `gps_findings`, `second_findings`, `source_findings`
"""
