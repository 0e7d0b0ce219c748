"""Decisions of people on what a program found: confirmed it is a pin, dismissed it is a pin that was deleted.

So decisions are undone, kept and shared with other servers as pins are. A thing is known again by its spots: pictures
and pixels, which are the same for all who receive from an aircraft; never by its place, where somebody else may stand.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

import numpy as np

from ground.pins.model import Pin, PinClick
from ground.spots.found_thing import FoundThing, SeenSpot

FOUND = "hot spot"  # method of a pin that was a machine's find

Key = tuple[str, int, int, float, float]


def click_of(thing: FoundThing, who: str) -> PinClick:
    """The merged place as a pin's position, with the picture that shows the thing best."""
    p, best = thing.place, thing.best
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = p.ellipse.covariance_en_m2
    covariance[2, 2] = p.sigma_height_m**2
    return PinClick(
        p.lat_deg, p.lon_deg, p.height_ellipsoid_m, p.height_amsl_m, covariance, who, time.time_ns(), FOUND,
        vehicle=best.vehicle, session=best.session, frame=best.frame, u_px=best.u_px, v_px=best.v_px,
        capture_unix_ns=thing.last_unix_ns,
    )  # fmt: skip


def decisions(pins: Iterable[Pin]) -> dict[Key, Pin]:
    """The decided pins by the spot that was decided on; deleted pins too: these were dismissed."""
    return {
        (click.vehicle, click.session, click.frame, click.u_px, click.v_px): pin
        for pin in pins
        for click in pin.clicks
        if click.method == FOUND and click.frame is not None and click.u_px is not None and click.v_px is not None
    }


def decision(thing: FoundThing, made: Mapping[Key, Pin]) -> Pin | None:
    """The pin that a decision on a thing made; None before that. A confirmed one counts before a dismissed one."""
    found = [pin for spot in thing.spots if (pin := made.get(_key(spot))) is not None]
    return min(found, key=lambda pin: pin.is_deleted, default=None)


def _key(spot: SeenSpot) -> Key:
    return spot.vehicle, spot.session, spot.frame, spot.u_px, spot.v_px
