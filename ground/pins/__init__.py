"""Pins: what was clicked, kept, fused, tied to known places, shared. Only `sharing` uses zenoh; nothing the web.

What other packages take from here (all values are frozen dataclasses; heights in metres; times are Unix nanoseconds):

`model`     `Category` person, vehicle, fire, hazard, poi (an Enum of those words).
            `PinClick` one click and its answer, with all that is needed to compare it with other clicks once its set
            is gone. `PinClick.of(feature_set, fix, uv_px, who=..., clicked_unix_ns=..., pointing_px=1.0, locator=...)`
            makes one from an answered click; `PinClick.entered(lat_deg, lon_deg, ...)` from a typed coordinate.
            `Pin` id, number, name, note, category, who, created_unix_ns, modified_unix_ns, modified_by, clicks.
            `Tie` a click on a known place, and its surveyed coordinate with sigmas.
            Each has `to_dict()` (JSON, without loss) and `from_dict()` (raises InputError on what is no such thing).
`store`     `PinStore(path)` SQLite, or a URL of PostgreSQL; on disk before a call returns; several threads, processes.
            `add(clicks, name=, note=, category=, who=, crop=) -> Pin`, `add_click(pin_id, click, who=, crop=)`,
            `remove_click(pin_id, click_id, who=)`, `edit(pin_id, who=, name=, note=, category=)`,
            `delete(pin_id, who=)`, `clear(who=)`, `bring_in(pins, who=, crops=)` (a file's, as one change),
            `undo(who=) -> str | None` and `redo(who=)` (a description of what was undone; None: nothing),
            `pins(category=, text=, vehicle=, who=, since_unix_ns=) -> list[Pin]`, `pin(pin_id)`, `by_number(number)`,
            `crop(click_id) -> bytes | None`, `ties()`, `add_tie(tie, who=)` (raises `TieRefused`),
            `delete_tie(tie_id, who=)`, `merge(pin)` (of another server: last writer wins), `removed()` (tombstones),
            `revision` (an integer that grows with each change by any user), `close()`. `file.default_path()`,
            `file.chosen_path(named)`, `file.chosen_store(named, url)`.
            `everything()` with tombstones, `merge_all(pins, most)` many in one transaction.
`sharing`   `PinSharing(store, connect=(), listen=(), tls=None)` shares a store with other servers until `close()`:
            a context manager; `state -> Shared` (counts, and as a text). `share_pins(store, ...)`: the same, or None
            without an endpoint. Raises LinkError. Ties and crops are not shared.
`fusion`    `fuse(clicks, ties=()) -> Place | Contradiction`: one position from several clicks of one thing.
            `Place` lat_deg, lon_deg, height_ellipsoid_m, height_amsl_m, covariance_enu_m2 (None: accuracy unknown),
            ellipse, ce90_m, le90_m, sigma_height_m, chi2, freedom, clicks, tied. `Contradiction` chi2, freedom,
            probability, reason, answers (each click alone, in the order given). `Unplaced`: a pin without clicks.
            `vector(clicks_a, clicks_b, ties=()) -> Vector | Contradiction | Unplaced` distance, bearing, height
            difference, each with sigma.
`places`    `Places(store)`: `place(pin)` with what was computed before kept; `between(pin, pin)`.
`ties`      `tie_of(feature_set, fix, uv_px, lat_deg=, lon_deg=, height_m=, datum=, sigma_m=, sigma_height_m=, ...)`;
            `judge(tie, earlier) -> Judgement` (chi2, freedom, misses_m, allowed_m, is_accepted).
"""
