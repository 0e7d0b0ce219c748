"""The budget of bytes for the link: how much may go out, and when. Pure logic, time is passed in.

A radio's queue cannot be seen from here, and a queue that fills is delay that stays; so what is sent keeps below
`link.max_bit_rate` at its source (80 kbit/s offered to 64 kbit/s are 7 to 17 s of delay, whatever zenoh is set to
drop). Everything counts: sets, status, replies, and what zenoh, TLS, TCP and IP add.

Overhead on the wire, IP headers and up, measured with zenoh 1.10 (`python -m benchmarks.link`): 63 B a message over
tcp, 40 over udp, 79 over tls and quic, the age sent with each set included; in addition 29 (udp) to 136 B/s a ground
for keep-alives and acknowledgements, 130 to 179 B a reply, and 0.29 (udp), 0.6 (tcp), 1.8 (tls) or 8 kB (quic) for a
ground that connects. Below, the highest of tcp, udp and tls.

Pictures take what nothing else has taken: bytes that came while the budget was full and would have been lost. So sets,
status and replies go out at the same moments with pictures as without.
"""

from __future__ import annotations

import math
from enum import Enum

from contract.topics import REPORTS, Topic

MESSAGE_OVERHEAD = 90  # bytes
REPLY_OVERHEAD = 200
GROUND_BYTES_PER_S = 140.0
CONNECT_BYTES = 600
SECURE_CONNECT_BYTES = 1850
PACKET_BYTES = 1500
BURST_S = 0.5
# Replies may take this share at most, each report its topic's: with status alone at least 0.35 stays for sets.
REPLY_SHARE = 0.4
# Older pictures' sets may take this share from new ones, else what those leave; and so many for each new one at most.
OLDER_SHARE, OLDER_A_NEW = 0.1, 0.5
PIECE_SHARE = 0.95  # of the time that a set leaves until the next one, that a packet of a picture may take
LEAST_PIECE = 300  # bytes, below which its head would be most of it
USUAL_SET = 600  # bytes


def left_for_pictures(max_bit_rate: float, max_rate_hz: float) -> float:
    """Bit/s that sets of the usual size at their greatest rate, status and one ground's keep-alives leave."""
    status_bytes = 300 + MESSAGE_OVERHEAD
    sets_hz = (1.0 + OLDER_A_NEW) * max_rate_hz
    return max_bit_rate - 8.0 * (sets_hz * (USUAL_SET + MESSAGE_OVERHEAD) + status_bytes + GROUND_BYTES_PER_S)


class Kind(Enum):
    """The kind of a message that is no report, which decides how much of the budget it may take."""

    SET = "set"  # of a new picture
    OLDER = "older"  # of a picture that is not the newest any more
    REPLY = "reply"
    REPORT = "report"  # a reply as well, but a large one that no flight depends on: the daemon's own detailed report
    PICTURE = "picture"


Use = Kind | Topic
"""The use that a message's bytes count for: one of the kinds, or the report of a topic."""
USES: tuple[Use, ...] = (*Kind, *REPORTS)

# Each kind waits this long for bytes before new sets are held back for it. An older set has waited for its small share.
PATIENCE_S: dict[Use, float] = {
    Kind.REPLY: 0.8, Kind.REPORT: 0.8, Kind.OLDER: 0.0, **{topic: topic.patience_s for topic in REPORTS}
}  # fmt: skip
SHARES: dict[Use, float] = {
    Kind.REPLY: REPLY_SHARE, Kind.REPORT: REPLY_SHARE, Kind.OLDER: OLDER_SHARE,
    **{topic: topic.share for topic in REPORTS},
}  # fmt: skip


