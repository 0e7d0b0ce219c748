"""`--connect mavlink:...`: an aircraft that is reached through its autopilot's radio."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl

from contract.signing_key import signing_key
from ground.link_options import UsageError

SCHEME = "mavlink:"
FORMS = (
    "mavlink:udpin:HOST:PORT, mavlink:udpout:HOST:PORT, mavlink:tcp:HOST:PORT or mavlink:serial:DEVICE:BAUD, and "
    "behind a ? what is not the usual, as in mavlink:udpin:0.0.0.0:14551?system=245&vehicle=1"
)
OUR_SYSTEM, OUR_COMPONENT = 245, 25  # no ground station's, and a number that is free for users
COMPANION = 191  # as telemetry.component on board
GROUND_STATIONS = "255-255"  # as autopilots have it, unless they are set otherwise


@dataclass(frozen=True)
class MavlinkEndpoint:
    """The connection, our address on it, and the vehicle that is asked; `vehicle` None: the only autopilot received."""

    kind: str  # udpin, udpout, tcp, serial
    host: str  # or a device
    port: int  # or a baud rate
    system: int = OUR_SYSTEM
    component: int = OUR_COMPONENT
    vehicle: int | None = None
    companion: int = COMPANION
    key: bytes | None = None  # of MAVLink's signing

    @classmethod
    def parse(cls, text: str) -> MavlinkEndpoint:
        """Raises UsageError, also for a system number of ours that is a ground station's."""
        place, _, options = text.removeprefix(SCHEME).partition("?")
        kind, _, rest = place.partition(":")
        host, _, port = rest.rpartition(":")
        if kind not in ("udpin", "udpout", "tcp", "serial") or not host or not port.isdecimal():
            raise UsageError(f"{text!r} is none of {FORMS}")
        given = dict(parse_qsl(options))
        key = _key(given.pop("key")) if "key" in given else None
        low, high = _range(given.pop("ground_stations", GROUND_STATIONS))
        unknown = set(given) - {"system", "component", "vehicle", "companion"}
        if unknown:
            raise UsageError(f"{text!r}: {', '.join(sorted(unknown))}? There are system, component, vehicle, companion "
                             "and ground_stations")  # fmt: skip
        numbers = {name: _number(name, value) for name, value in given.items()}
        found = cls(kind, host, int(port), **numbers, key=key)
        if low <= found.system <= high:
            raise UsageError(masking(found.system, low, high))
        return found


def masking(system: int, low: int, high: int) -> str:
    """Explain why such a system number is refused, and what to do."""
    return (
        f"MAVLink system {system} is one of the autopilot's ground stations (MAV_GCS_SYSID {low} to {high}): while we "
        "send under it, the autopilot would not notice that its ground station is lost; choose another with "
        f"?system={OUR_SYSTEM if not low <= OUR_SYSTEM <= high else low - 1}"
    )


def _range(text: str) -> tuple[int, int]:
    low, _, high = text.partition("-")
    return _number("ground_stations", low), _number("ground_stations", high or low)


def _key(path: str) -> bytes:
    try:
        return signing_key(Path(path).read_bytes())
    except OSError as error:
        raise UsageError(f"mavlink: key={path}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"mavlink: key={path}: {error}") from error


def _number(name: str, text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 255:
        raise UsageError(f"mavlink: {name}={text!r} is no number from 1 to 255")
    return int(text)
