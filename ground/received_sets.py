"""One vehicle's sets as they are received: which session runs, how old its pictures are, and what to ask of it. No I/O.

A set that was put on the link yesterday can come again today, and so can one that a fault has stamped an hour ahead.
Neither takes the place of what runs: a later session does, whose clock agrees with the ground's; and any session that
the aircraft itself, asked, answers with.
"""

from __future__ import annotations

from contract.answer import Refusal
from contract.errors import LinkError
from contract.feature_set import FeatureSet
from contract.history import History
from ground.aircraft_clock import AGREED_S, AHEAD_S, AircraftClock, Moment
from ground.freshness import STATED_S, Later, Reply, span

SILENT_S = 10.0  # without a set of the session that ran, after which a later one may be the next, though it is doubtful
AT_ONCE_S = 5.0  # after a session's first picture, from which on another session's newer ones are another aircraft's
ASK_S, MOST_ASK_S = 5.0, 60.0  # between questions to one vehicle, twice as long each time


def two_of_one_name(vehicle: str, session: int, other: int | None) -> str:
    """Words for two sessions of one name that run at once."""
    return (
        f"two aircraft call themselves {vehicle!r} (sessions {session} and {other} run at once): give each a "
        "vehicle.id of its own"
    )


def check_is_one(one: FeatureSet | Refusal, other: FeatureSet | Refusal) -> None:
    """Raise LinkError for two answers of one vehicle to one question, unless both are sets of one session: whose answer
    would be taken were chance.
    """
    if isinstance(one, FeatureSet) and isinstance(other, FeatureSet):
        if one.session != other.session:
            raise LinkError(two_of_one_name(one.vehicle, one.session, other.session))
        return
    refusal = one if isinstance(one, Refusal) else other
    raise LinkError(
        f"two aircraft call themselves {refusal.vehicle!r} (both answered one question, one with "
        f"{refusal.status.value!r}): give each a vehicle.id of its own"
    )


