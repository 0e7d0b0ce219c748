"""The configuration: typed, frozen, the only source of keys and defaults; and the files it is read from.

Public:

- `files`: `config_files`, `load_camera`, `load_config_files`, `load_second_camera`, `state_folder`
- `link`: `Link`, `Look`, `check_pointers`
- `recorded`: `recorded_toml`, `with_secrets_of`
- `schema`: `CameraConfig`, `Config`, `Gps`, `NOT_THERMAL`, `PictureConfig`, `SpotsConfig`, `ThermalConfig`,
  `parse_config`, `to_toml`, `validated`
- `second_camera`: `SecondCamera`
"""
