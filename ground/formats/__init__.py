"""How answers and pins are written for others, and pins read back. Texts are kept as they are; each format escapes.

What other packages take from here:

`mark`         `Mark` one thing to hand on, placed or not. `Mark.of_answer(answer, uv_px)`, `Mark.of_pin(pin, place)`.
`coordinates`  `latlon_text(lat, lon, "degrees"|"minutes"|"seconds")`, `mgrs_text`, `utm_text` (extra `geo`),
               `Projection("EPSG:2193")` (extra `geo`), `LocalGrid(lat, lon)`: `.of(mark) -> Projected`.
`documents`    `FORMATS` name -> `Format` (write(marks) -> str, media_type, suffix); `write(name, marks, grid=None)`,
               `read_pins(path_or_text, kind)`.
`geojson`      `write`, `read`: RFC 7946, without loss. `kml`, `gpx`, `table` (CSV): `write`, `read`.
`cot`          `event(mark, now_unix_ns, stale_s)`, `aircraft_event(...)`: Cursor on Target XML; None for a refusal.
"""
