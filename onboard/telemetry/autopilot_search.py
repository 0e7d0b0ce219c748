"""Which wires an autopilot speaks on: every serial port at the usual rates, and the usual UDP port, listened to."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT
from onboard.telemetry.mavlink_framing import Framer, SequenceGaps
from onboard.telemetry.transports import Address

BAUDS = (921600, 115200, 57600, 460800, 230400)  # autopilots' companion and telemetry ports, the likelier first
UDP = ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14540")
LISTEN_S = 2.2  # two heartbeats
SLOW_BAUD = 200_000  # below which a serial line cannot carry all that is asked for by default
KINDS = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}


@dataclass(frozen=True)
class FoundAutopilot:
    """An autopilot on a wire."""

    url: str
    kind: str
    system: int


def candidates(dev: Path = Path("/dev")) -> Iterator[str]:
    """`telemetry.url`s to try. A serial port under its persistent name, if it has one."""
    by_id = sorted((dev / "serial" / "by-id").glob("*")) if (dev / "serial" / "by-id").is_dir() else []
    named = {link.resolve() for link in by_id}
    plain = sorted(port for kind in ("ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*") for port in dev.glob(kind))
    ports = [*by_id, *(port for port in plain if port.resolve() not in named)]
    yield from UDP
    for port in ports:
        for baud in BAUDS:
            yield f"serial:{port}:{baud}"


def listen(url: str, seconds: float = LISTEN_S, now_s: Callable[[], float] = time.monotonic) -> FoundAutopilot | None:
    """The autopilot whose heartbeat comes within some seconds; None if none does, or the wire cannot be opened."""
    framer, ends_s = Framer(mavlink.MAVLink(None), SequenceGaps()), now_s() + seconds
    try:
        with closing(Address.parse(url).open()) as wire:
            while (left_s := ends_s - now_s()) > 0.0:
                for message in framer.feed(wire.read(min(left_s, 0.1))):
                    if _is_autopilot(message):
                        return FoundAutopilot(
                            url, KINDS.get(message.autopilot, "autopilot"), int(message.get_srcSystem())
                        )
    except OSError:
        return None
    return None


def _is_autopilot(message: Any) -> bool:
    is_heartbeat = message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT_COMPONENT
    return bool(is_heartbeat and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def is_slow(url: str) -> bool:
    """Whether a wire carries less than is asked for by default."""
    scheme, _, rest = url.partition(":")
    number = rest.rpartition(":")[2]
    return scheme == "serial" and number.isdecimal() and int(number) < SLOW_BAUD
