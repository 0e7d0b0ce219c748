"""Clicks that come through the autopilot, answered on board: for a radio on which no set gets to the ground.

Questions are computed in a thread of their own, so that telemetry's never waits. A question that is sent again gets the
same answer again, and all answers keep below a bit rate of their own.
"""

from __future__ import annotations

import json
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import replace

from contract.answer import Answer as ClickedAnswer
from contract.answer import Fix, Refusal
from contract.errors import WireError
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from contract.supervised_thread import Policy, SupervisedThread
from contract.wire import click_code, codec
from contract.wire.click_code import ClickAnswer, ClickQuestion
from contract.wire.radio_state import Held, RadioState, encode_state
from onboard.events.tunnel import Peer
from onboard.link.byte_budget import Bucket
from onboard.link.reply import Answer, Measure, Question, not_measured

MAX_WAITING = 8  # questions, and answers
MAX_KEPT = 32  # answers, to be sent again
# An answer counts as under way for this many times what it takes at our bit rate: asked again sooner, it is not lost.
UNDER_WAY = 1.5
IDLE_S = 0.5
MEASURED_WITHIN_S = 0.5  # after which the answer goes without; a ground asks again after 1 s
# Times that an answer went and its question came again: a radio that loses a tenth does that once in a thousand clicks.
UNHEARD = 3


