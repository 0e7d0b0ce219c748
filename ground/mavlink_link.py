"""A link through autopilots' radio: packets of ours in MAVLink TUNNEL; and clicks, which are answered on board."""

from __future__ import annotations

import contextlib
import errno
import random
import socket
import time
from typing import Any

from contract.answer import Answer
from contract.closing import Closing
from contract.errors import CorruptPayload, InputError, LinkError
from contract.wire.click_code import MAX_NUMBER, TUNNEL_TYPE, ClickQuestion, turned_away
from contract.wire.radio_state import read_state
from ground.click_asking import Asking
from ground.mavlink_endpoint import MavlinkEndpoint, masking
from ground.radio_traffic import RadioTraffic

LOOK_S = 0.05
BEAT_S = 30.0  # between heartbeats: any packet of ours teaches the autopilot where we are, and they cost 168 bits each
FIND_S = 10.0  # for a heartbeat of the vehicle
TUNNEL_BYTES = 128
CHUNK = 4096


def _check_free(host: str, port: int) -> None:
    """Raise LinkError where another program has the port: both would be let in, and only one of them receives."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise LinkError(
                    f"another program receives at UDP port {port}: end it, or have the radio's datagrams sent to a "
                    "second port too (a ground station forwards MAVLink, mavlink-router has as many ends as are needed)"
                ) from error
            raise


def opened_wire(e: MavlinkEndpoint) -> tuple[Any, Any, str]:
    """Open an endpoint's wire: pymavlink's connection, its dialect, and the place in words.

    Raises InputError without the library, LinkError where it cannot be opened.
    """
    try:
        from pymavlink import mavutil  # noqa: PLC0415  of the extra `mavlink`
        from pymavlink.dialects.v20 import ardupilotmega as dialect  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            "this needs the package pymavlink: install pointclick with its extra [mavlink] (README)"
        ) from error
    place = f"{e.kind}:{e.host}:{e.port}"
    try:
        if e.kind == "udpin":
            _check_free(e.host, e.port)
        wire = (
            mavutil.mavlink_connection(e.host, baud=e.port) if e.kind == "serial" else mavutil.mavlink_connection(place)
        )
    except (OSError, ImportError) as error:
        raise LinkError(f"cannot open {place}: {error}") from error
    return wire, dialect, place


class NumberRefused(LinkError):
    """An aircraft takes nothing under our system number: there is no use in asking again."""


class MavlinkLink(Closing):
    """Opened at once. Raises InputError without the library, LinkError where the endpoint cannot be opened."""

    def __init__(self, endpoint: MavlinkEndpoint) -> None:
        self._wire, self._dialect, self._place = opened_wire(endpoint)
        self._endpoint = e = endpoint
        self._mav: Any = self._dialect.MAVLink(None, srcSystem=e.system, srcComponent=e.component)
        self._mav.robust_parsing = True
        self._wire.mav = self._mav
        if e.key is not None:
            self._wire.setup_signing(e.key)
        self._vehicles: set[int] = set()
        self._number = random.randrange(MAX_NUMBER + 1)  # so that a new program's questions are not an old one's
        self.traffic = RadioTraffic()
        self._took_us: set[int] = set()  # aircraft, under our number
        self._beat_s = -BEAT_S

    def ask(self, u_px: float, v_px: float, *, frame: int | None = None, capture_unix_ns: int | None = None) -> Answer:
        """The answer to a click, its age that of when the click was made.

        Raises LinkError where none comes, or the aircraft turns us away.
        """
        self._number = (self._number + 1) % (MAX_NUMBER + 1)
        question = ClickQuestion(self._number, u_px, v_px, frame, capture_unix_ns)
        vehicle = self._find_vehicle()
        began_s = time.monotonic()
        asking = Asking(question, began_s)
        while not asking.is_over(time.monotonic()):
            self.beat()
            if asking.is_due(time.monotonic()):
                self.send(vehicle, asking.packet(time.monotonic()))
            for sender, payload in self.received():
                found = asking.take(payload) if sender == vehicle else None
                if found is not None:
                    return found
        raise LinkError(self._unanswered(vehicle, began_s))

    def _unanswered(self, vehicle: int, began_s: float) -> str:
        """Explain why no answer may have come to a question that was asked from `began_s` on."""
        if words := self.traffic.own_words(vehicle, began_s):
            return f"vehicle {vehicle} has received the click, and no answer arrived: {words}"
        traffic = self.traffic.autopilots_words(vehicle, time.monotonic())
        return (
            f"vehicle {vehicle} does not answer clicks: does pc-onboard run there with link.mavlink = true and "
            f"telemetry.component {self._endpoint.companion}, and does the autopilot forward to this link?"
            f"{' ' if traffic else ''}{traffic}"
        )

    def close(self) -> None:
        self._wire.close()

    def _find_vehicle(self) -> int:
        """The vehicle that is asked. Raises LinkError if there is none, or several."""
        until_s = time.monotonic() + FIND_S
        while not self.vehicles and time.monotonic() < until_s:
            self.received()
        if not self.vehicles:
            raise LinkError(f"no autopilot was received at {self._place} within {FIND_S:g} s")
        if len(self.vehicles) > 1:
            named = ", ".join(map(str, self.vehicles))
            raise LinkError(f"several vehicles are received: {named}; choose one with ?vehicle={self.vehicles[0]}")
        return self.vehicles[0]

    @property
    def vehicles(self) -> list[int]:
        """The one that was chosen, or all whose autopilot was received, by their system numbers."""
        return sorted(self._vehicles) if self._endpoint.vehicle is None else [self._endpoint.vehicle]

    def received(self) -> list[tuple[int, bytes]]:
        """Return the messages for us within a moment, with the system that sent it.

        Raises LinkError where the link is broken, NumberRefused where an aircraft turns our number away.
        """
        self._wire.select(LOOK_S)
        try:
            data = self._wire.recv(CHUNK)
        except OSError as error:
            raise LinkError(f"{self._place}: {error.strerror or error}") from error
        out = []
        ours = TUNNEL_TYPE, self._endpoint.system, self._endpoint.component
        for message in (self._mav.parse_buffer(data) or []) if data else []:
            name, sender = message.get_type(), message.get_srcSystem()
            is_ours = name == "TUNNEL" and message.payload_type == TUNNEL_TYPE
            if sender in self.vehicles:
                self.traffic.came(sender, len(message.get_msgbuf()), time.monotonic(), is_ours=is_ours)
            if name == "HEARTBEAT" and message.autopilot != self._dialect.MAV_AUTOPILOT_INVALID:
                self._vehicles.add(sender)
            elif name == "TUNNEL" and (message.payload_type, message.target_system, message.target_component) == ours:
                out.append((sender, bytes(message.payload[: message.payload_length])))
                self._note_answer(*out[-1])
        return out

    def _note_answer(self, vehicle: int, payload: bytes) -> None:
        refusal = turned_away(payload)
        if refusal is not None and vehicle in self.vehicles:
            raise NumberRefused(masking(self._endpoint.system, refusal.low, refusal.high))
        with contextlib.suppress(CorruptPayload):
            if (state := read_state(payload)) is not None:
                self.traffic.stated(vehicle, state, time.monotonic())
        self._took_us.add(vehicle)

    def beat(self) -> None:
        """Announce this end, seldom, and only once every aircraft has taken us: a heartbeat under a number that an
        autopilot's ground stations have would hide from it that it has lost them. Not as a ground station either.
        """
        if not self._took_us.issuperset(self.vehicles) or time.monotonic() - self._beat_s < BEAT_S:
            return
        self._beat_s = time.monotonic()
        d = self._dialect
        kind, autopilot, state = d.MAV_TYPE_ONBOARD_CONTROLLER, d.MAV_AUTOPILOT_INVALID, d.MAV_STATE_ACTIVE
        self._write(d.MAVLink_heartbeat_message(kind, autopilot, 0, 0, state, 3))

    def send(self, vehicle: int, payload: bytes) -> None:
        """Send to a vehicle's companion computer, never to all."""
        padded = list(payload.ljust(TUNNEL_BYTES, b"\0"))
        to = vehicle, self._endpoint.companion
        self._write(self._dialect.MAVLink_tunnel_message(*to, TUNNEL_TYPE, len(payload), padded))

    def _write(self, message: Any) -> None:
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._wire.write(bytes(packet))
