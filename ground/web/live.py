"""Aircraft on the link as a page's source: one session for each endpoint; all that comes is kept, bounded.

An aircraft that may send pictures of its keyframes does so while this listens.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from bisect import bisect_left
from collections import OrderedDict, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from contract.errors import LinkError, WireError
from contract.feature_set import FeatureSet
from contract.history import Entry
from contract.link_config import Tls
from contract.look import LookRequest
from contract.supervised_thread import Policy, SupervisedThread
from contract.topics import ANY_VEHICLE, PICTURE, STATUS
from contract.track import TrackRequest
from contract.vehicle_status import VehicleStatus
from contract.wire.message import read_set, read_status
from ground.client import PICTURE_TIMEOUT_S, SetCache, inquire
from ground.last_received import LastReceived
from ground.link_pictures import PictureCache
from ground.look_link import WITHOUT_TLS, LookLink
from ground.mavlink_endpoint import SCHEME
from ground.report_view import subscriptions
from ground.track_link import TrackLink
from ground.unmeasured import NO_ANSWER, NOT_TRIED
from ground.web.journal import Journal
from ground.web.refill import Refill
from ground.web.source import FrameRow, Picture, VehicleReport, Views

HISTORY_S = 3600.0
HISTORY_SETS = 20_000
RATE_SPAN_S = 10.0
KEPT_KEYS = "pc/*/*"  # of the journal: all that any vehicle sends
MAX_VEHICLES = 64  # of which anything is kept: a peer may publish under any number of names
ASKED_KEPT = 64  # sets that were asked for, since they had not come by themselves
ASK_AGAIN_S = 2.0
ASKED_WITHIN_S = PICTURE_TIMEOUT_S + 2.0  # that another's question takes, with the opening of its session
SILENT_SETS = 30  # without a picture among them, before it is reported


class _Received:
    """The messages received of one vehicle: sizes and times of sets, the newest status, a version that counts."""

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
    """Listens at every endpoint. Raises LinkError if one cannot be opened, InputError for a journal that cannot be.

    `journal`: a folder in which what crosses the link is kept, and from which the last hour is read at the start. What
    an aircraft still has of the minutes before is asked for.
    """

    is_live = True
    measures = True

    def __init__(self, endpoints: Sequence[str], tls: Tls | None = None, journal: Path | None = None) -> None:
        self.name = ", ".join(endpoints)
        self._tls = tls
        self._lock = threading.Lock()
        self._received = LastReceived(lambda _: _Received(), MAX_VEHICLES)
        self._under_way: dict[tuple[str, int], threading.Event] = {}  # questions, until each has its answer
        self._asked: OrderedDict[tuple[str, int], tuple[float, FeatureSet | None]] = OrderedDict()
        self._caches: dict[str, SetCache] = {}
        self._pictures = PictureCache()
        self.views = Views()
        self._journal = None if journal is None else Journal(journal)
        keep = {} if self._journal is None else {KEPT_KEYS: self._journal.take}
        with contextlib.ExitStack() as opened:
            for endpoint in endpoints:
                cache = SetCache(
                    endpoint,
                    max_age_s=HISTORY_S,
                    max_sets=HISTORY_SETS,
                    tls=tls,
                    subscriptions={
                        STATUS.key(ANY_VEHICLE): self._note_status,
                        PICTURE.key(ANY_VEHICLE): self._note_picture,
                        **subscriptions(ANY_VEHICLE, *self.views),
                        **keep,
                    },
                    on_set=self._note_set,
                )
                self._caches[endpoint] = opened.enter_context(cache)
            opened.pop_all()
        # Without what it takes from there the page goes on.
        self._reading = SupervisedThread("reading the journal", self._read_journal, Policy.DEGRADE, late_after_s=None)
        self._reading.start()
        self._refill = Refill(self.vehicles, self._newest, self._has, self._ask_at)

    def vehicles(self) -> list[str]:
        with self._lock:
            return sorted(self._received)

    def version(self, vehicle: str) -> int:
        """Counts sets as they come, and for a picture the sets since its own: so many of the newest rows changed."""
        with self._lock:
            return 0 if (known := self._received.get(vehicle)) is None else known.version

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        """The received pictures of the session that runs."""
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
        """The set as received; else the aircraft is asked, which may take seconds."""
        endpoint, cache = self._of(vehicle)
        if cache is None:
            return None
        found = cache.by_frame(vehicle, frame)
        if found is None:
            found = self._ask(endpoint, vehicle, frame)
        return found if found is not None and (session is None or found.session == session) else None

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        """The picture of a keyframe, if it came over the link."""
        if session is None:
            entries = self._entries(vehicle)
            session = entries[-1].item.session if entries else 0
        found = self._pictures.picture(vehicle, session, frame)
        return None if found is None else Picture(found.content, found.media_type)

    def age_s(self, feature_set: FeatureSet) -> float | None:
        """The age that counts from when its vehicle's sets were received; None for an unknown vehicle."""
        _, cache = self._of(feature_set.vehicle)
        return None if cache is None else cache.age_of(feature_set)

    def report(self, vehicle: str) -> VehicleReport:
        """The state of a vehicle, as it reports and as it is received."""
        _, cache = self._of(vehicle)
        now_s = time.monotonic()
        with self._lock:
            known = self._received.get(vehicle)
        if known is None:
            return VehicleReport(vehicle, 0, None, None, None, None, None, None)
        sets_hz, bit_rate = known.rates(now_s)
        entries = self._entries(vehicle)
        newest = entries[-1].item if entries else None
        status = known.status
        if status is not None and not self._is_of_now(vehicle, status.session):
            status = None
        trouble = "" if cache is None else "; ".join(t for t in (cache.link_error, cache.doubt(vehicle)) if t)
        return VehicleReport(
            vehicle,
            0 if newest is None else newest.session,
            None if newest is None else newest.frame,
            None if cache is None or newest is None else cache.age_of(newest),
            now_s - known.at_s,
            sets_hz,
            bit_rate,
            status,
            trouble,
        )

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        """Asked over the session that listens, at the endpoint where the aircraft is received best."""
        endpoint, cache = self._of(feature_set.vehicle)
        if endpoint.startswith(SCHEME):
            raise LinkError("clicks on the page are not measured through the autopilot's radio")
        if cache is None:
            raise LinkError(NO_ANSWER)
        found = cache.ask_measured(feature_set.vehicle, feature_set.frame, uv_px)
        if found is None or found.session != feature_set.session or found.clicked is None:
            raise LinkError(NOT_TRIED)
        return found

    def unfollowed(self, vehicle: str) -> str:
        """The reason from the way by which it is received, or from what it reports of itself."""
        endpoint, cache = self._of(vehicle)
        if cache is None:
            return f"no vehicle {vehicle!r} is known here"
        if endpoint.startswith(SCHEME):
            return "nothing can be followed through the autopilot's radio"
        with self._lock:
            known = self._received.get(vehicle)
        if known is not None and known.status is not None and not known.status.follows:
            return (
                f"{vehicle} does not follow things: for its next flight set tracks.enabled = true in its configuration"
            )
        return ""

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        """Asked of the aircraft, at the endpoint where it is received best."""
        if reason := self.unfollowed(vehicle):
            raise LinkError(reason)
        endpoint, _ = self._of(vehicle)
        with TrackLink(endpoint, vehicle, self._tls) as link:
            return link.ask(request)

    def unlooked(self, vehicle: str) -> str:
        """The reason from the way by which it is received, or from what it reports of itself."""
        endpoint, cache = self._of(vehicle)
        if cache is None:
            return f"no vehicle {vehicle!r} is known here"
        if endpoint.startswith(SCHEME):
            return "no camera is turned through the autopilot's radio"
        if self._tls is None:
            return WITHOUT_TLS
        with self._lock:
            known = self._received.get(vehicle)
        if known is not None and known.status is not None and not known.status.looks:
            return f"no one may have the camera of {vehicle} look anywhere: its link.pointers is empty"
        return ""

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        """Asked of the aircraft, at the endpoint where it is received best."""
        if reason := self.unlooked(vehicle):
            raise LinkError(reason)
        endpoint, _ = self._of(vehicle)
        with LookLink(endpoint, vehicle, self._tls) as link:
            return link.put(request)

    def damage(self) -> list[str]:
        """Links that cannot be opened again, and how much came that was no set."""
        lines = []
        for endpoint, cache in self._caches.items():
            if cache.link_error:
                lines.append(f"{endpoint}: {cache.link_error}")
            lines += [f"{endpoint}: {line}" for line in cache.dropped.lines()]
        if self._journal is not None and self._journal.error:
            lines.append(self._journal.error)
        if not self._reading.report().is_well:
            lines.append(f"the journal of the link could not be read: {self._reading.report().last_error}")
        lines += self._pictures.dropped.lines()
        return lines

    def no_pictures(self) -> str:
        """The advice once sets have come for a while and no picture among them."""
        rows = [row for vehicle in self.vehicles() for row in self.frames(vehicle, SILENT_SETS)]
        if len(rows) < SILENT_SETS or any(row.has_picture for row in rows):
            return ""
        return (
            "no pictures come over the link: set picture.enabled = true on the aircraft, or give this machine the "
            "downlink's video with --video"
        )

    def close(self) -> None:
        """Leave every link."""
        self._refill.close()
        if self._journal is not None:
            self._journal.close()
        for cache in self._caches.values():
            cache.close()

    def _read_journal(self, thread: SupervisedThread) -> None:
        """Take what earlier runs of this server received in the last hour, the newest file first."""
        views = {view.payload.topic.encoding: view for view in self.views}
        for _, age_s, messages in () if self._journal is None else self._journal.recent(HISTORY_S):
            counts: dict[str, int] = {}
            for key, encoding, payload, came_ns in messages:
                if encoding == PICTURE.encoding:
                    self._pictures.take(key, payload)
                    continue
                if (view := views.get(encoding)) is not None:
                    view.take(key, payload, came_ns)
                    continue
                try:
                    found = read_set(key, payload)
                except (WireError, ValueError):
                    continue  # the recorder that wrote the journal has counted it
                for cache in self._caches.values():  # the endpoint at which it will be received is not known yet
                    cache.bring_in(found)
                counts[found.vehicle] = counts.get(found.vehicle, 0) + 1
            for vehicle, count in counts.items():
                self._brought(vehicle, count, age_s)
        thread.end()  # finished

    def _brought(self, vehicle: str, count: int, age_s: float) -> None:
        """So many sets of before are there now; the vehicle was last received at least that long ago."""
        with self._lock:
            is_new = vehicle not in self._received
            known = self._received.of(vehicle)
            known.version += count
            known.at_s = time.monotonic() - age_s if is_new else known.at_s

    def _newest(self, vehicle: str) -> tuple[int, float] | None:
        entries = self._entries(vehicle)
        age_s = None if not entries else self.age_s(entries[-1].item)
        # What was read of the journal is no sign that the aircraft is there.
        return None if age_s is None else (entries[-1].item.session, entries[-1].capture_unix_ns / 1e9)

    def _has(self, vehicle: str, unix_s: float, within_s: float) -> bool:
        entries = self._entries(vehicle)
        at = bisect_left(entries, (unix_s - within_s) * 1e9, key=lambda entry: entry.capture_unix_ns)
        return at < len(entries) and entries[at].capture_unix_ns <= (unix_s + within_s) * 1e9

    def _ask_at(self, vehicle: str, unix_s: float) -> FeatureSet | None:
        _, cache = self._of(vehicle)
        try:
            found = None if cache is None else cache.ask_at(vehicle, unix_s)
        except (LinkError, WireError):
            return None
        if found is not None and cache is not None:
            cache.bring_in(found)
            since = sum(entry.frame >= found.frame for entry in self._entries(vehicle))
            with self._lock:
                self._received.of(vehicle).version += max(since, 1)
        return found

    def _of(self, vehicle: str) -> tuple[str, SetCache | None]:
        """The endpoint at which a vehicle is received best, and its sets."""
        with_it = [(e, c) for e, c in self._caches.items() if vehicle in c.vehicles]
        return (
            max(with_it, key=lambda pair: len(pair[1].entries(vehicle)))
            if len(with_it) > 1
            else next(iter(with_it), ("", None))
        )

    def _note_set(self, feature_set: FeatureSet, size: int) -> None:
        now_s = time.monotonic()
        with self._lock:
            known = self._received.of(feature_set.vehicle)
            known.version += 1
            known.at_s = now_s
            known.sets.append((now_s, size))

    def _note_picture(self, key: str, payload: bytes) -> None:
        picture = self._pictures.take(key, payload)
        if picture is None:
            return
        since = sum(e.frame >= picture.frame for e in self._entries(picture.vehicle))
        with self._lock:
            known = self._received.of(picture.vehicle)
            known.version += max(since, 1)
            known.at_s = time.monotonic()

    def _entries(self, vehicle: str) -> list[Entry[FeatureSet]]:
        _, cache = self._of(vehicle)
        return [] if cache is None else cache.entries(vehicle)

    def _note_status(self, key: str, payload: bytes) -> None:
        try:
            vehicle, status = read_status(key, payload)
        except (WireError, ValueError):
            return
        with self._lock:
            known = self._received.of(vehicle)
            known.status, known.at_s = status, time.monotonic()

    def _is_of_now(self, vehicle: str, session: int) -> bool:
        """Return whether what states this session is of the one that runs, wherever the vehicle is received."""
        return all(cache.is_of_now(vehicle, session) for cache in self._caches.values() if vehicle in cache.vehicles)

    def _ask(self, endpoint: str, vehicle: str, frame: int) -> FeatureSet | None:
        """The aircraft's own set of a frame; what it does not have is not asked for again at once.

        One question for a picture is under way at a time, and whoever else wants it gets the same answer.
        """
        key = (vehicle, frame)
        with self._lock:
            at_s, found = self._asked.get(key, (-math.inf, None))
            if found is not None or time.monotonic() - at_s < ASK_AGAIN_S:
                return found
            under_way = self._under_way.get(key)
            if under_way is None:
                answered = self._under_way[key] = threading.Event()
        if under_way is not None:
            under_way.wait(ASKED_WITHIN_S)
            with self._lock:
                return self._asked.get(key, (0.0, None))[1]
        try:
            reply = inquire(endpoint, vehicle, frame=frame, tls=self._tls).get(vehicle)
            found = reply.answer if reply is not None and isinstance(reply.answer, FeatureSet) else None
        except (LinkError, WireError):
            found = None
        finally:
            with self._lock:
                self._asked[key] = time.monotonic(), found
                while len(self._asked) > ASKED_KEPT:
                    self._asked.popitem(last=False)
                del self._under_way[key]
            answered.set()
        return found
