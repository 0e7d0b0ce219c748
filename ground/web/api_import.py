"""Places from elsewhere: a coordinate that was typed, and files of places."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool

from contract.errors import InputError
from ground.formats.coordinate_text import read_coordinate
from ground.formats.documents import read_pins_of
from ground.formats.rounded import rounded_text
from ground.pins.already_here import without_known
from ground.pins.model import MAX_WHO
from ground.web.context import ServerContext
from ground.web.dependency import Context

MOST_LISTED = 20  # of what a file has and cannot be read


# Routes below /api.
router = APIRouter(tags=["places from elsewhere"])


@router.get("/coordinate", summary="A typed coordinate in degrees (422 with the reason if it has none, or two)")
def coordinate(text: Annotated[str, Query(max_length=1000)]) -> dict[str, Any]:
    found = read_coordinate(text)
    return {
        "lat_deg": found.lat_deg,
        "lon_deg": found.lon_deg,
        "form": found.form,
        "texts": {name: _text(name, found.lat_deg, found.lon_deg) for name in ("degrees", "mgrs")},
    }


@router.post("/import", summary="Pins of a file (the body): GeoJSON, KML, KMZ, GPX, CSV or CoT, by its name")
async def bring_in(
    context: Context,
    request: Request,
    name: Annotated[str, Query(min_length=1, max_length=300)],
    who: Annotated[str, Query(max_length=MAX_WHO)] = "",
) -> dict[str, Any]:
    data = await request.body()
    return await run_in_threadpool(_import, context, name, data, who)


def _import(context: ServerContext, name: str, data: bytes, who: str) -> dict[str, Any]:
    found = read_pins_of(name, data, who=who)
    new = without_known(found.pins, context.store.pins(), context.places)
    count = context.store.bring_in(new, who=who, crops=found.crops)
    if count:
        context.changed()
    return {
        "imported": count,
        "known": len(found.pins) - count,
        "left_out": found.left_out,
        "bad": found.bad[:MOST_LISTED],
    }


def _text(form: str, lat_deg: float, lon_deg: float) -> str:
    """The coordinate in another form, for the eye to check; empty where it has none, as UTM at a pole."""
    try:
        return rounded_text(form, lat_deg, lon_deg, None)
    except InputError:
        return ""
