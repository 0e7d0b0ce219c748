"""Hot spots as things that a machine found: confirmed they become pins, dismissed deleted ones. Both can be undone."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Path, Query, Response
from pydantic import Field

from contract.circular_error import ce90_m
from ground.formats import fire_area
from ground.pins.machine import click_of, decision, decisions
from ground.pins.model import MAX_NAME, MAX_WHO, Category, Pin
from ground.spots.found_thing import FoundThing
from ground.web.context import NotThere, ServerContext
from ground.web.dependency import Body, Context

Number = Annotated[int, Path(ge=1, le=10**9)]


class Confirmed(Body):
    """The pin that a person makes of a found thing."""

    name: str = Field(default="", max_length=MAX_NAME)
    category: Category = Category.POI
    who: str = Field(default="", max_length=MAX_WHO)


class Dismissed(Body):
    """The name of the person who states that a found thing is nothing."""

    who: str = Field(default="", max_length=MAX_WHO)


# Routes below /api.
router = APIRouter(tags=["hot spots"])


def _thing(context: ServerContext, number: int) -> FoundThing:
    found = context.source.views.spots.thing(number)
    if found is None:
        raise NotThere(f"no hot spot {number}")
    return found


def _undecided(context: ServerContext, number: int) -> FoundThing:
    found = _thing(context, number)
    made = decision(found, decisions(context.store.everything()))
    if made is not None:
        word = "dismissed" if made.is_deleted else f"pin {made.number}"
        raise HTTPException(409, f"hot spot {number} is {word} already")
    return found


@router.get("/spots", summary="All hot spots as things, with what was decided of them")
def spots(context: Context) -> dict[str, Any]:
    version, things = context.source.views.spots.version, context.source.views.spots.things()
    return {"version": version, "spots": spots_json(context, things)}


@router.post("/spots/{number}/confirm", status_code=201, summary="It is something: a pin, with its source stated")
def confirm(context: Context, number: Number, body: Confirmed) -> Response:
    found = _undecided(context, number)
    click = click_of(found, body.who)
    note = f"found by the machine as hot spot {number}, confirmed by {body.who or 'a person'}: {found.heat_text}"
    pin = context.store.add(
        [click], name=body.name, note=note, category=body.category, who=body.who, crop=context.crop_of(click)
    )
    context.changed(pin.id)
    return Response(context.pin_text(pin.id), status_code=201, media_type="application/json")


@router.post("/spots/{number}/dismiss", summary="It is nothing: it is not shown again")
def dismiss(context: Context, number: Number, body: Dismissed) -> dict[str, Any]:
    found = _undecided(context, number)
    pin = context.store.add([click_of(found, body.who)], name=f"hot spot {number}", who=body.who)
    context.store.delete(pin.id, who=body.who)
    context.changed(pin.id)
    return {"pin": pin.id}


@router.get("/fire", summary="What burned in the last minutes: GeoJSON, as seen, surely and perhaps; and in words")
def fire(context: Context, minutes: Annotated[float, Query(gt=0.0, le=1440.0)] = 5.0) -> dict[str, Any]:
    found = context.source.views.spots.fire(minutes)
    if found is None:
        return {"type": "FeatureCollection", "features": [], "words": "No picture shows a fire with its outline."}
    return {**fire_area.features(found), "words": found.to_text()}


@router.get("/spots/{number}/crop", summary="The picture about it, where it is seen best", response_class=Response)
def crop(context: Context, number: Number) -> Response:
    found = context.crop_of(click_of(_thing(context, number), ""))
    if found is None:
        raise NotThere("no picture of it is there")
    return Response(found, media_type="image/jpeg")


def spots_json(context: ServerContext, things: list[FoundThing]) -> list[dict[str, Any]]:
    """The things as the page shows them, with the decisions on them."""
    made = decisions(context.store.everything()) if things else {}
    return [_spot_json(thing, decision(thing, made)) for thing in things]


def _spot_json(thing: FoundThing, made: Pin | None) -> dict[str, Any]:
    state = "open" if made is None else "dismissed" if made.is_deleted else "confirmed"
    return {
        **thing.to_dict(),
        "state": state,
        "pin": None if made is None else made.id,
        "is_sure": thing.is_sure,
        "ce90_m": round(ce90_m(thing.place.ellipse.covariance_en_m2), 3),
        "heat": thing.heat_text,
        "motion": thing.course_text,
    }
