"""A thing that is followed: what the aircraft is asked, and what it reports. docs/wire-format.md, section 14."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import Enum

from contract.answer import CONFIDENCE, EXPLANATIONS, Place, rounded, time_utc
from contract.errors import InputError
from contract.feature_set import Status
from contract.stated_values import number_or_nan

MOST_TRACKS = 8
MOST_PX = 8190.0  # that a packet holds
MOST_REQUEST = 200  # characters
OLD_LOOK_S = 0.5  # the age of an older look is written for people


class TrackState(Enum):
    """The state of a track. Values are the words users see; order, the wire code."""

    FOLLOWED = "followed"
    COASTING = "coasting"  # not seen; where it is follows from how it moved
    LOST = "lost"  # not seen for too long: the track has ended


class Unseen(Enum):
    """The reason why a thing is not seen. Values are the words users see; order, the wire code."""

    NONE = ""
    HIDDEN = "hidden"  # it is not where it should be
    OFF_PICTURE = "off the picture"
    NO_GROUND = "ground not followed"  # how the ground moves could not be seen
    NO_PICTURE = "no picture"  # none has come for a while
    NO_REPORT = "no report"  # the ground has received none for a while


# One sigma of a speed, or half of a speed, above which a walker could not be distinguished from one at rest.
REST_M_S = 0.5


@dataclass(frozen=True)
class Course:
    """Speed over the ground, m/s, and course, degrees clockwise from north; one sigma of each.

    A thing at rest, and one that may be, has no course: both its figures are None.
    """

    speed_m_s: float
    sigma_speed_m_s: float
    course_deg: float | None = None
    sigma_course_deg: float | None = None

    @property
    def is_moving(self) -> bool:
        return self.course_deg is not None

    def to_text(self) -> str:
        """The speed and course in words."""
        if self.course_deg is None or self.sigma_course_deg is None:
            is_slow = self.speed_m_s + 2.0 * self.sigma_speed_m_s <= 2.0 * REST_M_S
            words = "at rest" if is_slow else "may move"
            return f"{words} (+-{self.sigma_speed_m_s:.2f} m/s)"
        return (
            f"{self.speed_m_s:.1f} +-{self.sigma_speed_m_s:.1f} m/s towards {self.course_deg:.0f} "
            f"+-{self.sigma_course_deg:.0f} deg"
        )

    def to_dict(self) -> dict[str, object]:
        return {
            "is_moving": self.is_moving, "speed_m_s": rounded(self.speed_m_s),
            "sigma_speed_m_s": rounded(self.sigma_speed_m_s), "course_deg": rounded(self.course_deg),
            "sigma_course_deg": rounded(self.sigma_course_deg),
        }  # fmt: skip


@dataclass(frozen=True)
class TrackReport:
    """A track at a moment, `capture_unix_ns`: its place and ellipse are for then. `unseen_s` before it was seen last.

    `u_px`, `v_px`: the thing's middle in the picture `frame`, `size_px` how large it is. Without a place `status`
    states why, in the words of a refused click; without a course nothing is known of it yet.
    """

    number: int
    state: TrackState
    unseen: Unseen
    session: int
    frame: int
    capture_unix_ns: int
    u_px: float
    v_px: float
    size_px: float
    status: Status = Status.STARTING
    place: Place | None = None
    course: Course | None = None
    vehicle: str = ""
    unseen_s: float = 0.0

    @property
    def seen_unix_ns(self) -> int:
        return self.capture_unix_ns - round(self.unseen_s * 1e9)

    def to_json(self) -> str:
        """One line."""
        p, c = self.place, self.course
        content: dict[str, object] = {
            "track": self.number, "state": self.state.value, "unseen": self.unseen.value or None,
            "unseen_s": round(self.unseen_s, 2),
            "vehicle": self.vehicle or None, "frame": self.frame, "time_utc": time_utc(self.capture_unix_ns),
            "u": round(self.u_px, 2), "v": round(self.v_px, 2), "size_px": round(self.size_px, 1),
            "status": self.status.value,
        }  # fmt: skip
        if p is not None:
            content |= p.to_dict()
        if c is not None:
            content |= c.to_dict()
        return json.dumps(content)

    def to_text(self) -> str:
        """One line for people."""
        p = self.place
        if p is None:
            where = f"{self.status.value}: {EXPLANATIONS[self.status]}"
        else:
            e = p.ellipse
            where = (
                f"{e.rounded(p.lat_deg, p.lon_deg)}  {CONFIDENCE:.0%} ellipse {e.semi_major_m:.1f} x "
                f"{e.semi_minor_m:.1f} m at {e.azimuth_deg:.0f} deg"
            )
        return (
            f"track {self.number} {self.state_text}  {where}  {self.course_text}  at {time_utc(self.capture_unix_ns)}"
        )

    @property
    def state_text(self) -> str:
        """Its state in words, the reason why it is not seen, and how long ago it was."""
        ago = f", seen {self.unseen_s:.1f} s ago" if self.unseen_s >= OLD_LOOK_S else ""
        return self.state.value + (f" ({self.unseen.value})" if self.unseen.value else "") + ago

    @property
    def course_text(self) -> str:
        """The course in words; "speed not known" without one."""
        return "speed not known" if self.course is None else self.course.to_text()


@dataclass(frozen=True)
class StartTrack:
    """Follow what is at a pixel of a picture; `frame` None: the newest."""

    u_px: float
    v_px: float
    frame: int | None = None


@dataclass(frozen=True)
class StopTrack:
    """Follow it no longer."""

    number: int


@dataclass(frozen=True)
class ListTracks:
    """A request for the list of all tracks."""


TrackRequest = StartTrack | StopTrack | ListTracks


def parameters_of(request: TrackRequest) -> str:
    """A request as a query's parameters."""
    if isinstance(request, StartTrack):
        frame = "" if request.frame is None else f";frame={request.frame}"
        return f"u={request.u_px!r};v={request.v_px!r}{frame}"
    return f"stop={request.number}" if isinstance(request, StopTrack) else ""


def read_request(text: str) -> TrackRequest:
    """Read the request out of a query's parameters. Raises InputError in one line for anything else."""
    if len(text) > MOST_REQUEST:
        raise InputError(f"more than {MOST_REQUEST} characters")
    pairs = [part.partition("=")[::2] for part in text.split(";") if part]
    parameters = dict(pairs)
    given = set(parameters)
    if len(parameters) < len(pairs):
        raise InputError("something is given twice")
    if not given:
        return ListTracks()
    if given == {"stop"}:
        return StopTrack(_whole(parameters["stop"], "stop", 255))
    if given not in ({"u", "v"}, {"u", "v", "frame"}):
        raise InputError("a track is asked for with u, v and perhaps frame; ended with stop; listed without parameters")
    frame = parameters.get("frame")
    u, v = (_pixel(parameters[key], key) for key in ("u", "v"))
    return StartTrack(u, v, None if frame is None else _whole(frame, "frame", 2**32 - 1))


def refused(status: str, reason: str) -> bytes:
    """The answer to a request that is not done: a word for programs, a sentence for people."""
    return json.dumps({"status": status, "reason": reason}, separators=(",", ":")).encode()


def _whole(text: str, what: str, most: int) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 10 and int(text) <= most):
        raise InputError(f"{what}: not a whole number from 0 to {most}")
    return int(text)


def _pixel(text: str, what: str) -> float:
    value = number_or_nan(text) if len(text) <= 32 else math.nan
    if not -0.5 <= value <= MOST_PX:
        raise InputError(f"{what}: not a pixel")
    return value
