"""Spots of successive pictures, passes and aircraft -> things. Equations (26.1) to (26.9). No clock and no I/O."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse, Place
from contract.geodesy import LocalFrame, geodetic_to_ecef, level_ground_m
from contract.spot import Spot, SpotReport
from contract.track import REST_M_S, Course
from contract.velocity import Velocity
from ground.chi_square import limit
from ground.spots.found_thing import FoundThing, SeenSpot
from ground.spots.motion import STANDING_SPEED_M_S, WALKING_SPEED_M_S, Motion, Sighting

Array = NDArray[np.float64]
Session = tuple[str, int]  # vehicle and session: what shares slow errors

GATE = limit(1e-4, 2)  # of the squared distance: one in ten thousand of a thing's own spots begins another
MOVED = limit(1e-5, 2)  # of twice the logarithm of how much likelier moving is, above which a thing has moved
MOVES = limit(1e-2, 2)  # of the squared speed of one that has moved over its variance, above which it still does
UNSEEN_S = 20.0  # after which a moving thing may be anywhere
SHORT_S = 3.0  # for which what stood may have begun to move
SPEED_AFTER_S = 3.0  # of sightings, before a speed is reported
EXTENT_SHARE = 0.2  # of a spot's radius: how much what is taken for its middle changes with the view, one sigma
FRAME_REACH_M, MOST_FRAMES = 100_000.0, 64  # where a plane is true to centimetres and a degree
MOST_THINGS, MOST_KEPT_SPOTS = 2000, 60  # and as many that were the best once


@dataclass(eq=False)
class _Thing:
    """A thing with its spots and, by session, the filter in which it stands and the one in which it moves."""

    number: int
    frame: LocalFrame  # of its places
    still: dict[Session, Motion] = field(default_factory=dict)
    moving: dict[Session, Motion] = field(default_factory=dict)
    evidence: dict[Session, float] = field(default_factory=dict)  # that it has moved
    spots: list[SeenSpot] = field(default_factory=list)
    bests: list[SeenSpot] = field(default_factory=list)
    newest: Spot | None = None
    best: tuple[Spot, SeenSpot] | None = None
    first_unix_ns: int = 0
    pictures: int = 0
    vehicles: set[str] = field(default_factory=set)
    temperature_c: float | None = None
    above_ground_k: float | None = None
    likely: dict[Session, Spot] = field(default_factory=dict)  # the newest spot of each that a net has named

    @property
    def last(self) -> Session:
        return self.spots[-1].vehicle, self.spots[-1].session

    @property
    def has_moved(self) -> bool:
        return any(self._has_moved_in(session) for session in self.still)

    def _has_moved_in(self, session: Session) -> bool:
        """Return whether standing does not explain the places in a session. (26.7)"""
        return self.evidence[session] > MOVED

    @property
    def is_moving(self) -> bool:
        """True if it has moved in the newest session and has not come to rest."""
        motion = self.moving[self.last]
        v = motion.velocity_m_s
        return self._has_moved_in(self.last) and float(v @ np.linalg.solve(motion.velocity_covariance, v)) > MOVES

    def distance2(self, session: Session, seen: Sighting) -> float:
        """Squared distance of a place from where the thing is, or may have gone. (26.4), (26.6)"""
        held = self.still.get(session)
        if held is None:
            return self._distance2_from_others(seen)
        gap_s, moved = seen.at_s - held.at_s, self.moving[session].distance2(seen)
        if self.last != session and self._has_moved_in(self.last):
            # Another session has seen since where it went.
            return min(moved if gap_s <= UNSEEN_S else math.inf, self._distance2_from_others(seen))
        if self._has_moved_in(session):
            return moved if gap_s <= UNSEEN_S else math.inf
        # It is not yet known whether it moves: for a short while it may have.
        return min(moved, held.distance2(seen)) if gap_s <= SHORT_S else held.distance2(seen)

    def _distance2_from_others(self, seen: Sighting) -> float:
        """Squared distance from where other sessions have it."""
        place, covariance = self.merged()
        away, C = seen.place_m - place, covariance + seen.covariance_m2
        return float(away @ np.linalg.solve(C, away))

    def take(self, session: Session, seen: Sighting) -> None:
        if session not in self.still:
            self.still[session] = Motion(seen, STANDING_SPEED_M_S)
            self.moving[session] = Motion(seen, WALKING_SPEED_M_S)
            self.evidence[session] = 0.0
            return
        gained, before = self.still[session].take(seen) - self.moving[session].take(seen), self.evidence[session]
        # What has moved has: where it stands since, its places of before are no mean of.
        self.evidence[session] = before if before > MOVED else max(before + gained, 0.0)

    def merged(self) -> tuple[Array, Array]:
        """Place (2,), m, and covariance (2, 2): of sessions by their whole covariances. (26.8)

        One that has moved, in whichever session, is where its newest session has it: the others' places are of where
        it was. So is one of which an earlier session contradicts the newest.
        """
        if self.has_moved:
            motion = self.moving[self.last]
            return motion.place_m, motion.covariance_m2
        joined = {self.last: self.still[self.last]}
        place, covariance = _joined(joined)
        for session, motion in self.still.items():
            away, C = motion.place_m - place, covariance + motion.covariance_m2
            if session != self.last and float(away @ np.linalg.solve(C, away)) <= GATE:
                joined[session] = motion
                place, covariance = _joined(joined)
        return place, covariance


def _joined(sessions: Mapping[Session, Motion]) -> tuple[Array, Array]:
    """Place (2,) and covariance (2, 2) of what stands, weighed as if no two sessions shared anything. Those of one
    vehicle may have all of what each shares with itself in common, and the covariance has that. (26.8)
    """
    information = {session: np.linalg.inv(motion.covariance_m2) for session, motion in sessions.items()}
    T = np.linalg.inv(np.sum(list(information.values()), axis=0))
    place, covariance = np.zeros(2), np.zeros((2, 2))
    shared: dict[str, Array] = {}
    for (vehicle, session), motion in sessions.items():
        W = T @ information[vehicle, session]
        place = place + W @ motion.place_m
        covariance = covariance + W @ motion.own_covariance_m2 @ W.T
        shared[vehicle] = shared.get(vehicle, 0.0) + W @ motion.shared_root_m
    return place, covariance + np.sum([root @ root.T for root in shared.values()], axis=0)


class SpotMerger:
    """Takes reports as they come; those of one session in the order of capture, an older one is passed over."""

    def __init__(self) -> None:
        self._frames: deque[LocalFrame] = deque(maxlen=MOST_FRAMES)
        self._origin_ns = 0
        self._things: dict[int, _Thing] = {}
        self._newest_ns: dict[Session, int] = {}
        self._count = 0
        self.pictures = 0
        self.unplaced = 0  # spots without a place: they are of no thing

    def add(self, report: SpotReport) -> list[FoundThing]:
        """The things that a picture's spots are of, new or changed, as they are now."""
        session = report.vehicle, report.session
        if report.capture_unix_ns <= self._newest_ns.get(session, 0):
            return []
        self._newest_ns[session] = report.capture_unix_ns
        self.pictures += 1
        placed = [(spot, spot.place) for spot in report.spots if spot.place is not None]
        self.unplaced += len(report.spots) - len(placed)
        if placed and not self._frames:
            self._origin_ns = report.capture_unix_ns
        frames = [self._frame(place) for _, place in placed]
        seen = [self._sighting(report, *of, frame) for of, frame in zip(placed, frames, strict=True)]
        changed = []
        assigned = self._assigned(session, frames, seen)
        for (spot, _), frame, sighting, thing in zip(placed, frames, seen, assigned, strict=True):
            found = thing or self._new(frame)
            found.take(session, sighting)
            _note(found, report, spot)
            changed.append(found)
        self._forget()
        return [self._value(thing) for thing in changed if thing.number in self._things]

    def things(self, wanted: Collection[int] | None = None) -> list[FoundThing]:
        """The things by number: all, or those of some numbers that are still kept."""
        return [self._value(self._things[n]) for n in sorted(self._things) if wanted is None or n in wanted]

    def _frame(self, place: Place) -> LocalFrame:
        """The plane on which a place is: one that touches the earth so near that it is true there."""
        there = geodetic_to_ecef(place.lat_deg, place.lon_deg, 0.0)
        near = (frame for frame in self._frames if np.linalg.norm(frame.origin_ecef_m - there) < FRAME_REACH_M)
        if (found := next(near, None)) is None:
            found = LocalFrame(place.lat_deg, place.lon_deg, 0.0)
            self._frames.append(found)
        return found

    def _sighting(self, report: SpotReport, spot: Spot, place: Place, frame: LocalFrame) -> Sighting:
        east, north, _ = frame.to_enu(place.lat_deg, place.lon_deg, 0.0)
        extent_m2 = EXTENT_SHARE**2 * spot.area_m2 / math.pi
        C = place.ellipse.covariance_en_m2
        whole = C + extent_m2 * np.eye(2)
        # The extent is the spot's own: what is shared stays what it was.
        part = float(np.trace(C) / np.trace(whole))
        at_s = (report.capture_unix_ns - self._origin_ns) / 1e9
        place_m = np.array([float(east), float(north)])
        return Sighting.of(at_s, place_m, whole, part * report.picture_share, part * report.session_share)

    def _assigned(self, session: Session, frames: list[LocalFrame], seen: list[Sighting]) -> list[_Thing | None]:
        """Each spot's thing, nearest first, no thing twice: two spots of one picture are two things. (26.9)"""
        pairs = [
            (thing.distance2(session, sighting), k, thing.number)
            for k, (frame, sighting) in enumerate(zip(frames, seen, strict=True))
            for thing in self._near(session, frame, sighting)
        ]
        out: list[_Thing | None] = [None] * len(seen)
        taken: set[int] = set()
        for distance2, k, number in sorted(pairs):
            if distance2 > GATE:
                break
            if out[k] is None and number not in taken:
                out[k] = self._things[number]
                taken.add(number)
        return out

    def _near(self, session: Session, frame: LocalFrame, seen: Sighting) -> Iterable[_Thing]:
        """Yield the things within any reach: of thousands few are looked at closely."""
        reach_m = 6.0 * math.sqrt(float(np.linalg.eigvalsh(seen.covariance_m2)[-1])) + 50.0
        for thing in self._things.values():
            if thing.frame is not frame:
                continue
            held = thing.still.get(session) or thing.still[thing.last]
            if float(np.max(np.abs(held.place_m - seen.place_m))) < reach_m or thing.has_moved:
                yield thing

    def _new(self, frame: LocalFrame) -> _Thing:
        self._count += 1
        made = self._things[self._count] = _Thing(self._count, frame)
        return made

    def _forget(self) -> None:
        """Drop from too many things those that were seen in the fewest pictures, and longest ago."""
        while len(self._things) > MOST_THINGS:
            least = min(self._things.values(), key=lambda t: (t.pictures, t.spots[-1].capture_unix_ns))
            del self._things[least.number]

    def _value(self, t: _Thing) -> FoundThing:
        assert t.best is not None and t.newest is not None
        (east, north), covariance = t.merged()
        lat, lon, _ = (float(c) for c in t.frame.to_geodetic((east, north, float(level_ground_m(east, north)))))
        spot, where = t.best
        named = max(t.likely.values(), key=lambda one: one.log_odds, default=None)
        known = t.newest.place
        assert known is not None and spot.place is not None
        place = Place(
            lat, lon, known.height_amsl_m, known.height_ellipsoid_m, Ellipse.from_covariance(covariance),
            known.sigma_height_m,
        )  # fmt: skip
        return FoundThing(
            t.number, place, self._course(t), t.pictures, tuple(sorted(t.vehicles)), t.first_unix_ns,
            t.spots[-1].capture_unix_ns, t.temperature_c, t.above_ground_k, spot.contrast, spot.area_m2,
            spot.sigma_area_m2, where, t.spots[-1],
            None if named is None else named.kind, None if named is None else named.probability,
            tuple(dict.fromkeys([*t.bests, *t.spots])),
        )  # fmt: skip

    def _course(self, t: _Thing) -> Course | None:
        """None while too little is known. (26.7)"""
        motion = t.moving[t.last]
        if motion.at_s - min(m.began_s for m in t.moving.values()) < SPEED_AFTER_S or motion.count < 3:
            return None
        velocity = Velocity(motion.velocity_m_s, motion.velocity_covariance)
        if not t.is_moving and velocity.sigma_speed_m_s > REST_M_S:
            return None
        return velocity.course(t.is_moving)


