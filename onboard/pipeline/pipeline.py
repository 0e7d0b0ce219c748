"""Events in, feature sets out. No socket, no thread, no clock of its own: live and replay run this same code.

A picture waits until telemetry on both sides of its exposure has arrived, is tracked against the last keyframe,
becomes a keyframe itself when enough has moved, and gets a feature set: at once if the window has structure for it,
otherwise with the first solve that has; and once more, as a later revision, when the window has seen past it. Pictures
that come faster than sets can be sent get theirs only then, but for the newest (`record_book`).

A window solve never holds up tracking: a worker does it, and its outcome is adopted at a time that the data define, so
that the same events give the same sets however fast the worker is.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from onboard.config.schema import Config
from onboard.estimation.keyframe import Observation, observation
from onboard.estimation.moved_optics import MOVED
from onboard.estimation.platform_states import OFFSET
from onboard.estimation.prediction_error import prediction_sigma_px, turn_between, way_between
from onboard.estimation.sliding_window import Window
from onboard.estimation.solver_executor import Inline, Worker, timed_adjust
from onboard.events.types import Event, Frame, Zoom
from onboard.geometry.plane_homography import move
from onboard.geometry.robust import middle
from onboard.georeferencing.feature_sets import Origin, Picture
from onboard.georeferencing.surface_sets import over_known_ground
from onboard.navigation.limits import LIKELY_SIGMAS
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.estimates import found_in_flight
from onboard.pipeline.frozen_frames import Staleness, Stillness
from onboard.pipeline.keyframes import profile_of, wants_keyframe
from onboard.pipeline.mount_selection import MountSelection, carry_over
from onboard.pipeline.picture_motion import TURN_RAD_S, ground_so_far, moving_at, predict_motion, what_parts
from onboard.pipeline.placing import Placing
from onboard.pipeline.record_book import Pending, Record, RecordBook
from onboard.pipeline.statistics import MIN_OVERLAP, RunStatistics
from onboard.pipeline.summary import LeftOut, Summary
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
STANDING_PER_S = 0.01  # of the height above ground: slower than this is no parallax for as long as it lasts
LEAST_HEIGHT_M = 20.0  # that this is of
STANDING_S = 3.0  # before standing still is called that


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
        masks = [mask for mask in (burned_in, camera.rayless()) if mask is not None]
        if masks:
            self.tracker.leave_out(np.logical_or.reduce(masks))
        self.tracks = self.tracker.nothing()  # of the newest picture, for display
        self.window = Window(config, camera)
        self.mount_selection = MountSelection(self.window.R_body_cam)
        self._lens_doubt = LensDoubt()
        self._frame_doubt = FrameDoubt()
        self.zoom = ZoomFollowing(camera, config.camera.sigma_zoom)
        self.placing = Placing()
        self._waiting: deque[Frame] = deque()
        self._book = RecordBook(config)
        self._pending: Pending | None = None
        self._sets: list[FeatureSet] = []  # that have followed from the newest event so far
        self._now_ns = 0  # its stamp
        self.session: int | None = None  # its number; the second of its first picture, unless another is set before
        self._staleness, self._stillness = Staleness(), Stillness(camera.width_px)
        self._misses = self._failures = 0
        self._overlap = 1.0  # of the newest picture with the newest keyframe, as telemetry predicts it
        self._unsolved = Status.STARTING  # why there is no solution yet: as the last window was refused
        self._last_nav: NavState | None = None
        self._followed: NavState | None = None  # of the last picture that was followed by a prediction, or the keyframe
        self._frame: LocalFrame | None = None  # the navigation frame that the window's states are in
        self._statistics = RunStatistics(config)

    def handle(self, event: Event) -> list[FeatureSet]:
        """Take one event; returns the feature sets that follow from it, maybe of earlier pictures, maybe none."""
        self._now_ns, self._sets = event.stamp_ns, []
        if isinstance(event, Frame):
            self._waiting.append(event)
        elif isinstance(event, Zoom):
            self.zoom.note(event, self._offset_s, float(self.window.alignment.platform.sigma[OFFSET]))
        else:
            with self._statistics.timed("navigation"):
                self.navigation.add(event)
        if self._pending is not None and self._now_ns >= self._pending.due_ns:
            self._adopt()
        while self._is_next_ready:
            self._process(self._waiting.popleft())
            # A position that comes rarely releases many pictures at once: more than the window is long in a turn.
            self._catch_up()
        self._catch_up()
        return self._sets

    @property
    def _is_next_ready(self) -> bool:
        """True if telemetry on both sides of the next picture has arrived, or is awaited no longer."""
        if not self._waiting:
            return False
        # The moment that counts is the autopilot's: extrapolating to it would bend what is learned of the offset.
        stamp_ns, delay_s = self._waiting[0].stamp_ns, self.window.times_s()[1]
        is_covered = self.navigation.covers(self._moment_ns(stamp_ns), round(delay_s * 1e9))
        return is_covered or self._now_ns - stamp_ns >= MAX_WAIT_NS + self.navigation.behind_ns

    def finish(self) -> list[FeatureSet]:
        """The end of the data: place what still waits, and settle what the window holds."""
        self._sets = []
        while self._waiting:
            self._process(self._waiting.popleft())
        self._adopt()
        self._settle(self._book.take())
        self.window.conclude()
        return self._sets

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
            terrain_doubt=self.window.terrain_doubt,
            mounted_on=self.mount_selection.mounted_on(self.navigation),
            left_out=LeftOut(*self.tracker.left_out_shares),
        )

    def _process(self, frame: Frame) -> None:
        if self.session is None:
            self.session = (frame.stamp_ns // 1_000_000_000) & 0xFFFFFFFF
        refused = self._take_up(frame)
        if refused is not None:
            self._refuse(frame, refused)

    def _take_up(self, frame: Frame) -> Status | None:
        """Look at one picture; why it cannot be used, if it cannot."""
        if frame.image is None:
            return Status.BAD_PICTURE
        self._follow_mount()
        self._follow_zoom(frame.stamp_ns)
        if self.zoom.is_moving(frame.stamp_ns):
            return Status.ZOOMED
        with self._statistics.timed("navigation"):
            nav = self._state_at(frame.stamp_ns, frame.stamp_sigma_s)
        if nav is Status.NO_GPS:
            self._statistics.position_fault = self.navigation.reason
        if isinstance(nav, Status):
            return nav
        if self._staleness.is_stale(frame.image, nav, self._state_at):
            return Status.BAD_PICTURE
        last, self._last_nav = self._last_nav, nav
        parted_by = None if last is None else what_parts(last, nav, self.navigation, round(self._offset_s * 1e9))
        self._statistics.note_state(last, nav, parted_by)
        if parted_by is not None:  # this picture and the one before it may not be in one window
            self._restart()
        if self._frame is not self.navigation.frame:
            self._frame = self.navigation.frame
            self.window.forget_ground()
            self._lens_doubt.ground = None
        if self.terrain is not None:
            with self._statistics.timed("terrain"):
                self.window.change_terrain(terrain_about(self.terrain, self._frame, nav, self.window.terrain))
                self.window.see_take_off(nav)
        with self._statistics.timed("tracking"):
            tracks = self._track(frame.image, nav)
        if isinstance(tracks, Status):
            return tracks
        self._take_tracks(frame, nav, tracks, last is not None and nav.stamp_ns - last.stamp_ns > SLOW_NS)
        return None

    def _follow_mount(self) -> None:
        """Go over to the mount hypothesis that the pictures have selected, if that is another."""
        hypothesis = self.mount_selection.verdict
        if hypothesis and hypothesis is not self.navigation.mount_hypothesis:
            self._adopt()
            if not carry_over(self.window, self._book.records, self.navigation, hypothesis):
                self._restart()

    def _follow_zoom(self, stamp_ns: int) -> None:
        """Leave behind what was seen before the lens moved, and begin again with the camera that it has become.

        What was taken since is refused, whatever was reported of it.
        """
        if self.zoom.is_moving(stamp_ns) and self.window.keyframes:
            self._adopt()
            since_ns = self.zoom.suspect_since_ns
            zoomed = self._book.take_since(since_ns)
            self.window.forget_solution_since(since_ns)  # it has seen the zoom: what it places is placed wrongly
            self._restart()
            for record in zoomed:
                self._refuse(record.frame, Status.ZOOMED, record)
        stands = self.zoom.stands(stamp_ns)
        if stands is not None:
            self._restart()
            self.window.change_lens(*stands)
            self._lens_doubt.is_open = False
            self.camera = self.window.camera

    def _take_tracks(self, frame: Frame, nav: NavState, tracks: Tracks, is_slow: bool) -> None:
        """A tracked picture becomes a keyframe, is placed now or later, or has too few tracks for either."""
        self.tracks = tracks
        if not self.tracker.has_keyframe:
            # The first picture of a stretch: nothing to track against yet.
            self._make_keyframe(frame, nav, tracks)
            return
        self._statistics.track_counts.append(len(tracks))
        if len(tracks) < MIN_TRACKS:
            self._miss(frame, nav, is_slow)
            return
        self._misses = 0
        self._lens_doubt.tracked(len(tracks), tracks.offered)
        if wants_keyframe(tracks, self.camera.size_px):
            self._make_keyframe(frame, nav, tracks)
            return
        may_wait = self.window.solved is not None and self._book.may_wait(frame.stamp_ns, self._is_next_ready)
        record = Record(frame, lambda: self._seen(nav, tracks), nav, is_for_later=may_wait)
        self._book.records.append(record)
        if not may_wait:
            self._place(record)
            self._book.note_first(frame.stamp_ns, record.status is Status.OK)

    def _miss(self, frame: Frame, nav: NavState, is_slow: bool) -> None:
        """Too few tracks: the picture is refused, or all begins again with it."""
        self._misses += 1
        rate = self.navigation.body_rate_at(self._moment_ns(frame.stamp_ns))
        is_turning = rate is not None and float(np.linalg.norm(rate)) > TURN_RAD_S
        reason = Status.TURNING if is_turning else Status.FEATURELESS
        if self.tracker.is_ambiguous:  # there was enough to follow, and no one knows by how many rows it is off
            reason = Status.REPETITIVE
        if self._misses >= MAX_MISSES or (is_slow and self._overlap < MIN_OVERLAP):
            self._restart()  # which still adopts a window of before
            self._lens_doubt.lost(frame.stamp_ns, self._overlap)
            self.mount_selection.contradicted(nav)  # by which the features were looked for
            self._make_keyframe(frame, nav, self.tracker.nothing(), reason)
        else:
            self._refuse(frame, reason)

    @property
    def _offset_s(self) -> float:
        return self.window.times_s()[0]

    def _moment_ns(self, stamp_ns: int) -> int:
        return stamp_ns + round(self._offset_s * 1e9)

    def _state_at(self, stamp_ns: int, stamp_sigma_s: float = 0.0) -> NavState | Status:
        offset_s, delay_s = self.window.times_s()
        return self.navigation.state_at(stamp_ns, offset_s, stamp_sigma_s, delay_s)

    def _track(self, image: NDArray[np.uint8], nav: NavState) -> Tracks | Status:
        """Features found again, or why the picture is not to be used."""
        # While it is open what the camera is mounted on, the pictures must be tracked without a prediction by it.
        predicted = None if self.mount_selection.is_open(nav) else self._predict(nav)
        was = self.window.keyframes[-1].nav if self.window.keyframes else None
        self._overlap = self._statistics.note_overlap(self.camera, predicted, was, nav)
        sigma_px, plane = None, ground_so_far(self.window, nav)
        if predicted is not None and plane is not None and self.tracker.is_repeating and self._followed is not None:
            sigma_px = prediction_sigma_px(self.window, self.navigation, self._followed, nav, plane)
        tracks = self.tracker.track(image, predicted, sigma_px)
        if predicted is not None and len(tracks):
            self._followed = nav
        if predicted is not None and len(tracks) and self._stillness.is_old(tracks, predicted, nav.stamp_ns):
            return Status.BAD_PICTURE
        if len(tracks) < MIN_TRACKS:
            return tracks
        if was is not None and plane is not None:
            self.mount_selection.weigh(self.camera, was, nav, plane, tracks.keyframe_uv_px, tracks.uv_px)
        if predicted is not None:
            miss = middle(np.linalg.norm(move(predicted, tracks.keyframe_uv_px) - tracks.uv_px, axis=1))
            if miss > MAX_PREDICTION_MISS * self.camera.focal_px:
                return self.tracker.nothing()
        return tracks

    def _predict(self, nav: NavState) -> Array | None:
        """Motion since the newest keyframe, both moments looked up with one and the same time offset.

        None where attitudes come so rarely that a picture would be refused for what they miss.
        """
        if not self.window.keyframes:
            return None
        last = self.window.keyframes[-1]
        missed_rad = np.hypot(last.nav.attitude_sigma_rad, nav.attitude_sigma_rad)
        if LIKELY_SIGMAS * missed_rad > MAX_PREDICTION_MISS:
            return None
        was = last.nav if last.nav_offset_s == self._offset_s else self._state_at(last.nav.stamp_ns)
        if isinstance(was, Status):
            was = last.nav
        between = self.window, self.navigation, was, nav
        if self.tracker.is_repeating:
            return predict_motion(*between, way_between(*between)[0], turn_between(*between)[0])
        return predict_motion(*between)

    def _make_keyframe(self, frame: Frame, nav: NavState, tracks: Tracks, reason: Status | None = None) -> None:
        self._adopt()
        with self._statistics.timed("tracking"):
            ids, uv = self.tracker.promote(tracks)
        self._followed = nav
        self._stillness.begin(ids, uv, frame.stamp_ns)
        self.window.look_up_again(self.navigation)
        seen = observation(self.window.camera, ids, uv, moving_at(self.window, self.navigation, nav))
        moment_ns, displacement = self._moment_ns(frame.stamp_ns), None
        if self.window.keyframes:
            was_ns = self._moment_ns(self.window.keyframes[-1].nav.stamp_ns)
            displacement = self.navigation.displacement(was_ns, moment_ns)
        rate, flow_px = self.navigation.body_rate_at(moment_ns), self.tracker.flow_disagreement_px
        self.window.add(frame.index, seen, nav, self.window.times_s(), rate, displacement, flow_px)
        self._statistics.keyframes += 1
        record = Record(frame, lambda: seen, nav, is_keyframe=True)
        self._book.records.append(record)
        promise = self.worker.submit(timed_adjust, self.window.prepare(is_mount_open=self.mount_selection.is_open(nav)))
        self.mount_selection.begin_trials(self.window, self.worker, self.navigation)
        self._pending = Pending(promise, record, reason, self._now_ns + ADOPTION_NS)
        if reason is None:
            self._place(record)

    def _adopt(self) -> None:
        """Take the outcome of the solve under way, if there is one: wait for it, should it not be done."""
        pending, self._pending = self._pending, None
        if pending is None:
            return
        done, record = pending.promise.result(), pending.record
        outcome, trials_s = self.mount_selection.judged(done.outcome, self.window, self._book.records, self.navigation)
        self._statistics.stage_seconds["solve"] += done.processor_s + trials_s
        is_open = self.mount_selection.is_open(record.nav)
        clock = None if is_open else profile_of(outcome, self.window, self.navigation)
        status = self.window.adopt(self._frame_doubt.judged(self._lens_doubt.judged(outcome)), clock)
        if self.window.refusal:  # `what: how much`
            self._statistics.refused_windows[self.window.refusal.partition(":")[0]] += 1
        self._failures = self._failures + 1 if status is Status.POOR_FIT else 0
        if status in (Status.OK, Status.POOR_FIT, Status.LOW_PARALLAX, *MOVED):
            self._unsolved = Status.STARTING if status is Status.OK else status
        solved = self.window.solved
        if status is Status.OK and solved is not None:
            self._statistics.reprojections_px.append(solved.reprojection_px)
            self._place(record)
            self._book.queue(solved.frames, self.config.solve.keyframes // 2)
            return
        if status in (Status.MIRRORED, Status.STRETCHED):  # so are the pictures that were answered before it was seen
            for each in self._book.take(before=record.frame.index):
                self._refuse(each.frame, status, each)
        if self._failures >= MAX_FAILURES:
            # The window's keyframes do not fit together: begin again with this one alone.
            self._settle(self._book.take(before=record.frame.index))
            self.window.begin_again()
            self._failures = 0
        if status is Status.STARTING:
            status = self._unsolved
        elif status is Status.FEATURELESS:
            status = self._why_without_depth(record)
        if record.status is not Status.OK:
            self._refuse(record.frame, pending.reason or status, record)

    def _restart(self) -> None:
        """Begin again: what the window could place is settled first."""
        self._adopt()
        self._settle(self._book.take())
        self.window.reset()
        self.tracker.forget()
        self.placing.forget()
        self._misses = 0

    def _catch_up(self) -> None:
        """A few of the pictures that a solve allows to be placed, or placed for good: the newest that have no set."""
        for _ in range(PLACED_AN_EVENT):
            if self._book.unplaced:
                record = self._book.unplaced.pop()
                if record.status is not Status.OK:
                    self._place(record)
            elif self._book.settling:
                self._settle([self._book.settling.popleft()])

    def _settle(self, records: list[Record]) -> None:
        """The last revision of pictures that the window has seen past, where it holds anything new."""
        solved = self.window.solved
        for record in records:
            if not record.is_settled and (solved is not None or record.revision < 0):
                record.settle()
                if solved is None or not self.placing.is_needless(solved, record):
                    self._place(record)

    def _place(self, record: Record) -> None:
        """A picture's set by the newest solution; a refusal if it has had neither yet and waits for no solve."""
        with self._statistics.timed("georeference"):
            result = self._feature_set(record)
        if isinstance(result, FeatureSet):
            self._add(result, record)
        elif record.revision < 0 and (self._pending is None or self._pending.record is not record):
            self._refuse(record.frame, result, record)

    def _feature_set(self, record: Record) -> FeatureSet | Status:
        """The picture's set by the window's own points, else over a known ground; otherwise the reason for none."""
        taken, nav, solved = record.frame, record.nav, self.window.solved
        assert self._frame is not None and self.session is not None
        identity = self.config.vehicle.id, self.session, taken.index, taken.stamp_ns
        origin = Origin(*identity, min(record.revision + 1, 255), record.is_keyframe)
        camera, readout = (solved or self.window).camera, self.window.readout
        picture = Picture(camera, origin, self._frame, nav.undulation_m, record.seen.moving, readout)
        result: FeatureSet | Status
        if solved is None:
            result = self._why_unsolved(nav)
        else:
            record.see_with(solved.camera, solved.readout_s)
            result = self.placing.place(self.window, solved, record, picture)
        if result is Status.FEATURELESS:
            result = self._why_without_depth(record)
        # Where the mount is open or the optics have moved, nothing determines where the camera looks, or only the
        # attitude.
        is_moved = self._unsolved in MOVED or self._lens_doubt.is_open
        if isinstance(result, FeatureSet) or is_moved or self.mount_selection.is_open(nav):
            return result
        over = over_known_ground(self.config, self.window, nav, picture)
        return result if over is None else over

    def _seen(self, nav: NavState, tracks: Tracks) -> Observation:
        """The picture's observations, by the calibration that it is placed by."""
        camera, moving = (self.window.solved or self.window).camera, moving_at(self.window, self.navigation, nav)
        return observation(camera, tracks.ids, tracks.uv_px, moving)

    def _why_without_depth(self, record: Record) -> Status:
        """FEATURELESS only where the picture is: else its features are too new to have depth, as after a spin."""
        ids = record.seen.ids
        if len(ids) < MIN_TRACKS:
            return Status.FEATURELESS
        same = (k.nav for k in self.window.keyframes if len(np.intersect1d(k.observation.ids, ids)) >= MIN_TRACKS)
        return self._why_unsolved(record.nav, next(same, None))

    def _why_unsolved(self, nav: NavState, first: NavState | None = None) -> Status:
        """Starting, or standing still since `first`, the window's first by default: no parallax will come of that.

        By the mean speed: in a hover wind and receiver move the position by metres, but on the whole nowhere.
        """
        first = first or next((k.nav for k in self.window.keyframes), nav)
        lasted_s = (nav.stamp_ns - first.stamp_ns) / 1e9
        travelled_m = float(np.linalg.norm(nav.position_enu_m - first.position_enu_m))
        height_m = max(nav.height_above_home_m or 0.0, LEAST_HEIGHT_M)
        is_still = lasted_s > STANDING_S and travelled_m < STANDING_PER_S * height_m * lasted_s
        return Status.LOW_PARALLAX if is_still else self._unsolved

    def _refuse(self, frame: Frame, status: Status, record: Record | None = None) -> None:
        """Refuse a picture, by its record's next revision if it has one."""
        revision, is_keyframe = (0, False) if record is None else (record.revision + 1, record.is_keyframe)
        assert self.session is not None
        identity = self.config.vehicle.id, self.session, frame.index, frame.stamp_ns
        self._add(FeatureSet(*identity, status, self.camera, revision, is_keyframe), record)

    def _add(self, feature_set: FeatureSet, record: Record | None) -> None:
        if record is not None:
            record.answer(feature_set)
        self._statistics.note(feature_set.frame, feature_set.status)
        self._sets.append(feature_set)
