"""Spots as they are received with the sets, merged into things; and which have changed since one asked. Thread-safe."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Iterable
from dataclasses import replace

from contract.spot import SpotReport
from contract.wire.message import SPOT_REPORTS
from ground.report_clocks import ReportClocks
from ground.report_view import ReportView
from ground.spots.fire import HOT_C, Fire, FireGround
from ground.spots.found_thing import FoundThing
from ground.spots.merging import SpotMerger

MOST_SEARCHED = 20_000  # pictures of which it is kept who would have been found: an hour at five a second


class ReceivedSpots(ReportView[SpotReport]):
    """A view of them as things, each with its number."""

    payload = SPOT_REPORTS

    def __init__(self, hot_c: float = HOT_C) -> None:
        self._merger = SpotMerger()
        self._clocks = ReportClocks()
        self._fire = FireGround(hot_c, self._clocks)
        self._changed: dict[int, int] = {}  # by thing, the version at which it changed last
        self._person_found: dict[str, float | None] = {}  # by vehicle, of its newest picture
        self._searched: deque[SpotReport] = deque(maxlen=MOST_SEARCHED)  # without their spots
        # Of as many pictures, by vehicle, session and frame: where in it each thing was seen, by number.
        self._seen: OrderedDict[tuple[str, int, int], dict[int, tuple[float, float]]] = OrderedDict()
        self._shares = 0.0, 0  # sum and number, of all pictures
        self._version = 0
        self._lock = threading.Lock()

    def add(self, reports: Iterable[SpotReport]) -> None:
        """Reports of pictures, in any order among themselves; those of one session after all of earlier pictures."""
        in_order = sorted(reports, key=lambda report: report.capture_unix_ns)
        self.received((report.capture_unix_ns, report) for report in in_order)

    def received(self, reports: Iterable[tuple[int, SpotReport]]) -> None:
        """Reports of pictures in the order in which they came, with the times of that.

        One whose stamp is false is of no thing: it would make all that come after it too old.
        """
        with self._lock:
            for came_ns, report in reports:
                self._version += 1
                self._fire.add(report, came_ns)
                for accepted in self._clocks.accepted(report, came_ns):
                    self._merge(accepted)
                self._person_found[report.vehicle] = share = report.person_found
                self._searched.append(replace(report, spots=()))
                if share is not None:
                    self._shares = self._shares[0] + share, self._shares[1] + 1

    def _merge(self, report: SpotReport) -> None:
        seen = {}
        for thing in self._merger.add(report):
            self._changed[thing.number] = self._version
            seen[thing.number] = thing.newest.u_px, thing.newest.v_px
        if seen:
            self._seen[report.vehicle, report.session, report.frame] = seen
            while len(self._seen) > MOST_SEARCHED:
                self._seen.popitem(last=False)

    @property
    def version(self) -> int:
        with self._lock:
            return self._version

    @property
    def unplaced(self) -> int:
        with self._lock:
            return self._merger.unplaced

    @property
    def false_stamps(self) -> int:
        """The number of reports whose stamp contradicted those of their session: what they show is of no thing."""
        with self._lock:
            return self._clocks.false_stamps

    @property
    def pictures(self) -> int:
        """The number of pictures that were searched, also of one whose stamp the next report of its session judges."""
        with self._lock:
            return self._merger.pictures + self._clocks.waiting

    def searched(self) -> list[SpotReport]:
        """The reports of the newest MOST_SEARCHED pictures, without their spots."""
        with self._lock:
            return list(self._searched)

    def seen_in(self, vehicle: str, session: int, frame: int) -> dict[int, tuple[float, float]]:
        """The pixels at which a picture shows things, by their numbers; a thing that moves was elsewhere in others."""
        with self._lock:
            return dict(self._seen.get((vehicle, session, frame), {}))

    def person_found(self, vehicle: str) -> float | None:
        """The share of the ground of a vehicle's newest picture on which a person would be found; None: not known."""
        with self._lock:
            return self._person_found.get(vehicle)

    @property
    def mean_person_found(self) -> float | None:
        """The same of all pictures, in the mean; None if it is known of none."""
        with self._lock:
            total, count = self._shares
            return total / count if count else None

    def since(self, version: int) -> tuple[int, list[FoundThing]]:
        """The version now, and the things that are new or have changed since another; by number."""
        with self._lock:
            changed = {number for number, at in self._changed.items() if at > version}
            return self._version, self._merger.things(changed)

    def thing(self, number: int) -> FoundThing | None:
        with self._lock:
            return next(iter(self._merger.things({number})), None)

    def fire(self, minutes: float) -> Fire | None:
        """The fire of the last minutes of what was received; None if nothing burned. Takes a second or two."""
        with self._lock:
            held = self._fire.copy()
        return held.fire(minutes)

    def things(self) -> list[FoundThing]:
        with self._lock:
            return self._merger.things()

    def recent(self, seconds: float) -> list[FoundThing]:
        """The things that were seen so long before the newest one at most, by the ground's clock."""
        with self._lock:
            things = self._merger.things()
            newest = [thing.newest for thing in things]
            times = [self._clocks.at_unix_ns(s.vehicle, s.session, s.capture_unix_ns) for s in newest]
        since_ns = max(times, default=0) - round(seconds * 1e9)
        return [thing for thing, at_ns in zip(things, times, strict=True) if at_ns >= since_ns]
