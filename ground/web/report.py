"""A report of the search as one HTML file: map, pins with their pictures, what was seen, who would have been found."""

from __future__ import annotations

import base64
import html
import time
from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response

from contract.answer import time_utc
from contract.errors import InputError
from ground.formats.mark import Mark
from ground.formats.rounded import rounded_text
from ground.pins.fusion import Contradiction, Fused
from ground.pins.model import MAX_WHO, Pin
from ground.web.context import ServerContext
from ground.web.dependency import Context
from ground.web.report_map import report_map
from ground.web.view import camera_place

COUNTED_S = 20.0  # waited for what was seen to be counted; a report of an hour's flight states what is still ahead
LOOK_S = 0.05
MOST_PLACES = 500  # of a flight's path
STYLE = """
body{font:15px/1.4 system-ui,sans-serif;max-width:900px;margin:24px auto;padding:0 12px;color:#14202b}
h1{font-size:24px;margin:0 0 4px}h2{font-size:18px;margin:24px 0 6px}svg{width:100%;border:1px solid #7a8794}
table{border-collapse:collapse;width:100%}
th,td{border:1px solid #c6ced7;padding:5px 8px;text-align:left;vertical-align:top}
td img{width:110px}.big{font-weight:600;white-space:nowrap}.muted{color:#4a5866}tr{break-inside:avoid}
@media print{body{margin:0}}
"""

# Routes below /api.
router = APIRouter(tags=["hand-off and export"])


@router.get("/report", summary="A report of the search as one HTML file", response_class=Response)
def report(context: Context, who: Annotated[str, Query(max_length=MAX_WHO)] = "") -> Response:
    seen, found = _counted(context)
    pins = context.store.pins()
    marks = [_marks(pin, place) for pin, place in zip(pins, context.places.of(pins), strict=True)]
    paths = {vehicle: _path(context, vehicle) for vehicle in context.source.vehicles()}
    placed = [mark for of_pin in marks for mark in of_pin if mark.is_placed]
    drawing = report_map(placed, list(paths.values()), lambda z, x, y: context.seen_map.tile(z, x, y, "count"))
    name = f"search-{time.strftime('%Y%m%d-%H%MZ', time.gmtime())}.html"
    made = f"made {_moment(time_utc(time.time_ns()))}{f' by {who}' if who else ''}, from {context.source.name}"
    authors = sorted({click.who for pin in pins for click in pin.clicks if click.who})
    content = "".join(
        (
            '<!doctype html><html lang="en"><meta charset="utf-8"><title>Report of the search</title>',
            f"<style>{STYLE}</style><h1>Report of the search</h1><p class=muted>{_text(made)}</p>",
            "<h2>Map</h2>", drawing or "<p>Nothing has a place yet.</p>",
            "<p class=muted>Yellow to dark: ground seen in many to few pictures; no colour: not seen for certain. "
            "Lines: where the cameras were. Ellipses: 90 %.</p>",
            f"<h2>Pins ({len(marks)})</h2>", _pins(context, marks),
            "<h2>What was seen</h2>", _listed(_seen_lines(seen)),
            "<h2>Who would have been found there</h2>", _found_lines(found),
            "<h2>When and who</h2>", _listed(_times(context)),
            f"<p>Marked by: {_text(', '.join(authors) or 'no names given')}</p></html>",
        )
    )  # fmt: skip
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type="text/html; charset=utf-8", headers=headers)


def _counted(context: ServerContext) -> tuple[dict[str, Any], dict[str, Any]]:
    """The seen ground and who would have been found, waited for a while."""
    until_s = time.monotonic() + COUNTED_S
    context.seen_map.begin()
    while (seen := context.seen_map.state())["ahead"] != 0 and not seen["trouble"] and time.monotonic() < until_s:
        time.sleep(LOOK_S)
    # Asked for only now: who computes it while more is counted rests after each time.
    while not ((found := context.found_map.state())["is_current"] or found["trouble"]) and time.monotonic() < until_s:
        time.sleep(LOOK_S)
    return seen, found


