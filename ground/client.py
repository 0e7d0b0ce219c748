"""The ground's end of the link: ask one question, or listen and keep what comes."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import zenoh

from contract.answer import EXPLANATIONS, Refusal
from contract.closing import Closing
from contract.errors import ForeignMessage, LinkError, WireError
from contract.feature_set import FeatureSet, Status
from contract.history import Entry
from contract.link_config import Tls, link_config
from contract.locate import Locator
from contract.topics import (
    ANSWER_TIMEOUT_S,
    ANY_VEHICLE,
    FEATURES,
    FRAME_PARAMETER,
    PIXEL_PARAMETERS,
    QUERY,
    TIME_PARAMETER,
    WAIT_PARAMETER,
)
from contract.wire.codec import decode
from contract.wire.message import payload_of, read_set
from ground.aircraft_clock import Moment
from ground.dropped_messages import DroppedMessages
from ground.freshness import Later, Reply
from ground.last_received import MOST_VEHICLES, LastReceived
from ground.mavlink_endpoint import SCHEME, MavlinkEndpoint
from ground.mavlink_sets import MavlinkSets, RadioSystems
from ground.presence import Alone, is_through_router, vehicles_there
from ground.received_sets import ReceivedSets, check_is_one
from ground.watched_thread import WatchedThread

PICTURE_TIMEOUT_S = 8.0  # of a picture asked for by its number or its time, which may have no set yet
# Time without a message after which a listener opens the link again: longer than a short break, shorter than the time
# for which a coordinator waits.
RENEW_S = 8.0
RENEWAL_PERIOD_S = 0.1  # between looks at the link, and at what is in doubt
MOST_REFUSING = 256  # vehicles that refuse one question to all: a peer may invent names
FIRST_RETRY_S = 1.0  # after a renewal that failed; twice as long each time, at most RENEW_S


def inquire(
    endpoint: str,
    vehicle: str = ANY_VEHICLE,
    *,
    frame: int | None = None,
    unix_s: float | None = None,
    pixel: tuple[float, float] | None = None,
    tls: Tls | None = None,
    is_sole: bool = False,
    dropped: DroppedMessages | None = None,
) -> dict[str, Reply]:
    """Ask each vehicle at an endpoint for its set of a frame or a time, or its newest one; a reply may be a refusal.

    A picture whose set is still being made is waited for, up to PICTURE_TIMEOUT_S.
    `pixel`: u and v of one that the aircraft is to measure by itself, which takes it 0.5 s at most.
    Each reply has the age that the picture had at most when it came: what the aircraft states by its own clock when it
    is asked, and the time that the question took from here and back.
    `is_sole`: one aircraft's answer is wanted. Where a router knows of several, LinkError names them; none is asked.
    `dropped` counts answers that name another vehicle than the one under whose key they came.
    A client session: it opens in milliseconds where a peer waits half a second for others to show up. Raises LinkError
    if there is no vehicle or none answers, WireError for a set this version cannot read.
    """
    parts, timeout_s = [], ANSWER_TIMEOUT_S
    if frame is not None or unix_s is not None:
        which = f"{FRAME_PARAMETER}={frame}" if frame is not None else f"{TIME_PARAMETER}={unix_s!r}"
        parts, timeout_s = [which, f"{WAIT_PARAMETER}={PICTURE_TIMEOUT_S:g}"], PICTURE_TIMEOUT_S
    if pixel is not None:
        parts += _pixel_parameters(pixel)
    parameters = "?" + ";".join(parts) if parts else ""
    key = FEATURES.key(vehicle)
    dropped = dropped or DroppedMessages()
    if endpoint.startswith(SCHEME):
        raise LinkError("single pictures cannot be asked for through the autopilot's radio; it answers pc-ground click")
    session = open_link("client", endpoint, tls)
    try:
        if (
            is_sole
            and vehicle == ANY_VEHICLE
            and is_through_router(session)
            and len(there := vehicles_there(session)) > 1
        ):
            raise several_aircraft(endpoint, there)
        answers = _replies(session, vehicle, parameters, dropped, timeout_s)
    finally:
        session.close()
    if not answers:
        who = "no aircraft answers" if vehicle == ANY_VEHICLE else f"aircraft {vehicle!r} does not answer"
        raise LinkError("; ".join([f"{who} at {endpoint} (asked for {key})", *dropped.lines()]))
    return answers


def put_question(session: Any, selector: str, timeout_s: float = ANSWER_TIMEOUT_S, **options: Any) -> Iterable[Any]:
    """Zenoh's replies to a question, sent as questions are; `options` are those of its `get`."""
    replies: Iterable[Any] = session.get(
        selector,
        timeout=timeout_s,
        congestion_control=getattr(zenoh.CongestionControl, QUERY.congestion_control),
        priority=getattr(zenoh.Priority, QUERY.priority),
        express=QUERY.express,
        **options,
    )
    return replies


