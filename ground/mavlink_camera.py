"""A camera component on a ground's MAVLink network, that answers clicks from the sets that come over zenoh.

For aircraft whose own `mavlink_camera` is off. It sends as a component of the vehicle's system, through a router that
ground stations send through too, and nothing that commands anything.
"""

from __future__ import annotations

import contextlib
import json
import math
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import zenoh

from contract.errors import LinkError, WireError
from contract.feature_set import FeatureSet
from contract.geodesy import distance_m
from contract.link_config import Tls
from contract.mavlink_camera.clicks import CameraClicks
from contract.mavlink_camera.component import MavlinkCamera
from contract.mavlink_camera.messages import CameraFacts, Stream
from contract.topics import FOLLOW, TRACKS
from contract.track import refused
from ground.aircraft_clock import AGREED_S
from ground.client import SetCache, open_link, put_question
from ground.mavlink_endpoint import MavlinkEndpoint
from ground.mavlink_link import CHUNK, LOOK_S, opened_wire

FOLLOW_S = 1.5  # for the aircraft's answer whether it follows
SILENT = "the aircraft does not answer whether it follows: may this certificate?"
# An autopilot this far from where the sets have the aircraft, more than it flies in so long, is another aircraft's.
NEAR_M, LATE_S = 150.0, 5.0
CLOCK_SIGMA_S = AGREED_S / math.sqrt(3.0)  # of an aircraft's clock that counts as known: it may be off by AGREED_S


class Unlimited:
    """Serves `contract.mavlink_camera.end.Share` on a network of this machine's."""

    def wait_s(self, cost: float, now_s: float) -> float:
        return 0.0

    def take(self, cost: float, now_s: float) -> None:
        """Take what there is without end."""


@dataclass(frozen=True)
class _Position:
    """The autopilot's own position, its speed over the ground, and when it came."""

    lat_deg: float
    lon_deg: float
    speed_m_s: float
    since_s: float


@dataclass(frozen=True)
class CameraOptions:
    """The component: `system` is the vehicle's MAVLink number (None: that of the only autopilot that is received); a
    click arrives `delay_s` after its picture was taken, with one sigma of `sigma_delay_s`.
    """

    system: int | None = None
    component: int = 100
    stream: Stream | None = None
    delay_s: float = 0.5
    sigma_delay_s: float = 0.3