class Bucket:
    """A token bucket: in any window of t seconds, at most rate t + depth bytes (or one message larger than it)."""

    def __init__(self, bytes_per_s: float, depth: float, now_s: float) -> None:
        self.bytes_per_s, self.depth = bytes_per_s, depth
        self._level, self._at_s = depth, now_s
        self._spilt = 0.0

    def level(self, now_s: float) -> float:
        """Bytes that may go now; negative after a charge that could not be refused."""
        if now_s > self._at_s:
            self._fill(self._level + (now_s - self._at_s) * self.bytes_per_s)
            self._at_s = now_s
        return self._level

    def spilt(self, now_s: float) -> float:
        """Bytes that came while it was full, since the beginning. Asking changes nothing, not even by rounding."""
        came = max(now_s - self._at_s, 0.0) * self.bytes_per_s
        return self._spilt + max(self._level + came - self.depth, 0.0)

    def _fill(self, level: float) -> None:
        self._spilt += max(level - self.depth, 0.0)
        self._level = min(level, self.depth)

    def wait_s(self, cost: float, now_s: float) -> float:
        """Seconds until `cost` bytes may go; 0 if they may now."""
        return max(min(cost, self.depth) - self.level(now_s), 0.0) / self.bytes_per_s

    def take(self, cost: float, now_s: float) -> None:
        """Take them, whether they are there or not."""
        self._level = self.level(now_s) - cost

    def owe(self, cost: float, now_s: float) -> None:
        """Take what went without asking since the last look; what cannot be made good within one depth is forgiven.

        It is taken from what came in meanwhile, before that is cut at the depth: taken afterwards, a steady drain would
        keep the bucket from ever being full, and a message larger than it would wait for good.
        """
        came = max(now_s - self._at_s, 0.0) * self.bytes_per_s
        least = min(-self.depth, self._level + came)
        self._fill(max(self._level + came - cost, least))
        self._at_s = max(now_s, self._at_s)


