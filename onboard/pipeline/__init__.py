"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `estimates`: `BORESIGHT`, `RELATIVE_VARIANCE`, `Estimate`, `SensorError`, `as_rows`, `larger_than_declared`
- `pipeline`: `Pipeline`
- `statistics`: `Summary`
"""
