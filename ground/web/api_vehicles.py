"""Vehicles, their pictures and what the page draws on them, and clicks."""

from __future__ import annotations

import json
import math
import time
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Path, Query, Request, Response
from pydantic import Field

from contract.answer import EXPLANATIONS, Fix
from contract.circular_error import ce90_m
from contract.error_sources import in_a_line
from contract.feature_set import FeatureSet, HeightDatum
from ground.freshness import is_of_now
from ground.pins.fusion import Place
from ground.web.advice import ADVICE
from ground.web.clicks import Clicked
from ground.web.context import ServerContext
from ground.web.dependency import Body, Context
from ground.web.pin_json import method_json, place_json
from ground.web.source import FrameRow, VehicleReport
from ground.web.view import camera_place, frame_view

EARLIER = 6  # pictures that a feature's path reaches back
NEAR = 64
STALE_S = 3.0
LOST_S = 10.0
MAX_FRAME = 2**32 - 1

Frame = Annotated[int, Path(ge=0, le=MAX_FRAME)]
Session = Annotated[
    int | None, Query(ge=0, le=2**63 - 1, description="the aircraft's session; default: that which runs")
]


class ClickBody(Body):
    """One pixel of one picture. Pixel (0, 0) is the centre of the camera's top left pixel."""

    vehicle: str = Field(max_length=200)
    frame: int = Field(ge=0, le=MAX_FRAME)
    u: float = Field(ge=-1e6, le=1e6, allow_inf_nan=False)
    v: float = Field(ge=-1e6, le=1e6, allow_inf_nan=False)
    session: int | None = Field(default=None, ge=0, le=2**63 - 1)


class AnsweredBody(ClickBody):
    """`measured`: wait until the aircraft has measured the pixel by itself, or states why it has not."""

    measured: bool = False


# Routes below /api.
router = APIRouter(tags=["pictures and clicks"])


@router.get("/vehicles", summary="All vehicles and how they are")
def vehicles(context: Context) -> list[dict[str, Any]]:
    return [vehicle_json(context, name) for name in context.source.vehicles()]


@router.get("/vehicles/{vehicle}/frames", summary="The pictures that can be asked for, in capture order")
def frames(context: Context, vehicle: str) -> list[dict[str, Any]]:
    _known(context, vehicle)
    return [row_json(row) for row in context.source.frames(vehicle)]


@router.get("/vehicles/{vehicle}/frames/{frame}/picture", summary="A picture", response_class=Response)
def picture(context: Context, vehicle: str, frame: Frame, session: Session = None) -> Response:
    _known(context, vehicle)
    found = context.source.picture(vehicle, session, frame)
    if found is None:
        raise HTTPException(404, "this picture is not there")
    # A picture of a session never changes; a frame of a video may be another once its delay is known better.
    kept = "private, max-age=3600" if found.is_unchanging else "no-store"
    return Response(found.content, media_type=found.media_type, headers={"cache-control": kept})


@router.get("/vehicles/{vehicle}/frames/{frame}/features", summary="What is shown on a picture, and its camera")
def features(context: Context, vehicle: str, frame: Frame, session: Session = None) -> dict[str, Any]:
    _known(context, vehicle)
    found = context.source.feature_set(vehicle, session, frame)
    if found is None:
        raise HTTPException(404, "no set of this picture is there")
    seen = context.source.views.spots.seen_in(vehicle, found.session, frame)
    view = frame_view(found, _before(context, found), context.source.age_s(found), context.clicker.locator(found))
    return {**view, "spots": {str(number): [round(u, 2), round(v, 2)] for number, (u, v) in seen.items()}}


