"""The link in virtual time: the publisher's loop without its thread, and a radio without sockets.

`onboard.link.publisher` does the same with a clock, a session and what Linux says of its sockets.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from contract.topics import STATUS
from onboard.link.byte_budget import PACKET_BYTES, Budget, Kind
from onboard.link.publisher import BACKLOG_BYTES, BACKLOG_S
from onboard.link.set_selection import Offer, Selection

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS


def an_offer(frame: int, at_s: float, revision: int = 0, is_ok: bool = True, is_keyframe: bool = False) -> Offer[str]:
    return Offer(1, frame, revision, START_NS + round(at_s * 1e9), is_ok, is_keyframe, f"{frame}.{revision}")


@dataclass
class Sent:
    at_s: float
    kind: Kind
    wire_bytes: float
    offer: Offer[str] | None = None


@dataclass
class Radio:
    """A bit rate and a queue without end; cuts from .. to .. hold a stream and lose datagrams."""

    bit_rate: float
    cuts_s: tuple[tuple[float, float], ...] = ()
    is_stream: bool = True
    _queue: deque[tuple[float, Sent]] = field(default_factory=deque)  # bytes still to go
    _now_s: float = 0.0
    arrived: list[tuple[float, Offer[str]]] = field(default_factory=list)

    def is_cut(self, now_s: float) -> bool:
        return any(begin <= now_s < end for begin, end in self.cuts_s)

    def send(self, message: Sent) -> None:
        if self.is_stream or not self.is_cut(message.at_s):
            self._queue.append((message.wire_bytes, message))

    def unacknowledged(self) -> float:
        """Bytes under way, which Linux knows of a stream only."""
        return sum(left for left, _ in self._queue) if self.is_stream else 0.0

    def advance(self, now_s: float) -> None:
        could = (now_s - self._now_s) * self.bit_rate / 8.0
        self._now_s = now_s
        if self.is_cut(now_s):
            if not self.is_stream:
                self._queue.clear()
            return
        while self._queue and could > 0.0:
            left, message = self._queue.popleft()
            if left > could:
                self._queue.appendleft((left - could, message))
            elif message.offer is not None:
                self.arrived.append((now_s, message.offer))
            could -= left

    def ages_s(self, from_s: float, to_s: float) -> list[float]:
        """How old the newest picture on the ground is, a hundred times a second; infinite before the first."""
        out, newest_ns, upcoming = [], -1, deque(self.arrived)
        for tick in range(round(to_s * 100)):
            now_s = tick / 100.0
            while upcoming and upcoming[0][0] <= now_s:
                newest_ns = max(newest_ns, upcoming.popleft()[1].capture_unix_ns)
            if now_s >= from_s:
                out.append(now_s - (newest_ns - START_NS) / 1e9 if newest_ns >= 0 else float("inf"))
        return out


def run(
    budget: Budget,
    offers: list[tuple[float, Offer[str]]],
    duration_s: float,
    set_bytes: int = 600,
    status_bytes: int = 0,
    replies_hz: float = 0.0,
    radio: Radio | None = None,
    piece_bytes: int = 0,
) -> list[Sent]:
    """Sets come as given, a status a second, replies as often as asked; all that is sent, and through the radio.

    With `piece_bytes` there is always a piece of a picture of that size that waits.
    """
    selection: Selection[str] = Selection()
    sent: list[Sent] = []
    waiting = sorted(offers, key=lambda pair: pair[0])
    status_due, replies_due, step_s, passed = 0.0, 0.0, 0.02, 0
    for tick in range(round(duration_s / step_s)):
        now_s = tick * step_s
        while waiting and waiting[0][0] <= now_s:
            selection.offer(waiting.pop(0)[1])
        if radio is not None:
            for message in sent[passed:]:
                radio.send(message)
            passed = len(sent)
            radio.advance(now_s)
            if radio.unacknowledged() > max(BACKLOG_S * budget.bytes_per_s, BACKLOG_BYTES):
                continue
        is_clear = radio is None or radio.unacknowledged() <= PACKET_BYTES
        chosen, older = selection.next(now_s), selection.next_of_rest(now_s) if is_clear else None
        budget.waits(Kind.SET, set_bytes if chosen is not None else None, now_s)
        budget.waits(Kind.OLDER, set_bytes if older is not None else None, now_s)
        budget.waits(STATUS, status_bytes if status_bytes and now_s >= status_due else None, now_s)
        budget.waits(Kind.REPLY, set_bytes if replies_hz and now_s >= replies_due else None, now_s)
        if status_bytes and now_s >= status_due and budget.send(STATUS, status_bytes, now_s):
            sent.append(Sent(now_s, STATUS, budget.cost(STATUS, status_bytes)))
            status_due = now_s + 1.0
        if replies_hz and now_s >= replies_due and budget.send(Kind.REPLY, set_bytes, now_s):
            sent.append(Sent(now_s, Kind.REPLY, budget.cost(Kind.REPLY, set_bytes)))
            replies_due = now_s + 1.0 / replies_hz
        for kind, offer in ((Kind.SET, chosen), (Kind.OLDER, older)):
            if offer is not None and budget.send(kind, set_bytes, now_s):
                selection.sent(offer, now_s)
                sent.append(Sent(now_s, kind, budget.cost(kind, set_bytes), offer))
        while piece_bytes and is_clear and budget.send(Kind.PICTURE, piece_bytes, now_s):
            sent.append(Sent(now_s, Kind.PICTURE, budget.cost(Kind.PICTURE, piece_bytes)))
    return sent


def heaviest(sent: list[Sent], window_s: float) -> float:
    """The most bytes that went in any window of so long."""
    return max(
        (sum(s.wire_bytes for s in sent if first.at_s <= s.at_s <= first.at_s + window_s) for first in sent),
        default=0.0,
    )


def flight(
    duration_s: float, rate_hz: float = 30.0, revised_after_s: float = 3.0, made_s: Callable[[], float] = lambda: 0.05
) -> list[tuple[float, Offer[str]]]:
    """Every picture after `made_s`, and again when the window has seen past it; every tenth is a keyframe."""
    offers: list[tuple[float, Offer[str]]] = []
    for frame in range(round(duration_s * rate_hz)):
        at_s = frame / rate_hz
        key = frame % 10 == 0
        offers.append((at_s + made_s(), an_offer(frame, at_s, is_keyframe=key)))
        offers.append((at_s + revised_after_s, an_offer(frame, at_s, 1, is_keyframe=key)))
    return offers


def sets(sent: list[Sent]) -> list[tuple[float, Offer[str]]]:
    return [(s.at_s, s.offer) for s in sent if s.offer is not None]


@dataclass(frozen=True)
class Delivered:
    """What became of the pictures of a run: the share that was ever sent, or sent as a revision; and first waits, s."""

    reached: float
    revised: float
    waits_s: list[float]  # sorted; from a picture's first set to its first sending

    @classmethod
    def of(cls, offers: list[tuple[float, Offer[str]]], sent: list[Sent], until_s: float) -> Delivered:
        made: dict[int, float] = {}
        for at_s, offer in offers:
            made[offer.frame] = min(made.get(offer.frame, at_s), at_s)
        first = {offer.frame: at_s for at_s, offer in reversed(sets(sent))}
        counted = [frame for frame, at_s in made.items() if at_s < until_s]
        revised = {offer.frame for _, offer in sets(sent) if offer.revision}
        return cls(
            sum(frame in first for frame in counted) / len(counted),
            sum(frame in revised for frame in counted) / len(counted),
            sorted(first[frame] - made[frame] for frame in counted if frame in first),
        )

    def wait_s(self, quantile: float) -> float:
        return self.waits_s[round(quantile * (len(self.waits_s) - 1))]
