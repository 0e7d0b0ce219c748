"""One module a command of `pc-onboard`: what it opens and wires.

Public:

- `bench`: `run`
- `calibrate`: `run`
- `camera`: `run`
- `cameras`: `run`
- `check_config`: `run`
- `doctor`
- `import_photos`: `run`
- `import_video`: `run`
- `replay`: `run`
- `run`
- `status`
"""
