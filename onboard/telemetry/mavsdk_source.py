"""The MAVLink end made with mavsdk: it parses and writes packets; we hand it the bytes (`raw://`) and keep the wires.

Fed that way a serial line costs little and survives being unplugged, neither of which holds for mavsdk's own serial
connection. Messages come through `mavlink_direct`, whole and with the autopilot's own stamps, one callback each on a
thread of mavsdk's. Heartbeats it sends itself, each second: most are kept from the wire, for an autopilot passes them
on to every radio.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.clocks.timesync import SELDOM_NS
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.telemetry.mavlink_events import WANTED
from onboard.telemetry.mavlink_framing import Framer
from onboard.telemetry.transports import Wire
from onboard.telemetry.vehicle_choice import is_autopilot

NAMES = sorted(
    mavlink.mavlink_map[number].msgname
    for number in (
        *WANTED,
        mavlink.MAVLINK_MSG_ID_TIMESYNC,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    )
)
CLASSES = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}
MAX_WAITING = 5000
HEARTBEAT_BYTES = {0xFE: (17, 5), 0xFD: (21, 7)}  # by MAVLink's version: of a whole message, and where its number is


class MavsdkEnd:
    """mavsdk takes its system number when it is made, and ours is the vehicle's: it is made at its first heartbeat.

    Before that only heartbeats are handed on, by which the vehicle is chosen.
    """

    def __init__(self, config: Config, clock: SessionClock) -> None:
        self.system = config.telemetry.system or None
        self._component = config.telemetry.component
        self._clock = clock
        self._finder = Framer(mavlink.MAVLink(None))
        self._mavsdk: Any = None
        self._direct: Any = None
        self._system_as_made = 0
        self._waiting: deque[tuple[int, Any]] = deque(maxlen=MAX_WAITING)
        self._lock = threading.Lock()
        self._wire: Wire | None = None
        self._broken: OSError | None = None
        self._beat_ns: int | None = None  # when mavsdk's last heartbeat went out

    def attach(self, wire: Wire) -> None:
        """Let both directions run over this wire from now on."""
        with self._lock:
            self._wire, self._broken, self._beat_ns = wire, None, None
        self._finder = Framer(mavlink.MAVLink(None))

    def take(self, data: bytes, now_ns: int) -> list[tuple[int, Any]]:
        """Hand the bytes over; returns what mavsdk has made of these and earlier ones. Raises OSError: wire broken."""
        if self._broken is not None:
            raise self._broken
        if self._mavsdk is None:
            beats = [message for message in self._finder.feed(data) if is_autopilot(message)]
            beat = next((beat for beat in beats if beat.get_srcSystem() == self.system), None)
            if beat is None:
                return [(now_ns, beat) for beat in beats]
            self._begin(int(beat.get_srcSystem()), beat.autopilot == mavlink.MAV_AUTOPILOT_PX4)
        if data:
            self._mavsdk.pass_received_raw_bytes(data)
        if self._direct is None:
            self._subscribe()
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def send(self, message: Any, component: int | None = None) -> None:
        """Through mavlink_direct; before the vehicle is known, nothing is. Raises OSError where the wire is broken.

        There is no other `component` that would send through it: `open_telemetry` sees to that.
        """
        name = message.get_type()
        if self._direct is None or name == "HEARTBEAT":
            # The other end may send only to an address it has received from.
            if self._mavsdk is None and self._wire is not None:
                self._wire.write(bytes(message.pack(mavlink.MAVLink(None, self.system or 1, self._component))))
            return
        fields = {field: _to_json(getattr(message, field)) for field in message.fieldnames}
        target = int(fields.get("target_system", 0)), int(fields.get("target_component", 0))
        whole = MavlinkMessage(name, self._system_as_made, self._component, *target, json.dumps(fields))
        try:
            self._direct.send_message(whole)
        except MavlinkDirectError as error:
            self._broken = self._broken or OSError(f"mavsdk: {error.result.name.lower()}")
        if self._broken is not None:
            raise self._broken

    def lost(self, system: int) -> int | None:
        return None

    def complaint(self) -> str:
        """The reason to give where much comes in and no autopilot is in it; empty otherwise."""
        return f"{self._finder.garbage} bytes and no packet among them: another baud rate?" if self._is_garbage else ""

    @property
    def _is_garbage(self) -> bool:
        return self._mavsdk is None and self._finder.garbage > 2000

    def close(self) -> None:
        """Ends mavsdk's threads."""
        with self._lock:
            self._wire = None
        if self._mavsdk is not None:
            self._mavsdk.destroy()

    def _begin(self, system: int, is_px4: bool) -> None:
        if is_px4:  # of the type "generic": PX4 would miss a companion computer that leaves (`mavlink_session`)
            configuration = Configuration.create_manual(system, self._component, True)
        else:
            configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
            configuration.system_id = system
            configuration.component_id = self._component
        self._system_as_made = system
        self._mavsdk = Mavsdk(configuration)
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._write)
        self._mavsdk.add_any_connection("raw://")

    def _subscribe(self) -> None:
        for system in self._mavsdk.get_systems():
            if system.has_autopilot() and system.get_system_id() == self._system_as_made:
                self._direct = MavlinkDirect(system)
                for name in NAMES:
                    self._direct.subscribe_message(name, self._receive)
                return

    def _receive(self, message: Any, _data: object) -> None:
        """Keep a message with its arrival; called on mavsdk's thread."""
        now_ns = self._clock.now_ns()
        made = from_json(message.message_name, message.system_id, message.component_id, message.fields_json)
        if made is not None:
            self._waiting.append((now_ns, made))

    def _write(self, data: bytes) -> None:
        with self._lock:
            if self._wire is None or self._broken is not None:
                return
            now_ns, is_beat = self._clock.now_ns(), _is_heartbeat(data)
            if is_beat and self._beat_ns is not None and now_ns - self._beat_ns < SELDOM_NS:
                return
            try:
                # mavsdk's first one may come before the wire knows where to: then the next is due at once.
                if self._wire.write(data) and is_beat:
                    self._beat_ns = now_ns
            except OSError as error:
                self._broken = error


