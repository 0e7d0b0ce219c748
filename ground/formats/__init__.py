"""Formats in which answers and pins are written for others, and pins read back. Each escapes; texts stay as they are.

What other packages take from here:

`mark`         `Mark` one thing to hand on, placed or not. `Mark.of_answer(answer, uv_px)`, `Mark.of_pin(pin, place)`.
`coordinates`  `latlon_text(lat, lon, "degrees"|"minutes"|"seconds")`, `mgrs_text`, `utm_text` (extra `geo`),
               `Projection("EPSG:2193")` (extra `geo`), `LocalGrid(lat, lon)`: `.of(mark) -> Projected`.
`coordinate_text`
               `read_coordinate(text) -> Coordinate` (lat_deg, lon_deg, form) of what a person typed: degrees with
               points or commas, minutes, seconds, MGRS and UTM (extra `geo`), geo:. InputError if it can mean two
               places.
`documents`    `FORMATS` name -> `Format` (write(marks) -> str, media_type, suffix); `write(name, marks, grid=None)`,
               `read_pins(path, kind)`, `read_pins_of(name, data, kind)` -> `Imported` (pins, crops, left_out);
               `IMPORTED` their kinds.
`geojson`      `write`, `read`: RFC 7946, without loss. `kml`, `gpx`, `table` (CSV): `write`, `read`; `cot`: `read`.
`data_package` `write(marks, crop_of, now_unix_ns) -> bytes`: a TAK data package, with pictures.
`cot`          `event(mark, now_unix_ns, stale_s)`, `aircraft_events(...)`: Cursor on Target XML; None for a refusal.
"""
