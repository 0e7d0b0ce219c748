"""A ground station's side of MAVLink's camera protocol v2, written from common.xml and the protocol's page alone.

It knows nothing of pointclick: discovery by a camera's heartbeat, CAMERA_INFORMATION, then commands with their
acknowledgements. Without a router it stands in for the autopilot, whose heartbeat it sends too.
"""

import socket
import time
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as standard

GROUND = 255, 190
PATIENCE_S = 10.0


@dataclass
class StandardClient:
    """Sends to a UDP port of loopback, or `listens` at it behind a router, and keeps all that comes back with its
    sender's component.
    """

    port: int
    vehicle: int = 1
    listens: bool = False
    got: list[tuple[int, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer: tuple[str, int] | None = None if self.listens else ("127.0.0.1", self.port)
        if self.listens:
            self._socket.bind(("127.0.0.1", self.port))
        self._socket.settimeout(0.02)
        self._ground = standard.MAVLink(None, *GROUND)
        self._autopilot = standard.MAVLink(None, self.vehicle, 1)
        self._parser = standard.MAVLink(None)
        self._parser.robust_parsing = True
        self._beat_s = 0.0

    def close(self) -> None:
        self._socket.close()

    def look(self) -> None:
        """Beat as autopilot and ground station, and take what has come."""
        try:
            if time.monotonic() - self._beat_s > 0.2:
                self._beat_s = time.monotonic()
                beat = standard.MAVLink_heartbeat_message
                if not self.listens:
                    self._send(beat(2, standard.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3).pack(self._autopilot))
                self._send(beat(6, standard.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3).pack(self._ground))
            data, self._peer = self._socket.recvfrom(65536)
        except OSError:  # nothing has come, or no one listens yet
            return
        self.got += [(m.get_srcComponent(), m) for m in self._parser.parse_buffer(data) or []]

    def send_position(self, lat_deg: float, lon_deg: float, speed_m_s: float) -> None:
        """The autopilot's own position, on its way to the east, and what `look` sends."""
        self.look()
        degrees = round(lat_deg * 1e7), round(lon_deg * 1e7)
        position = standard.MAVLink_global_position_int_message
        self._send(position(0, *degrees, 160_000, 60_000, 0, round(100.0 * speed_m_s), 0, 9000).pack(self._autopilot))

    def _send(self, packet: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(packet, self._peer)

    def wait(self, name: str, since: int = 0) -> Any:
        """The first message of a name from the camera after so many."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            for component, message in self.got[since:]:
                if component == 100 and message.get_type() == name:
                    return message
            self.look()
        raise AssertionError(f"no {name} among {sorted({m.get_type() for _, m in self.got})}")

    def command(self, command: int, *parameters: float, component: int = 100) -> tuple[Any, int]:
        """Send a COMMAND_LONG; its acknowledgement, and how many messages had come before."""
        since = len(self.got)
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        long = standard.MAVLink_command_long_message(self.vehicle, component, command, 0, *padded)
        self._send(long.pack(self._ground))
        acknowledgement = self.wait("COMMAND_ACK", since)
        assert (acknowledgement.command, acknowledgement.target_system) == (command, GROUND[0])
        return acknowledgement, since

    def request(self, message_id: int, index: float = 0.0) -> tuple[Any, int]:
        """Ask for one message once."""
        return self.command(standard.MAV_CMD_REQUEST_MESSAGE, message_id, index)

    def texts(self) -> str:
        return " ".join(m.text for _, m in self.got if m.get_type() == "STATUSTEXT")
