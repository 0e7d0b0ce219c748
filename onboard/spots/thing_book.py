"""Places on the ground where a thing may be, and how likely that is by all looks. (25.14) to (25.20)"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from contract.answer import Fix
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import Locator, pixels_of
from contract.spot import ThingKind
from onboard.spots.counted_ground import CountedGround
from onboard.spots.ground_scale import GroundScale
from onboard.spots.second_camera import STATES, Pointing
from onboard.spots.shares import shares
from onboard.spots.thing_net import Image, Peak, ThingNet
from onboard.spots.thing_odds import MISSED, PlaceOdds, ScoreLaw, read_laws

Array = NDArray[np.float64]

MOST_PEAKS, MOST_PLACES, MOST_LOOKS = 100, 400, 240
GATE_CHI2 = 9.21  # of two degrees of freedom: one in a hundred
GATE_PX = 2.0  # of how well the net knows a thing's middle
WALK_M_S, WALKED_S = 1.5, 3.0
SLOW_S = 10.0  # the time constant of what pictures next to each other have in common
EDGE_PX = 8.0  # nearer to the picture's edge no peak is missed
STILL_PX = 20.0  # of ground; how looks from nearer to each other depend on each other has not been measured
MOST_VIEWS = 8  # that count of one place; how many more depend on each other has not been measured
KM2 = 1e-6  # a square metre
MOST_GATE_M = 100.0


class Net(Protocol):
    """Finds peaks in a picture."""

    def peaks(self, values: Image) -> list[Peak]:
        """Return those of a picture (H, W), the most likely first."""


@dataclass(frozen=True, eq=False)
class ThingSeen:
    """A peak that is reported: it is a thing with odds of exp(`log_odds`) to one."""

    peak: Peak
    log_odds: float


@dataclass(frozen=True, eq=False)
class _Seen:
    """A peak on the ground: its place (3,) and a pixel's side there, m, its own and its slow errors' variances, m2.

    `by_mount_m` (2, 4): how far a second camera's errors move it, m for each radian and second.
    """

    peak: Peak
    place_m: Array
    pixel_m: float
    own_m2: float
    slow_m2: float
    at_s: float
    by_mount_m: Array


@dataclass(eq=False)
class _Place:
    """A place where a thing of one kind may be: where it was seen last, and its odds by all looks.

    `from_m`: where the camera (3,) has been when looks counted, the first peak's first.
    """

    newest: _Seen
    odds: PlaceOdds
    from_m: list[Array]

    def is_new_from(self, camera_m: Array) -> bool:
        """Note that the camera (3,) looks at it; return whether it has not from about there: a hover is one look."""
        apart_m = np.linalg.norm(np.array(self.from_m) - camera_m, axis=1)
        is_new = len(self.from_m) < MOST_VIEWS and bool(apart_m.min() >= STILL_PX * self.newest.pixel_m)
        if is_new:
            self.from_m.append(camera_m)
        return is_new


@dataclass(frozen=True, eq=False)
class _Past:
    """A look that is over: its picture's set, camera (3,) and middle of the ground (2,), m, and that one's reach.

    `mount` (4, 4): the covariance of how a second camera sits; 0 without one.
    """

    its_set: FeatureSet
    camera_m: Array
    middle_m: Array
    reach_m: float
    mount: Array


@dataclass(eq=False)
class _Rate:
    """The rate at which this flight's ground resembles a kind, over the calibration's. (25.18)"""

    law: ScoreLaw
    peaks: float = 0.0
    expected: float = 0.0

    @property
    def value(self) -> float:
        return (self.law.flights + self.peaks) / (self.law.flights + self.expected)


@dataclass(eq=False)
class _Kind:
    """All of one kind: its law, this flight's rate of false peaks, its density and the places."""

    law: ScoreLaw
    rate: _Rate
    density_km2: float  # of things
    places: list[_Place] = field(default_factory=list)

    def learn_density(self, prior_km2: float, seen_km2: float) -> None:
        """Set the density to what the places and the ground that has been seen make of what was expected. (25.20)"""
        log_odds = np.array([place.odds.log_km2 for place in self.places]) + np.log(self.density_km2)
        self.density_km2 = float((1.0 + expit(log_odds).sum()) / (1.0 / prior_km2 + seen_km2))


