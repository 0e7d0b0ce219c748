"""Camera files: our own, and other tools' calibrations, read into the camera that we have.

Public:

- `formats`: `CameraFile`, `load_camera_file`, `read_camera_file`
"""
