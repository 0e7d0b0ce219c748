"""Pins: made of clicks, edited, undone, measured; and ties to known places."""

from __future__ import annotations

import json
import math
import time
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, BackgroundTasks, HTTPException, Query, Response
from pydantic import Field

from contract.answer import Fix
from ground.formats.imported import unix_ns_of
from ground.pins.fusion import Vector
from ground.pins.model import MAX_NAME, MAX_NOTE, MAX_WHO, Category, Pin, PinClick
from ground.pins.ties import TieRefused, tie_of
from ground.web.api_vehicles import ClickBody, answer_json
from ground.web.clicks import Clicked
from ground.web.context import ServerContext
from ground.web.dependency import Body, Context
from ground.web.pin_json import tie_json, vector_json


class NewPin(Body):
    """A pin at a click, or at a coordinate that was entered."""

    click: ClickBody | None = None
    lat_deg: float | None = Field(default=None, ge=-90, le=90)
    lon_deg: float | None = Field(default=None, ge=-180, le=180)
    height_amsl_m: float | None = Field(default=None, ge=-1000, le=100_000)
    sigma_m: float | None = Field(default=None, gt=0, le=100_000)
    seen_utc: datetime | None = None  # when it was seen, if that is known; of a click the picture gives it
    name: str = Field(default="", max_length=MAX_NAME)
    note: str = Field(default="", max_length=MAX_NOTE)
    category: Category = Category.POI
    who: str = Field(default="", max_length=MAX_WHO)


class MoreClick(ClickBody):
    """One more click on a pin's thing. `anyway`: add it even if it contradicts the others."""

    who: str = Field(default="", max_length=MAX_WHO)
    anyway: bool = False


class Edit(Body):
    """Changes to a pin; a field left out stays as it is."""

    name: str | None = Field(default=None, max_length=MAX_NAME)
    note: str | None = Field(default=None, max_length=MAX_NOTE)
    category: Category | None = None
    who: str = Field(default="", max_length=MAX_WHO)


class NewTie(Body):
    """A click on a place whose coordinate is known, WGS84. Sigmas are one sigma."""

    click: ClickBody
    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-180, le=180)
    height_m: float | None = Field(default=None, ge=-1000, le=100_000)
    datum: str = Field(default="amsl", pattern="^(amsl|ellipsoid)$")
    sigma_m: float = Field(gt=0, le=1000)
    sigma_height_m: float | None = Field(default=None, gt=0, le=1000)
    name: str = Field(default="", max_length=MAX_NAME)
    who: str = Field(default="", max_length=MAX_WHO)


class Who(Body):
    """The name of the person who makes a change."""

    who: str = Field(default="", max_length=MAX_WHO)


WhoQuery = Annotated[str, Query(max_length=MAX_WHO)]


# Routes below /api.
router = APIRouter(tags=["pins"])


@router.get("/pins", summary="All pins, or those that a filter leaves")
def pins(
    context: Context,
    category: Category | None = None,
    text: Annotated[str, Query(max_length=200)] = "",
    vehicle: Annotated[str, Query(max_length=200)] = "",
    who: WhoQuery = "",
) -> Response:
    revision = context.store.revision  # before they are read: the pins are at least as new
    found = context.store.pins(category=category, text=text, vehicle=vehicle, who=who)
    texts, ties = context.pins_text(found), json.dumps(context.ties_json())
    return _json(f'{{"revision":{revision},"pins":{texts},"ties":{ties}}}')


@router.post("/pins", status_code=201, summary="A pin at a click (422 with the reason if it is refused)")
def add(context: Context, body: NewPin, background: BackgroundTasks) -> Response:
    answer: dict[str, Any] | None = None
    clicked: Clicked | None = None
    if body.click is not None:
        clicked = _clicked(context, body.click)
        answer = answer_json(clicked.answer.to_json())
        made = context.pin_click(clicked, body.click.u, body.click.v, body.who)
        if made is None:
            return _reply(context, None, answer)
    elif body.lat_deg is None or body.lon_deg is None:
        raise HTTPException(422, "a pin needs a click, or lat_deg and lon_deg")
    else:
        seen_unix_ns = None if body.seen_utc is None else unix_ns_of(body.seen_utc.isoformat())
        made = PinClick.entered(
            body.lat_deg, body.lon_deg, height_amsl_m=body.height_amsl_m, sigma_m=body.sigma_m, who=body.who,
            seen_unix_ns=seen_unix_ns,
        )  # fmt: skip
    pin = context.store.add(
        [made], name=body.name, note=body.note, category=body.category, who=body.who, crop=context.crop_of(made)
    )
    context.changed(pin.id)
    if clicked is not None and context.source.measures:
        background.add_task(context.measure, pin.id, clicked, made)
    return _reply(context, pin, answer)


@router.get("/pins/{pin_id}", summary="One pin")
def one(context: Context, pin_id: str) -> Response:
    return _json(context.pin_text(pin_id))


