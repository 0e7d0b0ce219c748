"""Passing a pin on: its coordinate in every format, a form to read over the radio, a code for a phone, files of all."""

from __future__ import annotations

import contextlib
import io
import time
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query, Response

from contract.answer import time_utc
from contract.errors import InputError
from ground.formats import data_package
from ground.formats.coordinates import Projection
from ground.formats.documents import FORMATS
from ground.formats.mark import Mark, up
from ground.formats.rounded import decimals, rounded_text, spoken_mgrs
from ground.pins.fusion import Vector
from ground.pins.model import Category, Pin
from ground.web.context import NotThere, ServerContext
from ground.web.dependency import Context

_TITLES = {
    Category.PERSON: "Person",
    Category.VEHICLE: "Vehicle",
    Category.FIRE: "Fire",
    Category.HAZARD: "Hazard",
    Category.POI: "Point of interest",
}
_FORMS = {
    "degrees": "Degrees",
    "minutes": "Degrees, minutes",
    "seconds": "Deg, min, sec",
    "mgrs": "MGRS / USNG",
    "utm": "UTM",
}


# Routes below /api.
router = APIRouter(tags=["hand-off and export"])


@router.get("/pins/{pin_id}/handoff", summary="A pin's coordinate in every format, as texts to copy")
def handoff(
    context: Context,
    pin_id: str,
    first: Annotated[str, Query(alias="from", max_length=64)] = "",
    crs: Annotated[str, Query(max_length=40)] = "",
) -> dict[str, Any]:
    pin, mark = _placed(context, pin_id)
    texts = _texts(mark, crs)
    if first:
        texts.append(_bearing(context, context.pin(first), pin))
    return {"texts": texts, "readback": readback(mark), "geo": geo_uri(mark)}


@router.get("/coordinate/texts", summary="A place in every system, as precise as its 90 % radius")
def coordinate_texts(
    lat: Annotated[float, Query(ge=-90.0, le=90.0, allow_inf_nan=False)],
    lon: Annotated[float, Query(ge=-180.0, le=180.0, allow_inf_nan=False)],
    ce90: Annotated[float | None, Query(gt=0.0, allow_inf_nan=False)] = None,
) -> dict[str, str]:
    texts = {}
    for form in _FORMS:
        with contextlib.suppress(InputError):  # no such square at a pole: the others still hold
            texts[form] = rounded_text(form, lat, lon, ce90)
    return texts


@router.get("/pins/{pin_id}/qr.svg", summary="The position as a geo: code", response_class=Response)
def qr(context: Context, pin_id: str) -> Response:
    _, mark = _placed(context, pin_id)
    import segno  # noqa: PLC0415  no page waits for it

    out = io.BytesIO()
    segno.make(geo_uri(mark), error="m").save(out, kind="svg", border=2, scale=4, dark="#000", light="#fff")
    return Response(out.getvalue(), media_type="image/svg+xml")


@router.get("/pins/{pin_id}/package.zip", summary="A pin and its pictures as a TAK data package")
def package(context: Context, pin_id: str) -> Response:
    pin, mark = _placed(context, pin_id)
    return _package(context, [mark], f"pin-{pin.number}.zip")


@router.get("/export/tak", summary="All pins and their pictures as a TAK data package")
def export_package(context: Context) -> Response:
    return _package(context, [Mark.of_pin(pin, context.places.place(pin)) for pin in context.store.pins()], "pins.zip")


def _package(context: ServerContext, marks: list[Mark], name: str) -> Response:
    content = data_package.write(marks, context.store.crop, time.time_ns())
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=data_package.MEDIA_TYPE, headers=headers)


@router.get("/export/{kind}", summary=f"All pins as a file: {', '.join(FORMATS)}", response_class=Response)
def export(context: Context, kind: str) -> Response:
    if kind not in FORMATS:
        raise NotThere(f"no format {kind[:40]!r}; there is {', '.join(FORMATS)}")
    marks = [Mark.of_pin(pin, context.places.place(pin)) for pin in context.store.pins()]
    about = FORMATS[kind]
    headers = {"content-disposition": f'attachment; filename="pins{about.suffix}"'}
    return Response(about.write(marks, None), media_type=about.media_type, headers=headers)


def _placed(context: ServerContext, pin_id: str) -> tuple[Pin, Mark]:
    """A pin and its mark. Raises HTTPException for one without a position."""
    pin = context.pin(pin_id)
    mark = Mark.of_pin(pin, context.places.place(pin))
    if not mark.is_placed:
        raise HTTPException(409, f"pin {pin.number} has no position to hand on: {mark.reason}")
    return pin, mark