class GroundCamera:
    """Answers for `vehicle` at a MAVLink wire while entered.

    Raises InputError without pymavlink, LinkError where a link cannot be opened.
    """

    def __init__(
        self,
        wire: MavlinkEndpoint,
        endpoint: str,
        vehicle: str,
        *,
        tls: Tls | None = None,
        options: CameraOptions = CameraOptions(),
    ) -> None:
        self._wire, self._dialect, _ = opened_wire(wire)
        self._vehicle, self._options = vehicle, options
        self._systems: set[int] = set()
        self._mav: Any = self._dialect.MAVLink(None, srcComponent=options.component)
        self._mav.robust_parsing = True
        self._wire.mav = self._mav
        self._camera: MavlinkCamera | None = None
        self._own_place: _Position | None = None
        self.clicks = CameraClicks(vehicle, options.delay_s, math.hypot(options.sigma_delay_s, CLOCK_SIGMA_S))
        self.clicks.follow, self.clicks.stamped_ago_s = self._follow, self._stamped_ago_s
        self._link = endpoint, tls
        try:
            self._cache = SetCache(
                endpoint, vehicle, tls=tls, on_set=self._on_set, subscriptions={TRACKS.key(vehicle): self._on_tracks}
            )
        except LinkError:
            self._wire.close()
            raise

    def __enter__(self) -> Self:
        self.clicks.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.clicks.__exit__(kind, error, at)
        self._cache.close()
        self._wire.close()

    @property
    def state(self) -> str:
        """The state in a line for people."""
        system = self._its_system()
        if system is None:
            several = ", ".join(map(str, sorted(self._systems)))
            return (
                f"several vehicles are received: {several}; choose one with --system" if several else "no autopilot yet"
            )
        if self._camera is None:
            return f"system {system}: no set of {self._vehicle!r} yet{self._colon(self._cache.link_error)}"
        if away_m := self._elsewhere_m():
            return (
                f"system {system} is {away_m:.0f} m from where {self._vehicle!r} is: it is another aircraft's, and no "
                "click is answered; choose with --system or --vehicle"
            )
        contested = self._camera.complaint(time.monotonic_ns())
        doubt = "" if self._cache.is_certain(self._vehicle) else self._cache.doubt(self._vehicle)
        what = f"system {system}, component {self._options.component} answers for {self._vehicle!r}"
        return what + self._colon(contested or doubt)

    @staticmethod
    def _colon(words: str) -> str:
        return f": {words}" if words else ""

    def look(self) -> None:
        """Take and send the messages of a moment. Raises LinkError where the wire is broken."""
        try:
            self._wire.select(LOOK_S)
            data = self._wire.recv(CHUNK)
        except OSError as error:
            raise LinkError(f"the MAVLink network: {error.strerror or error}") from error
        messages = (self._mav.parse_buffer(data) or []) if data else []
        for message in messages:
            if message.get_type() == "HEARTBEAT" and message.autopilot != self._dialect.MAV_AUTOPILOT_INVALID:
                self._systems.add(message.get_srcSystem())
        system, camera = self._its_system(), self._made_camera()
        for message in messages:
            if message.get_type() == "GLOBAL_POSITION_INT" and message.get_srcSystem() == system:
                self._take_place(message)
        if system is None or camera is None or self._elsewhere_m():
            return
        for message in messages:
            camera.receive(message, system, time.monotonic_ns(), self._aircraft_now_ns())
        for message in camera.due(time.monotonic_ns()):
            self._mav.srcSystem = system
            packet = message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
            with contextlib.suppress(OSError):  # no one listens there now
                self._wire.write(bytes(packet))

    def _take_place(self, message: Any) -> None:
        if message.lat or message.lon:  # else it has none yet
            speed_m_s = math.hypot(message.vx, message.vy) / 100.0
            self._own_place = _Position(message.lat * 1e-7, message.lon * 1e-7, speed_m_s, time.monotonic())

    def _elsewhere_m(self) -> float:
        """The distance of the autopilot from where the sets have the aircraft, if it cannot be the same one; else 0."""
        own, newest = self._own_place, self._cache.newest(self._vehicle)
        age_s = None if newest is None else self._cache.age_of(newest)
        if own is None or newest is None or age_s is None or not newest.is_ok:
            return 0.0
        away_m = distance_m((newest.camera_lat_deg, newest.camera_lon_deg), (own.lat_deg, own.lon_deg))
        since_s = age_s + time.monotonic() - own.since_s + LATE_S
        return away_m if away_m > NEAR_M + own.speed_m_s * since_s else 0.0

    def _its_system(self) -> int | None:
        if self._options.system is not None:
            return self._options.system
        return next(iter(self._systems)) if len(self._systems) == 1 else None

    def _made_camera(self) -> MavlinkCamera | None:
        """The component, once a set has shown which camera it is."""
        newest = self._cache.newest(self._vehicle)
        if self._camera is None and newest is not None:
            facts = CameraFacts(
                self._dialect, self._vehicle, newest.camera, 0.0, self._options.stream, time.monotonic_ns()
            )
            self._camera = MavlinkCamera(self._options.component, facts, self.clicks, Unlimited())
        return self._camera

    def _aircraft_now_ns(self) -> int:
        """Now by the aircraft's clock (Unix ns); 0, when no picture was taken, while that is not known."""
        newest = self._cache.newest(self._vehicle)
        age_s = None if newest is None else self._cache.age_of(newest)
        if newest is None or age_s is None or not self._cache.is_certain(self._vehicle):
            return 0
        return newest.capture_unix_ns + round(age_s * 1e9)

    def _stamped_ago_s(self, unix_ns: int) -> float:
        return self._cache.stamped_ago_s(self._vehicle, unix_ns)

    def _on_set(self, found: FeatureSet, size: int) -> None:
        self.clicks.feature_set(found)

    def _on_tracks(self, key: str, payload: bytes) -> None:
        with contextlib.suppress(WireError):
            self.clicks.tracks(0, payload)

    def _follow(self, parameters: str) -> tuple[bytes, bool]:
        """Ask the aircraft: JSON, and whether it is a refusal. What cannot be read is one."""
        silent = refused("silent", SILENT), True
        try:
            session = open_link("client", *self._link)
        except LinkError:
            return silent
        try:
            for reply in put_question(session, f"{FOLLOW.key(self._vehicle)}?{parameters}", FOLLOW_S):
                payload = (reply.ok or reply.err).payload.to_bytes()
                content = json.loads(payload)
                wanted = content.get("track", 0) if reply.ok is not None else content.get("reason")
                if isinstance(wanted, int if reply.ok is not None else str):
                    return payload, reply.ok is None
        except (zenoh.ZError, ValueError, AttributeError, RecursionError):
            return silent
        finally:
            session.close()
        return silent