def _pixel_parameters(uv_px: tuple[float, float]) -> list[str]:
    return [f"{key}={float(value)!r}" for key, value in zip(PIXEL_PARAMETERS, uv_px, strict=True)]


def several_aircraft(endpoint: str, there: Sequence[str]) -> LinkError:
    """The error that names several aircraft where one is meant."""
    return LinkError(f"several aircraft are at {endpoint}: {', '.join(there)}; choose one with --vehicle")


def only_vehicle(session: Any, endpoint: str) -> str:
    """The vehicle at an endpoint where there is one. Raises LinkError if there is none, or there are several."""
    there = vehicles_there(session)
    if len(there) == 1:
        return there[0]
    if there:
        raise several_aircraft(endpoint, there)
    raise LinkError(f"no aircraft answers at {endpoint}")


def _replies(
    session: Any, vehicle: str, parameters: str, dropped: DroppedMessages, timeout_s: float = ANSWER_TIMEOUT_S
) -> dict[str, Reply]:
    """Each vehicle's answer to a question; its age includes the time that the question took. Raises WireError, and
    LinkError where two aircraft answer under one name.

    A set is accepted by the key under which it came. A refusal comes without one: where all were asked, whom it names
    is asked by its own key, which only that vehicle can answer.
    """
    answers: dict[str, Reply] = {}
    refusing: dict[str, None] = {}
    asked_s = time.monotonic()
    to_all = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    for reply in put_question(session, FEATURES.key(vehicle) + parameters, timeout_s, **to_all):
        took_s = time.monotonic() - asked_s
        if reply.ok is not None:
            try:
                answer = _answered(reply.ok)
            except ForeignMessage as error:
                dropped.failed(error)
                continue
            named = str(answer.answer.vehicle)
            if (before := answers.get(named)) is not None:
                check_is_one(before.answer, answer.answer)
            answers[named] = answer.later_by(took_s)
        elif (refusal := _refusal(reply.err)) is not None and len(refusing) < MOST_REFUSING:
            named = str(refusal.answer.vehicle)
            if vehicle == ANY_VEHICLE:
                refusing[named] = None
            elif named != vehicle:
                dropped.failed(ForeignMessage(f"{vehicle!r} sends what names {named!r}"))
            else:
                if (before := answers.get(named)) is not None:
                    check_is_one(before.answer, refusal.answer)
                answers[named] = refusal.later_by(took_s)
    for named in refusing:
        with contextlib.suppress(ValueError):  # a name that no key can hold is no vehicle's
            if named != ANY_VEHICLE:
                answers |= _replies(session, named, parameters, dropped, timeout_s)
    return answers


def ask_measured(
    session: Any, vehicle: str, frame: int, uv_px: tuple[float, float], dropped: DroppedMessages
) -> FeatureSet | None:
    """A vehicle's set of a picture with a pixel of it measured, or why it is not; None if it has none.

    Raises LinkError if it does not answer, WireError for a set this version cannot read.
    """
    parameters = ";".join([f"{FRAME_PARAMETER}={frame}", *_pixel_parameters(uv_px)])
    return _asked_set(session, vehicle, parameters, dropped)


def _asked_set(session: Any, vehicle: str, parameters: str, dropped: DroppedMessages) -> FeatureSet | None:
    try:
        reply = _replies(session, vehicle, f"?{parameters}", dropped).get(vehicle)
    except zenoh.ZError as error:
        raise LinkError(f"cannot ask {vehicle!r}: {error}") from error
    if reply is None:
        raise LinkError(f"aircraft {vehicle!r} does not answer")
    return reply.answer if isinstance(reply.answer, FeatureSet) else None


