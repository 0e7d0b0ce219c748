"""Spots as they are received with the sets, merged into things; and which have changed since one asked. Thread-safe."""

from __future__ import annotations

import threading
from collections.abc import Iterable

from contract.errors import WireError
from contract.spot import SpotReport
from contract.wire.message import read_spots
from ground.spots.fire import Fire, FireGround
from ground.spots.found_thing import FoundThing
from ground.spots.merging import SpotMerger


def reports_in(key: str, payload: bytes) -> list[SpotReport]:
    """The report in a message of the link; none if it is no message of spots."""
    try:
        return [read_spots(key, payload)]
    except (ValueError, WireError):
        return []


class ReceivedSpots:
    """`take` is for a subscription (`SetCache`'s `subscriptions`)."""

    def __init__(self) -> None:
        self._merger = SpotMerger()
        self._fire = FireGround()
        self._changed: dict[int, int] = {}  # by thing, the version at which it changed last
        self._version = 0
        self._lock = threading.Lock()

    def take(self, key: str, payload: bytes) -> None:
        """A message of the link; what is none of ours is passed over."""
        self.add(reports_in(key, payload))

    def add(self, reports: Iterable[SpotReport]) -> None:
        """Reports of pictures, those of one session in the order of capture."""
        with self._lock:
            for report in reports:
                self._version += 1
                self._fire.add(report)
                for thing in self._merger.add(report):
                    self._changed[thing.number] = self._version

    @property
    def version(self) -> int:
        with self._lock:
            return self._version

    @property
    def unplaced(self) -> int:
        with self._lock:
            return self._merger.unplaced

    @property
    def pictures(self) -> int:
        with self._lock:
            return self._merger.pictures

    def since(self, version: int) -> tuple[int, list[FoundThing]]:
        """The version now, and the things that are new or have changed since another; by number."""
        with self._lock:
            changed = {number for number, at in self._changed.items() if at > version}
            return self._version, self._merger.things(changed)

    def thing(self, number: int) -> FoundThing | None:
        """The thing of a number; None if there is none."""
        with self._lock:
            return next(iter(self._merger.things({number})), None)

    def fire(self, minutes: float) -> Fire | None:
        """The fire of the last minutes of what was received; None if nothing burned. Takes a second or two."""
        with self._lock:
            held = self._fire.copy()
        return held.fire(minutes)

    def things(self) -> list[FoundThing]:
        """All, by number."""
        with self._lock:
            return self._merger.things()
