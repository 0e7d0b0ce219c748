"""The thread that measures clicked pixels: in the pictures that it keeps next to the pipeline, or in a recording's.

The pipeline's thread only hands references over, and a question only joins a short queue: however many are asked, and
however long they take, the flight's own sets do not wait.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from contract.feature_set import FeatureSet
from contract.supervised_thread import SupervisedThread, WokenWork
from contract.wire.codec import decode
from onboard.config.schema import Config
from onboard.events.kept_pictures import KeptPictures, Pictured
from onboard.events.types import Event
from onboard.events.waiting_pictures import WaitingPictures
from onboard.measured.question import Questions

MAX_HELD = 64  # pictures that wait for their set
MAX_ASKED = 8  # questions that wait for this thread
LATE_ANSWER_S = 0.4  # after which a question is answered by what was there before: the ground waits 0.5 s more
REST = 1.0  # of the time that it worked, next to a pipeline
MOST_REST_S = 0.1
IDLE_S = 0.5

# Gets the set with what became of the pixel; None: it was not looked at.
Done = Callable[[FeatureSet | None], object]


class Looked(Protocol):
    """Pictures that are looked back in."""

    def placed(self, session: int, frame: int) -> tuple[Pictured | None, Sequence[Pictured]]:
        """A picture whose set answers clicks, None if it is not there; and others that may show the same ground."""


class QuestionThread(WokenWork):
    """Measures clicked pixels in `pictures`, one at a time. `monotonic_s` is a clock, `rest` how much of the time that
    it worked it leaves the processor to others.
    """

    def __init__(
        self, pictures: Looked, monotonic_s: Callable[[], float] = time.monotonic, *, rest: float = REST
    ) -> None:
        super().__init__("measured clicks")
        self._rest = rest
        self._monotonic_s = monotonic_s
        self._looked = pictures
        self._questions = Questions()
        self._asked: deque[tuple[bytes, tuple[float, float], Done, float]] = deque()

    def measure(self, payload: bytes, uv_px: tuple[float, float], done: Done) -> bool:
        """Measure a pixel of the set of a payload; `done` is called in this thread. False if too much is asked: then it
        is not called. From any thread.
        """
        with self._changed:
            if len(self._asked) >= MAX_ASKED:
                return False
            self._asked.append((payload, uv_px, done, self._monotonic_s()))
            self._changed.notify()
            return True

    def _run(self, thread: SupervisedThread) -> None:
        if thread.error is not None:  # begun again: what brought it down may be what it keeps of the last click
            self._questions = Questions()
        while not thread.is_set():
            with self._changed:
                if not self._asked:
                    self._changed.wait(IDLE_S)
            thread.wait(min(self._rest * self.work(), MOST_REST_S))

    def work(self) -> float:
        """Answer one question, if one waits. Returns the processor's time, s."""
        began_s = time.thread_time()
        with self._changed:
            if not self._asked:
                return 0.0
            payload, uv_px, done, asked_s = self._asked.popleft()
        answer: FeatureSet | None = None
        try:
            if self._monotonic_s() - asked_s < LATE_ANSWER_S:
                answer = self._answer(payload, uv_px)
        finally:
            done(answer)
        return time.thread_time() - began_s

    def _answer(self, payload: bytes, uv_px: tuple[float, float]) -> FeatureSet | None:
        asked = decode(payload)
        if not (asked.is_ok and asked.camera.contains(uv_px)):
            return None
        clicked, others = self._looked.placed(asked.session, asked.frame)
        return self._questions.measured_set(asked, uv_px, clicked, others)


class MeasureThread(QuestionThread):
    """A sink of the daemon, which keeps the pictures. `pictures`: a ring that is shared."""

    def __init__(
        self,
        config: Config,
        monotonic_s: Callable[[], float] = time.monotonic,
        *,
        pictures: KeptPictures | None = None,
    ) -> None:
        self._pictures = KeptPictures(round(config.tracks.keep_mb * 1e6)) if pictures is None else pictures
        super().__init__(self._pictures, monotonic_s)
        self._held = WaitingPictures(MAX_HELD)  # touched by the pipeline's thread alone

    def event(self, arrival_ns: int, event: Event) -> None:
        self._held.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """A picture's set, the first or a later one."""
        frame = self._held.take(output.frame)
        if frame is not None and frame.image is not None:
            self._pictures.add(frame.image, output, frame.stamp_ns)
        else:
            self._pictures.revise(output)