def running_session(session: Any, vehicle: str) -> int | None:
    """The number of a vehicle's session that runs now, as it answers itself; None without one answer or a set."""
    try:
        reply = _replies(session, vehicle, "", DroppedMessages()).get(vehicle)
    except (zenoh.ZError, WireError, LinkError):
        return None
    return reply.answer.session if reply is not None and isinstance(reply.answer, FeatureSet) else None


def ask(
    endpoint: str,
    vehicle: str = ANY_VEHICLE,
    *,
    frame: int | None = None,
    unix_s: float | None = None,
    tls: Tls | None = None,
) -> dict[str, FeatureSet | Refusal]:
    """The answers of `inquire` by themselves, however old."""
    replies = inquire(endpoint, vehicle, frame=frame, unix_s=unix_s, tls=tls)
    return {name: reply.answer for name, reply in replies.items()}


class SetCache(Closing):
    """Subscribes to the sets of one or all vehicles and keeps the last ones, by vehicle, frame and time.

    Thread-safe. `dropped` counts what was no set, or named another vehicle than its key. A peer session, which
    reconnects by itself, and is opened again after RENEW_S without a message: `link_error` states what prevents that.
    `subscriptions`: more key expressions to subscribe to, each with the function that gets its samples' keys and
    payloads; `on_set` gets each set and its size in bytes. Both are called in zenoh's thread: they must be quick and
    call nothing of zenoh's. Raises LinkError if the link cannot be opened.
    """

    def __init__(
        self,
        endpoint: str,
        vehicle: str = ANY_VEHICLE,
        max_age_s: float = 600.0,
        max_sets: int = 5000,
        *,
        tls: Tls | None = None,
        subscriptions: Mapping[str, Callable[[str, bytes], object]] | None = None,
        on_set: Callable[[FeatureSet, int], None] | None = None,
    ) -> None:
        self.dropped = DroppedMessages()
        self._subscriptions, self._on_set = dict(subscriptions or {}), on_set
        self._vehicles = LastReceived(lambda name: ReceivedSets(name, max_age_s, max_sets), MOST_VEHICLES)
        self._locators: dict[str, Locator] = {}
        self._lock = threading.Lock()
        self._ways = endpoint, tls, FEATURES.key(vehicle)
        self._systems, self._alone = RadioSystems(), Alone()
        self._received_s = self._renewed_s = time.monotonic()
        self._retry_s = FIRST_RETRY_S
        self._failure: Exception | None = None  # of the last attempt to open the link again
        self._is_closed = False
        self._session: Any = None
        self._subscribers: list[Any] = []
        self._subscribe()
        self._renewal = WatchedThread("renewal of the link", self._renew_if_silent, RENEWAL_PERIOD_S)

    @property
    def vehicles(self) -> list[str]:
        with self._lock:
            return sorted(self._vehicles)

    def newest(self, vehicle: str) -> FeatureSet | None:
        """The newest set that answers clicks, or the newest refusal if none does."""
        with self._lock:
            return None if (held := self._vehicles.get(vehicle)) is None else held.history.newest()

    def by_frame(self, vehicle: str, frame: int) -> FeatureSet | None:
        with self._lock:
            return None if (held := self._vehicles.get(vehicle)) is None else held.history.frame(frame)

    def by_time(self, vehicle: str, unix_s: float) -> FeatureSet | None:
        """The set captured nearest to a time, within half a second."""
        with self._lock:
            return None if (held := self._vehicles.get(vehicle)) is None else held.history.nearest(unix_s)

    def entries(self, vehicle: str) -> list[Entry[FeatureSet]]:
        """The sets of the session that runs, in capture order."""
        with self._lock:
            return [] if (held := self._vehicles.get(vehicle)) is None else held.history.ordered()

    def age_of(self, feature_set: FeatureSet) -> float | None:
        """Seconds since a set's picture was taken, at most; None before any set of its vehicle was received."""
        with self._lock:
            held = self._vehicles.get(feature_set.vehicle)
            return None if held is None else held.age_s(feature_set.capture_unix_ns, Moment.now())

    def stamped_ago_s(self, vehicle: str, unix_ns: int) -> float:
        """Seconds, at most, since a vehicle stamped a message so; by how much it differs from this computer's clock
        where no set of the vehicle came.
        """
        now = Moment.now()
        with self._lock:
            held = self._vehicles.get(vehicle)
            age_s = None if held is None else held.age_s(unix_ns, now)
        return abs(now.unix_ns - unix_ns) / 1e9 if age_s is None else age_s

    def age_s(self, vehicle: str) -> float | None:
        """Seconds since the newest known picture was taken, at most, whether it answers or not; None before the first.

        This, and not the link's own state, determines whether what is shown is old: a session outlives a break by its
        lease, and a set may be sent again, today or tomorrow. What the fastest set took on its way is not in it.
        """
        reply = self.reply(vehicle)
        return None if reply is None else reply.age_s if reply.later is None else reply.later.age_s

    def reply(self, vehicle: str) -> Reply | None:
        """`newest` with the age of its picture, and what is known of a newer one that refuses; None before the first.

        `Reply.fresh` makes a refusal of it where that is too old to be what is seen now.
        """
        with self._lock:
            return None if (held := self._vehicles.get(vehicle)) is None else held.reply(Moment.now())

    def doubt(self, vehicle: str) -> str:
        """The state of the aircraft's clock, in words; empty where it agrees with this computer's."""
        with self._lock:
            return "" if (held := self._vehicles.get(vehicle)) is None else held.doubt(Moment.now())

    def is_certain(self, vehicle: str) -> bool:
        """Return whether ages of a vehicle's pictures are known, not only their bound; true before any came."""
        with self._lock:
            held = self._vehicles.get(vehicle)
            clock = None if held is None else held.clock
            return clock is None or clock.is_certain(Moment.now())

    def is_of_now(self, vehicle: str, session: int) -> bool:
        """Return whether a message that states this session is of the one that runs; true before any set came."""
        with self._lock:
            return (held := self._vehicles.get(vehicle)) is None or held.is_of_now(session)

    def bring_in(self, feature_set: FeatureSet) -> None:
        """Keep a set of an earlier run, or one that was asked for: it gives no information on the aircraft's clock."""
        with self._lock:
            self._vehicles.of(feature_set.vehicle).bring_in(feature_set)

    def ask_at(self, vehicle: str, unix_s: float) -> FeatureSet | None:
        """The aircraft's set captured nearest to a time, over the session that listens; None if it has none.

        Raises LinkError if it does not answer, WireError for a set this version cannot read.
        """
        return _asked_set(self._asked_over(), vehicle, f"{TIME_PARAMETER}={unix_s!r}", self.dropped)

    def ask_measured(self, vehicle: str, frame: int, uv_px: tuple[float, float]) -> FeatureSet | None:
        """The aircraft's set of a picture with a pixel of it measured, or why it is not; as `ask_at`, as long."""
        return ask_measured(self._asked_over(), vehicle, frame, uv_px, self.dropped)

    def _asked_over(self) -> Any:
        with self._lock:
            session = self._session
        if session is None:
            raise LinkError(f"the link to {self._ways[0]} is down")
        if isinstance(session, MavlinkSets):
            raise LinkError("single pictures cannot be asked for through the autopilot's radio")
        return session

    @property
    def link_error(self) -> str:
        """The reason why the link cannot be opened again now, in a line; empty if none is known."""
        session = self._session
        return self._renewal.trouble or (session.trouble if isinstance(session, MavlinkSets) else "")

    @property
    def unreached(self) -> str:
        """The words for a link that has had no one at its other end for a while, else empty."""
        return f"nothing listens at {self._ways[0]}" if self._alone.is_long(time.monotonic()) else ""

    def locator(self, feature_set: FeatureSet) -> Locator:
        """A Locator of a set, the last one of each vehicle kept: repeated clicks on one picture are solved once."""
        with self._lock:
            held = self._locators.get(feature_set.vehicle)
            if held is None or held.feature_set is not feature_set:
                held = self._locators[feature_set.vehicle] = Locator(feature_set)
            return held

    def close(self) -> None:
        """Leave the link; what was kept stays readable. A renewal under way closes what it has opened by itself."""
        with self._lock:
            self._is_closed = True
            session, self._session, self._subscribers = self._session, None, []
        self._renewal.close()
        _close(session)

    def _subscribe(self) -> None:
        """Open a session where there is none. Raises LinkError."""
        endpoint, tls, key = self._ways
        if endpoint.startswith(SCHEME):
            self._begin(MavlinkSets(MavlinkEndpoint.parse(endpoint), self._take_from_radio, self._note_received), [])
            return
        session = open_link("peer", endpoint, tls)
        try:
            subscribers = [session.declare_subscriber(key, self._receive)]
            subscribers += [
                session.declare_subscriber(wanted, partial(self._pass_on, wanted, take))
                for wanted, take in self._subscriptions.items()
            ]
        except zenoh.ZError as error:
            _close(session)
            raise LinkError(f"cannot listen to {key} at {endpoint}: {error}") from error
        self._begin(session, subscribers)

    def _begin(self, session: Any, subscribers: list[Any]) -> None:
        with self._lock:
            if not self._is_closed:
                self._session, self._subscribers = session, subscribers
                return
        _close(session)

    def _renew_if_silent(self) -> None:
        """Begin again after a long time without messages: over udp a subscription that was lost is never sent again.

        Raises LinkError, and is called again.
        """
        self._ask_doubtful()
        now_s = time.monotonic()
        with self._lock:
            self._alone.note(self._session, now_s)
            if isinstance(self._session, MavlinkSets) and self._session.refusal:
                return  # it was turned away, and would be again
            is_down = self._session is None
            wait_s = self._retry_s if is_down else RENEW_S
            if self._is_closed or now_s - max(self._received_s, self._renewed_s) <= wait_s:
                if is_down and self._failure is not None:
                    raise self._failure  # still so
                return
            session, self._session, self._subscribers = self._session, None, []
            self._renewed_s = now_s
        _close(session)
        try:
            self._subscribe()
        except Exception as error:
            self._failure = error
            self._retry_s = min(2.0 * self._retry_s, RENEW_S)
            raise
        self._failure, self._retry_s = None, FIRST_RETRY_S

    def _receive(self, sample: zenoh.Sample) -> None:
        self._note_received()
        payload = sample.payload.to_bytes()
        try:
            received = read_set(str(sample.key_expr), payload)
        except (WireError, ValueError) as error:
            self.dropped.failed(error)
            return
        self._keep(received, len(payload), _seconds(_json(sample.attachment)))

    def _take_from_radio(self, system: int, payload: bytes, age_s: float | None) -> None:
        """A set that came without a key gets the one of the vehicle that its MAVLink system is."""
        try:
            received = self._systems.checked(system, decode(payload))
        except WireError as error:
            self.dropped.failed(error)
            return
        key = zenoh.KeyExpr(FEATURES.template.format(vehicle=received.vehicle))
        if key.intersects(zenoh.KeyExpr(self._ways[2])):
            self._keep(received, len(payload), age_s)
        for wanted, take in self._subscriptions.items():
            if key.intersects(zenoh.KeyExpr(wanted)):
                take(str(key), payload)

    def _note_received(self) -> None:
        self._received_s = time.monotonic()

    def _keep(self, received: FeatureSet, size: int, age_s: float | None) -> None:
        """A set that came now, and its picture's age when it was sent."""
        with self._lock:
            left_out = self._vehicles.of(received.vehicle).take(received, age_s, Moment.now())
        if left_out:
            self.dropped.not_accepted(left_out)
        elif self._on_set is not None:
            self._on_set(received, size)

    def _pass_on(self, wanted: str, take: Callable[[str, bytes], object], sample: zenoh.Sample) -> None:
        """A message for who has subscribed; no report of a session before the one that runs."""
        key, payload = str(sample.key_expr), sample.payload.to_bytes()
        kind = payload_of(wanted)
        if kind is not None and kind.is_report:
            vehicle, session = key.split("/")[1], 0
            with contextlib.suppress(WireError, ValueError):  # `take` counts what it cannot read
                session = kind.stamp_of(key, payload).session
            if not self.is_of_now(vehicle, session):
                self.dropped.not_accepted(f"{vehicle!r} sends {kind.topic.name} of an earlier session")
                return
        take(key, payload)

    def _ask_doubtful(self) -> None:
        """Ask the aircraft whose clock or session is in doubt for their newest set: an answer is of now."""
        now = Moment.now()
        with self._lock:
            session = self._session
            doubtful = [held.vehicle for held in self._vehicles.values() if held.is_to_be_asked(now)]
        for vehicle in doubtful if session is not None else ():
            if isinstance(session, MavlinkSets):
                session.ask(self._systems.system_of(vehicle), partial(self._answered_by_radio, vehicle))
                continue
            with contextlib.suppress(zenoh.ZError, ValueError):  # it is asked again
                put_question(session, FEATURES.key(vehicle), handler=partial(self._answered_now, vehicle, now))

    def _answered_now(self, vehicle: str, asked: Moment, reply: zenoh.Reply) -> None:
        """An aircraft's answer, in zenoh's thread."""
        if reply.ok is None:
            return
        try:
            found = _answered(reply.ok)
        except (WireError, ValueError) as error:
            self.dropped.failed(error)
            return
        s = found.answer
        if isinstance(s, FeatureSet) and s.vehicle == vehicle:
            sent_ns = None if found.age_s is None else s.capture_unix_ns + round(found.age_s * 1e9)
            with self._lock:
                self._vehicles.of(vehicle).answered(s.session, sent_ns, asked.monotonic_ns, Moment.now())

    def _answered_by_radio(self, vehicle: str, sent_unix_ns: int, asked_ns: int) -> None:
        """The same, through the autopilot's radio."""
        with self._lock:
            self._vehicles.of(vehicle).answered_by_radio(sent_unix_ns, asked_ns, Moment.now())


