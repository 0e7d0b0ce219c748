"""Pins, ties and measurements as the page and integrators get them."""

from __future__ import annotations

from typing import Any

from contract.answer import time_utc
from ground.pins.fusion import Contradiction, Fused, Place, Vector
from ground.pins.model import Pin, PinClick, Tie
from ground.unmeasured import in_words


def pin_json(pin: Pin, fused: Fused) -> dict[str, Any]:
    return {
        **_same(pin, "id", "number"),
        "was": list(pin.was),
        **_same(pin, "name", "note"),
        "category": pin.category.value,
        "who": pin.who,
        "created_utc": time_utc(pin.created_unix_ns),
        "seen_utc": None if pin.seen_unix_ns is None else time_utc(pin.seen_unix_ns),
        "modified_utc": time_utc(pin.modified_unix_ns),
        "modified_by": pin.modified_by,
        "clicks": [_click(click) for click in pin.clicks],
        "place": _fused(fused),
    }


def tie_json(tie: Tie) -> dict[str, Any]:
    return {
        **_same(tie, "id", "name", "who"),
        **_same(tie.click, "vehicle", "session", "frame", "u_px", "v_px"),
        **_same(tie, "lat_deg", "lon_deg", "height_m", "datum", "sigma_m", "sigma_height_m"),
        "created_utc": time_utc(tie.created_unix_ns),
    }


def vector_json(found: Vector) -> dict[str, Any]:
    return {"status": "ok", **vars(found)}


def _same(value: object, *names: str) -> dict[str, Any]:
    """Attributes whose names are those of the JSON object, too."""
    return {name: getattr(value, name) for name in names}


def _click(click: PinClick) -> dict[str, Any]:
    return {
        **_same(click, "id", "vehicle", "session", "frame", "u_px", "v_px", "who"),
        **method_json(click),
        "clicked_utc": time_utc(click.clicked_unix_ns),
        "capture_utc": None if click.capture_unix_ns is None else time_utc(click.capture_unix_ns),
    }


def method_json(click: PinClick) -> dict[str, Any]:
    """A click's method: with the height above the ground, if it was measured by itself, or why it was not."""
    stated = _same(click, "method", "above_ground_m", "sigma_above_ground_m")
    return {**stated, "unmeasured": in_words(click.unmeasured)}


def _fused(fused: Fused) -> dict[str, Any]:
    if isinstance(fused, Place):
        return {"status": "ok", **place_json(fused)}
    if isinstance(fused, Contradiction):
        answers = [place_json(answer) for answer in fused.answers]
        return {"status": "contradiction", "reason": fused.reason, "answers": answers}
    return {"status": "unplaced", "reason": fused.reason}


def place_json(place: Place) -> dict[str, Any]:
    """A position with its accuracy, and how many clicks and ties it rests on."""
    ellipse = place.ellipse
    return {
        **_same(place, "lat_deg", "lon_deg", "height_ellipsoid_m", "height_amsl_m", "ce90_m", "le90_m"),
        "heights_apart_m": place.heights_apart_m,
        "ellipse": None if ellipse is None else vars(ellipse),
        **_same(place, "clicks", "tied"),
    }
