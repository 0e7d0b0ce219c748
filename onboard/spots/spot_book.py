"""All spots of a flight's pictures: found, seen again on the same ground, and put there with their errors."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.spot import MOST_SPOTS, Spot, SpotReport
from onboard.config.schema import SpotsConfig, ThermalConfig
from onboard.events.types import Frame
from onboard.spots.blurred_area import unblurred
from onboard.spots.detector import PARTS, ZERO_C_K, Detector
from onboard.spots.ground_scale import ground_scale
from onboard.spots.regions import Region
from onboard.spots.second_camera import STATES, Pointing
from onboard.spots.shares import shares
from onboard.spots.thing_book import ThingBook, ThingSeen
from onboard.spots.thing_region import is_of_thing, region_of_thing
from onboard.spots.tried_people import OF, SEEN

Array = NDArray[np.float64]

EDGE_SIGMA_PX = 0.25  # of an outline, all of it outwards
BLUR_SIGMA = 0.2  # of how much is blurred, its share
LEAST_GATE_PX = 3.0


@dataclass(frozen=True, eq=False)
class Placed:
    """A region on the ground: east, north (2,) of a point that stays, how far from it the same may be found, m.

    `pointed_m` (2, k): a root of its horizontal covariance by how a second camera's errors move its pixel;
    `by_mount_m` (2, 4): how far they move it, m for each radian and second.
    """

    spot: Spot
    fix: Fix | None
    place_m: Array
    gate_m: float
    pointed_m: Array = field(default_factory=lambda: np.zeros((2, 0)))
    by_mount_m: Array = field(default_factory=lambda: np.zeros((2, STATES)))


class SpotBook:
    """Fed with pictures, each with its first set, in order; a picture without counts is passed over."""

    def __init__(self, vehicle: str, spots: SpotsConfig, thermal: ThermalConfig) -> None:
        self._vehicle, self._config, self._thermal = vehicle, spots, thermal
        self._begin(0)

    def _begin(self, session: int) -> None:
        self._session = session
        self._origin: LocalFrame | None = None
        self._detector = Detector(self._config, self._thermal.calibration)
        self._things = (
            ThingBook(self._config.false_per_km2, self._config.things_per_km2) if self._config.things else None
        )
        self._before: deque[list[Placed]] = deque(maxlen=OF - 1)
        self._turn = 0
        self.newest: list[Placed] = []  # of the last picture, those of its spots that have a place

    @property
    def thresholds(self) -> dict[float, float]:
        return self._detector.thresholds

    def picture(self, frame: Frame, its_set: FeatureSet, pointing: Pointing | None = None) -> SpotReport | None:
        """The spots of the next picture; None where there is nothing to look at. `pointing`: of a second camera."""
        if frame.counts is None:
            return None
        s = its_set
        if s.session != self._session:
            self._begin(s.session)
        locator = Locator(s) if s.is_ok else None
        if s.is_ok and self._origin is None:
            self._origin = LocalFrame(s.camera_lat_deg, s.camera_lon_deg, 0.0)
        ground_m = self._ground_place(locator)
        hot = self._detector.look(frame.counts, s, ground_m, self._origin)
        things = [] if locator is None else self._seen_things(frame.counts, locator, ground_m, pointing)
        placed = [self._thing(region, seen, locator, s.status, pointing) for region, seen in things]
        found = [one for one in hot if not any(is_of_thing(one, seen.peak, region) for region, seen in things)]
        placed += [self._placed(region, locator, s.status, pointing) for region in found]
        kept = self._in_turn(
            [one for one in placed if one.fix is None or one.spot.kind is not None or self._times_seen(one) + 1 >= SEEN]
        )
        self._before.append([one for one in placed if one.fix is not None])
        self.newest = shown = [one for one in kept if one.fix is not None]
        tried = self._detector.tried
        picture, session = shares([one.fix for one in shown if one.fix], s, [one.pointed_m for one in shown])
        return SpotReport(
            s.session, s.frame, s.capture_unix_ns, self._thermal.calibration is not None,
            tuple(one.spot for one in kept), 0, picture, session, self._vehicle, tried.found, tried.named,
        )  # fmt: skip

    def _seen_things(
        self, counts: NDArray[np.uint16], locator: Locator, ground_m: Array, pointing: Pointing | None
    ) -> list[tuple[Region, ThingSeen]]:
        """Return the net's finds in a picture, the most likely first; nothing where the picture shows no ground."""
        if self._things is None or self._origin is None:
            return []
        ground = ground_scale(locator.feature_set, PARTS)
        if ground is None:
            return []
        scale = self._thermal.calibration
        values = counts.astype(np.float32) if scale is None else scale.kelvin(counts)
        found = self._things.look(values, locator, ground, self._origin, ground_m, pointing)
        return [(region_of_thing(values, seen.peak), seen) for seen in found]

    def _thing(
        self, region: Region, seen: ThingSeen, locator: Locator | None, status: Status, pointing: Pointing | None
    ) -> Placed:
        one = self._placed(region, locator, status, pointing)
        return replace(one, spot=replace(one.spot, kind=seen.peak.kind, log_odds=seen.log_odds))

    def _ground_place(self, locator: Locator | None) -> Array:
        """About where a picture's ground is: the place at its middle, else below the camera."""
        if locator is None:
            return np.full(2, np.nan)
        camera = locator.feature_set.camera
        offset = locator.offset([0.5 * (camera.width_px - 1.0), 0.5 * (camera.height_px - 1.0)])
        at = np.zeros(3) if isinstance(offset, Status) else offset
        lat, lon, _ = (float(c) for c in locator.frame.to_geodetic(at))
        return self._en_m(lat, lon)

    def _en_m(self, lat_deg: float, lon_deg: float) -> Array:
        assert self._origin is not None
        return self._origin.to_enu(lat_deg, lon_deg, 0.0)[:2]

    def _placed(self, region: Region, locator: Locator | None, status: Status, pointing: Pointing | None) -> Placed:
        u, v = (float(c) for c in region.uv_px)
        scale = self._thermal.calibration
        hottest, above = (None, None) if scale is None else (region.hottest - ZERO_C_K, region.above)
        plain = Spot(u, v, region.contrast, hottest, above, status, is_cut=region.is_cut)
        if locator is None:
            return Placed(plain, None, np.full(2, np.nan), 0.0)
        root = None if pointing is None else pointing.root(region.uv_px)
        answer = locator.locate(region.uv_px, root)
        if not isinstance(answer, Fix):
            spot = Spot(u, v, region.contrast, hottest, above, answer.status, is_cut=region.is_cut)
            return Placed(spot, None, np.full(2, np.nan), 0.0)
        outline, pixel_m, is_whole = self._outline(region, locator, answer)
        area, sigma = area_and_sigma(outline, region, pixel_m, answer)
        spot = Spot(
            u, v, region.contrast, hottest, above, Status.OK, answer.place, area, sigma,
            tuple((float(east), float(north)) for east, north in outline), region.is_cut or not is_whole,
        )  # fmt: skip
        place = self._en_m(answer.lat_deg, answer.lon_deg)
        one = Placed(spot, answer, place, max(answer.ellipse.semi_major_m, LEAST_GATE_PX * pixel_m))
        parts = None if pointing is None else locator.error_parts(region.uv_px)
        if pointing is None or root is None or parts is None:
            return one
        by_pixel = parts.by_pixel_m[:2]
        return replace(one, pointed_m=by_pixel @ root, by_mount_m=by_pixel @ pointing.by_state(region.uv_px))

    def _outline(self, region: Region, locator: Locator, fix: Fix) -> tuple[Array, float, bool]:
        """East and north (N, 2) of the place, without what has none of its own; the side of a pixel there, m; whether
        nothing of it is without a place.
        """
        each = locator.answers(region.outline_px)
        shown = each.is_answered
        outline = (each.offset_enu_m[shown] - fix.offset_enu_m)[:, :2]
        pixels = each.by_pixel_m[shown][:, :2]
        if len(outline) < 3:
            return np.zeros((0, 2)), 0.0, False
        return outline, float(np.sqrt(np.median(np.abs(np.linalg.det(pixels))))), bool(shown.all())

    def _times_seen(self, one: Placed) -> int:
        """Count the pictures before that had a spot on that ground."""
        near = (
            any(float(np.hypot(*(one.place_m - other.place_m))) < max(one.gate_m, other.gate_m) for other in before)
            for before in self._before
        )
        return sum(near)

    def _in_turn(self, kept: list[Placed]) -> list[Placed]:
        """Return the spots, the next ones first where a packet does not hold all: else some would never be sent."""
        if len(kept) <= MOST_SPOTS:
            return kept
        first, self._turn = self._turn % len(kept), (self._turn + MOST_SPOTS) % len(kept)
        return kept[first:] + kept[:first]