def _path(context: ServerContext, vehicle: str) -> list[tuple[float, float]]:
    rows = [row for row in context.source.frames(vehicle) if row.status.value == "ok"]
    kept = rows[:: max(1, -(-len(rows) // MOST_PLACES))]
    sets = (context.source.feature_set(vehicle, row.session, row.frame) for row in kept)
    return [(place[0], place[1]) for s in sets if s is not None and (place := camera_place(s)) is not None]


def _marks(pin: Pin, place: Fused) -> list[Mark]:
    """The pin, and, where its clicks contradict each other, the place of each."""
    return [Mark.of_pin(pin, found) for found in (place, *(place.answers if isinstance(place, Contradiction) else ()))]


def _pins(context: ServerContext, marks: Sequence[Sequence[Mark]]) -> str:
    if not marks:
        return "<p>None.</p>"
    rows = []
    for of_pin in marks:
        mark, where = of_pin[0], "<br>".join(_where(mark) for mark in of_pin)
        seen = _moment(mark.time_text) if mark.time_text else "not known"
        words = f"<b>{_text(mark.title)}</b><br>{_text(mark.category)}<br>{_text(mark.note)}"
        by = f"seen {_text(seen)}<br>marked by {_text(mark.who or 'no name given')}"
        rows.append(f"<tr><td>{_crop(context, mark)}</td><td>{words}</td><td>{where}</td><td>{by}</td></tr>")
    head = "<tr><th>Picture</th><th>What</th><th>Where (WGS84)</th><th>When and who</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _where(mark: Mark) -> str:
    where = f"<span class=muted>{_text(mark.accuracy_text)}</span>"
    if not mark.is_placed:
        return where
    texts = "<br>".join(_text(text) for text in _coordinates(mark))
    return f"<span class=big>{texts}</span><br>{where}"


def _coordinates(mark: Mark) -> Iterable[str]:
    lat, lon = mark.position
    for form in ("mgrs", "degrees"):
        try:
            yield rounded_text(form, lat, lon, mark.ce90_m)
        except InputError:  # a pole has no such square
            continue


def _crop(context: ServerContext, mark: Mark) -> str:
    clicks = [] if mark.pin is None else mark.pin.clicks
    content = next((crop for click in reversed(clicks) if (crop := context.store.crop(click.id))), None)
    if content is None:
        return ""
    return f'<img alt="around the click" src="data:image/webp;base64,{base64.b64encode(content).decode()}">'


def _seen_lines(seen: dict[str, Any]) -> Iterable[str]:
    yield f"{seen['area_m2'] / 1e4:.2f} ha for certain, in {seen['pictures']} pictures"
    if seen["ahead"]:
        yield f"{seen['ahead']} pictures were still to be counted when this was made"
    if seen["left_out"]:
        yield f"{seen['left_out']} pictures reach too far to be counted"
    if seen["is_full"]:
        yield "too large a ground: the part seen longest ago is not counted"
    if seen["trouble"]:
        yield seen["trouble"]


def _found_lines(found: dict[str, Any]) -> str:
    parts = []
    for who, lines in found["lines"].items():
        if lines:
            parts.append(f"<p>By {_text(who)}, {_text(found['assumed'][who])}:</p>{_listed(lines)}")
    if not found["is_current"]:
        parts.append("<p class=muted>More was seen than this was computed from.</p>")
    return "".join(parts) or "<p>Not known: nothing that was seen is counted yet.</p>"


def _times(context: ServerContext) -> Iterable[str]:
    for vehicle in context.source.vehicles():
        rows = context.source.frames(vehicle)
        if rows:
            first, last = (_moment(time_utc(row.capture_unix_ns)) for row in (rows[0], rows[-1]))
            yield f"{vehicle}: {len(rows)} pictures, {first} to {last}"


def _listed(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{_text(line)}</li>' for line in lines)}</ul>"


def _moment(iso: str) -> str:
    return f"{iso[:19].replace('T', ' ')} UTC"


def _text(text: str) -> str:
    return html.escape(text)