@router.get("/vehicles/{vehicle}/path", summary="Where the camera was, picture by picture")
def path(context: Context, vehicle: str, most: Annotated[int, Query(ge=2, le=5000)] = 1000) -> list[list[float]]:
    _known(context, vehicle)
    rows = [row for row in context.source.frames(vehicle) if row.status.value == "ok"]
    step = max(1, -(-len(rows) // most))
    kept = rows[::-1][::step][::-1]
    places = (context.source.feature_set(vehicle, row.session, row.frame) for row in kept)
    return [place for s in places if s is not None and (place := camera_place(s)) is not None]


@router.post("/click", summary="A pixel's position on the ground, as pc-ground click --format json writes it")
def click(context: Context, body: AnsweredBody) -> Response:
    return Response(_answered(context, body).answer.to_json(), media_type="application/json")


@router.post("/place", summary="Where a pin at a pixel would be, ties applied, and how sure; nothing is kept")
def place(context: Context, body: AnsweredBody) -> dict[str, Any]:
    clicked = _answered(context, body)
    made = context.pin_click(clicked, body.u, body.v, "")
    found = None if made is None else context.places.of_clicks([made])
    if isinstance(found, Place) and made is not None:
        return {"status": "ok", **method_json(made), **place_json(found)}
    return answer_json(clicked.answer.to_json())


@router.get("/status", summary="How the server and all vehicles are")
def status(context: Context, request: Request) -> dict[str, Any]:
    tiles = context.tiles if context.area is None else context.area
    return {
        "role": request.state.role,
        "source": context.source.name,
        "is_live": context.source.is_live,
        "measures": context.source.measures,
        "damage": context.source.damage()[:20],
        "no_pictures": context.source.no_pictures(),
        "sharing": context.sharing_words(),
        "tak": "" if context.tak is None else context.tak.name,
        "up_s": round(time.time() - context.started_unix_s, 1),
        "browsers": len(context.hub),
        "tiles": None if tiles is None else tiles.to_dict(),
        "vehicles": [vehicle_json(context, name) for name in context.source.vehicles()],
    }


def _answered(context: ServerContext, body: AnsweredBody) -> Clicked:
    clicked = context.clicker.click(body.vehicle, body.session, body.frame, body.u, body.v)
    return context.clicker.measured(clicked, body.u, body.v) if body.measured else clicked


def _known(context: ServerContext, vehicle: str) -> None:
    if vehicle not in context.source.vehicles():
        raise HTTPException(404, f"no vehicle {vehicle[:80]!r}")


def _before(context: ServerContext, found: FeatureSet) -> list[FeatureSet]:
    rows: list[FrameRow] = []
    for newest in (NEAR, None):  # mostly it is one of the newest, and an hour has many pictures
        rows = [r for r in context.source.frames(found.vehicle, newest) if r.capture_unix_ns < found.capture_unix_ns]
        if len(rows) >= EARLIER:
            break
    sets = (context.source.feature_set(found.vehicle, r.session, r.frame) for r in rows[: -EARLIER - 1 : -1])
    return [s for s in sets if s is not None]


def row_json(row: FrameRow) -> dict[str, Any]:
    return {**vars(row), "status": row.status.value, "capture_unix_ns": str(row.capture_unix_ns)}


def vehicle_json(context: ServerContext, vehicle: str) -> dict[str, Any]:
    """A row of the status strip."""
    report = context.source.report(vehicle)
    status = report.status
    found = None
    if report.newest_frame is not None:
        found = context.source.feature_set(vehicle, report.session, report.newest_frame)
    centre_m = above_m = None
    if found is not None and found.is_ok:
        c = found.camera
        answer = context.clicker.locator(found).locate((0.5 * (c.width_px - 1), 0.5 * (c.height_px - 1)))
        if isinstance(answer, Fix):
            centre_m = round(ce90_m(answer.covariance_enu_m2[:2, :2]), 1)
            above_m = -float(answer.offset_enu_m[2])
    current = status if status is not None and is_of_now(status, found, report.received_age_s) else None
    return {
        "id": vehicle,
        "session": report.session,
        "is_live": context.source.is_live,
        "frame": report.newest_frame,
        "state": _state(report, found),
        "words": "; ".join(text for text in (_words(report, found), "" if status is None else status.amiss) if text),
        "is_lost": report.received_age_s is not None and report.received_age_s > LOST_S,
        "picture_age_s": _rounded(report.picture_age_s),
        "clock_unix_ns": _clock(report, found),
        "place": None if found is None else camera_place(found),
        "heard_age_s": _rounded(report.received_age_s),
        "sets_hz": _rounded(report.sets_hz),
        "kbit_s": None if report.bit_rate is None else round(report.bit_rate / 1000.0, 1),
        "features": 0 if found is None else len(found),
        "tracks": None if status is None else status.tracks,
        "ce90_centre_m": centre_m,
        "height_above_ground_m": _rounded(above_m),
        "height_amsl_m": None if found is None else _rounded(_height_amsl_m(found)),
        "gps": "" if current is None else current.gps_words,
        "battery": "" if current is None else current.battery_words,
        "mode": "" if current is None else current.mode,
        "cpu_c": None if status is None else status.cpu_c,
        "recording": None if status is None else status.recording,
        "trouble": report.trouble,
        "unfollowed": context.source.unfollowed(vehicle),
        "unlooked": context.source.unlooked(vehicle),
        "look": "" if status is None else status.look,
        "person_found": None
        if status is not None and status.heat  # what was searched last is no more
        else context.source.views.spots.person_found(vehicle),
        "radius": "" if status is None else in_a_line(status.fractions),
    }


def _state(report: VehicleReport, found: FeatureSet | None) -> str:
    """well, warning or lost: the page's colour and sign."""
    if report.received_age_s is not None and report.received_age_s > LOST_S:
        return "lost"
    is_old = report.received_age_s is not None and (report.picture_age_s or 0.0) > STALE_S
    is_well = report.status is None or report.status.state in ("ok", "at rest")
    return "well" if is_well and not is_old and found is not None and found.is_ok else "warning"


def _height_amsl_m(s: FeatureSet) -> float | None:
    """The camera's height above sea level; None where the set does not have it."""
    if not s.is_ok:
        return None
    if s.height_datum is HeightDatum.AMSL:
        return s.camera_height_m
    return None if math.isnan(s.undulation_m) else s.camera_height_m - s.undulation_m


def _clock(report: VehicleReport, found: FeatureSet | None) -> str | None:
    """The time now, ns, of the aircraft's clock, by which captures are stamped: a picture's age is the difference."""
    if found is None or report.picture_age_s is None:
        return None
    return str(found.capture_unix_ns + round(report.picture_age_s * 1e9))


def _words(report: VehicleReport, found: FeatureSet | None) -> str:
    """The state of the vehicle, for people."""
    if report.received_age_s is not None and report.received_age_s > LOST_S:
        return f"nothing received for {report.received_age_s:.0f} s"
    status = report.status
    if status is not None and status.state != "ok":
        return f"{status.state}: {status.reason}" if status.reason else status.state
    if found is None:
        return "no picture yet"
    if not found.is_ok:
        advice = ADVICE[found.status]
        return EXPLANATIONS[found.status] + (f"; {advice}" if advice else "")
    if report.received_age_s is None:
        return "recorded"
    return "ok" if (report.picture_age_s or 0.0) <= STALE_S else "the newest picture is old"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def answer_json(text: str) -> dict[str, Any]:
    """A click's JSON line as an object, with advice added."""
    answer: dict[str, Any] = json.loads(text)
    answer["advice"] = next((ADVICE[s] for s in ADVICE if s.value == answer["status"]), "")
    return answer
