"""The daemon: threads, health, watchdog, metrics, journal.

Public:

- `daemon`: `Daemon`, `SignalOrders`
- `host`: `cpu_temperature_c`, `free_mb`
- `journal`
- `prometheus`: `PrometheusServer`, `exposition`
- `sd_notify`: `Notifier`
- `session`: `Detail`, `Parts`, `Reporter`, `brightness`, `reported`, `restore`
- `solver_thread`: `SolverThread`
- `supervision`: `Supervisor`, `ThreadReport`, `ThreadState`
"""
