"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `estimates`: `BORESIGHT`, `RELATIVE_VARIANCE`, `Contradiction`, `Estimate`, `SensorError`, `as_rows`,
  `larger_than_declared`, `not_adopted`, `said_of`
- `pipeline`: `Pipeline`
- `statistics`: `Summary`
"""
