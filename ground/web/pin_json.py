"""Pins, ties and measurements as the page and integrators get them."""

from __future__ import annotations

from typing import Any

from contract.answer import Ellipse, time_utc
from ground.pins.fusion import Contradiction, Fused, Place, Vector
from ground.pins.model import Pin, PinClick, Tie
from ground.unmeasured import in_words


def pin_json(pin: Pin, fused: Fused) -> dict[str, Any]:
    return {
        "id": pin.id,
        "number": pin.number,
        "was": list(pin.was),
        "name": pin.name,
        "note": pin.note,
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
        "id": tie.id,
        "name": tie.name,
        "who": tie.who,
        "vehicle": tie.click.vehicle,
        "session": tie.click.session,
        "frame": tie.click.frame,
        "u_px": tie.click.u_px,
        "v_px": tie.click.v_px,
        "lat_deg": tie.lat_deg,
        "lon_deg": tie.lon_deg,
        "height_m": tie.height_m,
        "datum": tie.datum,
        "sigma_m": tie.sigma_m,
        "sigma_height_m": tie.sigma_height_m,
        "created_utc": time_utc(tie.created_unix_ns),
    }


def vector_json(found: Vector) -> dict[str, Any]:
    """A distance and a bearing, each with one sigma."""
    return {
        "status": "ok",
        "distance_m": found.distance_m,
        "bearing_deg": found.bearing_deg,
        "sigma_distance_m": found.sigma_distance_m,
        "sigma_bearing_deg": found.sigma_bearing_deg,
        "height_difference_m": found.height_difference_m,
        "sigma_height_difference_m": found.sigma_height_difference_m,
    }


def _click(click: PinClick) -> dict[str, Any]:
    return {
        "id": click.id,
        "vehicle": click.vehicle,
        "session": click.session,
        "frame": click.frame,
        "u_px": click.u_px,
        "v_px": click.v_px,
        "who": click.who,
        **method_json(click),
        "clicked_utc": time_utc(click.clicked_unix_ns),
        "capture_utc": None if click.capture_unix_ns is None else time_utc(click.capture_unix_ns),
    }


def method_json(click: PinClick) -> dict[str, Any]:
    """A click's method: with the height above the ground, if it was measured by itself, or why it was not."""
    return {
        "method": click.method,
        "above_ground_m": click.above_ground_m,
        "sigma_above_ground_m": click.sigma_above_ground_m,
        "unmeasured": in_words(click.unmeasured),
    }


def _fused(fused: Fused) -> dict[str, Any]:
    if isinstance(fused, Place):
        return {"status": "ok", **place_json(fused)}
    if isinstance(fused, Contradiction):
        answers = [place_json(answer) for answer in fused.answers]
        return {"status": "contradiction", "reason": fused.reason, "answers": answers}
    return {"status": "unplaced", "reason": fused.reason}


def place_json(place: Place) -> dict[str, Any]:
    """The JSON object of a place and its accuracy."""
    return {
        "lat_deg": place.lat_deg,
        "lon_deg": place.lon_deg,
        "height_ellipsoid_m": place.height_ellipsoid_m,
        "height_amsl_m": place.height_amsl_m,
        "ce90_m": place.ce90_m,
        "le90_m": place.le90_m,
        "heights_apart_m": place.heights_apart_m,
        "ellipse": _ellipse(place.ellipse),
        "clicks": place.clicks,
        "tied": place.tied,
    }


def _ellipse(ellipse: Ellipse | None) -> dict[str, float] | None:
    if ellipse is None:
        return None
    return {
        "semi_major_m": ellipse.semi_major_m,
        "semi_minor_m": ellipse.semi_minor_m,
        "azimuth_deg": ellipse.azimuth_deg,
    }
