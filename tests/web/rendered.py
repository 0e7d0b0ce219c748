"""A long flight for little: sets as a camera makes them that looks down on its way north, and rendered pictures."""

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.errors import LinkError
from contract.feature_set import FeatureSet, Status
from contract.look import AskCircle, AskLook, Circle, ConfirmLook, EndLook, LookRequest, Offer
from contract.track import MOST_TRACKS, StartTrack, StopTrack, TrackRequest
from contract.vehicle_status import VehicleStatus
from ground.unmeasured import NOT_TRIED
from ground.web.source import FrameRow, Picture, VehicleReport, Views
from onboard.events.types import Frame
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set

VEHICLE = "uav-1"
STEP_S = 1.0
STEP_DEG = 5.0 / 111_320.0  # on its way north, from picture to picture
DOWN = np.diag([1.0, -1.0, -1.0])


def rendered_set(frame: int) -> FeatureSet:
    first = plain_set(120, seed=frame % 50)
    return replace(
        first,
        vehicle=VEHICLE,
        frame=frame,
        revision=0,
        capture_unix_ns=first.capture_unix_ns + round(frame * STEP_S * 1e9),
        camera_lat_deg=first.camera_lat_deg + frame * STEP_DEG,
        R_enu_cam=DOWN,
    )


@lru_cache(maxsize=50)
def rendered_picture(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(40, 220, (12, 16), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC), np.uint8)


def record_rendered(path: Path, pictures: int = 12) -> None:
    """A recording of the first pictures, with them."""
    with SessionRecorder(path, VEHICLE, pictures="jpeg") as out:
        for frame in range(pictures):
            made = rendered_set(frame)
            out.write_event(Frame(made.capture_unix_ns, frame, rendered_picture(frame)))
            out.write_set(made)


def not_measured(feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
    raise LinkError(NOT_TRIED)


class FlyingSource:
    """Aircraft on a link, as fast as a test wants: `fly_to` is how many pictures have come of each. Serves `Source`.

    `silent_s`: for how long nothing has been received of all of them; `status_age_s`: how much older than their newest
    picture their status is.
    """

    is_live = True
    measures = True
    name = "a drawn flight"

    def __init__(self, aircraft: int = 1) -> None:
        self._names = [f"uav-{k}" for k in range(1, aircraft + 1)]
        self.silent_s = 0.1
        self.status_age_s = 0.1
        self._count = 1
        self.views = Views()
        self.asked: list[TrackRequest] = []
        self._followed = 0
        self.why_unfollowed = self.why_unlooked = ""
        self.looked: list[LookRequest] = []
        self.look_refusal = ""  # of the next confirmation
        self.may_circle = False
        self.look_words = ""  # what the aircraft reports of who had it look where
        self.heat = ""  # what it reports of a second camera
        self.measure: Callable[[FeatureSet, tuple[float, float]], FeatureSet] = not_measured
        self._lock = threading.Lock()
        self._first = rendered_set(0)
        self._encoded = [cv2.imencode(".jpg", rendered_picture(seed))[1].tobytes() for seed in range(50)]

    def fly_to(self, count: int) -> None:
        with self._lock:
            self._count = count

    def vehicles(self) -> list[str]:
        return sorted(self._names)

    def version(self, vehicle: str) -> int:
        return self._count

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        first = self._first
        step_ns = round(STEP_S * 1e9)
        return [
            FrameRow(first.session, k, 0, first.capture_unix_ns + k * step_ns, Status.OK, True)
            for k in range(0 if newest is None else max(self._count - newest, 0), self._count)
        ]

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        if frame >= self._count:
            return None
        made, column = rendered_set(frame), int(vehicle.rpartition("-")[2]) - 1
        return replace(made, vehicle=vehicle, camera_lon_deg=made.camera_lon_deg + 4e-4 * column)

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        return Picture(self._encoded[frame % 50], "image/jpeg") if frame < self._count else None

    def age_s(self, feature_set: FeatureSet) -> float | None:
        return (self._count - 1 - feature_set.frame) * STEP_S + self.silent_s

    def report(self, vehicle: str) -> VehicleReport:
        shares = {"mount": 60, "gps": 21}
        unix_s = self._first.capture_unix_ns / 1e9 + (self._count - 1) * STEP_S - self.status_age_s
        status = VehicleStatus(
            unix_s, self._first.session, "ok",
            tracks=120, cpu_c=61.0, shares=shares, look=self.look_words, heat=self.heat,
            fix=6, satellites=17, battery_percent=64, battery_v=22.1, mode="AUTO",
        )  # fmt: skip
        return VehicleReport(
            vehicle, self._first.session, self._count - 1, self.silent_s, self.silent_s, 1.0, 9000.0, status
        )

    def no_pictures(self) -> str:
        return ""

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        return self.measure(feature_set, uv_px)

    def unfollowed(self, vehicle: str) -> str:
        return self.why_unfollowed

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        """As an aircraft: numbers from 1, eight at most."""
        self.asked.append(request)
        if isinstance(request, StopTrack):
            return {"tracks": []}
        if self._followed >= MOST_TRACKS:
            raise LinkError("full: eight things are followed already")
        self._followed += 1
        return {"track": self._followed, "frame": request.frame if isinstance(request, StartTrack) else None}

    def unlooked(self, vehicle: str) -> str:
        return self.why_unlooked

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        """As an aircraft 520 m above the sea that finds the place where it was asked for, at 400 m."""
        self.looked.append(request)
        if isinstance(request, AskLook):
            offer = Offer("0123456789abcdef", request.lat_deg, request.lon_deg, 400.0, request.radius_m, 1.0)
            return cast(dict[str, Any], json.loads(offer.to_json()))
        if isinstance(request, AskCircle):
            offer = Offer("fedcba9876543210", 47.0, 8.0, 400.0, 3.0, 2.0, Circle(120.0, 520.0, 120.0))
            return cast(dict[str, Any], json.loads(offer.to_json()))
        if self.look_refusal:
            raise LinkError(self.look_refusal)
        is_circle = isinstance(request, ConfirmLook) and request.ticket.startswith("fedc")
        at = "circling 47.00000 8.00000 at 520 m, radius 120 m" if is_circle else "at 47.00000 8.00000, 400 m"
        self.look_words = f"anna: {'ahead' if isinstance(request, EndLook) else at}: accepted"
        return {"result": "accepted"} | ({"may_circle": True} if self.may_circle and not is_circle else {})

    def damage(self) -> list[str]:
        return []

    def close(self) -> None:
        """Nothing is held."""
