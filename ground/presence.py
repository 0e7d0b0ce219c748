"""Presence of aircraft: their liveliness tokens, which a router knows without asking any aircraft."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import zenoh

from contract.errors import WireError
from contract.topics import ALIVE, ANY_VEHICLE, STATUS
from contract.vehicle_status import VehicleStatus
from contract.wire.message import read_status

TOKENS_TIMEOUT_S = 2.0  # of a link that does not answer; one that does takes its round trip
ALONE_S = 3.0  # without another program at the other end, before it is reported; zenoh looks every second
SILENT_S = 3.0  # of an aircraft without a token, which sends a status a second
MOST = 2000  # vehicles: a peer may invent names


@dataclass(frozen=True)
class Present:
    """An aircraft that is there, or was when its last status came."""

    vehicle: str
    is_there: bool  # its session is open, as far as the other end of this link knows
    status: VehicleStatus | None  # the last one received; None before the first
    status_age_s: float | None


def vehicles_there(session: Any) -> list[str]:
    """The vehicles whose tokens are there now, sorted."""
    found: set[str] = set()
    for reply in session.liveliness().get(ALIVE.key(ANY_VEHICLE), timeout=TOKENS_TIMEOUT_S):
        if reply.ok is not None and (name := _name(str(reply.ok.key_expr))) is not None and len(found) < MOST:
            found.add(name)
    return sorted(found)


def is_through_router(session: Any) -> bool:
    """Return whether a session is connected to a router, and so perhaps to many aircraft."""
    return bool(session.info.routers_zid())


class Alone:
    """The time since when an open session is connected to no one. `note` is called again and again."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def note(self, session: Any, now_s: float) -> None:
        """Look at a session; one that is being opened (None), or is none of zenoh's, changes nothing."""
        if not hasattr(session, "info"):
            return
        is_met = bool(session.info.routers_zid() or session.info.peers_zid())
        self._since_s = None if is_met else self._since_s or now_s

    def is_long(self, now_s: float) -> bool:
        return self._since_s is not None and now_s - self._since_s > ALONE_S


class Presence:
    """The aircraft at a session: tokens as they come and go, and the statuses that are sent anyway. Thread-safe."""

    def __init__(self, session: Any) -> None:
        self._lock = threading.Lock()
        self._there: dict[str, bool] = {}
        self._statuses: dict[str, tuple[VehicleStatus, float]] = {}
        self._declared = [
            session.declare_subscriber(STATUS.key(ANY_VEHICLE), self._receive),
            session.liveliness().declare_subscriber(ALIVE.key(ANY_VEHICLE), self._changed, history=True),
        ]

    def now(self) -> list[Present]:
        """All who are there or were, by name."""
        with self._lock:
            there, statuses, now_s = dict(self._there), dict(self._statuses), time.monotonic()
        found = []
        for name in sorted({*there, *statuses}):
            status, received_s = statuses.get(name, (None, now_s))
            age_s = None if status is None else now_s - received_s
            # An aircraft of an earlier version has no token.
            is_there = there.get(name, age_s is not None and age_s < SILENT_S)
            found.append(Present(name, is_there, status, age_s))
        return found

    # In zenoh's threads

    def _receive(self, sample: Any) -> None:
        try:
            name, status = read_status(str(sample.key_expr), sample.payload.to_bytes())
        except (ValueError, WireError):
            return
        with self._lock:
            if name in self._statuses or len(self._statuses) < MOST:
                self._statuses[name] = status, time.monotonic()

    def _changed(self, sample: Any) -> None:
        name = _name(str(sample.key_expr))
        with self._lock:
            if name is not None and (name in self._there or len(self._there) < MOST):
                self._there[name] = sample.kind == zenoh.SampleKind.PUT


def _name(key: str) -> str | None:
    try:
        return ALIVE.vehicle(key)
    except ValueError:
        return None