def geo_uri(mark: Mark) -> str:
    """RFC 5870: the height above the ellipsoid where it is known, and the 90 % radius as its uncertainty."""
    lat, lon = mark.position
    height = "" if mark.height_ellipsoid_m is None else f",{mark.height_ellipsoid_m:.1f}"
    return f"geo:{lat:.7f},{lon:.7f}{height}" + ("" if mark.ce90_m is None else f";u={up(mark.ce90_m):.1f}")


def readback(mark: Mark) -> str:
    """The text to read over the radio: short groups, single digits, hard to misunderstand."""
    lat, lon = mark.position
    lines = [f"{_TITLES[Category(mark.category)]}, number {mark.number_text}{f', {mark.name}' if mark.name else ''}."]
    if square := spoken_mgrs(lat, lon, mark.ce90_m):
        lines.append(f"M G R S: {square}.")
    places = min(decimals("degrees", mark.ce90_m), 5)
    for word, value, letters in (("Latitude", lat, ("North", "South")), ("Longitude", lon, ("East", "West"))):
        whole, _, rest = f"{abs(value):.{places}f}".partition(".")
        groups = ", ".join(" ".join(rest[k : k + 3]) for k in range(0, len(rest), 3))
        lines.append(f"{word}: {letters[value < 0.0]} {' '.join(whole)} decimal {groups}.")
    within = None if mark.ce90_m is None else -(-mark.ce90_m // 1)
    lines.append("Accuracy unknown." if within is None else f"90 percent within {within:.0f} metres.")
    if mark.height_amsl_m is not None:
        lines.append(f"Height {mark.height_amsl_m:.0f} metres above sea level.")
    if mark.time_text:
        lines.append(f"Seen at {mark.time_text[11:16].replace(':', ' ')} U T C. Read back.")
    else:
        lines.append("Time of sighting unknown. Read back.")
    return "\n".join(lines)


def _texts(mark: Mark, crs: str) -> list[dict[str, str]]:
    rows = []
    for name, title in (_FORMS | {"crs": crs} if crs else _FORMS).items():
        try:
            text = Projection(crs).of(mark).text if name == "crs" else rounded_text(name, *mark.position, mark.ce90_m)
        except InputError as error:  # no such square at a pole, no such package: the others still hold
            text = f"not to be had: {error}"
        rows.append((name, title, text))
    rows += [
        ("accuracy", "90 % within", "unknown" if mark.ce90_m is None else f"{up(mark.ce90_m):.1f} m"),
        ("height", "Height", _height(mark)),
        ("time", "Seen at", _moment(mark.time_text) or "not known"),
        ("author", "Marked by", _author(mark)),
        ("geo", "geo: link", geo_uri(mark)),
    ]
    return [{"name": name, "title": title, "text": text} for name, title, text in rows]


def _height(mark: Mark) -> str:
    sure = "" if mark.le90_m is None else f", 90 % within {up(mark.le90_m):.1f} m"
    digits = 1 if mark.le90_m is not None and mark.le90_m < 2.0 else 0
    if mark.height_amsl_m is not None:
        return f"{mark.height_amsl_m:.{digits}f} m above sea level{sure}"
    if mark.height_ellipsoid_m is not None:
        return f"{mark.height_ellipsoid_m:.{digits}f} m above the WGS84 ellipsoid{sure}"
    return "not known"


def _moment(text: str) -> str:
    return f"{text[:19].replace('T', ' ')} UTC" if text else ""


def _author(mark: Mark) -> str:
    """The author of a mark and the moment it was made, which is another one than that of the sighting."""
    made = "" if mark.pin is None else _moment(time_utc(mark.pin.created_unix_ns))
    return ", ".join(part for part in (mark.who or "no name given", made) if part)


def _bearing(context: ServerContext, first: Pin, pin: Pin) -> dict[str, str]:
    found = context.places.between(first, pin)
    title = f"From pin {first.number}"
    if not isinstance(found, Vector):
        return {"name": "bearing", "title": title, "text": found.reason}
    sure = "" if found.sigma_distance_m is None else f" +-{found.sigma_distance_m:.1f} m (1 sigma)"
    text = f"{found.bearing_deg:05.1f} deg true, {found.distance_m:.1f} m{sure}"
    return {"name": "bearing", "title": title, "text": text}
