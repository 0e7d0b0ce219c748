"""Aircraft on the link as a page's source: one session an endpoint, and whatever comes is kept, bounded.

An aircraft that may send pictures of its keyframes does so while this listens.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Sequence

from contract.errors import LinkError, WireError
from contract.feature_set import FeatureSet
from contract.history import Entry
from contract.link_config import Tls
from contract.topics import ANY_VEHICLE, PICTURE, STATUS
from contract.vehicle_status import VehicleStatus, decode_status
from ground.client import SetCache, inquire
from ground.link_pictures import PictureCache
from ground.web.source import FrameRow, Picture, VehicleReport

HISTORY_S = 3600.0
HISTORY_SETS = 20_000
RATE_SPAN_S = 10.0
MAX_VEHICLES = 64  # of which anything is kept: a peer may publish under any number of names
ASKED_KEPT = 64  # sets that were asked for, since they had not come by themselves
ASK_AGAIN_S = 2.0


class _Heard:
    """Of one vehicle: what came when."""

    def __init__(self) -> None:
        self.version = 0
        self.at_s = time.monotonic()
        self.sets: deque[tuple[float, int]] = deque(maxlen=1000)
        self.status: VehicleStatus | None = None

    def rates(self, now_s: float) -> tuple[float, float]:
        """Sets a second and bit/s over the last RATE_SPAN_S."""
        recent = [size for at_s, size in list(self.sets) if now_s - at_s <= RATE_SPAN_S]
        return len(recent) / RATE_SPAN_S, 8.0 * sum(recent) / RATE_SPAN_S


class LiveSource:
    """Listens at every endpoint. Raises LinkError if one cannot be opened."""

    is_live = True

    def __init__(self, endpoints: Sequence[str], tls: Tls | None = None) -> None:
        self.name = ", ".join(endpoints)
        self._tls = tls
        self._lock = threading.Lock()
        self._heard: dict[str, _Heard] = {}
        self._asked: OrderedDict[tuple[str, int], tuple[float, FeatureSet | None]] = OrderedDict()
        self._caches: dict[str, SetCache] = {}
        self._pictures = PictureCache()
        with contextlib.ExitStack() as opened:
            for endpoint in endpoints:
                cache = SetCache(
                    endpoint,
                    max_age_s=HISTORY_S,
                    max_sets=HISTORY_SETS,
                    tls=tls,
                    beside={
                        STATUS.key(ANY_VEHICLE): self._note_status,
                        PICTURE.key(ANY_VEHICLE): self._note_picture,
                    },
                    heard=self._note_set,
                )
                self._caches[endpoint] = opened.enter_context(cache)
            opened.pop_all()

    def vehicles(self) -> list[str]:
        """Who was heard."""
        with self._lock:
            return sorted(self._heard)

    def version(self, vehicle: str) -> int:
        """Counts sets as they come, and for a picture the sets since its own: so many of the newest rows changed."""
        with self._lock:
            return self._heard[vehicle].version if vehicle in self._heard else 0

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        """What was received of the session that runs."""
        _, cache = self._of(vehicle)
        if cache is None:
            return []
        entries = cache.entries(vehicle)
        session = entries[-1].item.session if entries else 0
        with_picture = self._pictures.frames(vehicle, session)
        return [
            FrameRow(e.item.session, e.frame, e.revision, e.capture_unix_ns, e.status, e.frame in with_picture)
            for e in (entries if newest is None else entries[-newest:])
        ]

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        """What was received; else the aircraft is asked, which may take seconds."""
        endpoint, cache = self._of(vehicle)
        if cache is None:
            return None
        found = cache.by_frame(vehicle, frame)
        if found is None:
            found = self._ask(endpoint, vehicle, frame)
        return found if found is not None and (session is None or found.session == session) else None

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        """That of a keyframe, if it came over the link."""
        if session is None:
            entries = self._entries(vehicle)
            session = entries[-1].item.session if entries else 0
        found = self._pictures.picture(vehicle, session, frame)
        return None if found is None else Picture(found.content, found.media_type)

    def age_s(self, feature_set: FeatureSet) -> float | None:
        """By when its vehicle's sets were heard."""
        _, cache = self._of(feature_set.vehicle)
        return None if cache is None else cache.age_of(feature_set)

    def report(self, vehicle: str) -> VehicleReport:
        """How a vehicle is, as it says and as it is heard."""
        _, cache = self._of(vehicle)
        now_s = time.monotonic()
        with self._lock:
            heard = self._heard.get(vehicle)
        if heard is None:
            return VehicleReport(vehicle, 0, None, None, None, None, None, None)
        sets_hz, bit_rate = heard.rates(now_s)
        entries = self._entries(vehicle)
        newest = entries[-1].item if entries else None
        return VehicleReport(
            vehicle,
            0 if newest is None else newest.session,
            None if newest is None else newest.frame,
            None if cache is None or newest is None else cache.age_of(newest),
            now_s - heard.at_s,
            sets_hz,
            bit_rate,
            heard.status,
            "" if cache is None else cache.link_error,
        )

    def damage(self) -> list[str]:
        """Links that cannot be opened anew, and how much came that was no set."""
        lines = []
        for endpoint, cache in self._caches.items():
            if cache.link_error:
                lines.append(f"{endpoint}: {cache.link_error}")
            if cache.unreadable:
                lines.append(f"{endpoint}: {cache.unreadable} messages were no sets ({cache.last_error})")
        if self._pictures.unreadable:
            lines.append(f"{self._pictures.unreadable} messages were no pictures ({self._pictures.last_error})")
        return lines

    def close(self) -> None:
        """Leave every link."""
        for cache in self._caches.values():
            cache.close()

    def _of(self, vehicle: str) -> tuple[str, SetCache | None]:
        """The endpoint at which a vehicle is heard best, and its sets."""
        with_it = [(e, c) for e, c in self._caches.items() if vehicle in c.vehicles]
        return (
            max(with_it, key=lambda pair: len(pair[1].entries(vehicle)))
            if len(with_it) > 1
            else next(iter(with_it), ("", None))
        )

    def _note_set(self, received: FeatureSet, size: int) -> None:
        now_s = time.monotonic()
        with self._lock:
            heard = self._known(received.vehicle)
            if heard is not None:
                heard.version += 1
                heard.at_s = now_s
                heard.sets.append((now_s, size))

    def _note_picture(self, key: str, payload: bytes) -> None:
        picture = self._pictures.take(key, payload)
        if picture is None:
            return
        since = sum(e.frame >= picture.frame for e in self._entries(picture.vehicle))
        with self._lock:
            heard = self._known(picture.vehicle)
            if heard is not None:
                heard.version += max(since, 1)
                heard.at_s = time.monotonic()

    def _entries(self, vehicle: str) -> list[Entry[FeatureSet]]:
        _, cache = self._of(vehicle)
        return [] if cache is None else cache.entries(vehicle)

    def _note_status(self, key: str, payload: bytes) -> None:
        try:
            vehicle, status = STATUS.vehicle(key), decode_status(payload)
        except (WireError, ValueError):
            return
        with self._lock:
            heard = self._known(vehicle)
            if heard is not None:
                heard.status, heard.at_s = status, time.monotonic()

    def _known(self, vehicle: str) -> _Heard | None:
        if vehicle not in self._heard and len(self._heard) < MAX_VEHICLES:
            self._heard[vehicle] = _Heard()
        return self._heard.get(vehicle)

    def _ask(self, endpoint: str, vehicle: str, frame: int) -> FeatureSet | None:
        """The aircraft's own set of a frame; what it does not have is not asked for again at once."""
        key, now_s = (vehicle, frame), time.monotonic()
        with self._lock:
            at_s, found = self._asked.get(key, (0.0, None))
            if found is not None or (now_s - at_s < ASK_AGAIN_S and key in self._asked):
                return found
            self._asked[key] = now_s, None
            while len(self._asked) > ASKED_KEPT:
                self._asked.popitem(last=False)
        try:
            reply = inquire(endpoint, vehicle, frame=frame, tls=self._tls).get(vehicle)
        except (LinkError, WireError):
            return None
        if reply is None or not isinstance(reply.answer, FeatureSet):
            return None
        with self._lock:
            self._asked[key] = now_s, reply.answer
        return reply.answer
