"""Sources of a page's pictures and sets: one interface for what is received and for what was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from contract.feature_set import FeatureSet, Status
from contract.look import LookRequest
from contract.track import TrackRequest
from contract.vehicle_status import VehicleStatus
from ground.report_view import ReportView
from ground.spots.received import ReceivedSpots
from ground.track_paths import TrackPaths

T = TypeVar("T")

# Of the pictures that came since a list was read: some before them are read again, for sets may come out of order or in
# a better revision; where more have come, as when a journal was read, the whole list is.
SPARE_ROWS, MOST_ROWS = 8, 500


@dataclass(frozen=True)
class FrameRow:
    """One picture of which a set is there, by what a list of pictures needs."""

    session: int
    frame: int
    revision: int
    capture_unix_ns: int
    status: Status
    has_picture: bool


@dataclass(frozen=True)
class Picture:
    """An encoded picture and its media type; of any size, for a click is scaled to the camera's."""

    content: bytes
    media_type: str
    is_unchanging: bool = True  # the same whenever it is asked for again; a video's frame is another with another delay


@dataclass(frozen=True)
class VehicleReport:
    """State of a vehicle. Ages are in seconds, None if nothing was received; in a recording they count from its end."""

    vehicle: str
    session: int
    newest_frame: int | None
    picture_age_s: float | None  # since the newest known picture was taken
    received_age_s: float | None  # since anything was received
    sets_hz: float | None  # received recently; None: not a link
    bit_rate: float | None  # payload received recently, bit/s
    status: VehicleStatus | None  # its own report, the newest
    trouble: str = ""  # what is wrong at this end


class PageView(Protocol[T]):
    """A view whose news go to browsers."""

    @property
    def version(self) -> int: ...

    def since(self, version: int) -> tuple[int, list[T] | None]:
        """The version now, and what is new or has changed since another; None in its place where that is too much."""


@dataclass(frozen=True)
class Views:
    """The page's views of reports, each by its topic's name."""

    tracks: TrackPaths = field(default_factory=TrackPaths)
    spots: ReceivedSpots = field(default_factory=ReceivedSpots)

    def __iter__(self) -> Iterator[ReportView[Any]]:
        return iter(vars(self).values())


class Source(Protocol):
    """Thread-safe. Vehicles are named as on the link."""

    is_live: bool
    measures: bool  # it may be asked to measure a pixel
    name: str  # for people: endpoints, or the recording's path
    views: Views  # of all vehicles' reports

    def vehicles(self) -> list[str]:
        """The names of the vehicles that are there, sorted."""

    def version(self, vehicle: str) -> int:
        """A number that grows whenever the pictures or sets of a vehicle change."""

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        """The pictures of the session that runs, in capture order; only so many of the newest, if a number is given."""

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        """The set of a picture at its latest revision; None if there is none. No session: the one that runs."""

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        """The picture itself; None if it is not there.

        Every source of pictures (the recording, keyframes on the link, a video of the downlink) is asked here and
        nowhere else, and `FrameRow.has_picture` states whether to ask. It may be asked from several threads.
        """

    def age_s(self, feature_set: FeatureSet) -> float | None:
        """Seconds since a set's picture was taken; of a recording, until its newest one was."""

    def report(self, vehicle: str) -> VehicleReport:
        """The state of a vehicle."""

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        """Ask the aircraft, or who holds the recording, to measure a pixel by itself; the set with what became of it.

        Takes ANSWER_TIMEOUT_S at most. Raises LinkError with the reason, in words, if it is not asked or does not
        answer; WireError for what cannot be read.
        """

    def unfollowed(self, vehicle: str) -> str:
        """The reason why a vehicle can follow nothing that is clicked now; empty where it may be asked."""

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        """The answer of a vehicle to a question about tracks. Raises LinkError with its reason, or if it gives none."""

    def unlooked(self, vehicle: str) -> str:
        """The reason why a vehicle's camera can be sent nowhere from here; empty where it may be asked."""

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        """The answer of a vehicle to who has its camera look somewhere. Raises LinkError with its reason, or if it
        gives none.
        """

    def damage(self) -> list[str]:
        """The parts that could not be read, a line each."""

    def no_pictures(self) -> str:
        """The reason why the page has no picture, and what helps; empty where it has some, or may get some yet."""

    def close(self) -> None:
        """Close links and files."""
