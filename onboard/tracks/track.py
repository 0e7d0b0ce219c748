"""One track: a thing followed in the pictures, and where that puts it on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse, Fix, Place
from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.locate import MAX_ELLIPSE_SHARE, Locator
from contract.track import TrackReport, TrackState
from contract.track_age import LOST_AFTER_S, coasting, unforeseen_m2
from onboard.geometry.plane_homography import move
from onboard.tracks.follower import Follower, Observation
from onboard.tracks.ground_steps import Pictures, Seen
from onboard.tracks.plane_filter import Motion, PlaneFilter

Array = NDArray[np.float64]

STRETCH_S = 0.5, 2.0  # that the way back must take which determines how poses stretch it, and how long at most
SCALE_S = 0.4  # after which it is looked up again how large a pixel is, and how poses stretch a way
FIRST_SPEED_S = 1.0  # that a thing has been measured for, before its speed is stated


class Track:
    """Begun with a click; fed with every picture that comes after it, each with its set, in order."""

    def __init__(self, number: int, pictures: Pictures, clicked: Seen, uv_px: Array, locator: Locator | None) -> None:
        self.number = number
        self._pictures = pictures
        self.follower = Follower(pictures, clicked, uv_px, _metres_a_pixel(locator, uv_px))
        self.clicked = clicked
        self._seen = clicked
        # In the newest picture: the ground at which it was measured last, and that at which it was earlier; since when.
        self._landmark: Array | None = None
        self._behind: Array | None = None
        self._behind_ns = self._filtered_ns = self._first_ns = clicked.stamp_ns
        self._filter: PlaneFilter | None = None
        # The newest picture that gives a place: what answers, for which pixel, the pixel's covariance (2, 2), m^2, and
        # when it was taken.
        self._placed: tuple[Locator, Array, Array, int] | None = None
        self._by_pixel: tuple[Array, int] | None = None  # metres (2, 2) a pixel on the ground, and when
        self._stretched_ns = 0
        self._status = Status.STARTING
        self.state = TrackState.FOLLOWED
        self._observed = Observation(clicked, self.follower.uv_px, 1.0, 0.0)
        self._measure(self._observed, locator)

    def take(self, seen: Seen, locator: Locator | None) -> None:
        """The next picture; `locator` of its set, None if that gives no place."""
        before, self._seen = self._seen, seen
        H = self._pictures.between(before, seen)
        self._landmark, self._behind = (_carried(H, uv) for uv in (self._landmark, self._behind))
        is_gap = (seen.stamp_ns - before.stamp_ns) * 1e-9 > LOST_AFTER_S  # whatever is there now may be another thing
        self._observed = self.follower.passed_over(seen) if is_gap else self.follower.follow(seen)
        if self._observed.is_seen:
            self.state = TrackState.FOLLOWED
            self._measure(self._observed, locator)
        else:
            self.state = TrackState.LOST if self.follower.is_lost(seen) else TrackState.COASTING

    @property
    def is_lost(self) -> bool:
        return self.state is TrackState.LOST

    def end(self) -> None:
        """It is lost for good: pictures that come later do not find it again."""
        self.state = TrackState.LOST

    def motion(self) -> Motion | None:
        """Return its velocity at the newest picture; None before anything is known of it."""
        is_known = self._filtered_ns - self._first_ns >= FIRST_SPEED_S * 1e9
        since_s = (self._seen.stamp_ns - self._filtered_ns) * 1e-9
        return None if self._filter is None or not is_known else self._filter.motion(since_s)

    def report(self, session: int, vehicle: str) -> TrackReport:
        """Return its report as of the newest picture: a lost thing has neither place nor speed."""
        seen, observed, motion = self._seen, self._observed, self.motion()
        course = None if motion is None else motion.course(motion.is_moving)
        if self.state is not TrackState.FOLLOWED:
            course = coasting(course, 0.0, self.follower.unseen_s(seen))
        place = None if self.is_lost else self._place(motion)
        status = Status.UNCERTAIN if self.is_lost else self._status
        return TrackReport(
            self.number, self.state, observed.unseen, session, seen.frame, seen.stamp_ns, float(observed.uv_px[0]),
            float(observed.uv_px[1]), self.follower.size_px, Status.OK if place is not None else status, place,
            None if self.is_lost else course, vehicle, self.follower.unseen_s(seen),
        )  # fmt: skip

    def _measure(self, observed: Observation, locator: Locator | None) -> None:
        """A picture's place and way, (24.10) and (24.11)."""
        if locator is None:
            return
        landmark = [] if self._landmark is None else [self._landmark]
        offset, *marked = locator.offsets([observed.uv_px, *landmark])
        if isinstance(offset, Status):
            self._status = offset
            return
        if self._by_pixel is None or observed.seen.stamp_ns - self._by_pixel[1] > SCALE_S * 1e9:
            parts = locator.error_parts(observed.uv_px)
            if parts is None:
                return
            self._by_pixel = parts.by_pixel_m[:2], observed.seen.stamp_ns
        by_pixel = self._by_pixel[0]
        own = observed.sigma_px**2 * by_pixel @ by_pixel.T
        self._placed = locator, observed.uv_px, own, observed.seen.stamp_ns
        slant = offset[:2] / max(abs(float(offset[2])), 1.0)
        noise = own + 1e-6 * np.eye(2)
        now = observed.seen.stamp_ns
        if self._filter is None:
            self._filter, self._first_ns, self._filtered_ns = PlaneFilter(slant, noise), now, now
            self._landmark = observed.uv_px
            return
        dt = (now - self._filtered_ns) * 1e-9
        self._filter.predict(dt, float(np.sqrt(abs(np.linalg.det(by_pixel)))))
        self._filtered_ns = now
        ground = marked[0] if marked else Status.OUTSIDE
        if isinstance(ground, Status):
            self._filter.forget_place(slant, noise)
        elif not self._filter.update(offset[:2] - ground[:2], slant, noise, dt):
            return
        self._landmark = observed.uv_px
        self._stretch(observed, locator)

    def _stretch(self, observed: Observation, locator: Locator) -> None:
        """How poses stretch and turn the way that it has come recently. (24.16)"""
        now, (least_s, most_s) = observed.seen.stamp_ns, STRETCH_S
        since_s = (now - self._behind_ns) * 1e-9
        if self._behind is None or since_s > most_s:
            self._behind, self._behind_ns = observed.uv_px, now
        elif since_s >= least_s and now - self._stretched_ns > SCALE_S * 1e9 and self._filter is not None:
            self._stretched_ns = now
            stretch = locator.difference_covariance(observed.uv_px, self._behind)
            if stretch is not None:
                self._filter.stretched(stretch[:2, :2], since_s)

    def _place(self, motion: Motion | None) -> Place | None:
        """(24.18): the newest picture's place, and on as it moves since."""
        if self._placed is None:
            return None
        locator, uv, own, at_ns = self._placed
        fix = locator.locate(uv)
        if not isinstance(fix, Fix):
            self._status = fix.status
            return None
        dt = (self._seen.stamp_ns - at_ns) * 1e-9
        lat, lon, covariance = fix.lat_deg, fix.lon_deg, fix.covariance_enu_m2[:2, :2] + own
        if dt > 0.0:
            if self._filter is None:
                return None
            moved, ahead = self._filter.ahead(dt)
            if motion is not None and motion.is_moving:
                lat, lon, _ = (float(c) for c in LocalFrame(lat, lon, 0.0).to_geodetic([*moved, 0.0]))
            covariance = covariance + ahead
            if self.state is not TrackState.FOLLOWED:
                speed = 0.0 if motion is None else motion.speed_m_s
                covariance = covariance + unforeseen_m2(speed, self.follower.unseen_s(self._seen)) * np.eye(2)
        ellipse = Ellipse.from_covariance(covariance)
        if not ellipse.semi_major_m <= MAX_ELLIPSE_SHARE * max(abs(float(fix.offset_enu_m[2])), 1.0):
            self._status = Status.UNCERTAIN
            return None
        return Place(lat, lon, fix.height_amsl_m, fix.height_ellipsoid_m, ellipse, fix.sigma_height_m)


def _carried(H: Array | None, uv_px: Array | None) -> Array | None:
    """Return where a pixel (2,) of a picture is in the next one; None if either is not known."""
    return None if H is None or uv_px is None else np.asarray(move(H, uv_px[None])[0], float)


def _metres_a_pixel(locator: Locator | None, uv_px: Array) -> float | None:
    """Return the metres on the ground that a pixel spans; None without a place."""
    parts = None if locator is None else locator.error_parts(uv_px)
    return None if parts is None else float(np.sqrt(abs(np.linalg.det(parts.by_pixel_m[:2]))))
