"""Mount hypotheses tried on whole windows, while pictures alone have not distinguished them.

Pictures that come rarely, of a camera that a gimbal holds level under a leaning aircraft, move nearly as with a fixed
mount: their motion alone does not determine which is true, but a window's solve with the wrong attitudes contradicts
its positions. So where the accepted hypothesis is refused, the window is solved again by every other; one that alone
fits, several keyframes in a row, is accepted. What was seen meanwhile is kept: only the attitudes are exchanged.
"""

from __future__ import annotations

from dataclasses import replace

from contract.feature_set import Status
from onboard.estimation.sliding_window import Window
from onboard.estimation.solver_executor import Promise, Worker, timed_adjust
from onboard.estimation.window_request import Noise, Outcome, Request
from onboard.navigation.gimbal import MountHypothesis
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.mount_selection import MountSelection, unlike
from onboard.pipeline.record_book import Record

WINS = 2  # solves in a row that only one other hypothesis fits


class MountTrials:
    """Solves by the hypotheses that are not accepted, in addition to those by the one that is."""

    def __init__(self, selection: MountSelection) -> None:
        self._selection = selection
        self._running: dict[MountHypothesis, Promise] = {}
        self._noise: dict[MountHypothesis, Noise] = {}  # as earlier windows have found it by each hypothesis
        self._leader: MountHypothesis | None = None
        self._wins = 0

    def begin(self, window: Window, worker: Worker, navigation: Navigation) -> None:
        """Submit the newest request by the other hypotheses, if that is open and nothing is solved yet."""
        self._running = {}
        if window.solved is not None or not self._selection.is_open(window.keyframes[-1].nav):
            return
        assumed = navigation.mount_hypothesis
        for reading, R in window.keyframes[-1].nav.mount_hypotheses.items():
            own = window.keyframes[-1].nav.mount_hypotheses.get(assumed)
            request = None if own is None or not unlike(R, own) else _request(window, reading, self._noise.get(reading))
            if request is not None:
                self._running[reading] = worker.submit(timed_adjust, request)

    def judged(
        self, outcome: Outcome, window: Window, records: list[Record], navigation: Navigation
    ) -> tuple[Outcome, float]:
        """The outcome to continue with, and the processor time of trials. Where it is another hypothesis's, that one is
        accepted from now on, and window and records hold it.
        """
        done = {reading: promise.result() for reading, promise in self._running.items()}
        self._noise |= {reading: each.outcome.noise for reading, each in done.items()}
        spent_s = sum(each.processor_s for each in done.values())
        self._running = {}
        fitting = [reading for reading, each in done.items() if each.outcome.status is Status.OK]
        held = outcome.keyframes[-1].nav.mount_hypotheses if fitting else {}
        are_alike = not any(unlike(held[fitting[0]], held[other]) for other in fitting[1:])
        if outcome.status is not Status.POOR_FIT or not fitting or not are_alike:
            self._leader, self._wins = None, 0
            return outcome, spent_s
        leader = self._leader if self._leader in fitting else fitting[0]
        self._wins = self._wins + 1 if leader is self._leader else 1
        self._leader = leader
        is_won = self._wins >= WINS and self._selection.may_be(leader)
        if not is_won or not carry_over(window, records, navigation, leader):
            return outcome, spent_s
        self._selection.verdict = leader
        return done[leader].outcome, spent_s


def _by_reading(nav: NavState, reading: MountHypothesis) -> NavState | None:
    """The state with another hypothesis's attitude; None if it has none."""
    R = nav.mount_hypotheses.get(reading)
    return None if R is None else replace(nav, R_enu_body=R, attitude_sigma_rad=0.0)


def _request(window: Window, reading: MountHypothesis, noise: Noise | None = None) -> Request | None:
    """The window's newest request as it would be by another hypothesis: with the noise of its earlier windows, or
    as if it were the first.
    """
    keyframes = []
    for keyframe in window.keyframes:
        nav = _by_reading(keyframe.nav, reading)
        if nav is None or (R := window.attitude_guess(nav)) is None:
            return None
        keyframes.append(replace(keyframe, nav=nav, R_cam_enu=R, centre_enu_m=nav.position_enu_m))
    noise = noise or Noise(window.config.solve.pixel_sigma_px, window.config.camera.sigma_jitter_s)
    return replace(window.prepare(is_mount_open=True), keyframes=tuple(keyframes), previous=None, noise=noise)


def carry_over(window: Window, records: list[Record], navigation: Navigation, reading: MountHypothesis) -> bool:
    """Exchange the attitudes of all that a window and its pictures hold for another hypothesis's, and accept that one.

    What was solved by the old one is forgotten. False, with nothing exchanged, where any of them has no such attitude.
    """
    navigation.mount_hypothesis = reading
    request = _request(window, reading) if window.keyframes else None
    navs = [nav for record in records if (nav := _by_reading(record.nav, reading)) is not None]
    if request is None or len(navs) < len(records):
        return False
    keyframes = []
    for keyframe in request.keyframes:
        rate = navigation.body_rate_at(keyframe.nav.stamp_ns + round(keyframe.nav_offset_s * 1e9))
        keyframes.append(keyframe if rate is None else replace(keyframe, body_rate_rad_s=rate))
    window.forget_solutions()
    window.keyframes, window.noise = keyframes, request.noise
    for record, nav in zip(records, navs, strict=True):
        record.nav, record.placed, record.is_settled = nav, None, False
    return True
