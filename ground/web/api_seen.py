"""The seen ground: the layer of the map, and the pictures that show a place."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from ground.seen.area import MOST_OUTLINED, outlined_sector, sectors_of, woods_of
from ground.seen.export import document, gaps_kml
from ground.seen.flight_rows import MOST_OVERLAP, OVERLAP
from ground.seen.missions import FORMATS
from ground.seen.picture_cells import pixel_of
from ground.seen.searched import BELOW
from ground.web.api_vehicles import Frame, Session
from ground.web.dependency import Context

MAX_ZOOM = 24

Latitude = Annotated[float, Query(ge=-90.0, le=90.0, allow_inf_nan=False)]
Longitude = Annotated[float, Query(ge=-360.0, le=360.0, allow_inf_nan=False)]
TileNumber = Annotated[int, Path(ge=0, lt=2**MAX_ZOOM)]
FileName = Annotated[str, Query(min_length=1, max_length=300)]
By = Annotated[Literal["machine", "operator"] | None, Query()]  # None: the machine, if it has searched
Below = Annotated[float, Query(gt=0.0, lt=1.0)]
Height = Annotated[float | None, Query(gt=0.0, le=10_000.0, allow_inf_nan=False)]
Overlap = Annotated[float, Query(ge=0.0, le=MOST_OVERLAP)]


class OutlineBody(BaseModel):
    """A sector that somebody has outlined: corners are longitude and latitude in degrees, in order round it."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field("", max_length=300)
    corners: list[tuple[float, float]] = Field(max_length=2 * MOST_OUTLINED)


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


@router.post("/seen/sectors", summary="Sectors of a file (the body), GeoJSON, KML or KMZ, in place of earlier ones")
async def sectors(context: Context, request: Request, name: FileName) -> dict[str, int]:
    found = await run_in_threadpool(sectors_of, name, await request.body())
    context.found_map.choose(found)
    return {"sectors": len(found)}


@router.post("/seen/sectors/outline", status_code=201, summary="One more sector, by its corners")
def draw(context: Context, body: OutlineBody) -> dict[str, int]:
    return {"sectors": context.found_map.add(outlined_sector(body.name, [list(corner) for corner in body.corners]))}


@router.get("/seen/sectors", summary="The sectors as GeoJSON, which can be chosen again", response_class=Response)
def kept_sectors(context: Context) -> Response:
    return _file(json.dumps(context.found_map.sectors()), "sectors.geojson")


@router.delete("/seen/sectors", summary="No sectors: all that was seen; with a name, that one no longer")
def no_sectors(context: Context, name: Annotated[str | None, Query(max_length=300)] = None) -> dict[str, int]:
    if name is not None:
        return {"sectors": context.found_map.remove(name)}
    context.found_map.choose([])
    return {"sectors": 0}


@router.post("/seen/woods", summary="Trees of a GeoJSON file (the body), each area with `canopy`, in place of others")
async def woods(context: Context, request: Request, name: FileName) -> dict[str, int]:
    found = await run_in_threadpool(woods_of, name, await request.body())
    context.found_map.choose_woods(found)
    return {"woods": len(found)}


@router.delete("/seen/woods", summary="No trees")
def no_woods(context: Context) -> dict[str, int]:
    context.found_map.choose_woods([])
    return {"woods": 0}


@router.get("/seen/rows", summary="Rows to fly where too few would have been found: words, way, and the files of it")
def rows(
    context: Context, by: By = None, below: Below = BELOW, height_m: Height = None, overlap: Overlap = OVERLAP
) -> dict[str, Any]:
    found = context.found_map.rows(by, below, height_m, overlap)
    way = [[round(float(lon), 8), round(float(lat), 8)] for lat, lon in found.points_deg]
    files = {suffix.removeprefix("."): write(found) for suffix, write in FORMATS.items()}
    return {"words": found.to_text(), "height_m": round(found.height_m, 1), "way": way, "files": files}


@router.get("/seen/gaps/{kind}", summary="Where too few would have been found, as a file", response_class=Response)
def gaps_file(context: Context, kind: Literal["geojson", "kml"], by: By = None, below: Below = BELOW) -> Response:
    over, searched = context.found_map.gaps(by, below)
    text = json.dumps(document(over, searched)) if kind == "geojson" else gaps_kml(over, searched)
    return _file(text, f"gaps.{kind}")


def _file(text: str, name: str) -> Response:
    kind = "application/vnd.google-earth.kml+xml" if name.endswith(".kml") else "application/octet-stream"
    kind = "application/geo+json" if name.endswith(".geojson") else kind
    return Response(text, media_type=kind, headers={"content-disposition": f'attachment; filename="{name}"'})


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
