"""The ground's end of the link: ask one question, or listen and keep what comes."""

from __future__ import annotations

import json
import threading
import time
from types import TracebackType
from typing import Any

import zenoh

from contract.errors import LinkError, WireError
from contract.feature_set import FeatureSet, Status
from contract.history import History
from contract.link_config import Tls, link_config
from contract.topics import ANY_VEHICLE, FEATURES, FRAME_PARAMETER, TIME_PARAMETER
from contract.wire.codec import decode
from ground.answer import Refusal
from ground.locate import Locator

ANSWER_TIMEOUT_S = 3.0
RENEW_S = (
    8.0  # of silence, after which a listener begins anew: more than a short cut, less than a coordinator's patience
)


def ask(
    endpoint: str,
    vehicle: str = ANY_VEHICLE,
    *,
    frame: int | None = None,
    unix_s: float | None = None,
    tls: Tls | None = None,
) -> dict[str, FeatureSet | Refusal]:
    """What each vehicle at an endpoint answers: its set of a frame or a time, or its newest one, or a refusal.

    A client session: it opens in milliseconds where a peer waits half a second for others to show up. Raises LinkError
    if nobody is there or nobody answers, WireError for a set this version cannot read.
    """
    parameters = ""
    if frame is not None:
        parameters = f"?{FRAME_PARAMETER}={frame}"
    elif unix_s is not None:
        parameters = f"?{TIME_PARAMETER}={unix_s!r}"
    key = FEATURES.key(vehicle)
    answers: dict[str, FeatureSet | Refusal] = {}
    session = _open("client", endpoint, tls)
    try:
        replies = session.get(
            key + parameters,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWER_TIMEOUT_S,
        )
        for reply in replies:
            answer = _refusal(reply.err) if reply.ok is None else decode(reply.ok.payload.to_bytes())
            if answer is not None and answer.vehicle is not None:
                answers[answer.vehicle] = answer
    finally:
        session.close()
    if not answers:
        who = "no aircraft answers" if vehicle == ANY_VEHICLE else f"aircraft {vehicle!r} does not answer"
        raise LinkError(f"{who} at {endpoint} (asked for {key})")
    return answers


class SetCache:
    """Subscribes to the sets of one or all vehicles and keeps the last ones, by vehicle, frame and time.

    Thread-safe. `unreadable` counts payloads that were no sets; `last_error` is the last one's. A peer session, which
    reconnects by itself. Raises LinkError if the link cannot be opened.
    """

    def __init__(
        self,
        endpoint: str,
        vehicle: str = ANY_VEHICLE,
        max_age_s: float = 600.0,
        max_sets: int = 5000,
        *,
        tls: Tls | None = None,
    ) -> None:
        self.unreadable = 0
        self.last_error: WireError | None = None
        self._bounds = max_age_s, max_sets
        self._histories: dict[str, History[FeatureSet]] = {}
        self._newest: dict[str, tuple[int, int, float]] = {}  # session, newest capture, and when it was heard
        self._locators: dict[str, Locator] = {}
        self._lock = threading.Lock()
        self._ways = endpoint, tls, FEATURES.key(vehicle)
        self._heard_s = time.monotonic()
        self._closed = threading.Event()
        self._session, self._subscriber = self._subscribed()
        self._watch = threading.Thread(target=self._renew, name="renew", daemon=True)
        self._watch.start()

    @property
    def vehicles(self) -> list[str]:
        """Who was heard, sorted."""
        with self._lock:
            return sorted(self._histories)

    def newest(self, vehicle: str) -> FeatureSet | None:
        """The newest set that answers clicks, or the newest refusal if none does."""
        with self._lock:
            return self._histories[vehicle].newest() if vehicle in self._histories else None

    def by_frame(self, vehicle: str, frame: int) -> FeatureSet | None:
        """The set of a frame at its latest revision."""
        with self._lock:
            return self._histories[vehicle].frame(frame) if vehicle in self._histories else None

    def by_time(self, vehicle: str, unix_s: float) -> FeatureSet | None:
        """The set captured nearest to a time, within half a second."""
        with self._lock:
            return self._histories[vehicle].nearest(unix_s) if vehicle in self._histories else None

    def age_s(self, vehicle: str) -> float | None:
        """Seconds since a picture newer than all before was heard of; None before the first.

        This and not the link's own idea of being up says whether what is shown is old: a session outlives a cut by its
        lease, and a set may be said again. It needs no clock in common with the aircraft; the delay of the link adds.
        """
        with self._lock:
            return time.monotonic() - self._newest[vehicle][2] if vehicle in self._newest else None

    def locator(self, feature_set: FeatureSet) -> Locator:
        """A Locator of a set, the last one of each vehicle kept: repeated clicks on one picture are solved once."""
        with self._lock:
            held = self._locators.get(feature_set.vehicle)
            if held is None or held.feature_set is not feature_set:
                held = self._locators[feature_set.vehicle] = Locator(feature_set)
            return held

    def close(self) -> None:
        """Leave the link; what was kept stays readable."""
        self._closed.set()
        self._watch.join()
        self._session.close()

    def __enter__(self) -> SetCache:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _subscribed(self) -> tuple[Any, Any]:
        endpoint, tls, key = self._ways
        session = _open("peer", endpoint, tls)
        return session, session.declare_subscriber(key, self._receive)

    def _renew(self) -> None:
        """Begin anew after a long silence: over udp a subscription that was lost on its way is never said again."""
        while not self._closed.wait(0.5):
            if time.monotonic() - self._heard_s <= RENEW_S:
                continue
            self._heard_s = time.monotonic()
            self._session.close()
            try:
                self._session, self._subscriber = self._subscribed()
            except LinkError:
                continue  # no way out just now; the next silence tries again

    def _receive(self, sample: zenoh.Sample) -> None:
        self._heard_s = time.monotonic()
        try:
            received = decode(sample.payload.to_bytes())
        except WireError as error:
            with self._lock:
                self.unreadable += 1
                self.last_error = error
            return
        with self._lock:
            if received.vehicle not in self._histories:
                self._histories[received.vehicle] = History(*self._bounds)
            self._histories[received.vehicle].add(received, received)
            session, capture_ns, _ = self._newest.get(received.vehicle, (-1, 0, 0.0))
            if received.session != session or received.capture_unix_ns > capture_ns:
                self._newest[received.vehicle] = received.session, received.capture_unix_ns, time.monotonic()


def _open(mode: str, endpoint: str, tls: Tls | None) -> Any:
    try:
        return zenoh.open(zenoh.Config.from_json5(link_config(mode, connect=[endpoint], tls=tls)))
    except zenoh.ZError as error:
        reason = str(error).split(" at ", maxsplit=1)[0]
        if "Unable to connect" in reason:
            raise LinkError(f"nobody listens at {endpoint}") from error
        raise LinkError(f"cannot open the link to {endpoint}: {reason}") from error


def _refusal(error: zenoh.ReplyError | None) -> Refusal | None:
    """What a queryable said instead of a set; None if it is not one of ours."""
    if error is None:
        return None
    try:
        said = json.loads(error.payload.to_bytes())
        return Refusal(Status(said["status"]), vehicle=str(said["vehicle"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