@router.post(
    "/pins/{pin_id}/clicks",
    status_code=201,
    summary="One more click on the same thing (409 with the distance if it contradicts the others)",
)
def add_click(context: Context, pin_id: str, body: MoreClick, background: BackgroundTasks) -> Response:
    pin = context.pin(pin_id)
    clicked = _clicked(context, body)
    answer = answer_json(clicked.answer.to_json())
    made = context.pin_click(clicked, body.u, body.v, body.who)
    if made is None:
        return _reply(context, None, answer)
    first = made
    if not body.anyway and context.contradicts(pin, made) is not None:
        made = context.measured_click(clicked, made)  # a roof may contradict only by the height of its surroundings
    if not body.anyway and (apart_m := context.contradicts(pin, made)) is not None:
        reason = (
            f"this click is {apart_m:.0f} m from pin {pin.number}, more than the errors of both explain: "
            "it is another thing, or a click that missed it"
        )
        return _json(json.dumps({"pin": None, "answer": answer, "apart_m": apart_m, "reason": reason}), 409)
    pin = context.store.add_click(pin_id, made, who=body.who, crop=context.crop_of(made))
    context.changed(pin.id)
    if made is first and context.source.measures:
        background.add_task(context.measure, pin.id, clicked, made)
    return _reply(context, pin, answer)


@router.delete("/pins/{pin_id}/clicks/{click_id}", summary="Take a click off a pin")
def remove_click(context: Context, pin_id: str, click_id: str, who: WhoQuery = "") -> Response:
    context.pin(pin_id)
    pin = context.store.remove_click(pin_id, click_id, who=who)
    context.changed(pin.id)
    return _json(context.pin_text(pin.id))


@router.patch("/pins/{pin_id}", summary="Change name, note or category")
def edit(context: Context, pin_id: str, body: Edit) -> Response:
    context.pin(pin_id)
    pin = context.store.edit(pin_id, who=body.who, name=body.name, note=body.note, category=body.category)
    context.changed(pin.id)
    return _json(context.pin_text(pin.id))


@router.delete("/pins/{pin_id}", summary="Delete a pin; undo brings it back")
def delete(context: Context, pin_id: str, who: WhoQuery = "") -> dict[str, Any]:
    context.pin(pin_id)
    context.store.delete(pin_id, who=who)
    context.changed(pin_id)
    return {"deleted": pin_id}


@router.get("/pins/{pin_id}/crop", summary="The picture around its newest click", response_class=Response)
def crop(context: Context, pin_id: str) -> Response:
    for click in reversed(context.pin(pin_id).clicks):
        content = context.store.crop(click.id)
        if content is not None:
            return Response(content, media_type="image/webp")
    raise HTTPException(404, "no picture was kept with this pin")


@router.get("/pins/{pin_id}/seen", summary="The pictures that show it, and where in them")
def seen(context: Context, pin_id: str) -> list[dict[str, Any]]:
    return context.seen(context.pin(pin_id))


@router.get("/measure", summary="Distance and bearing from one pin to another, with their own sigmas")
def measure(context: Context, first: Annotated[str, Query(alias="from")], to: str) -> dict[str, Any]:
    found = context.places.between(context.pin(first), context.pin(to))
    return vector_json(found) if isinstance(found, Vector) else {"status": "no_place", "reason": found.reason}


@router.post("/undo", summary="Take back one's own last change")
def undo(context: Context, body: Who) -> dict[str, str | None]:
    change = context.store.undo(who=body.who)
    if change is not None:
        context.changed()
    return {"undone": change}


@router.post("/redo", summary="Make it again")
def redo(context: Context, body: Who) -> dict[str, str | None]:
    change = context.store.redo(who=body.who)
    if change is not None:
        context.changed()
    return {"redone": change}


@router.get("/ties", summary="All ties")
def ties(context: Context) -> list[dict[str, Any]]:
    return context.ties_json()


@router.post("/ties", status_code=201, summary="Tie a click to a surveyed place (409 with the figure if refused)")
def add_tie(context: Context, body: NewTie, response: Response) -> dict[str, Any]:
    click = body.click
    clicked = context.clicker.measured(_clicked(context, click), click.u, click.v)
    if clicked.feature_set is None or not isinstance(clicked.answer, Fix):
        response.status_code = 422
        return {"tie": None, "answer": answer_json(clicked.answer.to_json())}
    tie = tie_of(
        clicked.feature_set,
        clicked.answer,
        (click.u, click.v),
        lat_deg=body.lat_deg,
        lon_deg=body.lon_deg,
        height_m=body.height_m,
        datum=body.datum,
        sigma_m=body.sigma_m,
        sigma_height_m=body.sigma_height_m,
        name=body.name,
        who=body.who,
        created_unix_ns=time.time_ns(),
        locator=clicked.locator,
    )
    try:
        context.store.add_tie(tie, who=body.who)
    except TieRefused as refused:
        response.status_code = 409
        j = refused.judgement
        allowed = j.allowed_m if math.isfinite(j.allowed_m) else None
        return {"tie": None, "reason": str(refused), "misses_m": j.misses_m, "allowed_m": allowed}
    context.changed()
    return {"tie": tie_json(tie)}


@router.delete("/ties/{tie_id}", summary="Delete a tie: pins are where they were without it")
def delete_tie(context: Context, tie_id: str, who: WhoQuery = "") -> dict[str, Any]:
    context.store.delete_tie(tie_id, who=who)
    context.changed()
    return {"deleted": tie_id}


def _clicked(context: ServerContext, body: ClickBody) -> Clicked:
    return context.clicker.click(body.vehicle, body.session, body.frame, body.u, body.v)


def _reply(context: ServerContext, pin: Pin | None, answer: dict[str, Any] | None) -> Response:
    """A pin, or why there is none, with the click's answer."""
    revision = context.store.revision
    text = "null" if pin is None else context.pin_text(pin.id)
    return _json(f'{{"revision":{revision},"pin":{text},"answer":{json.dumps(answer)}}}', 422 if pin is None else 201)


def _json(text: str, status_code: int = 200) -> Response:
    return Response(text, status_code, media_type="application/json")