class ThingBook:
    """Fed with pictures and their sets with an answer, in order. Odds are kept for a session.

    `laws` and `net`: other than the ones in the package.
    """

    def __init__(
        self,
        false_per_km2: float,
        things_per_km2: float,
        laws: dict[ThingKind, ScoreLaw] | None = None,
        net: Net | None = None,
    ) -> None:
        laws = read_laws() if laws is None else laws
        self._net = ThingNet(min(float(law.edges[0]) for law in laws.values())) if net is None else net
        # Shared among the kinds, as among the sizes of hot spots.
        self._least = float(np.log(len(laws) / false_per_km2))
        self._prior_km2 = things_per_km2
        self._kinds = {kind: _Kind(law, _Rate(law), things_per_km2) for kind, law in laws.items()}
        self._looks: deque[_Past] = deque(maxlen=MOST_LOOKS)
        self._ground = CountedGround()

    def look(
        self,
        values: Image,
        locator: Locator,
        scale: GroundScale,
        origin: LocalFrame,
        ground_m: Array,
        pointing: Pointing | None = None,
    ) -> list[ThingSeen]:
        """Return what the picture (H, W) shows and all looks together hold for a thing, the most likely first.

        `origin`: where places are counted from, the same all session; `ground_m` (2,): about where the picture's ground
        is, east and north of it. `pointing`: of a second camera.
        """
        s = locator.feature_set
        peaks = self._net.peaks(values)[:MOST_PEAKS]
        now = _past(s, scale, origin, ground_m, pointing)
        observed = _placed(peaks, locator, now.camera_m, pointing)
        self._learn_rates(peaks, now, scale)
        shown: list[tuple[_Place, _Kind]] = []
        for kind, of in self._kinds.items():
            mine = [observation for observation in observed if observation.peak.kind is kind]
            shown += [(place, of) for place in self._looked(of, mine, now)]
        self._looks.append(now)
        for of in self._kinds.values():
            of.places = sorted(of.places, key=lambda place: -place.odds.log_km2)[:MOST_PLACES]
            of.learn_density(self._prior_km2, self._ground.km2)
        found = [
            ThingSeen(place.newest.peak, place.odds.log_km2 + float(np.log(of.density_km2)))
            for place, of in shown
            if place.odds.log_km2 >= self._least
        ]
        return sorted(found, key=lambda one: -one.log_odds)

    def _learn_rates(self, peaks: list[Peak], now: _Past, scale: GroundScale) -> None:
        """Count the peaks of ground that has not been counted yet: of the lower classes, which hold hardly a thing."""
        camera = now.its_set.camera
        area_km2 = KM2 * scale.area_m2(camera.size_px)
        if area_km2 <= 0.0 or not self._ground.is_new(now.middle_m, area_km2):
            return
        self._ground.add(now.middle_m, area_km2)
        mpx = 1e-6 * camera.width_px * camera.height_px * float(scale.is_ground.mean())
        for kind, of in self._kinds.items():
            low = of.law.low_classes
            classes = np.array([of.law.class_of(p.score) for p in peaks if p.kind is kind], int)
            of.rate.peaks += int(np.count_nonzero((classes >= 0) & (classes < low)))
            of.rate.expected += mpx * float(of.law.false_per_mpx[:low].sum())

    def _looked(self, of: _Kind, observed: list[_Seen], now: _Past) -> list[_Place]:
        """Give each peak to the place that it is of, a new one where there is none; return the places with a peak."""
        in_view = [of.places[k] for k in np.flatnonzero(_are_in_view(_places(of.places), now))]
        taken, used = _assigned(in_view, observed, now)
        seen = []
        for i, place in enumerate(in_view):
            observation = taken.get(i)
            gate_m = _gate_m(place.newest, observation or place.newest, now)
            if place.is_new_from(now.camera_m):
                _add(of, place, observation, gate_m)
            if observation is not None:
                place.newest = observation
                seen.append(place)
        begun = [
            _Place(observation, PlaceOdds(of.law), [now.camera_m])
            for j, observation in enumerate(observed)
            if j not in used
        ]
        for place in begun:
            _add(of, place, place.newest, _gate_m(place.newest, place.newest, now))
        if begun:
            self._add_looks_before(of, begun)
        of.places += begun
        return seen + begun

    def _add_looks_before(self, of: _Kind, begun: list[_Place]) -> None:
        """Add the looks that have shown nothing where there is a peak for the first time."""
        places_m = _places(begun)
        for past in self._looks:
            if not (np.hypot(*(places_m[:, :2] - past.middle_m).T) < past.reach_m).any():
                continue
            for k in np.flatnonzero(_are_in_view(places_m, past)):
                _add(of, begun[k], None, _gate_m(begun[k].newest, begun[k].newest, past))


