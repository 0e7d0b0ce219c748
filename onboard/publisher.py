"""Feature sets -> zenoh: published as they come, and answered from a bounded history."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Sequence
from types import TracebackType

import zenoh

from contract.codec import encode
from contract.errors import LinkError
from contract.feature_set import FeatureSet, Status
from contract.history import History
from contract.link_config import link_config
from contract.topics import DEFAULT_ENDPOINT, DETAIL_PARAMETER, FEATURES, FRAME_PARAMETER, STATUS, TIME_PARAMETER


class Publisher:
    """Publishes one vehicle's sets on `pc/<vehicle>/features` and answers queries on the same key.

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
    ) -> None:
        self._key = FEATURES.key(vehicle)
        self._vehicle = vehicle
        self._history: History[bytes] = History(history_s, history_sets)
        self._lock = threading.Lock()
        config = link_config("peer", listen=listen, connect=connect, scouting=scouting)
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError as error:
            raise LinkError(_open_failure(listen, connect, error)) from error
        self._publisher = self._session.declare_publisher(
            self._key,
            congestion_control=zenoh.CongestionControl.DROP,
            express=FEATURES.express,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        # The variable keeps the queryable declared.
        self._queryable = self._session.declare_queryable(self._key, self._answer)
        self._status_key = STATUS.key(vehicle)
        self._status, self._status_detail = b"", b""
        self._status_publisher = self._session.declare_publisher(
            self._status_key,
            congestion_control=zenoh.CongestionControl.DROP,
            express=STATUS.express,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        self._status_queryable = self._session.declare_queryable(self._status_key, self._answer_status)

    def publish(self, feature_set: FeatureSet, payload: bytes | None = None) -> bytes:
        """Send a set and keep it for queries; returns its payload, encoded here unless given. Raises ValueError."""
        if feature_set.vehicle != self._vehicle:
            raise ValueError(f"a set of {feature_set.vehicle!r} cannot be published as {self._vehicle!r}")
        if payload is None:
            payload = encode(feature_set)
        with self._lock:
            self._history.add(feature_set, payload)
        self._publisher.put(payload)
        return payload

    def publish_status(self, payload: bytes, detail: bytes) -> None:
        """Send an encoded status; it answers queries until the next, `detail` those that ask for more."""
        with self._lock:
            self._status, self._status_detail = payload, detail
        self._status_publisher.put(payload)

    def close(self) -> None:
        """Leave the link."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _answer(self, query: zenoh.Query) -> None:
        """Reply with a set, or with a Status and whose it is. A queryable that raised would look like an absent one."""
        with query:
            found = self._find(query.parameters.get(FRAME_PARAMETER), query.parameters.get(TIME_PARAMETER))
            if isinstance(found, Status):
                query.reply_err(json.dumps({"status": found.value, "vehicle": self._vehicle}))
            else:
                query.reply(self._key, found)

    def _answer_status(self, query: zenoh.Query) -> None:
        with query, self._lock:
            answer = self._status_detail if DETAIL_PARAMETER in query.parameters else self._status
            if answer:
                query.reply(self._status_key, answer)
            else:
                query.reply_err(json.dumps({"status": Status.STARTING.value, "vehicle": self._vehicle}))

    def _find(self, frame: str | None, time: str | None) -> bytes | Status:
        with self._lock:
            if frame is not None:
                is_number = frame.isascii() and frame.isdecimal() and len(frame) <= 10
                payload = self._history.frame(int(frame)) if is_number else None
            elif time is not None:
                try:
                    unix_s = float(time)
                except ValueError:
                    unix_s = math.nan
                payload = self._history.nearest(unix_s) if math.isfinite(unix_s) else None
            else:
                return self._history.newest() or Status.STARTING
        return payload or Status.UNKNOWN_FRAME


def _open_failure(listen: Sequence[str], connect: Sequence[str], error: zenoh.ZError) -> str:
    """The endpoint at fault first, zenoh's long message shortened to its first clause."""
    text = str(error)
    named = [e for e in (*listen, *connect) if e in text or e.split("/")[-1] in text] or [*listen, *connect]
    if "in use" in text:
        return f"cannot listen on {', '.join(named)}: the port is already in use"
    return f"cannot open the link at {', '.join(named)}: {text.split(' at ', maxsplit=1)[0]}"
