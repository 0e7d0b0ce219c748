"""The thread that looks for hot spots, next to the pipeline: what it finds in a picture, twice a second at most.

The pipeline's thread only hands references over. A picture that this thread has not come to when the next one is due
is passed over.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from contract.supervised_thread import SupervisedThread, WokenWork
from contract.wire.spot_code import encode_spots
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.spots.looking import Look, looking

MAX_HELD = 64  # pictures that wait for their set
IDLE_S = 0.5
REST = 1.0  # of the time that it worked, in which it leaves the processor to others
MOST_REST_S = 0.2
LATE_S = 20.0

Outlet = Callable[[int, bytes], object]

log = logging.getLogger("pointclick")


class SpotThread(WokenWork):
    """A sink of the daemon. `outlets` take a picture's capture time (Unix ns) and its spots as one packet.

    `second`: the optics of a second camera, whose thread hands its pictures to `second_picture`; `keepers` are given
    those that were looked at.
    """

    def __init__(self, config: Config, outlets: Sequence[Outlet] = (), second: Camera | None = None) -> None:
        super().__init__("spots", late_after_s=LATE_S)
        self.outlets = list(outlets)
        self._looking = looking(config, second, MAX_HELD)
        self.keepers = self._looking.keepers
        self._next: Look | None = None
        self._has_spots = False

    def event(self, arrival_ns: int, event: Event) -> None:
        with self._changed:
            self._looking.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """A picture's first set: what is due is this thread's now, in place of what it has not come to."""
        with self._changed:
            self._due(self._looking.feature_set(output))

    def second_picture(self, frame: Frame) -> None:
        with self._changed:
            self._due(self._looking.second_picture(frame))

    def work(self) -> float:
        """Look at the picture that waits. Returns the processor's time, s."""
        began_s = time.thread_time()
        with self._changed:
            look, self._next = self._next, None
        report = None if look is None else look()
        if report is not None:
            self._report(report)
        return time.thread_time() - began_s

    def _due(self, looks: list[Look]) -> None:
        if looks:
            self._next = looks[-1]
            self._changed.notify()

    def _report(self, report: SpotReport) -> None:
        if bool(report.spots) != self._has_spots:
            self._has_spots = bool(report.spots)
            log.info("spots: %s", report.to_text().splitlines()[0])
        try:
            payload = encode_spots(report)
        except ValueError as error:
            log.warning("%s", error)
            return
        for outlet in self.outlets:
            outlet(report.capture_unix_ns, payload)

    def _run(self, thread: SupervisedThread) -> None:
        if thread.error is not None:  # begun again: what brought it down may be what it has learned
            self._looking.begin_again()
        while not thread.is_set():
            with self._changed:
                if self._next is None:
                    self._changed.wait(IDLE_S)
            spent_s = self.work()
            thread.beat()
            thread.wait(min(REST * spent_s, MOST_REST_S))
