"""Things that are followed: their paths, and asking an aircraft to begin or end one."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Path, Query

from contract.answer import EXPLANATIONS
from contract.errors import LinkError
from contract.track import MOST_PX, StartTrack, StopTrack, TrackReport
from ground.web.api_vehicles import ClickBody
from ground.web.dependency import Context

MOST_OF_A_PATH = 600  # reports that a page gets of one track


# Routes below /api.
router = APIRouter(tags=["things that are followed"])


@router.get("/tracks", summary="What is or was followed: of each thing its reports, in capture order")
def tracks(context: Context, most: Annotated[int, Query(ge=2, le=7200)] = MOST_OF_A_PATH) -> dict[str, Any]:
    paths = context.source.views.tracks.paths(most)
    return {"version": context.source.views.tracks.version, "tracks": [[track_json(r) for r in path] for path in paths]}


@router.post("/tracks", status_code=201, summary="Follow what is at a pixel of a picture, seconds old or new")
def begin(context: Context, body: ClickBody) -> dict[str, Any]:
    if not (-0.5 <= body.u <= MOST_PX and -0.5 <= body.v <= MOST_PX):
        raise HTTPException(422, "not a pixel of a picture")
    rows = context.source.frames(body.vehicle, 1)
    if body.session is not None and rows and rows[-1].session != body.session:
        raise LinkError("the aircraft's software was restarted after this picture: click a newer one")
    reply = context.source.follow(body.vehicle, StartTrack(body.u, body.v, body.frame))
    return {"vehicle": body.vehicle, "track": reply.get("track"), "frame": reply.get("frame")}


@router.delete("/tracks/{vehicle}/{number}", summary="Follow it no longer")
def end(context: Context, vehicle: str, number: Annotated[int, Path(ge=1, le=255)]) -> dict[str, Any]:
    return {"tracks": context.source.follow(vehicle, StopTrack(number)).get("tracks", [])}


def track_json(report: TrackReport) -> dict[str, Any]:
    """A report as the page draws it."""
    p, c = report.place, report.course
    return {
        "vehicle": report.vehicle,
        "session": report.session,
        "track": report.number,
        "frame": report.frame,
        "capture_unix_ns": str(report.capture_unix_ns),
        "u": round(report.u_px, 2),
        "v": round(report.v_px, 2),
        "size_px": round(report.size_px, 1),
        "state": report.state.value,
        "unseen": report.unseen.value,
        "unseen_s": round(report.unseen_s, 2),
        "words": report.course_text if p is not None else EXPLANATIONS[report.status],
        "place": None
        if p is None
        else {
            "lat_deg": round(p.lat_deg, 9),
            "lon_deg": round(p.lon_deg, 9),
            "height_ellipsoid_m": p.height_ellipsoid_m,
            "height_amsl_m": p.height_amsl_m,
            "semi_major_m": round(p.ellipse.semi_major_m, 3),
            "semi_minor_m": round(p.ellipse.semi_minor_m, 3),
            "azimuth_deg": round(p.ellipse.azimuth_deg, 2),
        },
        "course": None
        if c is None
        else {
            "speed_m_s": round(c.speed_m_s, 3),
            "sigma_speed_m_s": round(c.sigma_speed_m_s, 3),
            "course_deg": None if c.course_deg is None else round(c.course_deg, 2),
            "sigma_course_deg": None if c.sigma_course_deg is None else round(c.sigma_course_deg, 2),
        },
    }
