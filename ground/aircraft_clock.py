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
        """This moment."""
        return cls(time.monotonic_ns(), time.time_ns())


class AircraftClock:
    """The clock of one session, from when its sets were received and from what the aircraft answers.

    A set received at h, of a picture of age a when it was sent, was captured at h - a at the latest; the least
    difference to its stamp is that of the set that came fastest, and what others took longer counts as their age.
    """

    # Largest rate at which two clocks' crystals drift apart: it limits what an old message can state about now.
    DRIFT = 100e-6

    def __init__(self) -> None:
        self._offset_ns: int | None = None  # monotonic minus the aircraft's clock, at most
        self._noted_ns = 0
        self._contrary = 0  # sets in a row
        self.is_asked = False  # the aircraft itself has answered what its clock shows

    def received(self, sent_unix_ns: int, now: Moment) -> bool:
        """A set came that was sent when the aircraft's clock showed this; False: it is stamped too far ahead of that.

        Of two clocks that contradict each other the one that agrees with the ground's own stays; if none does, that of
        more sets.
        """
        offset_ns = now.monotonic_ns - sent_unix_ns
        if self._offset_ns is None:
            self._note(offset_ns, now.monotonic_ns)
            return True
        held_ns = self._offset_at(now.monotonic_ns)
        difference_ns = offset_ns + now.unix_ns - now.monotonic_ns
        is_certain = self.is_certain(now)
        self._contrary = self._contrary + 1 if offset_ns > held_ns + AHEAD_S * 1e9 else 0
        if not is_certain and (abs(difference_ns) <= AGREED_S * 1e9 or self._contrary >= IN_A_ROW):
            self._note(offset_ns, now.monotonic_ns)
            return True
        if offset_ns < held_ns - AHEAD_S * 1e9:
            return False
        if offset_ns < held_ns:
            self._note(offset_ns, now.monotonic_ns)
        return True

    def answered(self, sent_unix_ns: int, asked_ns: int, answered_ns: int) -> None:
        """The aircraft answered a question of `asked_ns` with what its clock showed when the question came."""
        least_ns, most_ns = asked_ns - sent_unix_ns, answered_ns - sent_unix_ns
        held_ns = most_ns if self._offset_ns is None else self._offset_at(answered_ns)
        self._note(min(max(held_ns, least_ns), most_ns), answered_ns)
        self.is_asked = True

    @property
    def is_contradicted(self) -> bool:
        """Return whether the last sets all came much later than stamped: the clock or they are not what they seem."""
        return self._contrary >= IN_A_ROW

    def is_certain(self, now: Moment) -> bool:
        """Return whether ages are known: the aircraft has answered, or its clock agrees with the ground's."""
        return self.is_asked or (self._offset_ns is not None and abs(self.behind_s(now)) <= AGREED_S)

    def behind_s(self, now: Moment) -> float:
        """By how much the aircraft's clock is behind the ground's Unix clock, with what the fastest set took."""
        return (now.unix_ns - now.monotonic_ns + self._offset_at(now.monotonic_ns)) / 1e9

    def age_s(self, capture_unix_ns: int, now: Moment) -> float:
        """Seconds since a picture of that session was taken, at most.

        What the fastest set took on its way is not in it; the clocks' difference is, unless the aircraft has answered.
        """
        age_s = max((self.now_unix_ns(now) - capture_unix_ns) / 1e9, 0.0)
        return age_s if self.is_asked else age_s + abs(self.behind_s(now))

    def now_unix_ns(self, now: Moment) -> int:
        """The time that the aircraft's clock shows."""
        return now.monotonic_ns - self._offset_at(now.monotonic_ns)

    def latest_unix_ns(self, now: Moment) -> int:
        """The time that no stamp of the session is beyond."""
        return self.now_unix_ns(now) + round(AHEAD_S * 1e9)

    def _note(self, offset_ns: int, monotonic_ns: int) -> None:
        self._offset_ns, self._noted_ns, self._contrary = offset_ns, monotonic_ns, 0

    def _offset_at(self, now_ns: int) -> int:
        return (self._offset_ns or 0) + round(self.DRIFT * (now_ns - self._noted_ns))
