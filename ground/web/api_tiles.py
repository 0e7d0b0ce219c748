"""Downloading the area that the map shows, for work without internet. The guard lets no viewer do it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field

from contract.errors import InputError
from ground.web.context import ServerContext
from ground.web.dependency import Body, Context
from ground.web.tile_area import TileArea, View, why_no_area

Degrees = Annotated[float, Field(ge=-720.0, le=720.0, allow_inf_nan=False)]


class AreaBody(Body):
    """The map's bounds, and the zoom of its tiles."""

    west: Degrees
    south: Degrees
    east: Degrees
    north: Degrees
    zoom: int = Field(ge=0, le=30)

    def view(self) -> View:
        return View((self.west, self.south, self.east, self.north), self.zoom)


class DownloadBody(AreaBody):
    """The same, and to which zoom."""

    deepest: int = Field(ge=0, le=30)


# Routes below /api.
router = APIRouter(tags=["the base map without internet"])


@router.get("/tiles", summary="How the download of an area goes")
def state(context: Context) -> dict[str, Any]:
    return _area(context).state()


@router.post("/tiles/plan", summary="How many tiles an area has to which zoom, and about how many bytes")
def plan(context: Context, body: AreaBody) -> dict[str, Any]:
    return _area(context).plan(body.view())


@router.post("/tiles/download", summary="Download an area from the configured address into the user's data folder")
def begin(context: Context, body: DownloadBody) -> dict[str, Any]:
    area = _area(context)
    area.begin(body.view(), body.deepest)
    return area.state()


@router.delete("/tiles/download", summary="Download no more; what has been received stays")
def cancel(context: Context) -> dict[str, Any]:
    area = _area(context)
    area.cancel()
    return area.state()


def _area(context: ServerContext) -> TileArea:
    if context.area is None:
        raise InputError(why_no_area(context.tiles))
    return context.area
