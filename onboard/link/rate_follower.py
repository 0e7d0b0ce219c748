"""The rate of sending over a link of unknown capacity, by its far end's reports. Pure logic, time is passed in.

An autopilot drops what it has no room for without a word, and never forwards its radio's own reports: so the ground
states when packets came, and a queue before the radio shows in how much longer than the least they were under way.
Where packets queue, the autopilot's own messages do as well: so the rate follows the queue, and halves at loss. A radio
loses some packets at any rate: what does not change with the rate is its own.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from contract.wire.radio_state import Held
from contract.wire.set_pieces import ReceiverReport

BEGIN_BIT_RATE, LEAST_BIT_RATE = 1000.0, 300.0
START_S = 0.08  # of a queue at most, for the rate to be doubled, until there is more for the first time
OVERSHOT = 0.25  # times the rate, where it then is more than allowed: what is sent until the next report is too much
QUEUE_S, MOST_QUEUE_S = 0.145, 0.5  # what packets may queue on average; and where they do so at the least rate
LONGEST_S = 1.0  # of a queue: more is something else
REMEMBERED = 100  # delays, of which the least is the way without a queue
SMOOTHED, MOST_SMOOTHED, SLOWLY = 0.25, 0.5, 0.025  # the share of a packet in averages, of a report, of a trend
GROWTH, DECLINE = 0.7, 2.0  # of the rate, as far as it is known: without a queue, and with one twice as long as allowed
FAR = 0.5  # times the rate at which too much queued last: below it nothing that is known holds growth back
BIG_FALL = 0.7  # times the rate: what the next report states of queues was before it
GROWTH_AFTER_LOSS, RECOVERY = 0.15, 1.1  # and times that with every report
JUDGED = 16  # packets, at least, before what is lost of them counts
LOST_MORE, SIGMAS = 0.07, 2.5  # of the packets, beyond the radio's own loss and its chance: halves the rate
MOST_OWN_LOSS = 0.3  # of a radio: more may be what the autopilot drops
SILENT_S = 7.0  # without a report: the ground is gone


class RateFollower:
    """Starts with the first report; `bit_rate` is 0 while no ground listens."""

    def __init__(self, max_bit_rate: float) -> None:
        self._most = max_bit_rate
        self._rate = 0.0
        self._reported_s = 0.0
        self._judged: ReceiverReport | None = None
        self._is_starting = True
        self._under_way_s: deque[float] = deque(maxlen=REMEMBERED)
        self._queue_s = 0.0  # on average
        self._allowed_s = QUEUE_S
        self._growth = GROWTH
        self._too_much = 0.0  # the rate at which too much queued last
        self._has_fallen = False  # since the last report
        self._own_loss = 0.0
        self._halved_at: float | None = None  # the share that had come, where the last decision halved
        self._has_halved = False  # since the last report

    def bit_rate(self, now_s: float) -> float:
        return self._rate if now_s - self._reported_s < SILENT_S else 0.0

    @property
    def held(self) -> Held:
        """The reason why the rate is no higher: what is configured, or that a higher one was too much for the radio."""
        if self._rate >= self._most:
            return Held.BY_CONFIGURATION
        return Held.BY_NOTHING if self._is_starting else Held.BY_RADIO

    def received(self, report: ReceiverReport, now_s: float, under_way_s: Sequence[float]) -> None:
        """A ground's report, and how long each packet of which it is news was under way, the report's way included."""
        if self.bit_rate(now_s) == 0.0:
            self._rate, self._is_starting, self._judged = min(BEGIN_BIT_RATE, self._most), True, None
            self._queue_s, self._growth, self._halved_at = 0.0, GROWTH, None
            self._under_way_s.clear()
        self._reported_s = now_s
        if under_way_s:
            self._follow_queue(sorted(under_way_s))
        if self._judged is None or self._has_halved or report.received == 0:
            self._judged = report if report.received else None  # what was sent before it listened was not lost
            self._has_halved = False  # nor is what was lost before the rate was halved lost at the new one
            return
        sent = (report.highest - self._judged.highest) % 65536
        came = (report.received - self._judged.received) % 65536
        if sent >= 32768 or came > 2 * sent + JUDGED:  # the ground has begun again
            self._judged = report
            return
        if sent < JUDGED:
            return
        self._judged = report
        if self._is_lossy(min(came / sent, 1.0), sent):
            self._change(0.5)
            self._growth, self._is_starting, self._has_halved = GROWTH_AFTER_LOSS, False, True

    def _follow_queue(self, under_way_s: list[float]) -> None:
        self._under_way_s.extend(under_way_s)
        least_s, count = min(self._under_way_s), len(under_way_s)
        usual_s = min(under_way_s[(count - 1) // 2] - least_s, LONGEST_S)  # one alone may have been held up
        known = min(1.0 - (1.0 - SMOOTHED) ** count, MOST_SMOOTHED)
        if self._has_fallen:  # neither queues nor packets of before are of the lower rate
            self._queue_s, self._has_fallen = min(usual_s, self._queue_s), False
            return
        self._queue_s += known * (usual_s - self._queue_s)
        if self._rate <= LEAST_BIT_RATE:  # whatever queues now does so without us
            own_s = min(max(self._queue_s, QUEUE_S), MOST_QUEUE_S)
            self._allowed_s += SLOWLY * (own_s - self._allowed_s)
        if self._is_starting:
            self._start(sum(under_way_s) / count - least_s)
            return
        room = 1.0 - self._queue_s / self._allowed_s
        if room < 0.0:
            self._fall(max(1.0 + known * DECLINE * room, 0.5))
            return
        self._growth = min(RECOVERY * self._growth, GROWTH)
        weight = MOST_SMOOTHED if self._rate < FAR * self._too_much else known
        self._change(1.0 + weight * self._growth * room)

    def _start(self, queue_s: float) -> None:
        if queue_s <= START_S:
            self._change(2.0)
            return
        self._is_starting = False
        if queue_s > self._allowed_s:
            self._fall(OVERSHOT)

    def _fall(self, times: float) -> None:
        self._too_much = self._rate
        self._has_fallen = times < BIG_FALL
        self._change(times)

    def _is_lossy(self, came: float, sent: int) -> bool:
        """Return whether less came than by the radio's own loss: what half the rate has not lessened is its own."""
        before = self._halved_at
        if before is not None and came < 0.5 * (before + min(2.0 * before, 1.0)):  # nearer to as before than to twice
            self._own_loss = 1.0 - max(came, before)
            self._growth = GROWTH
        more = 1.0 - came - self._own_loss
        self._own_loss = min(self._own_loss + (SMOOTHED if more < 0.0 else SLOWLY) * more, MOST_OWN_LOSS)
        chance = max(math.sqrt(self._own_loss * (1.0 - self._own_loss) / sent), 1.0 / sent)
        is_lossy = 1.0 - came > self._own_loss + LOST_MORE + SIGMAS * chance
        self._halved_at = came if is_lossy and self._rate > LEAST_BIT_RATE else None
        return is_lossy

    def _change(self, times: float) -> None:
        self._rate = min(max(times * self._rate, LEAST_BIT_RATE), self._most)
