"""One module a command of `pc-onboard`: what it opens and wires.

Public:

- `calibrate`: `run`
- `cameras`: `run`
- `check_config`: `run`
- `doctor`
- `replay`: `run`
- `run`
- `status`
"""
