"""The age of an aircraft's pictures by the ground's monotonic clock, and how far that can be relied on. No I/O.

What a message states of its age is as old as the message: a packet of yesterday states a tenth of a second. So an age
counts by what ties the aircraft's clock to now: the ground's own Unix clock where the two agree, or an answer of the
aircraft to a question that was put now. Until there is either, a picture may be older by as much as the clocks differ.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

AGREED_S = 0.5  # clocks that differ by no more need no answer; they count as older by the difference all the same
# By how much a set may come before what its session's clock shows: longer than a link holds a set back that came
# before. One that is stamped further ahead is not what it seems.
AHEAD_S = 60.0
# Sets in a row that all contradict a clock of which nothing else is known: the first one, from which it is, was not
# what it seemed.
IN_A_ROW = 5


@dataclass(frozen=True)
class Moment:
    """One moment by the ground's two clocks."""

    monotonic_ns: int
    unix_ns: int

    @classmethod
    def now(cls) -> Moment:
        return cls(time.monotonic_ns(), time.time_ns())


@dataclass(frozen=True)
class _Shown:
    """The state of an aircraft's clock: the monotonic clock minus it, and when that was noted."""

    offset_ns: int
    noted_ns: int
    frame: int | None = None  # the set's that showed it

    def is_ahead(self, of_ns: int) -> bool:
        """Return whether this clock is ahead of one of that offset, by more than clocks need an answer for."""
        return self.offset_ns < of_ns - AGREED_S * 1e9


