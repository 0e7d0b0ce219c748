"""The answer to a query: a set or a refusal, and with it how old that is and why there is nothing newer.

Pure logic, time is passed in. docs/wire-format.md, section 8.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

from contract.errors import WireError
from contract.feature_set import FeatureSet, Status
from contract.history import Entry, History
from contract.stated_values import number_or_nan
from contract.topics import ANSWER_TIMEOUT_S
from contract.vehicle_status import VehicleStatus, decode_status
from onboard.link.pending_pictures import PendingPictures

WELL = "ok"
MOST_PATIENCE_S = 30.0
MOST_PX = 65535.0  # that a picture has
PENDING = "placing pictures"
# States of the daemon in which a missing first set is the camera's fault.
CAMERA_STATES = ("camera lost", "camera silent", "camera frozen")


# Measures a pixel of the set of a payload and calls the function with the set and what became of it, or with None, from
# any thread; False if it does not take the question: then nothing is called.
Measure = Callable[[bytes, tuple[float, float], Callable[[FeatureSet | None], object]], bool]


def not_measured(payload: bytes, uv_px: tuple[float, float], done: Callable[[FeatureSet | None], object]) -> bool:
    """Answer for an aircraft that keeps no pictures."""
    return False


@dataclass(frozen=True)
class Answer:
    """The answer to a query: `payload` is a set, or with `is_error` a refusal as JSON. `about` goes with a set, as
    JSON.
    """

    payload: bytes
    about: bytes = b""
    is_error: bool = False

    def __len__(self) -> int:
        return len(self.payload) + len(self.about)


@dataclass(frozen=True)
class Question:
    """A query's parameters as they came, and CLOCK_MONOTONIC (ns) when it did: ages are those of then."""

    frame: str | None
    unix_s: str | None
    monotonic_ns: int
    u: str | None = None
    v: str | None = None

    @property
    def frame_number(self) -> int | None:
        """The picture asked for by its number; None without one, and for what is none."""
        text = self.frame
        is_number = text is not None and text.isascii() and text.isdecimal() and len(text) <= 10
        return int(text) if is_number and text is not None else None

    @property
    def time_s(self) -> float | None:
        """The time asked for; None without one, and for what is none."""
        unix_s = math.nan if self.unix_s is None else number_or_nan(self.unix_s)
        return unix_s if math.isfinite(unix_s) else None

    @property
    def pixel(self) -> tuple[float, float] | None:
        """The pixel that is to be measured; None without one, and for what is none."""
        if self.u is None or self.v is None:
            return None
        u, v = number_or_nan(self.u), number_or_nan(self.v)
        return (u, v) if -0.5 <= u <= MOST_PX and -0.5 <= v <= MOST_PX else None

    def pending(self, history: History[bytes], pictures: PendingPictures) -> int | None:
        """The picture that is asked for, if it was taken and has no set yet, nor another in its place has."""
        if self.frame is not None:
            frame = self.frame_number
            return frame if frame is not None and frame in pictures else None
        if self.time_s is None or history.nearest_entry(self.time_s) is not None:
            return None
        return pictures.nearest(self.time_s)


class SetClock:
    """The clock of the capture times at any moment, from what has been seen of it: CLOCK_MONOTONIC plus a constant.

    Nothing arrives before it happened, so each event's arrival gives a lower bound of the time; the greatest difference
    counts. Without events the captures of the sets stand in, which come later by what a solution takes.
    """

    def __init__(self) -> None:
        self._arrivals_ns: int | None = None
        self._captures_ns: int | None = None
        self._session = -1

    def arrived(self, arrival_ns: int, monotonic_ns: int) -> None:
        """An event that arrived at `arrival_ns` on the session's clock is known of now."""
        self._arrivals_ns = _greater(self._arrivals_ns, arrival_ns - monotonic_ns)

    def captured(self, session: int, capture_unix_ns: int, monotonic_ns: int) -> None:
        """A set of a picture is known of now."""
        held_ns = self._captures_ns if session == self._session else None
        self._captures_ns, self._session = _greater(held_ns, capture_unix_ns - monotonic_ns), session

    def age_s(self, capture_unix_ns: int, monotonic_ns: int) -> float | None:
        """Return how long ago a picture was taken; None while nothing is known of the clock."""
        offset_ns = self._captures_ns if self._arrivals_ns is None else self._arrivals_ns
        return None if offset_ns is None else max((monotonic_ns + offset_ns - capture_unix_ns) / 1e9, 0.0)

    def age_text(self, capture_unix_ns: int, monotonic_ns: int) -> bytes | None:
        """The age as it goes with every set that is sent, in a few bytes; None if it is not known."""
        age_s = self.age_s(capture_unix_ns, monotonic_ns)
        return None if age_s is None else f"{age_s:.2f}".encode()


def answer(history: History[bytes], asked: Question, vehicle: str, status: bytes, clock: SetClock) -> Answer:
    """The answer to a query. `status` is the last one's encoding."""
    now = _state(status)
    later: Entry[bytes] | None = None
    found: Entry[bytes] | None = None
    if asked.frame is not None:
        found = None if asked.frame_number is None else history.entry(asked.frame_number)
    elif asked.unix_s is not None:
        found = None if asked.time_s is None else history.nearest_entry(asked.time_s)
    else:
        found, later = history.newest_entry(), history.newest_picture()
        if found is None:
            is_blind = now is not None and now.state in CAMERA_STATES
            return refusal(Status.CAMERA_LOST if is_blind else Status.STARTING, vehicle, now)
    if found is None:
        return refusal(Status.UNKNOWN_FRAME, vehicle)
    about = _aged(found, clock, asked.monotonic_ns)
    if later is not None and later is not found:
        about["newest"] = {"frame": later.frame, "status": later.status.value} | _aged(later, clock, asked.monotonic_ns)
    return Answer(found.item, _json(about | _daemon_state(now)))


def not_placed(vehicle: str, frame: int) -> Answer:
    """The refusal of a picture that still has no set when its ground waits no longer."""
    pending: dict[str, object] = {"status": Status.UNKNOWN_FRAME.value, "vehicle": vehicle, "state": PENDING}
    return Answer(_json(pending | {"reason": f"picture {frame} has no set yet: ask again"}), is_error=True)


def patience_s(stated: str | None) -> float:
    """Return how long a ground waits for its answer, s, as it states itself; not without limit."""
    seconds = math.nan if stated is None else number_or_nan(stated)
    return min(max(seconds, 0.0), MOST_PATIENCE_S) if math.isfinite(seconds) else ANSWER_TIMEOUT_S


def refusal(status: Status, vehicle: str, now: VehicleStatus | None = None) -> Answer:
    """Return the reason why there is no set, with the daemon's own state where that states more."""
    return Answer(_json({"status": status.value, "vehicle": vehicle} | _daemon_state(now)), is_error=True)


def _aged(entry: Entry[bytes], clock: SetClock, monotonic_ns: int) -> dict[str, object]:
    age_s = clock.age_s(entry.capture_unix_ns, monotonic_ns)
    return {} if age_s is None else {"age_s": round(age_s, 3)}


def _daemon_state(now: VehicleStatus | None) -> dict[str, object]:
    """The daemon's state, if there is anything to report."""
    return {} if now is None or now.state == WELL else {"state": now.state, "reason": now.reason}


def _greater(held: int | None, new: int) -> int:
    return new if held is None else max(held, new)


def _state(status: bytes) -> VehicleStatus | None:
    try:
        return decode_status(status)
    except WireError:
        return None  # none has been published yet


def _json(content: dict[str, object]) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode() if content else b""