def open_link(mode: str, endpoint: str, tls: Tls | None) -> Any:
    """A session of zenoh's. Raises LinkError."""
    try:
        return zenoh.open(zenoh.Config.from_json5(link_config(mode, connect=[endpoint], tls=tls)))
    except zenoh.ZError as error:
        reason = str(error).split(" at ", maxsplit=1)[0]
        if "Unable to connect" in reason:
            raise LinkError(
                f"nothing listens at {endpoint}: does pc-onboard run there, and does its link.listen open it?"
            ) from error
        raise LinkError(f"cannot open the link to {endpoint}: {reason}") from error


def _close(session: Any) -> None:
    """Close a session, if there is one; a session that cannot be closed is gone already."""
    if session is not None:
        with contextlib.suppress(zenoh.ZError):
            session.close()


def _answered(sample: zenoh.Sample) -> Reply:
    """A set, and what its attachment states of it. Raises WireError for a set that cannot be read or is another's."""
    found = read_set(str(sample.key_expr), sample.payload.to_bytes())
    about = json_object(sample.attachment)
    return Reply(found, _seconds(about.get("age_s")), _later(about.get("newest")), *_state_and_reason(about))


def _refusal(error: zenoh.ReplyError | None) -> Reply | None:
    """Read the refusal that a queryable replied with; None if it is not one of ours."""
    about = json_object(None if error is None else error.payload)
    try:
        status, vehicle = Status(about["status"]), str(about["vehicle"])
    except (ValueError, KeyError):
        return None
    state, reason = _state_and_reason(about)
    value = f"{state}: {reason}" if reason else state
    detail = f"{EXPLANATIONS[status]}; the aircraft reports: {value}" if value else ""
    return Reply(Refusal(status, vehicle=vehicle, detail=detail), None, None, state, reason)


def _json(content: zenoh.ZBytes | None) -> object:
    """None for what is no JSON: an attachment to a set is optional."""
    try:
        return None if content is None else json.loads(content.to_bytes())
    except (ValueError, RecursionError):
        return None


def json_object(content: zenoh.ZBytes | None) -> dict[str, Any]:
    """A JSON object; empty for anything else."""
    value = _json(content)
    return value if isinstance(value, dict) else {}


def _later(value: object) -> Later | None:
    if not isinstance(value, dict):
        return None
    try:
        return Later(Status(value["status"]), int(value["frame"]), _seconds(value.get("age_s")))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


def _state_and_reason(about: dict[str, Any]) -> tuple[str, str]:
    """The daemon's state and its reason, as one line of text each."""
    state, reason = (str(about.get(key, ""))[:80] for key in ("state", "reason"))
    return "".join(c for c in state if c.isprintable()), "".join(c for c in reason if c.isprintable())


def _seconds(value: object) -> float | None:
    """An age; None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if 0.0 <= value < 1e12 else None