class AircraftClock:
    """The clock of one session, from when its sets were received and from what the aircraft answers.

    A set received at h, of a picture of age a when it was sent, was captured at h - a at the latest; the least
    difference to its stamp is that of the set that came fastest, and what others took longer counts as their age.
    """

    # Largest rate at which two clocks' crystals drift apart: it limits what an old message can state about now.
    DRIFT = 100e-6

    def __init__(self) -> None:
        self._held: _Shown | None = None  # the offset at most
        self._least: _Shown | None = None  # the offset at least, as answered
        self._claim: _Shown | None = None
        self._contrary = 0  # sets in a row
        self._is_moved = False  # since the last answer: two sets agree on a clock ahead of it
        self._refuted: list[int] = []

    @property
    def is_asked(self) -> bool:
        """Return whether the aircraft itself has answered what its clock shows."""
        return self._least is not None

    def take_refuted(self) -> list[int]:
        """Return the frames of sets whose clock was contradicted since the last call: they are not what they seemed."""
        refuted, self._refuted = self._refuted, []
        return refuted

    def _refute(self, claim: _Shown | None) -> None:
        if claim is not None and claim.frame is not None:
            self._refuted.append(claim.frame)

    def received(self, sent_unix_ns: int, now: Moment, frame: int | None = None) -> bool:
        """A set came that was sent when the aircraft's clock showed this; False: it is stamped too far ahead of that.

        Of two clocks that contradict each other the one that agrees with the ground's own stays; if none does, that of
        more sets. A set ahead of a clock that is certain is a claim. An aircraft's clock does not go back: the next
        set confirms it, or contradicts it.
        """
        shown = _Shown(now.monotonic_ns - sent_unix_ns, now.monotonic_ns, frame)
        if self._held is None:
            self._held = shown
            return True
        held_ns = self._offset_at(now.monotonic_ns)
        is_certain = self.is_certain(now)
        agrees = abs(shown.offset_ns - _agreed_ns(now)) <= AGREED_S * 1e9
        self._contrary = self._contrary + 1 if shown.offset_ns > held_ns + AHEAD_S * 1e9 else 0
        if not is_certain and (agrees or self._contrary >= IN_A_ROW):
            self._claim = self._held if agrees and self._held.is_ahead(shown.offset_ns) else None
            self._note(shown)
        elif shown.offset_ns < held_ns - AHEAD_S * 1e9:
            return False
        elif (not is_certain or self._is_accepted(shown, now)) and shown.offset_ns < self._offset_at(now.monotonic_ns):
            self._note(shown)
        return True

    def answered(self, sent_unix_ns: int, asked_ns: int, answered_ns: int) -> None:
        """The aircraft answered a question of `asked_ns` with what its clock showed when the question came.

        That refutes a clock further ahead, unless a set showed it that came after the question.
        """
        least_ns, most_ns = asked_ns - sent_unix_ns, answered_ns - sent_unix_ns
        held_ns = most_ns if self._held is None else self._offset_at(answered_ns)
        claim = self._claim or self._held
        is_open = claim is not None and claim.noted_ns > asked_ns and claim.is_ahead(least_ns)
        if claim is not None and claim.is_ahead(least_ns) and not is_open:
            self._refute(claim)
        self._note(_Shown(min(max(held_ns, least_ns), most_ns), answered_ns))
        self._least, self._claim, self._is_moved = _Shown(least_ns, answered_ns), claim if is_open else None, False

    @property
    def is_contradicted(self) -> bool:
        """Return whether sets and clock contradict each other: one of them is not what it seems."""
        return self._contrary >= IN_A_ROW or self._claim is not None or self._is_moved

    def is_certain(self, now: Moment) -> bool:
        """Return whether ages are known: the aircraft has answered, or its clock agrees with the ground's."""
        return self.is_asked or (self._held is not None and abs(self.behind_s(now)) <= AGREED_S)

    def behind_s(self, now: Moment) -> float:
        """The lag of the aircraft's clock behind the ground's Unix clock, s, including what the fastest set took."""
        return (self._offset_at(now.monotonic_ns) - _agreed_ns(now)) / 1e9

    def age_s(self, capture_unix_ns: int, now: Moment) -> float:
        """Seconds since a picture of that session was taken, at most.

        What the fastest set took on its way is not in it; the clocks' difference is, unless the aircraft has answered,
        and by how much a claim is ahead.
        """
        age_s = max((self.now_unix_ns(now) - capture_unix_ns) / 1e9, 0.0)
        if self._claim is not None:
            age_s += max(self._least_at(now) - self._claim.offset_ns, 0) / 1e9
        return age_s if self.is_asked else age_s + abs(self.behind_s(now))

    def now_unix_ns(self, now: Moment) -> int:
        return now.monotonic_ns - self._offset_at(now.monotonic_ns)

    def latest_unix_ns(self, now: Moment) -> int:
        """The time that no stamp of the session is beyond; of a claim, that of the claim."""
        if not self.is_certain(now):
            return self.now_unix_ns(now) + round(AHEAD_S * 1e9)
        least_ns = self._least_at(now) if self._claim is None else self._claim.offset_ns
        return now.monotonic_ns - least_ns + round(AGREED_S * 1e9)

    def _is_accepted(self, shown: _Shown, now: Moment) -> bool:
        """Judge the claim by the set after it, of a clock that is certain; False: this set is a claim itself."""
        claim, self._claim = self._claim, None
        if not shown.is_ahead(self._least_at(now)):
            self._refute(claim)
            return True
        if claim is not None and not claim.is_ahead(shown.offset_ns):
            self._note(claim)
            self._is_moved = True
            if self._least is None:
                return True  # it is no longer certain
            self._least = claim
        else:
            self._refute(claim)
        self._claim = shown if shown.is_ahead(self._least_at(now)) else None
        return self._claim is None

    def _note(self, shown: _Shown) -> None:
        self._held, self._contrary = shown, 0

    def _offset_at(self, now_ns: int) -> int:
        held = self._held
        return 0 if held is None else held.offset_ns + round(self.DRIFT * (now_ns - held.noted_ns))

    def _least_at(self, now: Moment) -> int:
        """The least that the offset of a clock that is certain can be, but for AGREED_S."""
        if self._least is None:
            return _agreed_ns(now)
        return self._least.offset_ns - round(self.DRIFT * (now.monotonic_ns - self._least.noted_ns))


def _agreed_ns(now: Moment) -> int:
    """The offset of a clock that shows what the ground's own does."""
    return now.monotonic_ns - now.unix_ns