def _polygon_m2(outline: Array) -> float:
    """Return the area of a polygon (N, 2); 0 with fewer than three corners."""
    if len(outline) < 3:
        return 0.0
    x, y = outline.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def area_and_sigma(outline: Array, region: Region, pixel_m: float, fix: Fix) -> tuple[float, float]:
    """The area (m2) within an outline (N, 2) without its blur, (25.10), and one sigma of it.

    That is of its edge, of the blur that is taken off it, and of how far away the ground is. (25.11)
    """
    seen_m2, blur_m = _polygon_m2(outline), region.blur_px * pixel_m
    area = unblurred(seen_m2, blur_m)
    if not seen_m2:
        return area, 0.0
    steps = np.hypot(*(outline - np.roll(outline, -1, axis=0)).T)
    edge = EDGE_SIGMA_PX * region.pixels * pixel_m * float(steps.sum())
    by_edge = unblurred(seen_m2 + edge, blur_m) - area
    by_blur = unblurred(seen_m2, (1.0 + BLUR_SIGMA) * blur_m) - area
    distance = float(np.linalg.norm(fix.offset_enu_m))
    along = fix.offset_enu_m / distance
    by_distance = 2.0 * np.sqrt(float(along @ fix.covariance_enu_m2 @ along)) / distance
    return area, float(np.hypot(np.hypot(by_edge, by_blur), by_distance * area))
