"""Feature sets and status -> zenoh, within the link's bit rate; queries answered from a bounded history.

`byte_budget` and `set_selection` decide what goes and when; here is the session, the thread that sends, and nothing
that ever waits for the link: `publish` takes a set and returns.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import zenoh

from contract.closing import Closing
from contract.errors import LinkError
from contract.feature_set import FeatureSet, Status
from contract.history import History
from contract.link_config import NO_RIGHTS, Rights, Tls, link_config
from contract.look import ANSWERED_WITHIN_S, look_key
from contract.picture import LinkPicture
from contract.supervised_thread import Policy, SupervisedThread
from contract.topics import (
    ALIVE,
    ANSWER_TIMEOUT_S,
    DEFAULT_ENDPOINT,
    DETAIL_PARAMETER,
    FEATURES,
    FOLLOW,
    FRAME_PARAMETER,
    LOOK,
    PICTURE,
    PIXEL_PARAMETERS,
    QUERY,
    STATUS,
    TIME_PARAMETER,
    TOPICS,
    WAIT_PARAMETER,
    Topic,
)
from contract.track import refused
from contract.wire.codec import peek
from contract.wire.picture_code import cut
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.link.byte_budget import CONNECT_BYTES, PACKET_BYTES, SECURE_CONNECT_BYTES, USES, Budget, Kind, Use
from onboard.link.packet import MAX_PAYLOAD, one_packet
from onboard.link.pending_pictures import PendingPictures
from onboard.link.reply import (
    Answer,
    Measure,
    Question,
    SetClock,
    answer,
    not_measured,
    not_placed,
    patience_s,
    refusal,
)
from onboard.link.set_selection import REPEAT_S, Offer, Selection
from onboard.link.socket_backlog import Backlog
from onboard.link.swings import Swings

MAX_WAITING_QUERIES = 16
REPLIES = (Kind.REPLY, Kind.REPORT)  # the first is answered first
ANSWER_MARGIN_S = 0.2  # before the ground waits no longer: an answer after that is a waste
PENDING_MARGIN_S = 0.5  # of which the rest is for the refusal of a picture that has no set by then
IDLE_S = 0.25
HELD_S = 0.05
WARN_AGAIN_S = 10.0
# Unacknowledged bytes, in seconds of the bit rate and at least so many, above which nothing more is sent: more than a
# slow radio has under way, and less than a second of its time.
BACKLOG_S, BACKLOG_BYTES = 1.0, 3000
ACKNOWLEDGED_S = 0.02  # between looks whether a piece of a picture may follow the one before
PICTURE_PATIENCE_S = 10.0  # without room for a single piece, after which the rest of a picture is dropped
STREAMS = ("tcp/", "tls/")  # links that lose nothing

log = logging.getLogger("pointclick")


@dataclass(frozen=True)
class Rate:
    """The limits of sending: bit/s with everything the link adds, and sets a second, as in the section `link`."""

    max_bit_rate: float = 32000.0
    min_rate_hz: float = 0.2
    max_rate_hz: float = 5.0


@dataclass(eq=False)
class _Waiting:
    """A query and its reply."""

    query: zenoh.Query
    key: str
    answer: Answer
    until_s: float  # the ground waits for it
    kind: Kind


@dataclass(frozen=True, eq=False)
class _Parked:
    """A query for a picture whose set is being made."""

    query: zenoh.Query
    asked: Question
    frame: int
    until_s: float


@dataclass(frozen=True)
class _Message:
    """A message that could go now: its bytes, `gone` to call once it may go, and `put` to send it without the lock."""

    size: int
    gone: Callable[[], object]
    put: Callable[[], object]


class Publisher(Closing):
    """Publishes one vehicle's sets and status, and answers queries on the same keys. A Sink (`onboard.replay.runner`).

    For the daemon: `Publisher.open(config)` is one of the sinks; hand each encoded status to `publish_status`. Sets may
    be passed on as fast as they are made: the newest and most useful go out, all are kept for queries. Replies count
    against the same bit rate; a query that cannot be answered in time gets nothing.

    A peer without a router. `listen` and `connect` are zenoh endpoints, `scouting` turns multicast discovery on.
    Raises LinkError if the link cannot be opened (a port in use is named), ValueError for an impossible vehicle name.
    """

    def __init__(
        self,
        vehicle: str,
        listen: Sequence[str] = (DEFAULT_ENDPOINT,),
        connect: Sequence[str] = (),
        scouting: bool = False,
        history_s: float = 600.0,
        history_sets: int = 5000,
        *,
        rate: Rate | None = None,
        tls: Tls | None = None,
        rights: Rights = NO_RIGHTS,
    ) -> None:
        self._key, self._status_key = FEATURES.key(vehicle), STATUS.key(vehicle)
        self._follow_key = FOLLOW.key(vehicle)
        self._vehicle = vehicle
        self._history: History[bytes] = History(history_s, history_sets)
        self._set_clock = SetClock()
        rate = rate or Rate()
        connect_bytes = CONNECT_BYTES if tls is None else SECURE_CONNECT_BYTES
        self._budget = Budget(rate.max_bit_rate, rate.min_rate_hz, rate.max_rate_hz, time.monotonic(), connect_bytes)
        self._backlog, self._most_backlog = Backlog(), max(BACKLOG_S * rate.max_bit_rate / 8.0, BACKLOG_BYTES)
        self._swings = Swings()
        self._selection: Selection[bytes] = Selection(min(REPEAT_S, 1.0 / rate.min_rate_hz))
        self._queries: deque[_Waiting] = deque()
        self._parked: list[_Parked] = []
        self._pending = PendingPictures()
        self._pieces: deque[bytes] = deque()  # of the picture under way
        self._piece_s = -math.inf  # when it came, or one of them went
        self._needs_parity = not all(e.startswith(STREAMS) for e in (*listen, *connect))
        self._status, self._status_detail = b"", b""
        self._reports: dict[Topic, bytes] = {}  # the newest of each topic, until it has gone
        # Answers queries that begin, end and list tracks: a payload, and whether it is a refusal.
        self.follow: Callable[[str], tuple[bytes, bool]] = not_followed
        # Answers queries of those who may have the camera look somewhere: who asks, and the parameters; it calls the
        # function with the answer, and whether it is a refusal, from any thread.
        self.have_look: Callable[[str, str, Callable[[bytes, bool], object]], object] = _not_looked
        self._pointers = frozenset(() if tls is None else rights.pointers)  # without certificates no one has a name
        # Measures a pixel of a packet's set and hands the set over with it, or None; False if that cannot be done now.
        self.measure: Measure = not_measured
        self._is_closed = self._has_news = False
        self.watches: list[Callable[[Offer[bytes]], None]] = []  # shown every set as it is made
        self.sent = 0  # sets put on the link, without those asked for
        self.pictures = 0  # put on the link to their last piece
        self._warned_s = -math.inf
        self._changed = threading.Condition()
        if rights.allowed:  # the aircraft's own programs may ask it too
            rights = replace(rights, allowed=sorted({*rights.allowed, vehicle}))
        config = link_config(
            "peer",
            listen=listen,
            connect=connect,
            scouting=scouting,
            tls=tls,
            is_aircraft=True,
            rights=rights,
        )
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError as error:
            raise LinkError(_open_failure(listen, connect, error)) from error
        try:
            self._publishers = {topic: _declared(self._session, topic, vehicle) for topic in TOPICS}
            # The variables keep queryables and token declared.
            self._queryable = self._session.declare_queryable(self._key, self._asked)
            self._status_queryable = self._session.declare_queryable(self._status_key, self._asked_for_status)
            self._follow_queryable = self._session.declare_queryable(self._follow_key, self._asked_to_follow)
            if self._pointers:
                self._look_queryable = self._session.declare_queryable(f"{LOOK.key(vehicle)}/*", self._asked_to_look)
            self._alive = self._session.liveliness().declare_token(ALIVE.key(vehicle))
        except zenoh.ZError as error:
            self._session.close()  # type: ignore[no-untyped-call]
            raise LinkError(f"cannot publish as {vehicle!r}: {_first_clause(error)}; try again") from error
        self.thread = SupervisedThread("link", self._run, Policy.RESTART)
        self.thread.start()

    @classmethod
    def open(cls, config: Config) -> Self:
        """Open it as the sections `vehicle` and `link` specify. Raises LinkError."""
        link = config.link
        return cls(
            config.vehicle.id,
            link.listen,
            link.connect,
            link.scouting,
            link.history_s,
            link.history_sets,
            rate=Rate(link.max_bit_rate, link.min_rate_hz, link.max_rate_hz),
            tls=Tls.of(link.ca, link.certificate, link.key),
            rights=Rights(link.allowed, link.trackers, link.pointers),
        )

    def publish(self, feature_set: FeatureSet, payload: bytes | None = None) -> bytes:
        """Keep a set for queries and send it if its turn comes; returns its packet. Raises ValueError.

        `payload` is its encoding, if there is one already; a set too large for one packet is thinned.
        """
        s = feature_set
        if s.vehicle != self._vehicle:
            raise ValueError(f"a set of {s.vehicle!r} cannot be published as {self._vehicle!r}")
        with self._changed:
            before_ns = self._selection.sent_before_ns(s.capture_unix_ns)
            self._swings.add(s)
            swing = None if before_ns is None else self._swings.since(before_ns, s)
        packet = one_packet(s, payload) if swing is None else one_packet(replace(s, swing=swing))
        offer = Offer(s.session, s.frame, s.revision, s.capture_unix_ns, s.is_ok, s.is_keyframe, packet)
        with self._changed:
            self._history.add(s, packet, runs=True)  # what is made now is of the session that runs
            self._set_clock.captured(s.session, s.capture_unix_ns, time.monotonic_ns())
            self._selection.offer(offer)
            self._pending.made(s.frame)
            self._wake()
        for watch in self.watches:
            watch(offer)
        return packet

    def recall(self, payload: bytes) -> None:
        """Keep an encoded set of a recording for queries, without sending it. Raises WireError for what is none."""
        identity = peek(payload)
        with self._changed:
            self._history.add(identity, payload, runs=True)

    def publish_status(self, payload: bytes, detail: bytes) -> None:
        """Send an encoded status in its turn; it answers queries until the next, `detail` those that ask for more."""
        with self._changed:
            self._status, self._status_detail = payload, detail
        self.report(STATUS, payload)

    def report(self, topic: Topic, payload: bytes) -> None:
        """Send a message of one of the REPORTS in its turn; an earlier one that still waits is not sent."""
        with self._changed:
            self._reports[topic] = payload
            self._wake()

    def look_up(self, asked: Question) -> Answer | None:
        """Return the answer to a query that came by another way; None: the picture's set is still being made."""
        with self._changed:
            return None if asked.pending(self._history, self._pending) is not None else self._answer(asked)

    def set_of(self, frame: int) -> tuple[bytes, float | None] | None:
        """A picture's packet and its age, s, None while that is not known; None without a set of that picture."""
        with self._changed:
            entry = self._history.entry(frame)
            now_ns = time.monotonic_ns()
            return None if entry is None else (entry.item, self._set_clock.age_s(entry.capture_unix_ns, now_ns))

    def age_s(self, capture_unix_ns: int) -> float | None:
        """Return how long ago a picture was taken; None while nothing is known of the clock."""
        with self._changed:
            return self._set_clock.age_s(capture_unix_ns, time.monotonic_ns())

    def picture_room(self) -> int:
        """Bytes that a packet of a picture may take; 0 while another is being sent, or there is no receiver."""
        with self._changed:
            if self._pieces and time.monotonic() - self._piece_s < PICTURE_PATIENCE_S:
                return 0
            room = self._budget.piece_bytes(MAX_PAYLOAD)
        try:
            # zenoh 1.10 gives an object here, which its stubs call a bool.
            return room if getattr(self._publishers[PICTURE].matching_status, "matching", False) else 0
        except zenoh.ZError:  # the session is being closed
            return 0

    def send_picture(self, picture: LinkPicture, piece_bytes: int) -> None:
        """Send a picture in packets of so many bytes, as far as sets, status and replies leave room. Raises ValueError.

        What is left of an earlier one is dropped.
        """
        pieces = cut(picture, with_parity=self._needs_parity, max_bytes=piece_bytes)
        with self._changed:
            self._pieces, self._piece_s = deque(pieces), time.monotonic()
            self._wake()

    def event(self, arrival_ns: int, event: Event) -> None:
        """Events stay on board: their arrivals give the time from which the age of pictures is computed, and pictures
        that were taken are worth waiting for."""
        with self._changed:
            if isinstance(event, Frame):
                self._pending.taken(event.index, event.stamp_ns)
            self._set_clock.arrived(arrival_ns, time.monotonic_ns())

    def feature_set(self, output: FeatureSet) -> None:
        self.publish(output)

    def close(self) -> None:
        """Leave the link; what has not been sent is not."""
        self.thread.end()
        with self._changed:
            self._is_closed = True
            self._wake()
        self.thread.join(5.0)
        self._session.close()  # type: ignore[no-untyped-call]

    def _wake(self) -> None:
        self._has_news = True
        self._changed.notify()

    def _run(self, thread: SupervisedThread) -> None:
        """The link's thread. Its locks are never held while zenoh is at work: it calls back from threads of its own."""
        while not thread.is_set():
            with self._changed:
                self._has_news = False
            wait_s = self._send_one()
            with self._changed:
                if not self._has_news or wait_s == HELD_S:
                    self._changed.wait(wait_s)

    def _send_one(self) -> float:
        """Send at most one message; seconds until the next may go."""
        info = self._session.info
        grounds = len(info.transports())
        unacknowledged = self._unacknowledged(info)
        if unacknowledged > self._most_backlog:
            return HELD_S
        now_s = time.monotonic()
        with self._changed:
            budget = self._budget
            budget.connected(grounds, now_s)
            self._forget_old_queries(now_s)
            # A link with more than a packet under way has no room to spare, whatever rate is assumed.
            messages = self._messages(now_s, has_room=unacknowledged <= PACKET_BYTES)
            for kind in USES:
                budget.waits(kind, messages[kind].size if kind in messages else None, now_s)
            message = next((m for kind, m in messages.items() if budget.send(kind, m.size, now_s)), None)
            if message is None:
                waits = [budget.wait_s(kind, m.size, now_s) for kind, m in messages.items()]
                if self._pieces and Kind.PICTURE not in messages:
                    waits.append(ACKNOWLEDGED_S)
                return max(min([self._selection.wait_s(now_s) or IDLE_S, IDLE_S, *waits]), 0.001)
            message.gone()
        try:
            message.put()
        except (zenoh.ZError, OSError) as error:  # a link that breaks in use mends itself; the next message will do
            self._warn(_first_clause(error))
        return 0.0

    def _messages(self, now_s: float, *, has_room: bool) -> dict[Use, _Message]:
        """Return the messages that could go now, by priority: a click before a report several times as large."""
        reports: dict[Use, _Message] = {
            topic: _Message(
                len(report), partial(self._reports.pop, topic), partial(self._publishers[topic].put, report)
            )
            for topic, report in self._reports.items()
        }
        found: dict[Use, _Message] = {STATUS: reports[STATUS]} if STATUS in reports else {}
        for kind in REPLIES:
            asked = next((query for query in self._queries if query.kind is kind), None)
            if asked is not None:
                found[kind] = _Message(len(asked.answer), partial(self._queries.remove, asked), partial(_reply, asked))
        found |= reports  # a status keeps its place
        older = self._selection.next_of_rest(now_s) if has_room else None
        for kind, offer in ((Kind.SET, self._selection.next(now_s)), (Kind.OLDER, older)):
            if offer is not None:
                gone = partial(self._selection.sent, offer, now_s)
                found[kind] = _Message(len(offer.item), gone, partial(self._put_set, offer))
        if self._pieces and has_room:
            piece = self._pieces[0]
            gone = partial(self._piece_gone, now_s)
            found[Kind.PICTURE] = _Message(len(piece), gone, partial(self._publishers[PICTURE].put, piece))
        return found

    def _piece_gone(self, now_s: float) -> None:
        self._pieces.popleft()
        self._piece_s = now_s
        self.pictures += not self._pieces

    def _put_set(self, offer: Offer[bytes]) -> None:
        age = self._set_clock.age_text(offer.capture_unix_ns, time.monotonic_ns())
        self._publishers[FEATURES].put(offer.item, attachment=age)
        self.sent += 1

    def _unacknowledged(self, info: zenoh.SessionInfo) -> int:
        """Bytes under way; 0 where it cannot be known, as where no descriptor is left to look with."""
        try:
            return self._backlog.unacknowledged(link.dst for link in info.links())
        except OSError as error:
            self._warn(f"what is under way cannot be known: {error.strerror or error}")
            return 0

    def _warn(self, text: str) -> None:
        now_s = time.monotonic()
        if now_s - self._warned_s >= WARN_AGAIN_S:
            self._warned_s = now_s
            log.warning("link: %s", text)

    def _forget_old_queries(self, now_s: float) -> None:
        """Drop queries whose ground waits no longer; answer parked ones whose set is made, or that are late."""
        for waiting in [w for w in self._queries if now_s > w.until_s - ANSWER_MARGIN_S]:
            self._queries.remove(waiting)
            waiting.query.drop()  # type: ignore[no-untyped-call]
        gone: set[int] = set()
        for parked in self._parked:
            is_made, is_late = parked.frame not in self._pending, now_s > parked.until_s - PENDING_MARGIN_S
            if is_made or is_late:
                found = self._answer(parked.asked) if is_made else not_placed(self._vehicle, parked.frame)
                if not self._is_measured(parked.query, parked.asked, found, parked.until_s):
                    self._queries.append(_Waiting(parked.query, self._key, found, parked.until_s, Kind.REPLY))
                gone.add(id(parked.query))
        self._parked = [parked for parked in self._parked if id(parked.query) not in gone]

    def _is_measured(self, query: zenoh.Query, asked: Question, found: Answer, until_s: float) -> bool:
        """Return whether a pixel is being measured: then the query is answered when it has been."""
        if asked.pixel is None or found.is_error:
            return False

        def done(measured: FeatureSet | None) -> None:
            payload = found.payload if measured is None else one_packet(measured)
            self._wait_to_answer(query, self._key, replace(found, payload=payload), Kind.REPLY, until_s)

        return self.measure(found.payload, asked.pixel, done)

    def _answer(self, asked: Question) -> Answer:
        return answer(self._history, asked, self._vehicle, self._status, self._set_clock)

    def _asked(self, query: zenoh.Query) -> None:
        """A set, or a Status and whose it is. A queryable that raised would look like an absent one."""
        parameters = query.parameters
        pixel = (parameters.get(key) for key in PIXEL_PARAMETERS)
        asked = Question(parameters.get(FRAME_PARAMETER), parameters.get(TIME_PARAMETER), time.monotonic_ns(), *pixel)
        until_s = time.monotonic() + patience_s(parameters.get(WAIT_PARAMETER))
        with self._changed:
            frame = asked.pending(self._history, self._pending)
            if frame is not None and len(self._parked) < MAX_WAITING_QUERIES and not self._is_closed:
                self._parked.append(_Parked(query, asked, frame, until_s))
                return
            found = self._answer(asked)
        if not self._is_measured(query, asked, found, until_s):
            self._wait_to_answer(query, self._key, found, Kind.REPLY, until_s)

    def _asked_for_status(self, query: zenoh.Query) -> None:
        is_detailed = DETAIL_PARAMETER in query.parameters
        with self._changed:
            payload = self._status_detail if is_detailed else self._status
        found = Answer(payload) if payload else refusal(Status.STARTING, self._vehicle)
        kind = Kind.REPORT if is_detailed else Kind.REPLY
        self._wait_to_answer(query, self._status_key, found, kind, time.monotonic() + ANSWER_TIMEOUT_S)

    def _asked_to_follow(self, query: zenoh.Query) -> None:
        try:
            asked = str(query.parameters)
        except ValueError:  # what is no text
            asked = "?"
        payload, is_error = self.follow(asked)
        found = Answer(payload, is_error=is_error)
        self._wait_to_answer(query, self._follow_key, found, Kind.REPLY, time.monotonic() + ANSWER_TIMEOUT_S)

    def _asked_to_look(self, query: zenoh.Query) -> None:
        """Access control lets each of the pointers ask by the key that has his name, and no one else by any."""
        until_s = time.monotonic() + ANSWERED_WITHIN_S
        key = str(query.key_expr)
        who = next((name for name in self._pointers if key == look_key(self._vehicle, name)), None)

        def done(payload: bytes, is_error: bool) -> None:
            self._wait_to_answer(query, key, Answer(payload, is_error=is_error), Kind.REPLY, until_s)

        try:
            asked = str(query.parameters)
        except ValueError:  # what is no text
            asked = "?"
        if who is None:
            done(refused("not_allowed", "no one of that name may have the camera look anywhere"), True)
        else:
            self.have_look(who, asked, done)

    def _wait_to_answer(self, query: zenoh.Query, key: str, found: Answer, kind: Kind, until_s: float) -> None:
        with self._changed:
            if len(self._queries) < MAX_WAITING_QUERIES and not self._is_closed:
                self._queries.append(_Waiting(query, key, found, until_s, kind))
                self._wake()
                return
        query.drop()  # type: ignore[no-untyped-call]


