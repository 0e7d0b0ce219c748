"""The thread that answers the clicks of a MAVLink camera component, on board next to the pipeline or on the ground.

Who makes or receives sets only hands them over, and a click only joins a short queue: however many come, nothing else
waits for them. A click bears no picture's time, only its arrival: the sets around the moment when its picture was
taken answer it, and those to come are waited for a little.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse, Fix
from contract.feature_set import FeatureSet
from contract.history import History
from contract.locate import Locator
from contract.mavlink_camera.end import Answered, Asked, Clicked, VideoClick, View, ViewQuestion
from contract.supervised_thread import SupervisedThread, WokenWork
from contract.track import StartTrack, StopTrack, TrackReport, Unseen, parameters_of
from contract.track_age import as_of
from contract.untimed_click import UntimedClick, locate_untimed, pixel_at
from contract.wire.track_code import decode_tracks

MAX_ASKED = 4  # that wait for this thread
MAX_ANSWERED = 8
MAX_SETS = 600
WAIT_S = 1.0  # for the sets of pictures that are taken while the click arrives
IDLE_S = 0.5
POLL_S = 0.05
SILENT_S = 3.0  # without a report, or a pose, after which what was followed, or the view, is not any more
REST = 1.0  # of the time that it worked, in which it leaves the processor to others
MOST_REST_S = 0.1
STOPPED = "stopped before it was answered"

Follow = Callable[[str], tuple[bytes, bool]]
"""Answers requests about tracks: JSON, and whether it is a refusal."""


@dataclass(frozen=True, eq=False)
class _Followed:
    """The track of the last click, what its click's moment adds to its covariance, and its newest report with when
    that came.
    """

    track: int
    by_delay_m2: NDArray[np.float64]
    since_s: float
    report: TrackReport | None = None


class CameraClicks(WokenWork):
    """A sink of the daemon's, and a `CameraEnd`. A click arrives `delay_s` after its picture was taken, with one sigma
    of `sigma_delay_s`. `monotonic_s` is a clock; `follow` is set where things are followed, `stamped_ago_s` (how long
    ago the aircraft stamped something so, Unix ns) where that is known: without it, what has come is new as it comes.
    """

    def __init__(
        self, vehicle: str, delay_s: float, sigma_delay_s: float, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__("camera clicks")
        self._delay_s, self._sigma_s = delay_s, sigma_delay_s
        self._vehicle, self._monotonic_s = vehicle, monotonic_s
        self.follow: Follow | None = None
        self.stamped_ago_s: Callable[[int], float] = lambda unix_ns: 0.0
        reach_s = self._delay_s + 4.0 * self._sigma_s + WAIT_S + 5.0
        self._sets: History[FeatureSet] = History(reach_s, MAX_SETS)
        self._asked: deque[tuple[Asked, float]] = deque()
        self._answered: deque[Answered] = deque(maxlen=MAX_ANSWERED)
        self._followed: _Followed | None = None
        self._placed_s = -math.inf  # when a set came that gives a pose
        self._ended: deque[int] = deque()  # tracks that are to be ended
        self._stops = 0  # how often nothing more was to be followed

    # --- from those who have sets and reports ---

    def event(self, arrival_ns: int, event: object) -> None:
        """Ignore it: sets have all that is needed."""

    def feature_set(self, output: FeatureSet) -> None:
        """A picture's set, the first or a later one."""
        with self._changed:
            self._sets.add(output, output, runs=True)
            if output.is_ok:
                self._placed_s = self._monotonic_s()
            if self._asked:
                self._changed.notify()

    def tracks(self, capture_unix_ns: int, payload: bytes) -> None:
        """Take the reports of all tracks, in one packet."""
        with self._changed:
            followed = self._followed
            if followed is None:
                return
            for report in decode_tracks(payload, self._vehicle):
                if report.number == followed.track:
                    self._followed = replace(followed, report=report, since_s=self._monotonic_s())

    # --- from the thread of the MAVLink line ---

    def ask(self, asked: Asked) -> bool:
        """Take a question; False where too many wait already."""
        with self._changed:
            if len(self._asked) >= MAX_ASKED:
                return False
            self._asked.append((asked, self._monotonic_s()))
            self._changed.notify()
            return True

    def answers(self) -> list[Answered]:
        with self._changed:
            out = list(self._answered)
            self._answered.clear()
            return out

    def stop(self) -> None:
        """Follow what was clicked no longer, nor what a click asks for that is not answered yet."""
        with self._changed:
            self._stops += 1
            self._asked = deque(entry for entry in self._asked if not isinstance(entry[0], VideoClick))
        self._end_followed()

    def _end_followed(self) -> None:
        with self._changed:
            if self._followed is not None:
                self._ended.append(self._followed.track)
                self._followed = None
                self._changed.notify()

    def followed(self) -> TrackReport | None:
        """The newest report of the thing that is followed, as of now: no message of the standard's states when it was
        there. Its ellipse is as wide as the click's moment makes it. None without one.
        """
        followed = self._still_followed()
        if followed is None or followed.report is None:
            return None
        silent_s = self._monotonic_s() - followed.since_s
        age_s = max(silent_s, self.stamped_ago_s(followed.report.capture_unix_ns))
        return _widened(as_of(followed.report, age_s, silent_s, Unseen.NO_REPORT), followed.by_delay_m2)

    @property
    def is_following(self) -> bool:
        return self._still_followed() is not None

    def _still_followed(self) -> _Followed | None:
        with self._changed:
            if self._followed is not None and self._monotonic_s() - self._followed.since_s > SILENT_S:
                self._followed = None
            return self._followed

    # --- in its own ---

    def _run(self, thread: SupervisedThread) -> None:
        while not thread.is_set():
            with self._changed:
                if not self._ended:
                    self._changed.wait(POLL_S if self._asked else IDLE_S)
            thread.wait(min(REST * self.work(), MOST_REST_S))

    def work(self) -> float:
        """Answer what can be answered now. Returns the processor's time, s."""
        began_s = time.thread_time()
        self._end_tracks()
        while (found := self._next()) is not None:
            asked, stops = found
            answered = self._clicked(asked, stops) if isinstance(asked, VideoClick) else self._view(asked)
            with self._changed:
                self._answered.append(answered)
            self.thread.beat()
        return time.thread_time() - began_s

    def _next(self) -> tuple[Asked, int] | None:
        """The first question, once the sets that it needs are there or have been waited for, and the stops before."""
        with self._changed:
            if not self._asked:
                return None
            asked, since_s = self._asked[0]
            if isinstance(asked, VideoClick) and self._monotonic_s() - since_s < WAIT_S:
                newest = self._sets.newest_picture()
                latest_ns = min(self._moment_ns(asked) + round(self._sigma_s * 1e9), asked.arrival_ns)
                if newest is None or newest.capture_unix_ns < latest_ns:
                    return None
            self._asked.popleft()
            return asked, self._stops

    def _moment_ns(self, click: VideoClick) -> int:
        return click.arrival_ns - round(self._delay_s * 1e9)

    def _clicked(self, click: VideoClick, stops: int) -> Clicked:
        with self._changed:
            sets = [entry.item for entry in self._sets.ordered()]
        found = locate_untimed(sets, click.share, self._moment_ns(click), self._sigma_s)
        if not isinstance(found.answer, Fix):
            return Clicked(click.number, found.answer)
        self._end_followed()
        self._end_tracks()
        return Clicked(click.number, found.answer, *self._begin(click, found, found.answer, stops))

    def _end_tracks(self) -> None:
        """End the tracks of earlier clicks: who is asked may be an aircraft at the other end of a link."""
        while True:
            with self._changed:
                if not self._ended or self.follow is None:
                    return
                track = self._ended.popleft()
            self.follow(parameters_of(StopTrack(track)))

    def _begin(self, click: VideoClick, found: UntimedClick, fix: Fix, stops: int) -> tuple[bool, str]:
        """Begin to follow what was clicked; whether it is followed now, and else why not.

        Who follows may answer after a stop: what it follows then is ended.
        """
        with self._changed:
            entry = self._sets.entry(fix.frame)
            if self._stops != stops:
                return False, STOPPED
        if self.follow is None or entry is None:
            return False, ""
        uv_px = pixel_at(entry.item.camera, click.share)
        payload, is_refusal = self.follow(parameters_of(StartTrack(*uv_px, fix.frame)))
        content = json.loads(payload)
        if is_refusal:
            return False, str(content["reason"])
        track = content.get("track")
        if not isinstance(track, int):  # who answers may be another program at the end of a link
            return False, "the answer has no track"
        with self._changed:
            if self._stops != stops:
                self._ended.append(track)
                return False, STOPPED
            self._followed = _Followed(track, found.by_delay_m2, self._monotonic_s())
        return True, ""

    def _view(self, question: ViewQuestion) -> View:
        """The camera's view by the newest picture that has a pose; without one where that is too old."""
        with self._changed:
            newest, silent_s = self._sets.newest_answer(), self._monotonic_s() - self._placed_s
        age_s = silent_s if newest is None else max(silent_s, self.stamped_ago_s(newest.capture_unix_ns))
        if newest is None or age_s > SILENT_S:
            return View(question.number, None, None)
        camera = newest.item.camera
        middle = 0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)
        return View(question.number, newest.item, Locator(newest.item).locate(middle), age_s)


def _widened(report: TrackReport, by_delay_m2: NDArray[np.float64]) -> TrackReport:
    """A report of what may be next to the thing that was meant, as far as the click's moment is not known."""
    if report.place is None:
        return report
    place = report.place
    ellipse = Ellipse.from_covariance(place.ellipse.covariance_en_m2 + by_delay_m2[:2, :2])
    sigma_m = float(np.sqrt(place.sigma_height_m**2 + by_delay_m2[2, 2]))
    return replace(report, place=replace(place, ellipse=ellipse, sigma_height_m=sigma_m))
