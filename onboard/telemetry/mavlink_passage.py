"""Passage through the autopilot to grounds behind its radio, in MAVLink's TUNNEL. No link, no thread.

Always addressed to one ground's system and component: a broadcast TUNNEL floods every link of the autopilot. Nothing
of a ground's is taken before it is known whether its number is one of the autopilot's ground stations: it asks again.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.wire.click_code import TUNNEL_TYPE
from onboard.config.schema import Config
from onboard.events.tunnel import Peer, TunnelEnd
from onboard.telemetry.ground_stations import GroundStations
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

TUNNEL_BYTES = 128  # of its payload's field
FRAME_BYTES, SIGNATURE_BYTES = 12, 13  # of a packet, in addition to its payload


class Passage:
    """Between messages of the line and a `TunnelEnd`."""

    def __init__(self, config: Config, tunnel: TunnelEnd) -> None:
        self._component, self._tunnel = config.telemetry.component, tunnel
        self._signature_bytes = SIGNATURE_BYTES if config.telemetry.signing_key is not None else 0
        self._ground_stations = GroundStations()

    def receive(self, message: Any, system: int | None) -> None:
        """One message from the line; `system`: the vehicle's number, as far as it is known."""
        name = message.get_type()
        if name == "TUNNEL" and message.payload_type == TUNNEL_TYPE:
            is_ours = (message.target_system, message.target_component) == (system, self._component)
            if is_ours and not self._ground_stations.is_open:
                ground = Peer(message.get_srcSystem(), message.get_srcComponent())
                self._tunnel.receive(ground, bytes(message.payload[: message.payload_length]))
        elif name == "RADIO_STATUS":  # of a radio on our own line: no autopilot forwards its own's
            self._tunnel.note_radio(int(message.txbuf))
        elif name in ("HEARTBEAT", "PARAM_VALUE"):
            is_autopilot = (message.get_srcSystem(), message.get_srcComponent()) == (system, AUTOPILOT_COMPONENT)
            if is_autopilot and self._ground_stations.receive(message):
                self._tunnel.know_ground_stations(*self._ground_stations.range)

    def note_sent(self, message: Any) -> None:
        """A message of ours went to the autopilot, which passes on what has no target."""
        if not hasattr(message, "target_system"):
            self._tunnel.charge(FRAME_BYTES + self._signature_bytes + message.unpacker.size)

    def due(self, now_ns: int, system: int) -> list[Any]:
        return self._ground_stations.due(now_ns, system) + [
            tunnelled(ground.system, ground.component, payload) for ground, payload in self._tunnel.due()
        ]


def tunnelled(system: int, component: int, payload: bytes) -> Any:
    """A TUNNEL of ours to one system and component."""
    padded = list(payload.ljust(TUNNEL_BYTES, b"\0"))
    return mavlink.MAVLink_tunnel_message(system, component, TUNNEL_TYPE, len(payload), padded)
