"""Pins shared by several ground servers over zenoh: the last writer wins, by time and then by name, on all of them.

Each server sends once a second how many pins it has, and a digest of them; and every change at once, also one that it
has received from others, so that all servers that are connected in any way get it. Where digests stay different (a
late joiner, a partition that has healed, a message lost) a server asks the other what it has and for what it has not:
nothing depends on any single message. Only what `PinStore.merge_all` takes gets in.

Every server that can connect can write: on a network that is not your own, use certificates (docs/certificates.md).
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import zenoh

from contract.errors import InputError, LinkError
from contract.link_config import Tls, link_config, passing_only
from ground.pins import sharing_messages as messages
from ground.pins.model import Pin
from ground.pins.sharing_messages import PREFIX, Announcement
from ground.pins.store import PinStore
from ground.watched_thread import WatchedThread

MAX_PINS = 100_000  # tombstones too, above which no new ones are taken from others
MAX_SERVERS = 64  # a peer may invent them
MAX_WAITING, MAX_WAITING_BYTES = 2000, 16_000_000  # changes received and not yet merged
MAX_QUESTIONS = 16
MAX_ANSWER_BYTES = 8_000_000
MAX_REFUSED = 10_000  # versions that are not asked for again
PUSHED = 50  # changes at once that are sent one by one; for more, as after a break, other servers ask
TURN_S = 0.05
BEAT_S = 1.0
FORGET_S = 10.0  # a server that has sent nothing for so long is gone
SETTLE_S = 2.5  # digests of servers known to each other may differ so long: a change is on its way
FORGIVE_S = 3600.0  # after which refused versions are asked for again: a clock may have been set
AGAIN_S = 60.0  # between questions to a server whose difference was not resolved, and of which nothing has changed
ANSWER_S = 10.0


@dataclass(frozen=True)
class Shared:
    """The state of sharing. Counts are since its beginning."""

    servers: int  # received from recently
    same: int  # of these, with the same pins as here
    pins: int  # here, tombstones too
    taken: int  # changes of others
    sent: int  # changes sent to others
    refused: int  # pins of others that cannot be taken
    unreadable: int  # messages that were none
    dropped: int  # messages, because the buffer was full; they are asked for later
    clock_s: float  # by how much the worst of the other clocks differs from this one
    last_refusal: str
    trouble: str  # why a thread cannot do its work

    def __str__(self) -> str:
        parts = [f"{self.servers} other servers, {self.same} with the same {self.pins} pins"]
        parts.append(f"{self.taken} changes taken, {self.sent} sent")
        if abs(self.clock_s) > 5.0:
            parts.append(
                f"a clock differs by {self.clock_s:.0f} s: the last writer is the one with the later clock time"
            )
        if self.refused or self.unreadable or self.dropped:
            parts.append(f"{self.refused} pins refused, {self.unreadable} messages unreadable, {self.dropped} dropped")
        parts += [self.last_refusal] if self.last_refusal else []
        return "; ".join(parts + ([self.trouble] if self.trouble else []))


@dataclass(eq=False)
class _Server:
    """Another server, as its messages describe it."""

    announcement: Announcement
    received_s: float
    ahead_s: float  # of its clock
    unlike_since_s: float | None
    is_new: bool = True
    ask_at_s: float = 0.0
    asked: tuple[int, int] = (-1, -1)  # both digests as of the last question


class PinSharing:
    """Shares a store until closed. Raises LinkError if the link cannot be opened.

    `listen` and `connect` are zenoh endpoints. The store may be changed at the same time, also by other processes.
    """

    def __init__(
        self, store: PinStore, *, connect: Sequence[str] = (), listen: Sequence[str] = (), tls: Tls | None = None
    ) -> None:
        self.server = uuid.uuid4().hex[:16]
        self._store = store
        self._lock = threading.Lock()
        self._servers: OrderedDict[str, _Server] = OrderedDict()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._questions: deque[zenoh.Query] = deque()
        self._known: dict[str, tuple[Pin, bytes]] = {}  # all pins here with their versions, as of `_revision`
        self._digest, self._revision = 0, -1
        self._refused: OrderedDict[tuple[str, bytes], None] = OrderedDict()
        self._refused_s = time.monotonic()  # when they were cleared last
        self._counts = dict.fromkeys(("taken", "sent", "refused", "unreadable", "dropped"), 0)
        self._last_refusal = ""
        self._beat_s = -BEAT_S
        self._is_closed = False
        self._look()
        # A router among routers, so that every server receives from all others; it relays nothing but pins, and to no
        # one else.
        config = json.loads(link_config("router", listen=listen, connect=connect, tls=tls))
        config["access_control"] = passing_only(f"{PREFIX}/**")
        try:
            self._session: Any = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        except zenoh.ZError as error:
            reason = str(error).split(" at ", maxsplit=1)[0]
            raise LinkError(f"cannot share pins at {', '.join((*listen, *connect))}: {reason}") from error
        own = f"{PREFIX}/{self.server}"
        self._announcements = self._session.declare_publisher(
            f"{own}/said", congestion_control=zenoh.CongestionControl.DROP
        )
        self._changed = self._session.declare_publisher(
            f"{own}/changed", congestion_control=zenoh.CongestionControl.DROP
        )
        self._declared = [
            self._session.declare_subscriber(f"{PREFIX}/*/said", self._receive),
            self._session.declare_subscriber(f"{PREFIX}/*/changed", self._receive),
            self._session.declare_queryable(f"{own}/summary", self._asked),
            self._session.declare_queryable(f"{own}/pins", self._asked),
        ]
        # Two, for two servers that ask each other at once would wait for each other.
        self._threads = [
            WatchedThread("sharing pins", self._serve, TURN_S),
            WatchedThread("asking for pins", self._catch_up, TURN_S),
        ]

    @property
    def state(self) -> Shared:
        with self._lock:
            servers = list(self._servers.values())
            return Shared(
                len(servers), sum(s.announcement.digest == self._digest for s in servers), len(self._known),
                **self._counts, clock_s=max((s.ahead_s for s in servers), key=abs, default=0.0),
                last_refusal=self._last_refusal, trouble="; ".join(t.trouble for t in self._threads if t.trouble),
            )  # fmt: skip

    def close(self) -> None:
        """Stop sharing; the store stays open."""
        with self._lock:
            self._is_closed = True
        for thread in self._threads:
            thread.close()
        with contextlib.suppress(zenoh.ZError):
            self._session.close()

    def __enter__(self) -> PinSharing:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # In zenoh's threads: only put messages into the buffer

    def _receive(self, sample: zenoh.Sample) -> None:
        try:
            server, kind = messages.server_of(str(sample.key_expr))
            if server == self.server:
                return
            payload = sample.payload.to_bytes()
            if kind == "said":
                self._note(server, messages.announcement_from_bytes(payload))
            elif len(payload) > messages.MAX_PIN_BYTES:
                raise InputError(f"a pin of {len(payload)} bytes")
            else:
                self._wait_to_merge(payload)
        except InputError:
            self._count("unreadable")

    def _note(self, server: str, announcement: Announcement) -> None:
        if announcement.server != server:
            raise InputError("a server that claims to be another")
        now_s, ahead_s = time.monotonic(), (announcement.unix_ns - time.time_ns()) / 1e9
        with self._lock:
            held = self._servers.get(server)
            if held is None:
                held = self._servers[server] = _Server(announcement, now_s, ahead_s, None)
            held.announcement, held.received_s, held.ahead_s = announcement, now_s, ahead_s
            self._servers.move_to_end(server)
            while len(self._servers) > MAX_SERVERS:
                self._servers.popitem(last=False)
            if announcement.digest == self._digest:
                held.unlike_since_s, held.is_new = None, False
            elif held.unlike_since_s is None:
                held.unlike_since_s = now_s

    def _wait_to_merge(self, payload: bytes) -> None:
        with self._lock:
            if len(self._waiting) >= MAX_WAITING or self._waiting_bytes + len(payload) > MAX_WAITING_BYTES:
                self._counts["dropped"] += 1
                return
            self._waiting.append(payload)
            self._waiting_bytes += len(payload)

    def _asked(self, query: zenoh.Query) -> None:
        with self._lock:
            if len(self._questions) < MAX_QUESTIONS and not self._is_closed:
                self._questions.append(query)
                return
            self._counts["dropped"] += 1
        query.drop()  # type: ignore[no-untyped-call]

    # In the thread that serves

    def _serve(self) -> None:
        self._merge_received()
        changed = self._look()
        for pin in changed if len(changed) <= PUSHED else ():
            try:
                self._changed.put(messages.pin_to_bytes(pin))
                self._count("sent")
            except InputError as error:
                self._refuse(str(error))
        while True:
            with self._lock:
                query = self._questions.popleft() if self._questions else None
            if query is None:
                break
            self._answer(query)
        if time.monotonic() - self._beat_s >= BEAT_S:
            self._beat_s = time.monotonic()
            self._announce()

    def _announce(self) -> None:
        now_s = time.monotonic()
        with self._lock:
            for server in [name for name, s in self._servers.items() if now_s - s.received_s > FORGET_S]:
                del self._servers[server]
            announcement = Announcement(self.server, len(self._known), self._digest, time.time_ns())
        self._announcements.put(messages.announcement_to_bytes(announcement))

    def _look(self) -> list[Pin]:
        """The pins that have changed in the store since the last look; none at the first."""
        revision = self._store.revision
        if revision == self._revision:
            return []
        changed, known = [], {}
        for pin in self._store.everything():
            held = self._known.get(pin.id)
            if held is None or held[0] is not pin:
                fresh = messages.version_of(pin)
                if self._revision >= 0 and (held is None or held[1] != fresh):
                    changed.append(pin)
                held = pin, fresh
            known[pin.id] = held
        with self._lock:
            self._known, self._digest = known, messages.digest_of(version for _, version in known.values())
        self._revision = revision
        return changed

    def _merge_received(self) -> None:
        with self._lock:
            received, self._waiting, self._waiting_bytes = list(self._waiting), deque(), 0
        found = []
        for payload in received:
            try:
                found.append(messages.pin_from_bytes(payload))
            except InputError as error:
                self._count("unreadable")
                self._last_refusal = str(error)
        self._merge(found)

    def _merge(self, pins: list[Pin]) -> None:
        for begin in range(0, len(pins), messages.MAX_ASKED):  # a transaction is short: others wait for it
            taken, refused = self._store.merge_all(pins[begin : begin + messages.MAX_ASKED], MAX_PINS)
            self._count("taken", taken)
            for pin, why in refused:
                self._refuse(why)
                with self._lock:
                    self._refused[pin.id, messages.version_of(pin)] = None
                    while len(self._refused) > MAX_REFUSED:
                        self._refused.popitem(last=False)

    def _answer(self, query: zenoh.Query) -> None:
        with self._lock:
            known = self._known
        with query:
            key = str(query.key_expr)
            if key.endswith("/summary"):
                for part in messages.summaries({name: version for name, (_, version) in known.items()}):
                    query.reply(key, part)
                return
            try:
                names = messages.asked_from_bytes(b"" if query.payload is None else query.payload.to_bytes())
            except InputError as error:
                self._count("unreadable")
                query.reply_err(str(error))
                return
            left = MAX_ANSWER_BYTES
            for name in names:
                if name in known and left > 0:
                    with contextlib.suppress(InputError):  # too large to be shared, which `_serve` reports
                        payload = messages.pin_to_bytes(known[name][0])
                        left -= len(payload)
                        query.reply(key, payload)

    # In the thread that asks

    def _catch_up(self) -> None:
        """Ask one server whose pins stay different from ours."""
        server = self._most_unlike()
        if server is None:
            return
        began_s, held = time.monotonic(), server
        digests = held.announcement.digest, self._digest
        try:
            wanted = self._wanted(held.announcement.server)
            for begin in range(0, len(wanted), messages.MAX_ASKED):
                if self._is_closed:
                    return
                asked = messages.asked_to_bytes(wanted[begin : begin + messages.MAX_ASKED])
                self._merge(self._pins_of(held.announcement.server, asked))
        finally:
            took_s = time.monotonic() - began_s
            with self._lock:
                held.is_new, held.asked = False, digests
                held.ask_at_s = time.monotonic() + max(SETTLE_S, 10.0 * took_s)

    def _most_unlike(self) -> _Server | None:
        now_s = time.monotonic()
        with self._lock:
            for held in self._servers.values():
                since_s = held.unlike_since_s
                if since_s is None or now_s < held.ask_at_s or now_s - held.received_s > FORGET_S:
                    continue
                is_known = held.asked == (held.announcement.digest, self._digest) and now_s < held.ask_at_s + AGAIN_S
                if not is_known and (held.is_new or now_s - since_s > SETTLE_S):
                    return held
        return None

    def _wanted(self, server: str) -> list[str]:
        """Ids of the pins that differ between a server and this one, except versions refused before."""
        with self._lock:
            if time.monotonic() - self._refused_s > FORGIVE_S:
                self._refused.clear()
                self._refused_s = time.monotonic()
            known, refused = self._known, set(self._refused)
        wanted: dict[str, None] = {}
        for payload in self._replies(f"{PREFIX}/{server}/summary", None):
            for name, version in messages.summary_from_bytes(payload):
                if (name not in known or known[name][1] != version) and (name, version) not in refused:
                    wanted[name] = None
                if len(wanted) > MAX_PINS:
                    raise InputError(f"a server that claims to have more than {MAX_PINS} pins that we have not")
        return list(wanted)

    def _pins_of(self, server: str, asked: bytes) -> list[Pin]:
        found = []
        for payload in self._replies(f"{PREFIX}/{server}/pins", asked):
            try:
                found.append(messages.pin_from_bytes(payload))
            except InputError as error:
                self._count("unreadable")
                self._last_refusal = str(error)
        return found[: messages.MAX_ASKED]

    def _replies(self, key: str, payload: bytes | None) -> list[bytes]:
        """The replies of one server, bounded in bytes. Raises InputError beyond that."""
        found, left = [], MAX_ANSWER_BYTES
        for reply in self._session.get(
            key, payload=payload, consolidation=zenoh.ConsolidationMode.NONE, timeout=ANSWER_S
        ):
            if reply.ok is not None:
                found.append(reply.ok.payload.to_bytes())
                left -= len(found[-1])
            if left < 0:
                raise InputError(f"a server answered more than {MAX_ANSWER_BYTES} bytes")
        return found

    # For all of them

    def _count(self, what: str, by: int = 1) -> None:
        with self._lock:
            self._counts[what] += by

    def _refuse(self, why: str) -> None:
        with self._lock:
            self._counts["refused"] += 1
            self._last_refusal = why


def share_pins(
    store: PinStore, *, connect: Sequence[str] = (), listen: Sequence[str] = (), tls: Tls | None = None
) -> PinSharing | None:
    """Share a store, or None without an endpoint: for a server whose options may name one. Raises LinkError."""
    return PinSharing(store, connect=connect, listen=listen, tls=tls) if connect or listen else None
