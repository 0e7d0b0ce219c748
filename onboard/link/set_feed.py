"""Sets through the autopilot's radio, in pieces, to the one ground that asks for them. Thread-safe; nothing waits."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from contract.wire.radio_state import Held, RadioState, encode_state
from contract.wire.set_pieces import MAX_WIRE_BYTES, PIECE_HEAD, SetPiece, cut_set, encode_piece, read_report
from onboard.events.tunnel import Peer
from onboard.link.byte_budget import Bucket
from onboard.link.rate_follower import RateFollower
from onboard.link.set_selection import Offer, Selection

REPEAT_S = 10.0  # a picture that is still the newest
REMEMBERED = 1000  # packets: when each was sent
SLOW_S = 3.0  # for a set: the newest picture is then too old to be clicked before the next one comes
SETTLED_S = 6.0  # of slow sets: the rate has been sought by then
STATE_S = 30.0  # between two words to the ground about it


class SetFeed:
    """Sets are offered as they are made; the newest goes whole before the next is chosen.

    `overhead`: bytes on the wire in addition to a payload. `bucket` is shared with all that goes this way. `age_s`
    gives a picture's age by its capture time.
    """

    def __init__(
        self,
        max_bit_rate: float,
        overhead: int,
        bucket: Bucket,
        age_s: Callable[[int], float | None],
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._overhead, self._bucket, self._age_s, self._now_ns = overhead, bucket, age_s, now_ns
        self._follower, self._max_bit_rate = RateFollower(max_bit_rate), max_bit_rate
        self._own = Bucket(max_bit_rate / 8.0, MAX_WIRE_BYTES, now_ns() / 1e9)
        self._selection: Selection[bytes] = Selection(REPEAT_S)
        self._ground: Peer | None = None
        self._pieces: deque[tuple[int, int, int, bytes]] = deque()
        self._packet = self._of = 0
        self._sent_s: dict[int, float] = {}  # of the last packets
        self._set_bits = 0.0  # of the last set, on the wire
        self._slow_s: float | None = None  # since when sets have taken too long
        self._stated_s, self._has_complained = -STATE_S, False
        self._lock = threading.Lock()
        self.sent = 0  # sets, to their last piece

    def offer(self, offered: Offer[bytes]) -> None:
        with self._lock:
            self._selection.offer(offered)

    def receive(self, ground: Peer, payload: bytes) -> None:
        """A ground's report: it wants sets. Another's is passed over while one listens."""
        report = read_report(payload)
        if report is None:
            return
        with self._lock:
            now_s = self._now_ns() / 1e9
            if self._follower.bit_rate(now_s) == 0.0:
                self._ground = ground
                self._pieces.clear()
            if ground == self._ground:
                under_way_s = [
                    now_s - came_s - self._sent_s.pop(number)  # each once
                    for number, came_s in report.came_s.items()
                    if number in self._sent_s
                ]
                self._follower.received(report, now_s, under_way_s)

    def state(self) -> RadioState | None:
        """Return how a listening ground gets its sets; None while none listens, or none was sent."""
        with self._lock:
            return self._state(self._now_ns() / 1e9)

    def _state(self, now_s: float) -> RadioState | None:
        rate = self._follower.bit_rate(now_s)
        if rate == 0.0 or self._set_bits == 0.0:
            return None
        held = Held.BY_NOTHING
        if self._slow_s is not None and now_s - self._slow_s >= SETTLED_S:
            # At most half of it is the radio's fault: with all that is configured, sets would still take too long.
            is_configured = rate > 0.5 * self._max_bit_rate and self._set_bits / self._max_bit_rate > SLOW_S
            held = Held.BY_CONFIGURATION if is_configured else self._follower.held
        return RadioState(held, rate, self._set_bits / rate)

    def _stated(self, now_s: float) -> list[tuple[Peer, bytes]]:
        """A word to the ground that sets take too long, and why; and one that they do not any more."""
        state = self._state(now_s)
        if state is None or (state.set_s or 0.0) <= SLOW_S or self._follower.held is Held.BY_NOTHING:
            self._slow_s = None
        elif self._slow_s is None:
            self._slow_s = now_s
        if state is None or self._ground is None:
            return []
        is_due = now_s - self._stated_s >= STATE_S if state.words else self._has_complained
        if not is_due:
            return []
        self._stated_s, self._has_complained = now_s if state.words else -STATE_S, bool(state.words)
        payload = encode_state(state)
        for bucket in (self._own, self._bucket):
            bucket.take(len(payload) + self._overhead, now_s)
        return [(self._ground, payload)]

    def due(self) -> list[tuple[Peer, bytes]]:
        """Packets that may go now."""
        with self._lock:
            now_s = self._now_ns() / 1e9
            out = self._stated(now_s)
            rate = self._follower.bit_rate(now_s)
            self._own.level(now_s)  # what came at the rate until now
            self._own.bytes_per_s = max(rate, 1.0) / 8.0
            while rate > 0.0 and self._ground is not None and self._choose(now_s):
                cost = len(self._pieces[0][3]) + PIECE_HEAD + self._overhead
                if max(self._own.wait_s(cost, now_s), self._bucket.wait_s(cost, now_s)) > 0.0:
                    break
                self._own.take(cost, now_s)
                self._bucket.take(cost, now_s)
                number, pieces, size, content = self._pieces.popleft()
                self._packet = (self._packet + 1) % 65536
                piece = SetPiece(self._packet, self._of, number, pieces, size, content)
                self._sent_s[self._packet] = now_s
                if len(self._sent_s) > REMEMBERED:
                    del self._sent_s[next(iter(self._sent_s))]
                out.append((self._ground, encode_piece(piece)))
                self.sent += not self._pieces
        return out

    def _choose(self, now_s: float) -> bool:
        """Return whether there is a piece to be sent; if there is none of the last set, take the next set's."""
        if self._pieces:
            return True
        offer = self._selection.next(now_s) or self._selection.next_of_rest(now_s)
        if offer is None:
            return False
        self._selection.sent(offer, now_s)
        self._of = (self._of + 1) % 256
        room = MAX_WIRE_BYTES - self._overhead
        self._pieces.extend(cut_set(offer.item, self._age_s(offer.capture_unix_ns), room))
        self._set_bits = 8.0 * sum(len(piece[3]) + PIECE_HEAD + self._overhead for piece in self._pieces)
        return True
