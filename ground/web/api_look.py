"""Having an aircraft's camera look at what was clicked, or the aircraft circle there: asked about, confirmed, ended.

Only with the token for that.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter
from pydantic import Field

from contract.answer import Fix
from contract.circular_error import ce90_m
from contract.errors import LinkError
from contract.look import AskCircle, AskLook, ConfirmLook, EndLook, Offer
from ground.web.api_vehicles import ClickBody
from ground.web.dependency import Body, Context


class VehicleBody(Body):
    """One aircraft."""

    vehicle: str = Field(max_length=200)


class TicketBody(VehicleBody):
    """The ticket of an aircraft's offer."""

    ticket: str = Field(pattern="^[0-9A-Za-z]{1,32}$")


class ConfirmBody(TicketBody):
    """An offer's ticket, and for how long the person had it before he confirmed it."""

    waited_s: float = Field(ge=0.0, allow_inf_nan=False)


# Routes below /api. The guard lets only pointers post to them.
router = APIRouter(tags=["having a camera look somewhere"])


@router.post("/look", summary="The place that a camera would be sent to look at; nothing moves before it is confirmed")
def ask(context: Context, body: ClickBody) -> dict[str, Any]:
    clicked = context.clicker.click(body.vehicle, body.session, body.frame, body.u, body.v)
    answer, found = clicked.answer, clicked.feature_set
    if not isinstance(answer, Fix) or found is None:
        raise LinkError(answer.to_text())
    radius_m = ce90_m(answer.covariance_enu_m2[:2, :2])
    asked = AskLook(found.session, found.frame, body.u, body.v, answer.lat_deg, answer.lon_deg, radius_m)
    return _offer(context, body.vehicle, asked)


@router.post("/look/circle", summary="The circle that the aircraft would fly about what its camera looks at")
def circle(context: Context, body: TicketBody) -> dict[str, Any]:
    return _offer(context, body.vehicle, AskCircle(body.ticket))


def _offer(context: Context, vehicle: str, asked: AskLook | AskCircle) -> dict[str, Any]:
    return {"vehicle": vehicle, **asdict(Offer.of(context.source.look(vehicle, asked)))}


@router.post("/look/confirm", summary="Have what was offered done; the answer is the autopilot's acknowledgement")
def confirm(context: Context, body: ConfirmBody) -> dict[str, Any]:
    return context.source.look(body.vehicle, ConfirmLook(body.ticket, body.waited_s))


@router.post("/look/ahead", summary="Have it look there no longer")
def ahead(context: Context, body: VehicleBody) -> dict[str, Any]:
    return context.source.look(body.vehicle, EndLook())
