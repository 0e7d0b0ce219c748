"""The seen ground: the layer of the map, and the pictures that show a place."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from ground.seen.area import sectors_of
from ground.seen.picture_cells import pixel_of
from ground.web.api_vehicles import Frame, Session
from ground.web.dependency import Context

MAX_ZOOM = 24

Latitude = Annotated[float, Query(ge=-90.0, le=90.0, allow_inf_nan=False)]
Longitude = Annotated[float, Query(ge=-360.0, le=360.0, allow_inf_nan=False)]
TileNumber = Annotated[int, Path(ge=0, lt=2**MAX_ZOOM)]


# Routes below /api. The first question begins the counting.
router = APIRouter(tags=["what was seen"])


@router.get("/seen", summary="How much of the ground was seen, and how much is still to be counted")
def state(context: Context) -> dict[str, Any]:
    context.seen_map.begin()
    return context.seen_map.state()


@router.get("/seen/detection", summary="Who would have been found there, by machine and by operator, sector by sector")
def detection(context: Context) -> dict[str, Any]:
    context.seen_map.begin()
    return context.found_map.state()


@router.post(
    "/seen/sectors", summary="Sectors of a file (the body), GeoJSON or KML by its name, in place of earlier ones"
)
async def sectors(
    context: Context, request: Request, name: Annotated[str, Query(min_length=1, max_length=300)]
) -> dict[str, int]:
    found = await run_in_threadpool(sectors_of, name, await request.body())
    context.found_map.choose(found)
    return {"sectors": len(found)}


@router.delete("/seen/sectors", summary="No sectors: all that was seen")
def no_sectors(context: Context) -> dict[str, int]:
    context.found_map.choose([])
    return {"sectors": 0}


@router.get(
    "/seen/tiles/{z}/{x}/{y}",
    summary="A tile of the map, PNG, by age, by count, or by who would have been found",
    response_class=Response,
)
def tile(
    context: Context,
    z: Annotated[int, Path(ge=0, le=MAX_ZOOM)],
    x: TileNumber,
    y: TileNumber,
    by: Literal["age", "count", "machine", "operator"] = "age",
) -> Response:
    context.seen_map.begin()
    is_found = by in ("machine", "operator")
    image = context.found_map.tile(z, x, y, by) if is_found else context.seen_map.tile(z, x, y, by)
    return Response(image, media_type="image/png", headers={"cache-control": "private, max-age=60"})


@router.get("/seen/at", summary="The pictures that have seen a place")
def at(context: Context, lat: Latitude, lon: Longitude) -> dict[str, Any]:
    context.seen_map.begin()
    return context.seen_map.at(lat, lon)


@router.get("/vehicles/{vehicle}/frames/{frame}/pixel", summary="The pixel of a picture that shows a place")
def pixel(
    context: Context, vehicle: str, frame: Frame, lat: Latitude, lon: Longitude, session: Session = None
) -> dict[str, float]:
    found = context.source.feature_set(vehicle, session, frame) if vehicle in context.source.vehicles() else None
    if found is None:
        raise HTTPException(404, "no set of this picture is there")
    uv = pixel_of(found, lat, lon)
    if uv is None:
        raise HTTPException(404, "the place is not in this picture")
    return {"u_px": round(uv[0], 2), "v_px": round(uv[1], 2)}
