"""How fast a link of unknown capacity is sent over, by what its far end reports. Pure logic, time is passed in.

An autopilot drops what it has no room for without a word, and never forwards its radio's own reports: so the ground
counts. Slow start, half at loss. A radio loses some packets at any rate, so it is loss beyond that which halves.
"""

from __future__ import annotations

from contract.wire.set_pieces import ReceiverReport

BEGIN_BIT_RATE, LEAST_BIT_RATE = 2400.0, 300.0
HALVE_AT = 0.25  # of the packets
JUDGED = 16  # packets, at least, between two decisions
GROWTH = 0.1  # of the greatest rate, a decision, once anything was lost
SILENT_S = 7.0  # without a report: the ground is gone


class RateFollower:
    """Starts with the first report; `bit_rate` is 0 while no ground listens."""

    def __init__(self, max_bit_rate: float) -> None:
        self._most = max_bit_rate
        self._rate = 0.0
        self._reported_s = 0.0
        self._judged: ReceiverReport | None = None
        self._is_starting = True

    def bit_rate(self, now_s: float) -> float:
        """What may be sent now."""
        return self._rate if now_s - self._reported_s < SILENT_S else 0.0

    def received(self, report: ReceiverReport, now_s: float) -> None:
        """A ground's report."""
        if self.bit_rate(now_s) == 0.0:
            self._rate, self._is_starting, self._judged = min(BEGIN_BIT_RATE, self._most), True, None
        self._reported_s = now_s
        if self._judged is None or report.received == 0:
            self._judged = report if report.received else None  # what was sent before it listened was not lost
            return
        sent = (report.highest - self._judged.highest) % 65536
        came = (report.received - self._judged.received) % 65536
        if sent >= 32768 or came > 2 * sent + JUDGED:  # the ground has begun again
            self._judged = report
            return
        if sent < JUDGED:
            return
        self._judged = report
        if came < (1.0 - HALVE_AT) * sent:
            self._rate, self._is_starting = max(0.5 * self._rate, LEAST_BIT_RATE), False
        else:
            self._rate = 2.0 * self._rate if self._is_starting else self._rate + GROWTH * self._most
        self._rate = min(self._rate, self._most)