class Budget:
    """All that may be sent, by kind. `grounds` is how many sessions each message goes to, at least 1.

    The cap is never exceeded for long: over any t seconds, rate t + one burst, and with pictures one packet more.
    Within it, status and replies have their shares (reports what replies leave of theirs), and none while sets are
    behind `min_rate_hz`; new pictures' sets go out `max_rate_hz` times a second at most. Sets of older pictures go
    when the next new one still finds its bytes, half as often at most; where new ones take all, in a share of theirs.
    """

    def __init__(
        self,
        max_bit_rate: float,
        min_rate_hz: float,
        max_rate_hz: float,
        now_s: float,
        connect_bytes: float = CONNECT_BYTES,
    ) -> None:
        self._connect_bytes = connect_bytes
        self.bytes_per_s = max_bit_rate / 8.0
        self.min_rate_hz, self.max_rate_hz = min(min_rate_hz, max_rate_hz), max_rate_hz
        self.grounds = 1
        self._all = Bucket(self.bytes_per_s, max(PACKET_BYTES, BURST_S * self.bytes_per_s), now_s)
        self._shares = {
            kind: Bucket(share * self.bytes_per_s, max(PACKET_BYTES, BURST_S * share * self.bytes_per_s), now_s)
            for kind, share in SHARES.items()
        }
        self._left = self._spilt = 0.0  # for pictures, at most a packet; and what had been left when they looked last
        self._free_at_s = now_s  # when a link of just this rate has carried all that was sent
        self._set_at_s: float | None = None
        self._set_due_s = now_s  # before it no new set goes; one that came late may be made up for once
        self._set_cost = self.cost(Kind.SET, USUAL_SET)  # of the last one
        self._older_due_s = now_s
        self._waiting: dict[Use, tuple[float, int]] = {}  # since when, and how many bytes
        self._background_at_s = now_s

    def cost(self, kind: Use, payload_bytes: int) -> float:
        """Bytes on the wire, to every ground; a reply goes to one."""
        if kind in (Kind.REPLY, Kind.REPORT):
            return payload_bytes + REPLY_OVERHEAD
        return (payload_bytes + MESSAGE_OVERHEAD) * max(self.grounds, 1)

    def waits(self, kind: Use, payload_bytes: int | None, now_s: float) -> None:
        """Pass what waits to be sent, None for nothing: what has waited long goes before what has not."""
        if payload_bytes is None:
            self._waiting.pop(kind, None)
        else:
            since_s, _ = self._waiting.get(kind, (now_s, 0))
            self._waiting[kind] = since_s, payload_bytes

    def is_behind(self, now_s: float) -> bool:
        """Return whether sets wait and come more rarely than they must: then nothing else may go."""
        if Kind.SET not in self._waiting:
            return False
        since_s, _ = self._waiting[Kind.SET]
        if self._set_at_s is not None:
            since_s = max(since_s, self._set_at_s)
        return now_s - since_s >= 1.0 / self.min_rate_hz

    def wait_s(self, kind: Use, payload_bytes: int, now_s: float) -> float:
        """Seconds until a message may go, if nothing else goes before; 0 if it may now; inf while others go first."""
        cost = self.cost(kind, payload_bytes)
        if kind is Kind.PICTURE:
            return self._picture_wait_s(cost, now_s)
        self._note_background(now_s)
        wait = self._all.wait_s(cost, now_s)
        if kind is Kind.SET:
            if not self.is_behind(now_s) and self._others_turn(now_s):
                return math.inf
            return max(wait, self._until_set_s(now_s))
        if self.is_behind(now_s):
            return math.inf
        if kind is Kind.OLDER:
            return max(wait, self._older_wait_s(cost, now_s))
        return max(wait, self._shares[kind].wait_s(cost, now_s))

    def _until_set_s(self, now_s: float) -> float:
        """Seconds until the next new picture's set may go, by their greatest rate."""
        return max(self._set_due_s - now_s, 0.0)

    def _older_wait_s(self, cost: float, now_s: float) -> float:
        """Return the seconds until it takes nothing from the next new set, or its own share has the bytes."""
        comes = self._until_set_s(now_s) * self.bytes_per_s
        spare_s = self._all.wait_s(cost + max(self._set_cost - comes, 0.0), now_s)
        return max(self._older_due_s - now_s, min(spare_s, self._shares[Kind.OLDER].wait_s(cost, now_s)))

    def _picture_wait_s(self, cost: float, now_s: float) -> float:
        """Return the seconds until a piece of a picture may go; inf while sets go first.

        It goes only if the link has carried it before the next set may go.
        """
        spilt = self._all.spilt(now_s)
        self._left = min(self._left + max(spilt - self._spilt, 0.0), PACKET_BYTES)
        self._spilt = max(spilt, self._spilt)
        wait = max(min(cost, PACKET_BYTES) - self._left, 0.0) / self.bytes_per_s
        until_set_s = self._until_set_s(now_s)
        if until_set_s <= 0.0:
            return math.inf if Kind.SET in self._waiting else wait
        carried_s = max(self._free_at_s - now_s, 0.0) + cost / self.bytes_per_s
        return wait if carried_s <= until_set_s else max(wait, until_set_s)

    def piece_bytes(self, most: int) -> int:
        """Return how large a packet of a picture may be, so that there is time for it between two sets."""
        between = PIECE_SHARE * (self.bytes_per_s / self.max_rate_hz - self._set_cost) / max(self.grounds, 1)
        return int(min(max(between - MESSAGE_OVERHEAD, LEAST_PIECE), most))

    def _others_turn(self, now_s: float) -> bool:
        """Return whether something with a share has waited long for want of bytes alone: new sets would take all."""
        return any(
            now_s >= max(since_s + PATIENCE_S[kind], self._older_due_s if kind is Kind.OLDER else since_s)
            and share.wait_s(self.cost(kind, payload_bytes), now_s) <= 0.0
            for kind, share in self._shares.items()
            for since_s, payload_bytes in [self._waiting.get(kind, (math.inf, 0))]
        )

    def send(self, kind: Use, payload_bytes: int, now_s: float) -> bool:
        """Return whether a message may go now; if so, it is paid for."""
        if self.wait_s(kind, payload_bytes, now_s) > 0.0:
            return False
        cost = self.cost(kind, payload_bytes)
        self._waiting.pop(kind, None)
        self._free_at_s = max(self._free_at_s, now_s) + cost / self.bytes_per_s
        if kind is Kind.PICTURE:
            self._left -= cost
            return True
        self._all.take(cost, now_s)
        if kind is Kind.SET:
            self._set_at_s, self._set_cost = now_s, cost
            interval_s = 1.0 / self.max_rate_hz
            self._set_due_s = max(self._set_due_s, now_s - interval_s) + interval_s
        elif kind is Kind.OLDER:
            self._older_due_s = now_s + 1.0 / (OLDER_A_NEW * self.max_rate_hz)
            self._shares[kind].owe(cost, now_s)  # of which most was left over: no debt grows of that
        else:
            self._shares[kind].take(cost, now_s)
            if kind is Kind.REPLY:  # both have one share; a report may exhaust it for other reports, never for replies
                self._shares[Kind.REPORT].take(cost, now_s)
        return True

    def connected(self, grounds: int, now_s: float) -> None:
        """Set how many sessions there are now; each new one has cost its handshake."""
        self._note_background(now_s)
        if grounds > self.grounds:
            self._all.owe(self._connect_bytes * (grounds - self.grounds), now_s)
        self.grounds = max(grounds, 0)

    def _note_background(self, now_s: float) -> None:
        """Keep-alives and acknowledgements; they never take more than half, or a slow link would fall silent."""
        rate = min(GROUND_BYTES_PER_S * max(self.grounds, 1), 0.5 * self.bytes_per_s)
        self._all.owe(rate * max(now_s - self._background_at_s, 0.0), now_s)
        self._background_at_s = max(now_s, self._background_at_s)