class ReceivedSets:
    """The sets of a vehicle, bounded as `History` is, with the clock of each session that is kept."""

    def __init__(self, vehicle: str, max_age_s: float, max_sets: int) -> None:
        self.vehicle = vehicle
        self.history: History[FeatureSet] = History(max_age_s, max_sets)
        self._clocks: dict[int, AircraftClock] = {}
        self._ran_ns = 0  # monotonic, when a set of the session that runs came last
        self._is_contradicted = False  # since the last answer
        self._ask_at_ns, self._pause_s, self._is_unanswered = 0, ASK_S, False

    @property
    def clock(self) -> AircraftClock | None:
        """The clock of the session that runs; None before a set of it was received."""
        session = self.history.session
        return None if session is None else self._clocks.get(session)

    def take(self, s: FeatureSet, age_s: float | None, now: Moment) -> str:
        """A set that came now, and its picture's age when it was sent; why it is left out, or nothing."""
        clock = self._clocks.setdefault(s.session, AircraftClock())
        if not clock.received(s.capture_unix_ns + round((age_s or 0.0) * 1e9), now, s.frame):
            self._is_contradicted = True
            return f"{self.vehicle!r} stamps sets more than {AHEAD_S:.0f} s ahead of its own clock"
        self._forget_false(s.session, clock, now)
        self.history.add(s, s, runs=self._runs(s.session, clock, now))
        self._forget_clocks()
        if s.session != self.history.session:
            self._is_contradicted = True
            if self._are_two_at_once(s.session, now):
                return two_of_one_name(self.vehicle, s.session, self.history.session)
            return f"{self.vehicle!r} sends sets of session {s.session}, and {self.history.session} runs"
        self._ran_ns = now.monotonic_ns
        return ""

    def bring_in(self, s: FeatureSet) -> None:
        """Keep a set of an earlier run, or one that was asked for: it gives no information on the aircraft's clock."""
        self.history.add(s, s, runs=None if self.clock is None else False)
        self._forget_clocks()

    def answered(self, session: int, sent_unix_ns: int | None, asked_ns: int, now: Moment) -> None:
        """The aircraft answered a question that was put at `asked_ns` with a set of this session.

        `sent_unix_ns`: what its clock showed when the question came, if that is known.
        """
        if session != self.history.session:
            self.history.run(session)
            self._ran_ns = now.monotonic_ns
        clock = self._clocks.setdefault(session, AircraftClock())
        if sent_unix_ns is not None:
            clock.answered(sent_unix_ns, asked_ns, now.monotonic_ns)
            self._forget_false(session, clock, now)
        self._is_contradicted = self._is_unanswered = False
        self._forget_clocks()

    def answered_by_radio(self, sent_unix_ns: int, asked_ns: int, now: Moment) -> None:
        """Take an answer as `answered` does, without the session: it is the one whose clock fits best."""
        fits = min(self._clocks, key=lambda n: abs(self._clocks[n].now_unix_ns(now) - sent_unix_ns), default=None)
        if fits is not None:
            self.answered(fits, sent_unix_ns, asked_ns, now)

    def is_to_be_asked(self, now: Moment) -> bool:
        """Return whether to ask the aircraft now for its clock and its session; counted as asked."""
        clock = self.clock
        if clock is None and not self._clocks:
            return False  # nothing came by itself
        is_contradicted = self._is_contradicted or clock is None or clock.is_contradicted
        if not is_contradicted and clock is not None and clock.is_certain(now):
            self._pause_s = ASK_S
            return False
        if now.monotonic_ns < self._ask_at_ns:
            return False
        self._ask_at_ns = now.monotonic_ns + round(self._pause_s * 1e9)
        self._pause_s, self._is_unanswered = min(2.0 * self._pause_s, MOST_ASK_S), True
        return True

    def age_s(self, capture_unix_ns: int, now: Moment) -> float | None:
        """Seconds since a picture of the session that runs was taken, at most; None before a set of it came."""
        clock = self.clock
        return None if clock is None else clock.age_s(capture_unix_ns, now)

    def is_of_now(self, session: int) -> bool:
        """Return whether what states this session is of the one that runs, or of a later one; true before any set came.

        A status states session 0 before its session's first picture.
        """
        running = self.history.session
        return session == 0 or running is None or session >= running

    def reply(self, now: Moment) -> Reply | None:
        """The newest set that answers with its age, and what is known of a newer one that refuses."""
        found, latest = self.history.newest_entry(), self.history.newest_picture()
        if found is None or latest is None or self.clock is None:
            return None
        later = None
        if latest is not found:
            later = Later(latest.status, latest.frame, self.age_s(latest.capture_unix_ns, now))
        return Reply(found.item, self.age_s(found.capture_unix_ns, now), later, doubt=self.doubt(now))

    def doubt(self, now: Moment) -> str:
        """The state of the aircraft's clock, in words; empty where it agrees with the ground's."""
        clock = self.clock
        if clock is None or abs(clock.behind_s(now)) <= (STATED_S if clock.is_asked else AGREED_S):
            return ""
        behind_s = clock.behind_s(now)
        by = f"{span(abs(behind_s))} {'behind' if behind_s > 0.0 else 'ahead of'} this computer's clock"
        if clock.is_asked:
            return f"the aircraft's clock is {by}"
        what = "they are old, or a clock is wrong" if behind_s > 0.0 else "a clock is wrong"
        asked = ", and the aircraft does not answer which" if self._is_unanswered else ""
        return f"pictures are stamped {by}: {what}{asked}"

    def _runs(self, session: int, clock: AircraftClock, now: Moment) -> bool:
        """Return whether a set that came now shows that its session is the one that runs."""
        running = self.history.session
        if running in (None, session):
            return True
        held = self.clock
        is_held_certain = held is not None and held.is_certain(now)
        if session > self.history.highest:
            is_silent = now.monotonic_ns - self._ran_ns > SILENT_S * 1e9
            return clock.is_certain(now) or not is_held_certain or is_silent
        return clock.is_certain(now) and not is_held_certain

    def _are_two_at_once(self, session: int, now: Moment) -> bool:
        """Return whether a session and the one that runs take pictures at once, by clocks that are certain: an aircraft
        that began again takes none in the session before.
        """
        ages_s: list[tuple[float, float]] = []
        for number in (session, self.history.session):
            clock = None if number is None else self._clocks.get(number)
            span_ns = None if number is None else self.history.span_ns(number)
            if clock is None or span_ns is None or not clock.is_certain(now):
                return False
            ages_s.append((clock.age_s(span_ns[0], now), clock.age_s(span_ns[1], now)))
        (first_s, newest_s), (its_first_s, its_newest_s) = ages_s
        return min(first_s - its_newest_s, its_first_s - newest_s) > AT_ONCE_S

    def _forget_false(self, session: int, clock: AircraftClock, now: Moment) -> None:
        """Drop the sets stamped in the future, and those that were when they came, though that is past by now."""
        self.history.forget_after(session, clock.latest_unix_ns(now))
        for frame in clock.take_refuted():
            self.history.forget(session, frame)

    def _forget_clocks(self) -> None:
        kept = self.history.sessions
        self._clocks = {number: clock for number, clock in self._clocks.items() if number in kept}