class ClickService:
    """Answers clicks. `look_up` finds a picture's set as for a query over the link; None: not yet.

    `overhead`: bytes on the wire in addition to a payload. `bucket` is shared with all that goes this way; `now_ns` is
    CLOCK_MONOTONIC.
    """

    def __init__(
        self,
        vehicle: str,
        look_up: Callable[[Question], Answer | None],
        overhead: int,
        bucket: Bucket,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._vehicle, self._look_up, self._now_ns = vehicle, look_up, now_ns
        self._overhead, self._bucket = overhead, bucket
        self.measure: Measure = not_measured
        self._asked: deque[tuple[Peer, ClickQuestion, int]] = deque()
        self._ready: deque[tuple[Peer, bytes]] = deque()
        self._kept: OrderedDict[tuple[Peer, int], bytes] = OrderedDict()
        self._gone_s: OrderedDict[bytes, float] = OrderedDict()  # when the last answers were sent
        self._again: Counter[bytes] = Counter()  # how often an answer of `_gone_s` did not get to the ground
        self._locator: tuple[bytes, Locator] | None = None  # of the last set
        self.answered = self.unheard = 0  # questions; and those of which answers went and did not arrive
        self._changed = threading.Condition()
        self.thread = SupervisedThread("clicks", self._run, Policy.RESTART)

    def close(self) -> None:
        """No more answers."""
        self.thread.end()
        with self._changed:
            self._changed.notify()
        self.thread.join(5.0)

    def receive(self, ground: Peer, payload: bytes) -> None:
        """A packet from a ground; what is no question is passed over."""
        try:
            question = click_code.decode(payload)
        except WireError:
            return
        if not isinstance(question, ClickQuestion):
            return
        with self._changed:
            known = self._kept.get((ground, question.number))
            if known is not None:
                if not self._is_under_way(known):
                    self._note_unheard(ground, known)
                    self._send(ground, known)
            elif not self._is_waiting(ground, question.number) and len(self._asked) < MAX_WAITING:
                self._asked.append((ground, question, self._now_ns()))
                self._changed.notify()

    def _note_unheard(self, ground: Peer, payload: bytes) -> None:
        """Count an answer that went in vain; a packet that is small enough to get through reports it to the ground."""
        if payload not in self._gone_s or (ground, payload) in self._ready:
            return
        self._again[payload] += 1
        if self._again[payload] >= UNHEARD:
            self.unheard += self._again[payload] == UNHEARD
            self._send(ground, encode_state(RadioState(Held.BY_RADIO)))

    def _is_waiting(self, ground: Peer, number: int) -> bool:
        return any((asked[0], asked[1].number) == (ground, number) for asked in self._asked)

    def due(self) -> list[tuple[Peer, bytes]]:
        """Answers that may go now, the bit rate paid."""
        out: list[tuple[Peer, bytes]] = []
        with self._changed:
            now_s = self._now_ns() / 1e9
            while self._ready:
                cost = len(self._ready[0][1]) + self._overhead
                if self._bucket.wait_s(cost, now_s) > 0.0:
                    break
                self._bucket.take(cost, now_s)
                out.append(self._ready.popleft())
                self._gone_s[out[-1][1]] = now_s
                while len(self._gone_s) > MAX_KEPT:
                    self._again.pop(self._gone_s.popitem(last=False)[0], None)
        return out

    def work(self) -> bool:
        """Answer one question; whether there was one."""
        with self._changed:
            if not self._asked:
                return False
            ground, question, at_ns = self._asked[0]
        try:
            answer = self._answer(question, at_ns)
            payload = None if answer is None else click_code.encode_answer(ClickAnswer(question.number, answer))
        finally:
            with self._changed:
                self._asked.popleft()
        if payload is None:
            return True  # its set is being made: the ground asks again
        with self._changed:
            self._kept[ground, question.number] = payload
            while len(self._kept) > MAX_KEPT:
                self._kept.popitem(last=False)
            self._send(ground, payload)
            self.answered += 1
        return True

    def _send(self, ground: Peer, payload: bytes) -> None:
        """Once at a time, however often it is asked for meanwhile."""
        if (ground, payload) not in self._ready and len(self._ready) < MAX_WAITING:
            self._ready.append((ground, payload))

    def _is_under_way(self, payload: bytes) -> bool:
        gone_s = self._gone_s.get(payload)
        takes_s = (len(payload) + self._overhead) / self._bucket.bytes_per_s
        return gone_s is not None and self._now_ns() / 1e9 - gone_s < UNDER_WAY * takes_s

    def _answer(self, question: ClickQuestion, at_ns: int) -> ClickedAnswer | None:
        found = self._found(question, at_ns)
        if found is None:
            return None
        about = json.loads(found.about or b"{}")
        if found.is_error:
            content = json.loads(found.payload)
            state = ": ".join(str(content[key]) for key in ("state", "reason") if content.get(key))
            return Refusal(Status(content["status"]), question.frame, vehicle=self._vehicle, detail=state)
        if self._locator is None or self._locator[0] != found.payload:
            self._locator = found.payload, Locator(codec.decode(found.payload))
        uv_px = question.u_px, question.v_px
        answer = self._locator[1].locate(uv_px)
        if isinstance(answer, Fix) and (measured := self._measured(found.payload, uv_px)) is not None:
            again = Locator(measured).locate(uv_px)
            answer = again if isinstance(again, Fix) else answer
        age_s = about.get("age_s")
        return replace(answer, age_s=None if age_s is None else max(age_s - question.waited_s, 0.0))

    def _measured(self, payload: bytes, uv_px: tuple[float, float]) -> FeatureSet | None:
        """The set with what became of the pixel; None if it is not measured, or not in time."""
        found: list[FeatureSet | None] = []
        done = threading.Event()

        def take(measured: FeatureSet | None) -> None:
            found.append(measured)
            done.set()

        return found[0] if self.measure(payload, uv_px, take) and done.wait(MEASURED_WITHIN_S) else None

    def _found(self, question: ClickQuestion, at_ns: int) -> Answer | None:
        """Return the answer as for a query; None while it is being made.

        A question for the newest picture that comes late means the one captured nearest to the click.
        """
        frame = None if question.frame is None else str(question.frame)
        unix_s = None if question.capture_unix_ns is None else repr(question.capture_unix_ns / 1e9)
        found = self._look_up(Question(frame, unix_s, at_ns))
        if not question.waited_s or found is None or found.is_error or frame is not None or unix_s is not None:
            return found
        age_s = json.loads(found.about or b"{}").get("age_s")
        if age_s is None or age_s >= question.waited_s:
            return found  # nothing newer has come since
        clicked_s = codec.peek(found.payload).capture_unix_ns / 1e9 + age_s - question.waited_s
        return self._look_up(Question(None, repr(clicked_s), at_ns))

    def _run(self, thread: SupervisedThread) -> None:
        while not thread.is_set():
            thread.beat()
            while self.work():
                thread.beat()
            with self._changed:
                if not self._asked:
                    self._changed.wait(IDLE_S)