def _note(t: _Thing, report: SpotReport, spot: Spot) -> None:
    """Note all of a report on a thing but its place. Its best picture is the one with the most contrast, uncut."""
    where = SeenSpot(report.vehicle, report.session, report.frame, report.capture_unix_ns, spot.u_px, spot.v_px)
    t.first_unix_ns = min(t.first_unix_ns or where.capture_unix_ns, where.capture_unix_ns)
    t.pictures += 1
    t.vehicles.add(report.vehicle)
    t.newest = spot
    if spot.kind is not None:
        t.likely[report.vehicle, report.session] = spot
    t.spots.append(where)
    if len(t.spots) > MOST_KEPT_SPOTS:
        del t.spots[1]  # the first stays: it is what the thing was known by at first
    if t.best is None or (not spot.is_cut, abs(spot.contrast)) >= (not t.best[0].is_cut, abs(t.best[0].contrast)):
        t.best = spot, where
        t.bests = [*t.bests, where][-MOST_KEPT_SPOTS:]
    if spot.temperature_c is not None and spot.above_ground_k is not None:
        is_first = t.above_ground_k is None
        if is_first or abs(spot.above_ground_k) > abs(t.above_ground_k or 0.0):
            t.temperature_c, t.above_ground_k = spot.temperature_c, spot.above_ground_k
