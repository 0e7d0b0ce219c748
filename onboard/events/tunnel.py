"""What may travel through the autopilot next to telemetry, to and from grounds behind its radio."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol


class Peer(NamedTuple):
    """A ground's MAVLink system and component number."""

    system: int
    component: int


class TunnelEnd(Protocol):
    """Our end of the tunnel. Called in the telemetry's thread: nothing here waits."""

    def receive(self, ground: Peer, payload: bytes) -> None:
        """A ground has sent this."""

    def due(self) -> Iterable[tuple[Peer, bytes]]:
        """What is to be sent now, and to which ground."""

    def charge(self, wire_bytes: int) -> None:
        """The autopilot was sent so many bytes that it passes on to its radios."""

    def know_ground_stations(self, low: int, high: int) -> None:
        """The system numbers that the autopilot takes for its ground stations."""
