"""A recorded flight through the same pipeline as live, and a comparison of what came out.

Public:

- `comparison`: `Comparison`
- `digital_zoom`: `SIGMA_EQUIVALENT`, `equivalent_px`
- `followed`: `Clicked`, `Followed`
- `load`: `SHARE`, `WARM_UP`, `Load`, `measure`
- `made_flight`: `MadeFlight`
- `photo_steps`: `SMALL_PX`, `doubt_text`, `east_north_m`, `small_pictures`, `without_steps`
- `photo_telemetry`: `datum_sigma_m`, `gap_to_join_s`, `height_amsl`, `photo_telemetry`, `side_lacking`
- `runner`: `Events`, `Flight`, `ProgressLines`, `check_overlap`, `replay`, `summary_text`
- `spotted`: `Spotted`
"""
