"""The autopilot's boot clock on ours, live: by TIMESYNC where it answers, else by the least delayed arrivals.

An exchange (we send our time, the autopilot adds its own, the answer comes back) gives the clocks' offset to within
half its round trip, whatever the delays (12.1). Offset and drift follow all exchanges through a filter
(`clock_filter`) that weighs each by what its round trip has over the least one, and estimates how fast the drift itself
changes: a crystal's hardly does, a simulator's by thousandths within seconds. Every stamp has a sigma.

Stamps follow the estimate without ever running backwards: where the estimate moves, the clock that is used catches up
at a bounded rate; only a reboot, which starts the boot clock again, makes it jump.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from onboard.clocks.arrivals import Arrivals
from onboard.clocks.boot_clock import Mode
from onboard.clocks.clock_filter import ClockFilter

NS_PER_S = 1_000_000_000
BIN_NS = NS_PER_S // 2
FIRST_FEW = 30  # exchanges, asked for in a hurry
WINDOW_NS, LEAST_KEPT = 60 * NS_PER_S, 24  # over which, and over how many, the least round trip is sought
# Between questions: autopilots pass them on to every radio, 28 bytes each. Asked once the offset has become less
# certain by `GROWN_NS` (0.02 m at 20 m/s), or where it is not known as well, by a twentieth, as its own
# filter predicts it; unanswered some times, ever more seldom.
HURRIED_NS, SOON_NS, SELDOM_NS = NS_PER_S // 5, NS_PER_S, 30 * NS_PER_S
GROWN_NS, GROWN_SHARE = 1_000_000.0, 0.3
MAX_UNANSWERED = 5
MAX_ROUND_TRIP_NS = 2 * NS_PER_S
FLOOR_NS = 100_000.0  # of an exchange's error: scheduling, reading the clocks
TOLERANCE_NS = 2_000_000.0  # beyond half its round trip, before an exchange contradicts the line
MAX_CONTRADICTIONS = 3
FEW = 16  # exchanges, while the least round trip is still falling: all are weighted again with each
DISAGREEMENT_NS = 1.5 * NS_PER_S  # between TIMESYNC and the newest arrivals: it is of another clock
STALE_NS = 5 * NS_PER_S  # without an answer, before arrivals may serve better
FIRST_EXCHANGES = 3
HOLD_NS = 1 * NS_PER_S  # until what has come is trusted without them
SLEW = 0.25
PIECE_NS = NS_PER_S // 5
PIECES = 32


@dataclass(frozen=True)
class Line:
    """Offset = `level_ns` + `drift` (boot - `origin_ns`), one sigma at the origin."""

    origin_ns: int
    level_ns: float
    drift: float
    sigma_ns: float = math.inf

    def at(self, boot_ns: int) -> float:
        """The offset (ns) at a boot time."""
        return self.level_ns + self.drift * (boot_ns - self.origin_ns)


@dataclass(frozen=True)
class _Exchange:
    boot_ns: int
    offset_ns: int
    round_trip_ns: int


@dataclass
class TimeSync:
    """Exchanges of one run of the boot clock -> offset and drift. Memory is bounded by the window."""

    kept: dict[int, _Exchange] = field(default_factory=dict)  # the least round trip of every half second
    outliers: list[_Exchange] = field(default_factory=list)
    exchanges: int = 0  # counted in
    round_trip_ns: int = 0  # the least of the window; 0 before the first exchange
    _filter: ClockFilter | None = None
    _first: list[_Exchange] = field(default_factory=list)

    def add(self, sent_ns: int, boot_ns: int, received_ns: int) -> bool:
        """Take one exchange; returns whether the line now counts it. Times of an impossible round trip are ignored."""
        round_trip = received_ns - sent_ns
        if not 0 <= round_trip <= MAX_ROUND_TRIP_NS:
            return False
        new = _Exchange(boot_ns, (sent_ns + received_ns) // 2 - boot_ns, round_trip)
        if self._filter is not None and not self._is_explained(new):
            self.outliers.append(new)
            if len(self.outliers) < MAX_CONTRADICTIONS:
                return False
            self._start_over()
            return True
        self.outliers.clear()
        self._take(new)
        return True

    def _is_explained(self, exchange: _Exchange) -> bool:
        """The truth lies within half a round trip: a line farther off than that is wrong, or a clock has stepped."""
        line = self.line_at(exchange.boot_ns)
        assert line is not None
        allowed_ns = exchange.round_trip_ns / 2 + 3.0 * line.sigma_ns + TOLERANCE_NS
        return abs(exchange.offset_ns - line.level_ns) <= allowed_ns

    def _start_over(self) -> None:
        """Several contradictions in a row: a clock has stepped (a simulator that stalled), and only they count."""
        again, self.outliers = self.outliers, []
        self.kept.clear()
        self._first.clear()
        self._filter = None
        for outlier in again:
            self._take(outlier)

    @property
    def is_settled(self) -> bool:
        """Return whether it has what it needs to predict how long it will do."""
        return self.exchanges >= FIRST_FEW and not self.outliers

    def grown_ns(self, boot_ns: int) -> float:
        """The growth of one sigma of the offset (ns), in squares, since the newest exchange."""
        if self._filter is None:
            return math.inf
        return math.sqrt(max(self._filter.at(boot_ns)[2] - self._filter.at(self._filter.boot_ns)[2], 0.0))

    @property
    def line(self) -> Line | None:
        """Offset and drift at the newest exchange; None before the first."""
        return None if self._filter is None else self.line_at(self._filter.boot_ns)

    def line_at(self, boot_ns: int) -> Line | None:
        """Offset, drift and one sigma at a boot time, which grows with the time since the newest exchange."""
        if self._filter is None:
            return None
        level, drift, variance = self._filter.at(boot_ns)
        # Which way the least round trip was spent cannot be seen: anything within its half, evenly.
        variance += (self.round_trip_ns / 2.0) ** 2 / 3.0
        return Line(boot_ns, self._filter.base_ns + level, drift, math.sqrt(variance))

    @property
    def newest_ns(self) -> int:
        """Boot time of the newest exchange; 0 before the first."""
        return 0 if self._filter is None else self._filter.boot_ns

    def _take(self, new: _Exchange) -> None:
        self.exchanges += 1
        key = new.boot_ns // BIN_NS
        held = self.kept.get(key)
        if held is None or new.round_trip_ns < held.round_trip_ns:
            self.kept[key] = new
        oldest = min((new.boot_ns - WINDOW_NS) // BIN_NS, sorted(self.kept)[-LEAST_KEPT:][0])
        self.kept = {k: exchange for k, exchange in self.kept.items() if k >= oldest}
        trips = sorted(exchange.round_trip_ns for exchange in self.kept.values())
        least = self.round_trip_ns = trips[0]
        # (12.2): what a round trip has over the least was spent on the way there or back, and its half is the error.
        # The least of a few has an excess of its own, about as large as what lies between it and the next few.
        own = FLOOR_NS**2 + ((trips[(len(trips) + 1) // 4] - least) / 2.0) ** 2 if len(trips) > 1 else FLOOR_NS**2

        def variance(exchange: _Exchange) -> float:
            return own + ((exchange.round_trip_ns - least) / 2.0) ** 2

        if self._filter is not None and len(self._first) >= FEW:
            self._filter.update(new.boot_ns, new.offset_ns, variance(new))
            return
        self._first.append(new)
        first = self._first[0]
        self._filter = ClockFilter(first.boot_ns, first.offset_ns, variance(first))
        for exchange in self._first[1:]:
            self._filter.update(exchange.boot_ns, exchange.offset_ns, variance(exchange))


@dataclass(frozen=True)
class _Piece:
    """The clock from `start_ns` on: the target line, plus a gap that closes."""

    start_ns: int
    line: Line
    gap_ns: float

    def gap(self, boot_ns: int) -> float:
        """Return how far (ns) the clock that is used is from its target at a boot time."""
        closed = SLEW * max(boot_ns - self.start_ns, 0)
        return math.copysign(max(abs(self.gap_ns) - closed, 0.0), self.gap_ns)

    def offset(self, boot_ns: int) -> float:
        return self.line.at(boot_ns) + self.gap(boot_ns)


class LinkClock:
    """Boot time -> session clock, fed by one link. All times in ns; answers grow with boot time within one boot."""

    def __init__(self, mode: Mode) -> None:
        self._arrivals = Arrivals(mode)
        self._pieces: deque[_Piece] = deque(maxlen=PIECES)
        self._began_ns = 0
        self._newest_ns = 0
        self._is_handed_out = False  # a stamp of this boot has left: from now on the clock may only slew
        self._round_trip_ns = 0  # the least that was known last, of this link
        self._contradictions = 0
        self._asked_ns: int | None = None
        self._unanswered = 0  # questions since the newest exchange that counts
        self._waiting_boot_ns: int | None = None  # since when one is unanswered
        self._figures: dict[str, float] = {}  # made by the thread that feeds, read by any
        self._figures_ns = 0
        self.sync = TimeSync()
        self.disagrees = False  # TIMESYNC is answered, but from another clock
        self.is_by_arrival = False  # exchanges once served, and do not: they are not answered any more, or wrongly

    def arrived(self, boot_ns: int, arrival_ns: int) -> bool:
        """Take a message's boot stamp and arrival; returns whether the boot clock has started again, or stepped."""
        restarted = self._arrivals.add(boot_ns, arrival_ns)
        if restarted:
            self.sync = TimeSync()
            self._pieces.clear()
            self._is_handed_out = False
            self._began_ns, self._newest_ns = arrival_ns, boot_ns
            self._asked_ns, self._unanswered, self._waiting_boot_ns = None, 0, None
            self._figures_ns = boot_ns
        self._newest_ns = max(self._newest_ns, boot_ns)
        self._follow()
        if restarted or self._newest_ns - self._figures_ns >= PIECE_NS:
            self._note_figures()
        return restarted and self._arrivals.segments > 1

    def is_due(self, now_ns: int) -> bool:
        """Return whether a TIMESYNC request is worth its bytes now."""
        if self._asked_ns is None:
            return True
        since_ns = now_ns - self._asked_ns
        if self._unanswered > 2 * MAX_UNANSWERED or (self._unanswered > MAX_UNANSWERED and self.sync.is_settled):
            return since_ns >= min(SOON_NS << min(self._unanswered - MAX_UNANSWERED, 8), SELDOM_NS)
        if not self.sync.is_settled:
            return since_ns >= HURRIED_NS
        is_wanted = self._unanswered > 0 or self._has_grown
        return since_ns >= (SOON_NS if is_wanted else SELDOM_NS)

    @property
    def _has_grown(self) -> bool:
        line = self.sync.line
        known_ns = GROWN_NS if line is None else max(GROWN_NS, GROWN_SHARE * line.sigma_ns)
        return self.sync.grown_ns(self._newest_ns) > known_ns

    def asked(self, now_ns: int) -> None:
        """A TIMESYNC request has left."""
        self._asked_ns = now_ns
        self._unanswered += 1
        if self._waiting_boot_ns is None:
            self._waiting_boot_ns = self._newest_ns

    def exchanged(self, sent_ns: int, boot_ns: int, received_ns: int) -> None:
        """Take an answered TIMESYNC request: our time when it left, the autopilot's, our time when it came back."""
        if not self._arrivals.segments:
            return
        # Against the newest arrivals alone: over longer, the drift of a simulator's clock would add up to as much.
        offset_ns = (sent_ns + received_ns) // 2 - boot_ns
        self.disagrees = abs(offset_ns - self._arrivals.nearest_offset_ns()) > DISAGREEMENT_NS
        self._contradictions = self._contradictions + 1 if self.disagrees else 0
        if self._contradictions >= MAX_CONTRADICTIONS and self.sync.exchanges:
            self.sync = TimeSync()  # what was known by exchanges is out of date, and is not extrapolated
            self._follow(at_once=True)
        if not self.disagrees and self.sync.add(sent_ns, boot_ns, received_ns):
            self._round_trip_ns = self.sync.round_trip_ns
            self._unanswered, self._waiting_boot_ns = 0, None
            self._follow(at_once=True)
        self._note_figures()

    def is_known(self, now_ns: int) -> bool:
        """Return whether stamps may be used: after a few exchanges, or after some time of any messages."""
        return self._arrivals.segments > 0 and (
            self.sync.exchanges >= FIRST_EXCHANGES or now_ns - self._began_ns >= HOLD_NS
        )

    def to_host_ns(self, boot_ns: int) -> int:
        """Boot time on the session's clock; raises LookupError before the first arrival."""
        self._is_handed_out = True
        return boot_ns + round(self._piece(boot_ns).offset(boot_ns))

    def sigma_ns(self, boot_ns: int) -> float:
        """One sigma (ns) of what `to_host_ns` gives for a boot time; raises LookupError before the first arrival."""
        return math.hypot(self._target(boot_ns).sigma_ns, self._piece(boot_ns).gap(boot_ns))

    def _piece(self, boot_ns: int) -> _Piece:
        if not self._pieces:
            raise LookupError("the clock has not seen a message yet")
        for candidate in reversed(self._pieces):
            if candidate.start_ns <= boot_ns:
                return candidate
        return self._pieces[0]

    def figures(self) -> dict[str, float]:
        """`round_trip_ms`, `drift_ppm` (ours against the boot clock) and `clock_sigma_ms` (of the newest stamps).

        By arrival `arrival_sigma_ms` instead, which does not hold the least delay; where that is known from exchanges
        before, `clock_sigma_ms` too. Empty before the first message. From any thread.
        """
        return dict(self._figures)

    def _note_figures(self) -> None:
        self._figures_ns = self._newest_ns
        is_synchronised = self._is_synchronised
        self.is_by_arrival = bool(self._round_trip_ns) and not is_synchronised
        sigma_ms = self.sigma_ns(self._newest_ns) / 1e6
        figures = {"drift_ppm": self._target(self._newest_ns).drift * 1e6}
        if is_synchronised:
            figures["round_trip_ms"] = self.sync.round_trip_ns / 1e6
        else:
            figures["arrival_sigma_ms"] = sigma_ms
        if self._round_trip_ns:
            figures["clock_sigma_ms"] = sigma_ms
        self._figures = figures

    @property
    def _is_synchronised(self) -> bool:
        """True if exchanges serve: there are some, and they are new or still better than arrivals."""
        line = self.sync.line_at(self._newest_ns)
        if line is None:
            return False
        return self._is_answered or line.sigma_ns <= self._by_arrival(self._newest_ns).sigma_ns

    def _by_arrival(self, boot_ns: int) -> Line:
        offset_ns, drift, sigma_ns = self._arrivals.line(boot_ns)
        # Even the promptest message was under way for some of the least round trip.
        return Line(boot_ns, offset_ns, drift, math.hypot(sigma_ns, self._round_trip_ns / 2.0))

    def _target(self, boot_ns: int) -> Line:
        if self._is_synchronised:
            line = self.sync.line_at(boot_ns)
            assert line is not None
            return line
        return self._by_arrival(boot_ns)

    def _follow(self, at_once: bool = False) -> None:
        """Aim at the best estimate from the newest boot time on, starting from where the clock stands."""
        if not self._pieces:
            self._pieces.append(_Piece(self._newest_ns, self._target(self._newest_ns), 0.0))
            return
        last = self._pieces[-1]
        is_followed = self._is_answered and self.sync.line is not None
        if not at_once and (self._newest_ns - last.start_ns < PIECE_NS or is_followed):
            return
        target = self._target(self._newest_ns)
        if not self._is_handed_out:
            self._pieces.clear()
            self._pieces.append(_Piece(self._newest_ns, target, 0.0))
            return
        gap = last.offset(self._newest_ns) - target.at(self._newest_ns)
        self._pieces.append(_Piece(self._newest_ns, target, gap))

    @property
    def _is_answered(self) -> bool:
        """Return whether no question has been waiting for its answer for long."""
        return self._waiting_boot_ns is None or self._newest_ns - self._waiting_boot_ns <= STALE_NS
