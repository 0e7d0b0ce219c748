"""A recorded session as a page's source: the sets of `ground.recording` and the pictures stored with them."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contract.errors import InputError, LinkError
from contract.feature_set import FeatureSet
from contract.look import LookRequest
from contract.recorded_pictures import PictureIndex
from contract.track import TrackRequest
from contract.vehicle_status import VehicleStatus
from contract.wire.message import STATUSES
from ground.recorded_link_pictures import RecordedLinkPictures
from ground.recording import Recording
from ground.web.recorded_pictures import picture_of
from ground.web.source import FrameRow, Picture, VehicleReport, Views

if TYPE_CHECKING:
    from ground.recording_server import RecordingServer

KEPT_SETS = 256
UNMEASURED = "a recording: its clicks are answered between measured points"


class RecordedSource:
    """Raises InputError for what is no recording. `measure_by` has its clicks measured."""

    is_live = False
    measures = False

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._recording = Recording(path)
        self._pictures = PictureIndex(path)
        self._link_pictures = RecordedLinkPictures(path)  # of `pc-ground record`
        self._server: RecordingServer | None = None
        self._lock = threading.Lock()  # the recording's maps are read by many requests at once
        self._unreadable: list[str] = []
        self._sessions = {vehicle: self._session_of(vehicle) for vehicle in self._recording.vehicles}
        self._with_picture: dict[str, frozenset[int]] = {}
        self.views = Views()
        for view in self.views:
            view.read(self._recording, self._recording.vehicles)
        self._statuses = {vehicle: self._last_status(vehicle) for vehicle in self._recording.vehicles}
        self._kept = lru_cache(maxsize=KEPT_SETS)(self._read)

    def vehicles(self) -> list[str]:
        return self._recording.vehicles

    def version(self, vehicle: str) -> int:
        return 0

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        """Every picture that has a set."""
        session = self._sessions[vehicle]
        rows = self._recording.rows(vehicle)
        came = self._came(vehicle)
        return [
            FrameRow(session, frame, revision, capture_ns, status, frame in came or self._pictures.has(vehicle, frame))
            for frame, revision, capture_ns, status in (rows if newest is None else rows[-newest:])
        ]

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        """The set as recorded; a damaged one counts as none, and `damage` reports it."""
        if vehicle not in self._sessions or (session is not None and session != self._sessions[vehicle]):
            return None
        with self._lock:
            return self._kept(vehicle, frame)

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        """The picture as recorded on board, or else as it crossed the link."""
        if vehicle not in self._sessions or (session is not None and session != self._sessions[vehicle]):
            return None
        message = self._pictures.message(vehicle, frame)
        if message is not None and (found := picture_of(message)) is not None:
            return found
        came = self._link_pictures.picture(vehicle, self._sessions[vehicle], frame)
        return None if came is None else Picture(came.content, came.media_type)

    def _came(self, vehicle: str) -> frozenset[int]:
        """The frames whose picture crossed the link whole."""
        if vehicle not in self._with_picture:
            self._with_picture[vehicle] = frozenset(self._link_pictures.frames(vehicle, self._sessions[vehicle]))
        return self._with_picture[vehicle]

    def age_s(self, feature_set: FeatureSet) -> float | None:
        return self._recording.age_s(feature_set)

    def report(self, vehicle: str) -> VehicleReport:
        """The state of a vehicle at the end of the recording."""
        rows = self._recording.rows(vehicle)
        newest = max(rows, key=lambda row: row[2])
        return VehicleReport(
            vehicle, self._sessions[vehicle], newest[0], 0.0, None, None, None, self._statuses[vehicle]
        )

    def measure_by(self, server: RecordingServer) -> None:
        """Have clicked pixels measured by a server of this recording, which ends with this source."""
        self._server, self.measures = server, True

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        """Measured in the recording's pictures."""
        if self._server is None:
            raise LinkError(UNMEASURED)
        return self._server.measured(feature_set, uv_px)

    def unfollowed(self, vehicle: str) -> str:
        return (
            "a recording: what was followed in flight is shown; to follow more in its pictures: "
            "pc-onboard replay SESSION.mcap --track FRAME,U,V"
        )

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        """Raises LinkError, always."""
        raise LinkError(self.unfollowed(vehicle))

    def unlooked(self, vehicle: str) -> str:
        return "a recording: no camera is there to be turned"

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        """Raises LinkError, always."""
        raise LinkError(self.unlooked(vehicle))

    def damage(self) -> list[str]:
        """The damaged places of files, and the sets that cannot be read."""
        return [*self._recording.damage, *self._unreadable]

    def no_pictures(self) -> str:
        """A recording has them or not."""
        if any(self._pictures.has_any(vehicle) or self._came(vehicle) for vehicle in self.vehicles()):
            return ""
        return (
            'the recording holds no pictures (recording.pictures = "none"): give the video of the flight by --video, '
            "or open the video or the photographs: pc-ground open FILE"
        )

    def has_own_pictures(self) -> bool:
        """Return whether it holds pictures as the pipeline had them: clicked pixels can be measured in these."""
        return any(self._pictures.has_any(vehicle) for vehicle in self.vehicles())

    def close(self) -> None:
        """End what measures; the files are closed with the object."""
        if self._server is not None:
            self._server.close()

    def _session_of(self, vehicle: str) -> int:
        """All sets of a recording are of one session."""
        for frame in self._recording.frames(vehicle):
            found = self._read(vehicle, frame)
            if found is not None:
                return found.session
        raise InputError(f"recording {self.name}: no set of {vehicle} can be read")

    def _last_status(self, vehicle: str) -> VehicleStatus | None:
        """The last status of a vehicle, with the last error budget that any has; None without one."""
        statuses = self._recording.reports(STATUSES, [vehicle])
        shares = next((status.shares for status in reversed(statuses) if status.shares), None)
        last = statuses[-1] if statuses else None
        return last if last is None or shares is None else replace(last, shares=shares)

    def _read(self, vehicle: str, frame: int) -> FeatureSet | None:
        try:
            return self._recording.by_frame(vehicle, frame)
        except InputError as error:
            if len(self._unreadable) < 100:
                self._unreadable.append(str(error))
            return None