def _is_heartbeat(data: bytes) -> bool:
    size, at = HEARTBEAT_BYTES.get(data[0], (0, 0)) if data else (0, 0)
    return len(data) == size and not any(data[at : at + (1 if data[0] == 0xFE else 3)])


def from_json(name: str, system: int, component: int, text: str) -> Any | None:
    """A message as mavlink_direct gives it -> the same as pymavlink has it; None for what does not fit."""
    kind = CLASSES.get(name)
    if kind is None:
        return None
    try:
        fields = json.loads(text)
        values = {field: _from_json(fields[field]) for field in kind.fieldnames if field in fields}
        message = kind(**values)
        message._header = mavlink.MAVLink_header(kind.id, srcSystem=system, srcComponent=component)
        # Packed once, as if it had come off the line: logs want its bytes, and a value out of range shows here.
        message.pack(mavlink.MAVLink(None, system, component))
    except (ValueError, TypeError, KeyError, mavlink.struct.error):
        return None
    return message


def _from_json(value: Any) -> Any:
    """JSON has no nan: it is null there."""
    if value is None:
        return math.nan
    if isinstance(value, list):
        return [_from_json(part) for part in value]
    return value.encode("ascii", "replace") if isinstance(value, str) else value


def _to_json(value: Any) -> Any:
    if isinstance(value, bytes | str):
        return value.decode("ascii", "replace").rstrip("\0") if isinstance(value, bytes) else value
    if isinstance(value, list | tuple):
        return [_to_json(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_muted(*_what: object) -> bool:
    """mavsdk's own log goes to stdout in colours; what matters of it is in our health."""
    return True


# Once in a process, as the import is: to do it again frees the callback that a thread of mavsdk's may be about to call.
log_subscribe(_is_muted)
