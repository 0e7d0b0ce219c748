"""Search for an autopilot: every serial port at the usual rates, and the usual UDP port, listened to."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.telemetry.mavlink_framing import Framer, SequenceGaps
from onboard.telemetry.transports import Address
from onboard.telemetry.vehicle_choice import LISTEN_NS, is_autopilot, kind_of

BAUDS = (921600, 115200, 57600, 460800, 230400)  # autopilots' companion and telemetry ports, the likelier first
UDP = ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14540")
LISTEN_S = LISTEN_NS / 1e9
SLOW_BAUD = 200_000  # below which a serial line cannot carry all that is asked for by default


@dataclass(frozen=True)
class FoundAutopilot:
    """An autopilot on a wire."""

    url: str
    kind: str
    system: int

    def __str__(self) -> str:
        return f"{self.url}  system {self.system}, {self.kind}"


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


def listen(url: str, seconds: float = LISTEN_S, now_s: Callable[[], float] = time.monotonic) -> list[FoundAutopilot]:
    """The autopilots on a wire, by number: all received within some seconds, or soon after the first."""
    framer, ends_s = Framer(mavlink.MAVLink(None), SequenceGaps()), now_s() + seconds
    found: dict[int, FoundAutopilot] = {}
    try:
        with closing(Address.parse(url).open()) as wire:
            while (left_s := ends_s - now_s()) > 0.0:
                for message in framer.feed(wire.read(min(left_s, 0.1))):
                    if is_autopilot(message):
                        ends_s = ends_s if found else now_s() + LISTEN_S
                        system = int(message.get_srcSystem())
                        found[system] = FoundAutopilot(url, kind_of(message), system)
    except OSError:
        return []
    return [found[system] for system in sorted(found)]


def is_slow(url: str) -> bool:
    """Return whether the wire is a serial one too slow for the messages that are requested by default."""
    scheme, _, rest = url.partition(":")
    number = rest.rpartition(":")[2]
    return scheme == "serial" and number.isdecimal() and int(number) < SLOW_BAUD
