"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `estimates`: `BORESIGHT`, `Estimate`, `SensorError`, `as_rows`, `larger_than_declared`, `not_adopted`
- `pipeline`: `Pipeline`
- `statistics`: `Summary`
"""
