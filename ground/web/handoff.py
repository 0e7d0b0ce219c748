"""Passing a pin on: its coordinate in every format, a form to read over the radio, a code for a phone, files of all."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from typing import Annotated, Any

import segno
from fastapi import APIRouter, HTTPException, Query, Response

from contract.errors import InputError
from ground.formats.coordinates import Projection, latlon_text, mgrs_text, utm_text
from ground.formats.documents import FORMATS
from ground.formats.mark import Mark
from ground.pins.fusion import Vector
from ground.pins.model import Category, Pin
from ground.web.desk import Desk, NotThere

_TITLES = {
    Category.PERSON: "Person",
    Category.VEHICLE: "Vehicle",
    Category.FIRE: "Fire",
    Category.HAZARD: "Hazard",
    Category.POI: "Point of interest",
}


def handoff_router(desk: Desk) -> APIRouter:
    """Routes below /api."""
    router = APIRouter(tags=["hand-off and export"])

    @router.get("/pins/{pin_id}/handoff", summary="A pin's coordinate in every format, as texts to copy")
    def handoff(
        pin_id: str,
        first: Annotated[str, Query(alias="from", max_length=64)] = "",
        crs: Annotated[str, Query(max_length=40)] = "",
    ) -> dict[str, Any]:
        pin = desk.pin(pin_id)
        mark = Mark.of_pin(pin, desk.places.place(pin))
        if not mark.is_placed:
            raise HTTPException(409, f"pin {pin.number} has no position to hand on: {mark.reason}")
        texts = _texts(mark, crs)
        if first:
            texts.append(_bearing(desk, desk.pin(first), pin))
        return {"texts": texts, "readback": readback(mark), "geo": geo_uri(mark)}

    @router.get("/pins/{pin_id}/qr.svg", summary="The position as a geo: code", response_class=Response)
    def qr(pin_id: str) -> Response:
        pin = desk.pin(pin_id)
        mark = Mark.of_pin(pin, desk.places.place(pin))
        if not mark.is_placed:
            raise HTTPException(409, f"pin {pin.number} has no position to hand on: {mark.reason}")
        out = io.BytesIO()
        segno.make(geo_uri(mark), error="m").save(out, kind="svg", border=2, scale=4, dark="#000", light="#fff")
        return Response(out.getvalue(), media_type="image/svg+xml")

    @router.get("/export/{kind}", summary=f"All pins as a file: {', '.join(FORMATS)}", response_class=Response)
    def export(kind: str) -> Response:
        if kind not in FORMATS:
            raise NotThere(f"no format {kind[:40]!r}; there is {', '.join(FORMATS)}")
        marks = [Mark.of_pin(pin, desk.places.place(pin)) for pin in desk.store.pins()]
        about = FORMATS[kind]
        headers = {"content-disposition": f'attachment; filename="pins{about.suffix}"'}
        return Response(about.write(marks, None), media_type=about.media_type, headers=headers)

    return router


def up(metres: float) -> float:
    """To a tenth, never smaller than it is: what is said of the accuracy is not surer than what is known."""
    return math.ceil(metres * 10.0 - 1e-9) / 10.0


def geo_uri(mark: Mark) -> str:
    """RFC 5870: the height above the ellipsoid where it is known, and the 90 % radius as its uncertainty."""
    lat, lon = mark.position
    height = "" if mark.height_ellipsoid_m is None else f",{mark.height_ellipsoid_m:.1f}"
    return f"geo:{lat:.7f},{lon:.7f}{height}" + ("" if mark.ce90_m is None else f";u={up(mark.ce90_m):.1f}")


def readback(mark: Mark) -> str:
    """What is said over the radio: short groups, digits apart, nothing that the ear could miss."""
    lat, lon = mark.position
    radius = "unknown" if mark.ce90_m is None else f"{-(-mark.ce90_m // 1):.0f} metres, 90 percent"
    lines = [f"{_TITLES[Category(mark.category)]}, number {mark.number}{f', {mark.name}' if mark.name else ''}."]
    for word, value, letters in (("Latitude", lat, ("North", "South")), ("Longitude", lon, ("East", "West"))):
        whole, _, rest = f"{abs(value):.5f}".partition(".")
        groups = f"{' '.join(whole)} decimal {' '.join(rest[:3])}, {' '.join(rest[3:])}"
        lines.append(f"{word}: {letters[value < 0.0]} {groups}.")
    lines.append(f"Within {radius}." if mark.ce90_m is not None else "Accuracy unknown.")
    if mark.height_amsl_m is not None:
        lines.append(f"Height {mark.height_amsl_m:.0f} metres above sea level.")
    if mark.time_text:
        lines.append(f"Seen at {mark.time_text[11:16].replace(':', ' ')} U T C. Read back.")
    return "\n".join(lines)


def _texts(mark: Mark, crs: str) -> list[dict[str, str]]:
    lat, lon = mark.position
    made: list[tuple[str, str, Callable[[], str]]] = [
        ("degrees", "Degrees", lambda: latlon_text(lat, lon, "degrees")),
        ("minutes", "Degrees, minutes", lambda: latlon_text(lat, lon, "minutes")),
        ("seconds", "Deg, min, sec", lambda: latlon_text(lat, lon, "seconds")),
        ("mgrs", "MGRS / USNG", lambda: mgrs_text(lat, lon)),
        ("utm", "UTM", lambda: utm_text(lat, lon)),
    ]
    if crs:
        made.append(("crs", crs, lambda: Projection(crs).of(mark).text))
    out = []
    for name, title, text in made:
        try:
            out.append({"name": name, "title": title, "text": text()})
        except InputError as error:  # no such square at a pole, no such package: the others still hold
            out.append({"name": name, "title": title, "text": f"not to be had: {error}"})
    radius = "unknown" if mark.ce90_m is None else f"+-{up(mark.ce90_m):.1f} m (CE90)"
    out.append({"name": "accuracy", "title": "Within", "text": radius})
    out.append({"name": "height", "title": "Height", "text": _height(mark)})
    out.append({"name": "time", "title": "Seen at", "text": mark.time_text or "not known"})
    out.append({"name": "geo", "title": "geo: link", "text": geo_uri(mark)})
    return out


def _height(mark: Mark) -> str:
    sigma = "" if mark.le90_m is None else f" +-{up(mark.le90_m):.1f} m (LE90)"
    if mark.height_amsl_m is not None:
        return f"{mark.height_amsl_m:.1f} m above mean sea level{sigma}"
    if mark.height_ellipsoid_m is not None:
        return f"{mark.height_ellipsoid_m:.1f} m above the WGS84 ellipsoid{sigma}"
    return "not known"


def _bearing(desk: Desk, first: Pin, pin: Pin) -> dict[str, str]:
    found = desk.places.between(first, pin)
    title = f"From pin {first.number}"
    if not isinstance(found, Vector):
        return {"name": "bearing", "title": title, "text": found.reason}
    sure = "" if found.sigma_distance_m is None else f" +-{found.sigma_distance_m:.1f} m (1 sigma)"
    text = f"{found.bearing_deg:05.1f} deg true, {found.distance_m:.1f} m{sure}"
    return {"name": "bearing", "title": title, "text": text}
