"""The choice of the set that goes out next, when not all can. Pure logic, time is passed in.

There are two queues. Of new pictures only the newest waits, for the next moment. The rest, better revisions of older
pictures and pictures that were overtaken before their turn came, goes in bytes that new pictures leave.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)

# With nothing newer, the newest set is sent again after this: it may have been sent into a link that was cut.
REPEAT_S = 2.0
# Older pictures wait until the newest picture is not older than this on the ground.
FRESH_S = 1.0
# Refusals give way to a set that answers and is at most this much older.
ANSWER_LEAD_NS = 1_000_000_000
# Pictures older than this are only answered when asked for.
MEMORY_NS = 15_000_000_000
MAX_REST = 512


@dataclass(frozen=True)
class Offer(Generic[T]):
    """A set that could be sent, by what makes it worth sending. `item` is whatever the sender needs."""

    session: int
    frame: int
    revision: int
    capture_unix_ns: int
    is_ok: bool
    is_keyframe: bool
    item: T


class Selection(Generic[T]):
    """The choice: `next` of the newest pictures, the newest that answers first; `next_of_rest` of older ones.

    Of the rest keyframes go first, then revisions, for an overtaken picture is soon revised; then pictures of which the
    ground has nothing, and those where on the time line least has been sent, so that what the ground holds is spread
    evenly. What is not chosen is not lost: it answers queries from the history.
    """

    def __init__(self, repeat_s: float = REPEAT_S) -> None:
        self._repeat_s = repeat_s
        self._session: int | None = None
        self._begin()

    def _begin(self) -> None:
        self._answer: Offer[T] | None = None  # the newest that answers, unsent
        self._refusal: Offer[T] | None = None  # the newest that does not, unsent
        self._rest: dict[int, Offer[T]] = {}  # of older pictures, by frame, unsent
        self._known_ns: dict[int, int] = {}  # captures of the answers that were sent, by frame
        self._rest_ns: list[int] = []  # captures of the rest that was sent, in order of time
        self._repeated: Offer[T] | None = None  # the newest of all
        self._newest_ns = 0
        self._sent_ns = self._sent_answer_ns = 0  # newest capture sent, and of those that answer
        self._fresh_at_s: float | None = None

    @property
    def waiting(self) -> bool:
        """True if there is a set that was never sent."""
        return self._answer is not None or self._refusal is not None or bool(self._rest)

    def offer(self, offered: Offer[T]) -> None:
        """Take a set; one of a new session puts all others away."""
        o = offered
        if o.session != self._session:
            self._session = o.session
            self._begin()
        self._newest_ns = max(self._newest_ns, o.capture_unix_ns)
        if self._repeated is None or _precedes(self._repeated, o):
            self._repeated = o
        if not o.is_ok:
            newest_ns = self._sent_ns if self._refusal is None else max(self._sent_ns, self._refusal.capture_unix_ns)
            if o.capture_unix_ns >= newest_ns and not (o.revision and o.capture_unix_ns == self._sent_ns):
                self._refusal = o
        elif self._is_fresh(o):
            overtaken, self._answer = self._answer, o
            if overtaken is not None and overtaken.frame != o.frame:
                self._keep_for_later(overtaken)
        elif o.revision or o.frame not in self._known_ns:
            self._keep_for_later(o)
        self._forget()

    def next(self, now_s: float) -> Offer[T] | None:
        """The newest picture's set, or again what was the newest; the same until `sent`. None: nothing new is there."""
        fresh = self._fresh()
        if fresh is not None:
            return fresh
        wait_s = self.wait_s(now_s)
        return self._repeated if wait_s is not None and wait_s <= 0.0 else None

    def next_of_rest(self, now_s: float) -> Offer[T] | None:
        """The older picture's set that is worth most; None also while the newest on the ground is too old for that."""
        is_fresh_enough = self._fresh_at_s is not None and now_s - self._fresh_at_s < FRESH_S
        return self._best_of_rest() if self._rest and (is_fresh_enough or self._fresh() is None) else None

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until the newest is due to be sent again; None: there is none, or a new one waits."""
        if self._fresh() is not None or self._repeated is None or self._fresh_at_s is None:
            return None
        return max(self._fresh_at_s + self._repeat_s - now_s, 0.0)

    def sent(self, offered: Offer[T], now_s: float) -> None:
        """Note that it went out."""
        o = offered
        if o.capture_unix_ns >= self._sent_ns or o is self._repeated:
            self._fresh_at_s = now_s
        self._sent_ns = max(self._sent_ns, o.capture_unix_ns)
        if o.is_ok:
            self._sent_answer_ns = max(self._sent_answer_ns, o.capture_unix_ns)
            self._known_ns[o.frame] = o.capture_unix_ns
            held = self._rest.get(o.frame)
            if held is not None and held.revision <= o.revision:
                del self._rest[o.frame]
                insort(self._rest_ns, o.capture_unix_ns)
        if self._answer is o:
            self._answer = None
        if self._refusal is not None and self._refusal.capture_unix_ns <= self._sent_ns:
            self._refusal = None

    def sent_before_ns(self, capture_unix_ns: int) -> int | None:
        """The capture of the last picture before this one whose answering set was sent; None if nothing is known."""
        return max((at for at in self._known_ns.values() if at < capture_unix_ns), default=None)

    def _keep_for_later(self, o: Offer[T]) -> None:
        held = self._rest.get(o.frame)
        if held is None or held.revision <= o.revision:
            self._rest[o.frame] = o

    def _is_fresh(self, o: Offer[T]) -> bool:
        if o.capture_unix_ns < self._sent_answer_ns:
            return False
        held = self._answer
        return held is None or (held.capture_unix_ns, held.revision) <= (o.capture_unix_ns, o.revision)

    def _fresh(self) -> Offer[T] | None:
        answer, refusal = self._answer, self._refusal
        if answer is None or refusal is None:
            return answer or refusal
        return refusal if refusal.capture_unix_ns - answer.capture_unix_ns > ANSWER_LEAD_NS else answer

    def _best_of_rest(self) -> Offer[T]:
        def kind(o: Offer[T]) -> tuple[bool, bool, bool]:
            return o.is_keyframe, o.revision > 0, o.frame not in self._known_ns

        def gap_then_newest(o: Offer[T]) -> tuple[int, int]:
            after = bisect_left(self._rest_ns, o.capture_unix_ns)
            nearest = self._rest_ns[max(after - 1, 0) : after + 1]
            gap = min((abs(o.capture_unix_ns - at) for at in nearest), default=MEMORY_NS)
            return gap, o.capture_unix_ns

        best = max(map(kind, self._rest.values()))
        return max((o for o in self._rest.values() if kind(o) == best), key=gap_then_newest)

    def _forget(self) -> None:
        oldest = self._newest_ns - MEMORY_NS
        old = [frame for frame, o in self._rest.items() if o.capture_unix_ns < oldest]
        surplus = len(self._rest) - len(old) - MAX_REST
        for frame in old:
            del self._rest[frame]
        for frame in sorted(self._rest)[: max(surplus, 0)]:
            del self._rest[frame]
        self._rest_ns = [at for at in self._rest_ns if at >= oldest]
        self._known_ns = {frame: at for frame, at in self._known_ns.items() if at >= oldest}


def _precedes(held: Offer[T], new: Offer[T]) -> bool:
    """Return whether a ground that has nothing should receive `new` first: answers before refusals, then the newest."""
    if held.is_ok != new.is_ok:
        lead = new.capture_unix_ns - held.capture_unix_ns
        return lead > -ANSWER_LEAD_NS if new.is_ok else lead > ANSWER_LEAD_NS
    return (held.capture_unix_ns, held.revision) <= (new.capture_unix_ns, new.revision)
