"""The autopilot's boot clock on ours, live: by TIMESYNC where it answers, else by the least delayed arrivals.

An exchange (we send our time, the autopilot adds its own, the answer comes back) gives the clocks' offset to within
half its round trip, whatever the delays. The exchange with the least round trip of every half second is kept for a
minute, and a line through those, weighted by what their excess round trips allow, is offset and drift.

Stamps follow the estimate without ever running backwards: where the estimate moves, the clock handed out catches up at
a bounded rate; only a reboot, which starts the boot clock again, makes it jump.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from onboard.telemetry.boot_clock import BootClock, Mode

NS_PER_S = 1_000_000_000
BIN_NS = NS_PER_S // 2
SETTLED_NS = 4 * NS_PER_S
WINDOW_NS = 60 * NS_PER_S
MAX_ROUND_TRIP_NS = 2 * NS_PER_S
FLOOR_NS = 100_000.0  # of an exchange's error: scheduling, reading the clocks
PRIOR_DRIFT = 2e-4  # one sigma: crystals
WIDE_PRIOR_DRIFT = 1e-2  # once they contradict it: simulators, whose clocks are a per cent off
MAX_DRIFT = 0.1  # more is no clock; with SLEW it keeps stamps rising
TOLERANCE_NS = 2_000_000.0  # beyond half its round trip, before an exchange contradicts the line
MAX_STRIKES = 3
DISAGREEMENT_NS = 1.5 * NS_PER_S  # between TIMESYNC and arrivals: it is of another clock
ARRIVALS_NS = 120 * NS_PER_S
FIRST_EXCHANGES = 3
HOLD_NS = 1 * NS_PER_S  # until what has come is trusted without them
SLEW = 0.25
PIECE_NS = NS_PER_S // 5
PIECES = 32


@dataclass(frozen=True)
class Line:
    """Offset = `level_ns` + `drift` (boot - `origin_ns`), one sigma at its newest exchange."""

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

    kept: dict[int, _Exchange] = field(default_factory=dict)
    strays: list[_Exchange] = field(default_factory=list)
    line: Line | None = None
    exchanges: int = 0  # counted in
    prior_drift: float = PRIOR_DRIFT
    round_trip_ns: int = 0  # the least of the window; 0 before the first exchange

    def add(self, sent_ns: int, boot_ns: int, received_ns: int) -> bool:
        """Take one exchange; returns whether the line now counts it. Times of an impossible round trip are ignored."""
        round_trip = received_ns - sent_ns
        if not 0 <= round_trip <= MAX_ROUND_TRIP_NS:
            return False
        new = _Exchange(boot_ns, (sent_ns + received_ns) // 2 - boot_ns, round_trip)
        if self.line is not None and not self._is_explained(new):
            self.strays.append(new)
            if len(self.strays) < MAX_STRIKES:
                return False
            self._start_over()
            return True
        self.strays.clear()
        self._keep(new)
        self._fit()
        return True

    def _is_explained(self, exchange: _Exchange) -> bool:
        """The truth lies within half a round trip: a line farther off than that is wrong, or a clock has stepped."""
        assert self.line is not None
        miss = abs(exchange.offset_ns - self.line.at(exchange.boot_ns))
        return miss <= exchange.round_trip_ns / 2 + 3.0 * self.line.sigma_ns + TOLERANCE_NS

    def _start_over(self) -> None:
        """Several contradictions in a row: a drift that no crystal has explains them and all before, or a step."""
        again, self.strays = self.strays, []
        self.prior_drift = WIDE_PRIOR_DRIFT
        for stray in again:
            self._keep(stray)
        self._fit()
        if not all(self._is_explained(exchange) for exchange in (*again, *self.kept.values())):
            self.kept.clear()
            for stray in again:
                self._keep(stray)
            self._fit()

    @property
    def is_settled(self) -> bool:
        """Whether it has what it needs, so that asking once a second is enough."""
        return (max(self.kept) - min(self.kept)) * BIN_NS >= SETTLED_NS and not self.strays if self.kept else False

    def _keep(self, new: _Exchange) -> None:
        self.exchanges += 1
        key = new.boot_ns // BIN_NS
        held = self.kept.get(key)
        if held is None or new.round_trip_ns < held.round_trip_ns:
            self.kept[key] = new
        oldest = (new.boot_ns - WINDOW_NS) // BIN_NS
        self.kept = {k: exchange for k, exchange in self.kept.items() if k >= oldest}

    def _fit(self) -> None:
        """Weighted least squares with a prior on the drift alone, about the exchanges' own weighted mean."""
        samples = list(self.kept.values())
        least = self.round_trip_ns = min(s.round_trip_ns for s in samples)
        origin, base = samples[-1].boot_ns, samples[-1].offset_ns
        # What a round trip has over the least was spent on the way there or back: its half is the offset's error.
        # The least of a few has an excess of its own, about as large as what lies between it and the next few.
        usual = sorted(s.round_trip_ns for s in samples)[(len(samples) + 1) // 4]
        own = FLOOR_NS**2 + ((usual - least) / 2.0) ** 2
        weights = [1.0 / (own + ((s.round_trip_ns - least) / 2.0) ** 2) for s in samples]
        x = [float(s.boot_ns - origin) for s in samples]
        y = [float(s.offset_ns - base) for s in samples]
        total = sum(weights)
        mean_x = sum(w * a for w, a in zip(weights, x, strict=True)) / total
        mean_y = sum(w * b for w, b in zip(weights, y, strict=True)) / total
        spread = sum(w * (a - mean_x) ** 2 for w, a in zip(weights, x, strict=True)) + 1.0 / self.prior_drift**2
        drift = sum(w * (a - mean_x) * (b - mean_y) for w, a, b in zip(weights, x, y, strict=True)) / spread
        drift = min(max(drift, -MAX_DRIFT), MAX_DRIFT)
        residual = [b - mean_y - drift * (a - mean_x) for a, b in zip(x, y, strict=True)]
        scatter = sum(w * r * r for w, r in zip(weights, residual, strict=True)) / max(len(samples) - 2, 1)
        variance = (1.0 / total + mean_x**2 / spread) * max(scatter, 1.0)
        # Which way the least round trip was spent, nobody can tell: anything within its half, evenly.
        variance += (least / 2.0) ** 2 / 3.0
        self.line = Line(origin, base + mean_y - drift * mean_x, drift, math.sqrt(variance))


@dataclass(frozen=True)
class _Piece:
    """From `start_ns` on: the target line, plus a gap that closes."""

    start_ns: int
    line: Line
    gap_ns: float

    def offset(self, boot_ns: int) -> float:
        closed = SLEW * max(boot_ns - self.start_ns, 0)
        return self.line.at(boot_ns) + math.copysign(max(abs(self.gap_ns) - closed, 0.0), self.gap_ns)


class LinkClock:
    """Boot time -> session clock, fed by one link. All times in ns; answers grow with boot time within one boot."""

    def __init__(self, mode: Mode) -> None:
        self._arrivals = BootClock(mode, ARRIVALS_NS)
        self._segments = 0
        self._pieces: deque[_Piece] = deque(maxlen=PIECES)
        self._began_ns = 0
        self._newest_ns = 0
        self._is_handed_out = False  # a stamp of this boot has left: from now on the clock may only slew
        self.sync = TimeSync()
        self.disagrees = False  # TIMESYNC is answered, but from another clock

    def arrived(self, boot_ns: int, arrival_ns: int) -> bool:
        """Take a message's boot stamp and arrival; returns whether the boot clock has started again, or stepped."""
        restarted = self._arrivals.add(boot_ns, arrival_ns) + 1 > self._segments
        if restarted:
            self._segments = self._arrivals.segments
            self.sync = TimeSync()
            self._pieces.clear()
            self._is_handed_out = False
            self._began_ns, self._newest_ns = arrival_ns, boot_ns
        self._newest_ns = max(self._newest_ns, boot_ns)
        self._follow()
        return restarted and self._segments > 1

    def exchanged(self, sent_ns: int, boot_ns: int, received_ns: int) -> None:
        """Take an answered TIMESYNC request: our time when it left, the autopilot's, our time when it came back."""
        if not self._segments:
            return
        offset_ns = (sent_ns + received_ns) // 2 - boot_ns
        self.disagrees = abs(offset_ns - self._arrival_offset(boot_ns)) > DISAGREEMENT_NS
        if not self.disagrees and self.sync.add(sent_ns, boot_ns, received_ns):
            self._follow(at_once=True)

    def is_known(self, now_ns: int) -> bool:
        """Whether stamps may be handed out: after a few exchanges, or after a while of whatever came."""
        return self._segments > 0 and (self.sync.exchanges >= FIRST_EXCHANGES or now_ns - self._began_ns >= HOLD_NS)

    def to_host_ns(self, boot_ns: int) -> int:
        """Boot time on the session's clock; raises LookupError before the first arrival."""
        if not self._pieces:
            raise LookupError("the clock has not seen a message yet")
        self._is_handed_out = True
        piece = self._pieces[0]
        for candidate in reversed(self._pieces):
            if candidate.start_ns <= boot_ns:
                piece = candidate
                break
        return boot_ns + round(piece.offset(boot_ns))

    def figures(self) -> dict[str, float]:
        """`round_trip_ms`, `drift_ppm` (ours against the boot clock) and `clock_sigma_ms`; empty without exchanges."""
        line = self.sync.line
        if line is None:
            return {}
        return {
            "round_trip_ms": self.sync.round_trip_ns / 1e6,
            "drift_ppm": line.drift * 1e6,
            "clock_sigma_ms": line.sigma_ns / 1e6,
        }

    def _arrival_offset(self, boot_ns: int) -> int:
        return self._arrivals.to_host_ns(boot_ns) - boot_ns

    def _target(self) -> Line:
        if self.sync.line is not None:
            return self.sync.line
        return Line(self._newest_ns, self._arrival_offset(self._newest_ns), self._arrivals.drift())

    def _follow(self, at_once: bool = False) -> None:
        """Aim at the best estimate from the newest boot time on, starting from where the clock stands."""
        if not self._pieces:
            self._pieces.append(_Piece(self._newest_ns, self._target(), 0.0))
            return
        last = self._pieces[-1]
        if not at_once and (self.sync.line is not None or self._newest_ns - last.start_ns < PIECE_NS):
            return
        target = self._target()
        if not self._is_handed_out:
            self._pieces.clear()
            self._pieces.append(_Piece(self._newest_ns, target, 0.0))
            return
        gap = last.offset(self._newest_ns) - target.at(self._newest_ns)
        self._pieces.append(_Piece(self._newest_ns, target, gap))
