"""The protocol of data that travels through the autopilot next to telemetry, to and from grounds behind its radio."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Peer(NamedTuple):
    """A ground's MAVLink system and component number."""

    system: int
    component: int


@dataclass(frozen=True)
class RadioReport:
    """The state of the traffic through the autopilot's radio.

    `bit_rate`, `set_s`: as to a ground that listens, None without one.
    `finding`: what is amiss and what to do, in words. `unheard`: questions whose answers did not arrive.
    `free_percent`: of the radio's own buffer, by a RADIO_STATUS that came to us.
    """

    bit_rate: float | None = None
    set_s: float | None = None
    finding: str = ""
    answered: int = 0
    unheard: int = 0
    free_percent: int | None = None


class TunnelEnd(Protocol):
    """Our end of the tunnel. Called in the telemetry's thread: nothing here waits."""

    def receive(self, ground: Peer, payload: bytes) -> None:
        """A ground has sent this."""

    def due(self) -> Iterable[tuple[Peer, bytes]]:
        """The messages to send now, each with the ground that it is for."""

    def charge(self, wire_bytes: int) -> None:
        """The autopilot was sent so many bytes that it passes on to its radios."""

    def know_ground_stations(self, low: int, high: int) -> None:
        """The system numbers that the autopilot takes for its ground stations."""

    def note_radio(self, free_percent: int) -> None:
        """A radio on our line has reported how much of its buffer is free."""
