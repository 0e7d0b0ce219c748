"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `pipeline`: `Pipeline`
- `statistics`: `Summary`
"""
