"""Events in, feature sets out. No socket, no thread, no clock of its own: live and replay run this same code.

A picture waits until telemetry on both sides of its exposure has arrived, is tracked against the last keyframe,
becomes a keyframe itself when enough has moved, and gets a feature set: at once if the window has structure for it,
otherwise with the first solve that has; and once more, as a later revision, when the window has seen past it. Pictures
that come faster than sets can be sent get theirs only then, but for the newest (`first_placing`).

A window solve never holds up tracking: a worker does it, and its outcome is adopted at a time that the data define, so
that the same events give the same sets however fast the worker is.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from onboard.config.schema import Config
from onboard.estimation.keyframe import Observation, seen_with
from onboard.estimation.moved_optics import MOVED
from onboard.estimation.platform_states import OFFSET
from onboard.estimation.sliding_window import Window
from onboard.estimation.solver_executor import Inline, Worker, timed_adjust
from onboard.events.types import Event, Frame, Zoom
from onboard.geometry.plane_homography import move
from onboard.geometry.robust import middle
from onboard.georeferencing.feature_sets import Origin, Picture
from onboard.georeferencing.surface_sets import over_known_ground
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.estimates import found_in_flight
from onboard.pipeline.frozen_frames import Staleness, Stillness
from onboard.pipeline.keyframes import look_up_again, profile_of, wants_keyframe
from onboard.pipeline.mount_selection import MountSelection
from onboard.pipeline.mount_trial import MountTrials, carry_over
from onboard.pipeline.picture_motion import TURN_RAD_S, ground_so_far, predict_motion, seen_at, what_parts
from onboard.pipeline.placing import Placing
from onboard.pipeline.record_book import FirstPlacing, Pending, Record, RecordBook
from onboard.pipeline.shortfall import MIN_OVERLAP, Evidence, is_standing_still
from onboard.pipeline.statistics import LeftOut, RunStatistics, Summary
from onboard.pipeline.terrain_at_hand import TerrainSource, terrain_about
from onboard.pipeline.window_doubt import FrameDoubt, LensDoubt
from onboard.pipeline.zoom_following import ZoomFollowing
from onboard.vision.klt_tracker import MIN_TRACKS, Tracks
from onboard.vision.reduced_tracker import tracker_for

Array = NDArray[np.float64]

MAX_WAIT_NS = 1_500_000_000  # for telemetry to catch up with a picture
MAX_FAILURES = 4  # window solves in a row without a result before a new start
MAX_MISSES = 3  # pictures in a row that found too little before a new start
SLOW_NS = 1_000_000_000  # between pictures, above which one that has lost the keyframe's ground begins again at once
MAX_PREDICTION_MISS = 0.15  # rad: tracks this far from telemetry's prediction have locked onto the wrong features
PLACED_AN_EVENT = 2  # a solve releases as many pictures as lie between two keyframes: all at once would delay the next
ADOPTION_NS = 250_000_000  # of data after a keyframe is taken up, until which its solve need not be done


class Pipeline:
    """The whole of the aircraft's work on one flight."""

    def __init__(
        self,
        config: Config,
        camera: Camera,
        terrain: TerrainSource | None = None,
        worker: Worker | None = None,
        burned_in: NDArray[np.bool_] | None = None,
    ) -> None:
        """`worker` solves the windows; by default this thread does, at once. `burned_in` (H, W): where no ground is."""
        self.terrain = terrain
        self.worker: Worker = Inline() if worker is None else worker
        self.config = config
        self.camera = camera
        self.navigation = Navigation(config)
        self.tracker = tracker_for(camera.size_px, config.tracking.features, config.tracking.min_distance_px)
        if burned_in is not None:
            self.tracker.leave_out(burned_in)
        self.window = Window(config, camera)
        self.mount_selection = MountSelection(camera, self.window.R_body_cam)
        self._lens_doubt = LensDoubt()
        self._frame_doubt = FrameDoubt()
        self.zoom = ZoomFollowing(camera, config.camera.sigma_zoom)
        self._trials = MountTrials(self.mount_selection)
        self.placing, self._first_placing = Placing(), FirstPlacing(config)
        self.tracks: Tracks | None = None  # of the newest picture, for display
        self._waiting: deque[Frame] = deque()
        self._book = RecordBook()
        self._pending: Pending | None = None
        self._now_ns = 0  # stamp of the newest event
        self._session: int | None = None
        self._staleness, self._stillness = Staleness(), Stillness(camera.width_px)
        self._misses = self._failures = 0
        self._overlap = 1.0  # of the newest picture with the newest keyframe, as telemetry predicts it
        self._unsolved = Status.STARTING  # why there is no solution yet: as the last window was refused
        self._last_nav: NavState | None = None
        self._frame: LocalFrame | None = None  # the navigation frame that the window's states are in
        self._statistics = RunStatistics(Evidence(config))

    def handle(self, event: Event) -> list[FeatureSet]:
        """Take one event; returns the feature sets that follow from it, maybe of earlier pictures, maybe none."""
        self._now_ns = event.stamp_ns
        if isinstance(event, Frame):
            self._waiting.append(event)
        elif isinstance(event, Zoom):
            self.zoom.note(event, self._offset_s, float(self.window.alignment.platform.sigma[OFFSET]))
        else:
            with self._statistics.timed("navigation"):
                self.navigation.add(event)
        is_due = self._pending is not None and self._now_ns >= self._pending.due_ns
        out = self._adopt() if is_due else []
        while self._waiting and self._is_ready(self._waiting[0]):
            out.extend(self._process(self._waiting.popleft()))
            # A position that comes rarely releases many pictures at once: more than the window is long in a turn.
            out.extend(self._catch_up())
        out.extend(self._catch_up())
        return out

    def _is_ready(self, frame: Frame) -> bool:
        """Whether telemetry on both sides of a picture has arrived, or is waited for no longer."""
        # The moment that counts is the autopilot's: extrapolating to it would bend what is learned of the offset.
        moment_ns = self._moment_ns(frame.stamp_ns)
        waited_ns = self._now_ns - frame.stamp_ns
        is_covered = self.navigation.covers(moment_ns, round(self._delay_s * 1e9))
        return is_covered or waited_ns >= MAX_WAIT_NS + self.navigation.behind_ns

    def finish(self) -> list[FeatureSet]:
        """The end of the data: place what still waits, and settle what the window holds."""
        out: list[FeatureSet] = []
        while self._waiting:
            out.extend(self._process(self._waiting.popleft()))
        out.extend(self._adopt())
        out.extend(self._settle_all())
        self.window.conclude()
        return out

    @property
    def summary(self) -> Summary:
        """Counts so far; a picture counts by its latest revision."""
        estimates, sensor_errors, unconfirmed, contradictions = found_in_flight(self.config, self.window, self._now_ns)
        return replace(
            self._statistics.summary,
            estimates=estimates,
            sensor_errors=sensor_errors,
            unconfirmed=unconfirmed,
            contradictions=contradictions,
            carrier=self.mount_selection.carrier(self.navigation),
            left_out=LeftOut(*self.tracker.left_out_shares),
        )

    def _process(self, frame: Frame) -> list[FeatureSet]:
        if self._session is None:
            self._session = (frame.stamp_ns // 1_000_000_000) & 0xFFFFFFFF
        if frame.image is None:
            return [self._refuse(frame, Status.BAD_PICTURE)]
        out = [*self._follow_mount(), *self._follow_zoom(frame.stamp_ns)]
        if self.zoom.is_moving(frame.stamp_ns):
            return [*out, self._refuse(frame, Status.ZOOMED)]
        nav = self._navigated(frame)
        if isinstance(nav, Status):
            return [*out, self._refuse(frame, nav)]
        out.extend(self._part_from_last(nav))
        if self._frame is not self.navigation.frame:
            self._frame, self.window.terrain = self.navigation.frame, None
            self.window.ground_slope.forget()
            self._lens_doubt.forget_ground()
        is_slow = self._last_nav is not None and nav.stamp_ns - self._last_nav.stamp_ns > SLOW_NS
        self._last_nav = nav
        if self.terrain is not None:
            with self._statistics.timed("terrain"):
                self.window.terrain = terrain_about(self.terrain, self._frame, nav, self.window.terrain)
        with self._statistics.timed("tracking"):
            tracks = self._track(frame, nav)
        if isinstance(tracks, Status):
            return [*out, self._refuse(frame, tracks)]
        return [*out, *self._take_tracks(frame, nav, tracks, is_slow)]

    def _follow_mount(self) -> list[FeatureSet]:
        """Go over to the mount hypothesis that the pictures have selected, if that is another."""
        hypothesis = self.mount_selection.verdict
        if not hypothesis or hypothesis is self.navigation.mount_hypothesis:
            return []
        out = self._adopt()
        if not carry_over(self.window, self._book.records, self.navigation, hypothesis):
            out.extend(self._restart())
        return out

    def _follow_zoom(self, stamp_ns: int) -> list[FeatureSet]:
        """Leave behind what was seen before the lens moved, and begin again with the camera that it has become."""
        out: list[FeatureSet] = []
        if self.zoom.is_moving(stamp_ns) and self.window.keyframes:
            out = self._forget_zoomed(self.zoom.suspect_since_ns)
        stands = self.zoom.stands(stamp_ns)
        if stands is not None:
            camera, sigma = stands
            out += self._restart()
            self.window.change_lens(camera, sigma)
            self._lens_doubt.settle()
            self.camera = self.window.camera
            self.mount_selection.change_lens(self.camera)
        return out

    def _forget_zoomed(self, since_ns: int) -> list[FeatureSet]:
        """Settle what was taken before the lens moved; what was taken since is refused, whatever was said of it."""
        out = self._adopt()
        zoomed = [r for r in self._book.records if r.frame.stamp_ns >= since_ns]
        self._book.records = [r for r in self._book.records if r.frame.stamp_ns < since_ns]
        if self.window.keyframes[-1].nav.stamp_ns >= since_ns:
            self.window.solved = None  # it has seen the zoom: what it places is placed wrongly
        return [*out, *self._restart(), *(self._refuse_record(r, Status.ZOOMED) for r in zoomed)]

    def _navigated(self, frame: Frame) -> NavState | Status:
        """Where the aircraft was, or why the picture cannot be used."""
        assert frame.image is not None
        with self._statistics.timed("navigation"):
            nav = self._state_at(frame.stamp_ns, frame.stamp_sigma_s)
        if nav is Status.NO_GPS:
            self._statistics.evidence.navigation = self.navigation.reason
        if isinstance(nav, Status):
            return nav
        return Status.BAD_PICTURE if self._staleness.is_stale(frame.image, nav, self._state_at) else nav

    def _take_tracks(self, frame: Frame, nav: NavState, tracks: Tracks | None, is_slow: bool) -> list[FeatureSet]:
        """A tracked picture becomes a keyframe, is placed now or later, or is refused because of too few tracks."""
        self.tracks = tracks
        if tracks is None:
            # The first picture of a stretch: nothing to track against yet.
            return self._make_keyframe(frame, nav, self.tracker.nothing())
        self._statistics.track_counts.append(len(tracks))
        if len(tracks) < MIN_TRACKS:
            self._misses += 1
            reason = Status.TURNING if self._is_turning(frame) else Status.FEATURELESS
            if self._misses >= MAX_MISSES or (is_slow and self._overlap < MIN_OVERLAP):
                out = self._restart()  # which still adopts a window of before
                self._lens_doubt.lost(frame.stamp_ns, self._overlap)
                return [*out, *self._make_keyframe(frame, nav, self.tracker.nothing(), reason)]
            return [self._refuse(frame, reason)]
        self._misses = 0
        self._lens_doubt.tracked(len(tracks), tracks.offered)
        if wants_keyframe(tracks, self.camera.width_px):
            return self._make_keyframe(frame, nav, tracks)
        record = Record(frame, partial(self._seen, nav, tracks), nav, False)
        self._book.add(record)
        has_newer = bool(self._waiting) and self._is_ready(self._waiting[0])
        record.is_for_later = self.window.solved is not None and self._first_placing.may_wait(frame.stamp_ns, has_newer)
        if record.is_for_later:
            return []
        out = self._place(record)
        self._first_placing.note(frame.stamp_ns, record.status is Status.OK)
        return out

    def _part_from_last(self, nav: NavState) -> list[FeatureSet]:
        """Begin again where this picture and the one before it may not be in one window."""
        last, evidence, why = self._last_nav, self._statistics.evidence, None
        if last is not None:
            why = what_parts(last, nav, self.navigation, round(self._offset_s * 1e9))
            evidence.note_step((nav.stamp_ns - last.stamp_ns) / 1e9, why)
        evidence.note_place(nav.position_enu_m, nav.height_above_home_m, nav.R_enu_body is not None)
        return [] if why is None else self._restart()

    @property
    def _offset_s(self) -> float:
        """Camera-to-autopilot time offset as it is known now."""
        return self.window.times_s()[0]

    def _moment_ns(self, stamp_ns: int) -> int:
        """A picture's moment on the autopilot's clock."""
        return stamp_ns + round(self._offset_s * 1e9)

    @property
    def _delay_s(self) -> float:
        """How much older than its stamp the position is, beyond `gps.latency_s`, as it is known now."""
        return self.window.times_s()[1]

    def _state_at(self, stamp_ns: int, stamp_sigma_s: float = 0.0) -> NavState | Status:
        return self.navigation.state_at(stamp_ns, self._offset_s, stamp_sigma_s, self._delay_s)

    def _track(self, frame: Frame, nav: NavState) -> Tracks | Status | None:
        """Features found again; None if there was nothing to look for, a status if the picture is not to be used."""
        assert frame.image is not None
        # While it is open what the camera is mounted on, the pictures must be tracked without a prediction by it.
        predicted = None if self.mount_selection.is_open(nav) else self._predict(nav)
        was = self.window.keyframes[-1].nav if self.window.keyframes else None
        self._overlap = self._statistics.evidence.note_overlap(self.camera, predicted, was, nav)
        tracks = self.tracker.track(frame.image, predicted)
        if not self.tracker.has_keyframe:
            return None
        if predicted is not None and len(tracks) and self._stillness.is_old(tracks, predicted, frame.stamp_ns):
            return Status.BAD_PICTURE
        plane = ground_so_far(self.window, nav)
        if nav.mount_hypotheses and self.window.keyframes and plane is not None and len(tracks) >= MIN_TRACKS:
            self.mount_selection.weigh(self.window.keyframes[-1].nav, nav, plane, tracks.keyframe_uv_px, tracks.uv_px)
        if predicted is not None and len(tracks) >= MIN_TRACKS:
            miss = middle(np.linalg.norm(move(predicted, tracks.keyframe_uv_px) - tracks.uv_px, axis=1))
            if miss > MAX_PREDICTION_MISS * self.camera.focal_px:
                return self.tracker.nothing()
        return tracks

    def _predict(self, nav: NavState) -> Array | None:
        """Motion since the newest keyframe, both moments looked up with one and the same time offset."""
        if not self.window.keyframes:
            return None
        last = self.window.keyframes[-1]
        was = last.nav if last.nav_offset_s == self._offset_s else self._state_at(last.nav.stamp_ns)
        return predict_motion(self.window, self.navigation, last.nav if isinstance(was, Status) else was, nav)

    def _is_turning(self, frame: Frame) -> bool:
        rate = self.navigation.body_rate_at(self._moment_ns(frame.stamp_ns))
        return rate is not None and float(np.linalg.norm(rate)) > TURN_RAD_S

    def _make_keyframe(
        self, frame: Frame, nav: NavState, tracks: Tracks, reason: Status | None = None
    ) -> list[FeatureSet]:
        out = self._adopt()
        with self._statistics.timed("tracking"):
            ids, uv = self.tracker.promote(tracks)
        self._stillness.begin(ids, uv, frame.stamp_ns)
        look_up_again(self.window, self.navigation)
        seen = seen_at(self.window, self.window.camera, self.navigation, nav, replace(tracks, ids=ids, uv_px=uv))
        moment_ns, displacement = self._moment_ns(frame.stamp_ns), None
        if self.window.keyframes:
            displacement = self.navigation.displacement(
                self._moment_ns(self.window.keyframes[-1].nav.stamp_ns), moment_ns
            )
        rate = self.navigation.body_rate_at(moment_ns)
        self.window.add(
            frame.index,
            seen,
            nav,
            (self._offset_s, self._delay_s),
            rate,
            displacement,
            self.tracker.flow_disagreement_px,
        )
        self._statistics.keyframes += 1
        record = Record(frame, seen, nav, True)
        self._book.add(record)
        promise = self.worker.submit(timed_adjust, self.window.prepare(is_mount_open=self.mount_selection.is_open(nav)))
        self._trials.begin(self.window, self.worker, self.navigation)
        self._pending = Pending(promise, record, reason, self._now_ns + ADOPTION_NS)
        if reason is None:
            out.extend(self._place(record, only_ok=True))
        return out

    def _adopt(self) -> list[FeatureSet]:
        """Take the outcome of the solve under way, if there is one: wait for it, should it not be done."""
        pending, self._pending = self._pending, None
        if pending is None:
            return []
        done, record = pending.promise.result(), pending.record
        outcome, trials_s = self._trials.judged(done.outcome, self.window, self._book.records, self.navigation)
        self._statistics.spend("solve", done.processor_s + trials_s)
        is_open = self.mount_selection.is_open(record.nav)
        clock = None if is_open else profile_of(outcome, self.window, self.navigation)
        status = self.window.adopt(self._frame_doubt.judged(self._lens_doubt.judged(outcome)), clock)
        self._statistics.note_window(self.window.refusal)
        self._failures = self._failures + 1 if status is Status.POOR_FIT else 0
        if status in (Status.OK, Status.POOR_FIT, Status.LOW_PARALLAX, *MOVED):
            self._unsolved = Status.STARTING if status is Status.OK else status
        solved = self.window.solved
        if status is not Status.OK or solved is None:
            out: list[FeatureSet] = []
            if self._failures >= MAX_FAILURES:
                # What the window holds does not fit together: begin again with this keyframe alone.
                out = self._settle(self._book.take_before(record))
                self.window.begin_again()
                self._failures = 0
            if record.status is Status.OK:
                return out
            reported = self._unsolved if status is Status.STARTING else status
            if status is Status.FEATURELESS:
                reported = self._why_without_depth(record)
            return [*out, self._refuse_record(record, pending.reason or reported)]
        self._statistics.reprojections_px.append(solved.reprojection_px)
        out = self._place(record)
        self._book.queue(solved.frames, self.config.solve.keyframes // 2)
        return out

    def _restart(self) -> list[FeatureSet]:
        """Begin again: what the window could place is settled first."""
        out = [*self._adopt(), *self._settle_all()]
        self.window.reset()
        self.tracker.forget()
        self.placing.forget()
        self._misses = 0
        return out

    def _catch_up(self) -> list[FeatureSet]:
        """A few of the pictures that a solve allows to be placed, or placed for good: the newest that have no set."""
        out: list[FeatureSet] = []
        for _ in range(PLACED_AN_EVENT):
            if self._book.unplaced:
                record = self._book.unplaced.pop()
                if record.status is not Status.OK:
                    out.extend(self._place(record))
            elif self._book.settling:
                out.extend(self._settle([self._book.settling.popleft()]))
        return out

    def _settle_all(self) -> list[FeatureSet]:
        """The last revision of all that the window holds, which is then forgotten."""
        return self._settle(self._book.take_all())

    def _settle(self, records: list[Record]) -> list[FeatureSet]:
        """The last revision of pictures that the window has seen past, where it holds anything new."""
        solved, out = self.window.solved, []
        for record in records:
            is_first = record.is_for_later and record.revision < 0
            if not record.is_settled and (solved is not None or is_first):
                record.is_settled = True
                if is_first or solved is None or not self.placing.is_needless(solved, record):
                    out.extend(self._place(record, only_ok=not is_first))
        return out

    def _place(self, record: Record, only_ok: bool = False) -> list[FeatureSet]:
        """A picture's set by the newest solution; a refusal too, unless `only_ok` or refused before."""
        with self._statistics.timed("georeference"):
            result = self._feature_set(record)
        if isinstance(result, FeatureSet):
            return [result]
        return [] if only_ok or record.revision >= 0 else [self._refuse_record(record, result)]

    def _feature_set(self, record: Record) -> FeatureSet | Status:
        frame = self._frame
        if frame is None or self._session is None:
            return Status.STARTING
        index, stamp_ns, revision = record.frame.index, record.frame.stamp_ns, min(record.revision + 1, 255)
        origin = Origin(self.config.vehicle.id, self._session, index, stamp_ns, revision, record.is_keyframe)
        solved = self.window.solved
        camera = (solved or self.window).camera
        picture = Picture(camera, origin, frame, record.nav.undulation_m, record.seen.moving, self.window.readout)
        result = self._by_structure(record, picture)
        # Where the mount is open or the optics have moved, nothing determines where the camera looks, or only the
        # attitude.
        is_moved = self._unsolved in MOVED or self._lens_doubt.is_open
        if isinstance(result, Status) and not (self.mount_selection.is_open(record.nav) or is_moved):
            over = over_known_ground(self.config, self.window, record.nav, picture)
            result = result if over is None else over
        if isinstance(result, FeatureSet):
            record.status, record.revision = Status.OK, result.revision
            self._statistics.note(record.frame.index, Status.OK)
        return result

    def _seen(self, nav: NavState, tracks: Tracks) -> Observation:
        """What a picture saw, by the calibration that it is placed by."""
        return seen_at(self.window, (self.window.solved or self.window).camera, self.navigation, nav, tracks)

    def _by_structure(self, record: Record, picture: Picture) -> FeatureSet | Status:
        """From the window's own points; the reason why not otherwise."""
        solved = self.window.solved
        if solved is None:
            return self._why_unsolved(record.nav)
        record.seen = seen_with(solved.camera, record.seen, solved.readout_s)
        result = self.placing.place(self.window, solved, record, picture)
        return self._why_without_depth(record) if result is Status.FEATURELESS else result

    def _why_without_depth(self, record: Record) -> Status:
        """FEATURELESS only where the picture is: else its features are too new to have depth, as after a spin."""
        if len(record.seen.ids) < MIN_TRACKS:
            return Status.FEATURELESS
        same = (
            k for k in self.window.keyframes if len(np.intersect1d(k.observation.ids, record.seen.ids)) >= MIN_TRACKS
        )
        return self._why_unsolved(record.nav, next((k.nav for k in same), None))

    def _why_unsolved(self, nav: NavState, first: NavState | None = None) -> Status:
        """Starting, or standing still since `first`, the window's first by default: no parallax will come of that."""
        first = first or next((k.nav for k in self.window.keyframes), nav)
        return Status.LOW_PARALLAX if is_standing_still(first, nav) else self._unsolved

    def _refuse_record(self, record: Record, status: Status) -> FeatureSet:
        record.status = status
        record.revision += 1
        return replace(self._refuse(record.frame, status), revision=record.revision, is_keyframe=record.is_keyframe)

    def _refuse(self, frame: Frame, status: Status) -> FeatureSet:
        self._statistics.note(frame.index, status)
        assert self._session is not None
        return FeatureSet(self.config.vehicle.id, self._session, frame.index, frame.stamp_ns, status, self.camera)