def not_followed(_: str) -> tuple[bytes, bool]:
    return refused(
        "disabled",
        "this aircraft does not follow things: for its next flight set tracks.enabled = true in its configuration",
    ), True


def _not_looked(_who: str, _parameters: str, done: Callable[[bytes, bool], object]) -> None:
    done(refused("disabled", "this aircraft's camera cannot be sent anywhere"), True)


def _reply(waiting: _Waiting) -> None:
    with waiting.query as query:
        found = waiting.answer
        if found.is_error:
            query.reply_err(found.payload)
        else:
            query.reply(waiting.key, found.payload, express=QUERY.express, attachment=found.about or None)


def _declared(session: zenoh.Session, topic: Topic, vehicle: str) -> zenoh.Publisher:
    """A publisher of a topic with the quality of service of the table."""
    qos = topic.qos
    return session.declare_publisher(
        topic.key(vehicle),
        congestion_control=getattr(zenoh.CongestionControl, qos.congestion_control),
        priority=getattr(zenoh.Priority, qos.priority),
        express=qos.express,
        reliability=getattr(zenoh.Reliability, qos.reliability),
    )


def _open_failure(listen: Sequence[str], connect: Sequence[str], error: zenoh.ZError) -> str:
    """The endpoint at fault first, zenoh's long message shortened to its first clause."""
    text = str(error)
    named = [e for e in (*listen, *connect) if e in text or e.split("/")[-1] in text] or [*listen, *connect]
    if "in use" in text:
        return f"cannot listen on {', '.join(named)}: the port is already in use"
    return f"cannot open the link at {', '.join(named)}: {_first_clause(error)}"


def _first_clause(error: Exception) -> str:
    """zenoh's long messages name the places in its source."""
    return str(error).split(" at ", maxsplit=1)[0]