def _add(of: _Kind, place: _Place, observation: _Seen | None, gate_m: float) -> None:
    """Add a look at a place: with a peak, or without one within the gate."""
    area_m2 = float(np.pi * gate_m**2)
    score_class = MISSED if observation is None else of.law.class_of(observation.peak.score)
    place.odds.look(
        score_class, 1e-6 * area_m2 / (observation or place.newest).pixel_m ** 2, KM2 * area_m2, of.rate.value
    )


def _placed(peaks: list[Peak], locator: Locator, camera_m: Array, pointing: Pointing | None) -> list[_Seen]:
    """The peaks that have a place. Raises nothing: others are left out."""
    if not peaks:
        return []
    s = locator.feature_set
    uv = np.array([(peak.u_px, peak.v_px) for peak in peaks])
    answers = locator.answers(uv)
    first = next((locator.locate(uv[k]) for k in np.flatnonzero(answers.is_answered)), None)
    if not isinstance(first, Fix):
        return []
    picture, session = shares([first], s, [np.zeros((2, 0))])
    out = []
    for k in np.flatnonzero(answers.is_answered):
        variance = 0.5 * float(np.trace(answers.covariance_enu_m2[k][:2, :2]))
        own, slow = (1.0 - picture) * variance, (picture - session) * variance
        pixel_m = float(np.sqrt(abs(np.linalg.det(answers.by_pixel_m[k][:2]))))
        place_m = camera_m + answers.offset_enu_m[k]
        by_mount = np.zeros((2, STATES))
        if pointing is not None:
            by_mount = answers.by_pixel_m[k][:2] @ pointing.by_state(uv[k])
            own += 0.5 * float(np.sum((by_mount[:, :3] * pointing.turn_sigma_rad) ** 2))
        out.append(_Seen(peaks[k], place_m, max(pixel_m, 1e-3), own, slow, s.capture_unix_ns / 1e9, by_mount))
    return out


def _gate_m(one: _Seen, two: _Seen, look: _Past) -> float:
    """The distance within which two observations are of one place. (25.19), with (27.8) of a second camera"""
    apart_s = abs(look.its_set.capture_unix_ns / 1e9 - one.at_s)
    changed = 1.0 - float(np.exp(-apart_s / SLOW_S))
    by_mount = one.by_mount_m - two.by_mount_m
    mount_m2 = 0.5 * float(np.trace(by_mount @ look.mount @ by_mount.T))
    errors_m2 = GATE_CHI2 * (one.own_m2 + two.own_m2 + changed * (one.slow_m2 + two.slow_m2) + mount_m2)
    walked_m = WALK_M_S * min(apart_s, WALKED_S)
    return float(np.sqrt(errors_m2 + walked_m**2 + (GATE_PX * one.pixel_m) ** 2))


def _past(s: FeatureSet, scale: GroundScale, origin: LocalFrame, ground_m: Array, pointing: Pointing | None) -> _Past:
    camera_m = origin.to_enu(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
    side_m = float(np.sqrt(max(scale.area_m2(s.camera.size_px), 1.0)))
    mount = np.zeros((STATES, STATES)) if pointing is None else pointing.covariance
    return _Past(s, camera_m, ground_m, 2.0 * side_m, mount)


def _assigned(places: list[_Place], observed: list[_Seen], now: _Past) -> tuple[dict[int, _Seen], set[int]]:
    """The observations that are of places, by the place's position in the list, nearest first; and which are taken."""
    taken: dict[int, _Seen] = {}
    used: set[int] = set()
    if not places or not observed:
        return taken, used
    held = _places(places)[:, None, :2] - np.array([observation.place_m[:2] for observation in observed])
    apart_m = np.hypot(held[..., 0], held[..., 1])
    pairs = [
        (float(apart_m[i, j]) / _gate_m(places[i].newest, observed[j], now), int(i), int(j))
        for i, j in np.argwhere(apart_m < MOST_GATE_M)
    ]
    for away, i, j in sorted(pairs):
        if away > 1.0:
            break
        if i not in taken and j not in used:
            taken[i] = observed[j]
            used.add(j)
    return taken, used


def _places(places: list[_Place]) -> Array:
    """Return where they were seen last, (N, 3), m."""
    return np.array([place.newest.place_m for place in places]).reshape(-1, 3)


def _are_in_view(places_m: Array, look: _Past) -> NDArray[np.bool_]:
    """Return which places (N, 3) a picture shows, and not at its edge."""
    uv, usable = pixels_of(look.its_set, places_m - look.camera_m)
    size = np.array(look.its_set.camera.size_px, float)
    out: NDArray[np.bool_] = usable & ((uv >= EDGE_PX - 0.5) & (uv < size - EDGE_PX - 0.5)).all(axis=1)
    return out
