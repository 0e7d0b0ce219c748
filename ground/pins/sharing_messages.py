"""Messages about pins between ground servers: bytes <-> values, all of them checked. No clock, no link.

docs/wire-format.md, section 12. Anything that is not as specified there is an InputError.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from contract.errors import InputError
from contract.topics import PINS
from ground.pins.model import Pin, to_text
from ground.pins.reading import Reader
from ground.pins.versions import order_of

VERSION = 1
PREFIX = PINS
MAX_PIN_BYTES = 1_000_000  # some 270 clicks
MAX_ANNOUNCEMENT_BYTES = 500
MAX_ASKED = 100  # pins in one question
SUMMARY_BYTES = 32_000  # of one answer; there are as many as it takes
VERSION_BYTES = 8
_SERVER = re.compile(r"[0-9a-f]{16}")
_KEY = re.compile(rf"{PREFIX}/([0-9a-f]{{16}})/(said|changed)")
_IDENTITY = re.compile(rb"[0-9A-Za-z_-]{1,64}")


@dataclass(frozen=True)
class Announcement:
    """The report of a server about itself, once a second. `digest` is the same where all pins are the same."""

    server: str
    pins: int  # tombstones too
    digest: int
    unix_ns: int  # its clock


def server_of(key: str) -> tuple[str, str]:
    """Server and kind of a key. Raises InputError."""
    found = _KEY.fullmatch(key)
    if found is None:
        raise InputError(f"{key[:80]!r} is no key of a server of pins")
    return found[1], found[2]


def announcement_to_bytes(a: Announcement) -> bytes:
    """JSON."""
    content = {
        "v": VERSION,
        "server": a.server,
        "pins": a.pins,
        "digest": f"{a.digest:016x}",
    }
    return json.dumps({**content, "unix_ns": a.unix_ns}).encode()


def announcement_from_bytes(payload: bytes) -> Announcement:
    """Raises InputError."""
    r = Reader(_json(payload, MAX_ANNOUNCEMENT_BYTES, "what a server reports"), "server")
    if r.whole("v") != VERSION:
        raise InputError(f"server: of version {r.get('v')!s:.20}; this program reads {VERSION}")
    server, digest = r.text("server", 16), r.text("digest", 16)
    if not _SERVER.fullmatch(server) or not _SERVER.fullmatch(digest):
        raise InputError("server: its name and digest must be 16 hexadecimal digits")
    return Announcement(server, r.whole("pins"), int(digest, 16), r.whole("unix_ns"))


def pin_to_bytes(pin: Pin) -> bytes:
    """JSON. Raises InputError for a pin that is too large to be shared."""
    payload = to_text(pin.to_dict()).encode()
    if len(payload) > MAX_PIN_BYTES:
        raise InputError(f"pin {pin.number} has {len(payload)} bytes; at most {MAX_PIN_BYTES} are shared")
    return payload


def pin_from_bytes(payload: bytes) -> Pin:
    """Raises InputError."""
    return Pin.from_dict(_json(payload, MAX_PIN_BYTES, "a pin"))


def version_of(pin: Pin) -> bytes:
    """A few bytes that identify a version of a pin. Its number, each server's own, is not in them."""
    return hashlib.blake2b(repr(order_of(pin)).encode(), digest_size=VERSION_BYTES).digest()


def digest_of(versions: Iterable[bytes]) -> int:
    """The digest of all pins' versions, in any order."""
    return sum(int.from_bytes(version, "little") for version in versions) % 2**64


def summaries(versions: dict[str, bytes]) -> Iterator[bytes]:
    """Ids and versions, in answers of bounded size; one that is empty where there are none."""
    part = bytearray()
    for name, version in versions.items():
        part += bytes([len(name)]) + name.encode() + version
        if len(part) >= SUMMARY_BYTES:
            yield bytes(part)
            part.clear()
    yield bytes(part)


def summary_from_bytes(payload: bytes) -> Iterator[tuple[str, bytes]]:
    """Raises InputError, perhaps after some."""
    at = 0
    while at < len(payload):
        length = payload[at]
        name, version = payload[at + 1 : at + 1 + length], payload[at + 1 + length : at + 1 + length + VERSION_BYTES]
        if not _IDENTITY.fullmatch(name) or len(version) != VERSION_BYTES:
            raise InputError("a summary of pins that cannot be read")
        yield name.decode(), version
        at += 1 + length + VERSION_BYTES


def asked_to_bytes(names: Iterable[str]) -> bytes:
    """Ids, a line each."""
    return "\n".join(names).encode()


def asked_from_bytes(payload: bytes) -> list[str]:
    """Raises InputError."""
    names = payload.split(b"\n")
    if len(names) > MAX_ASKED or not all(_IDENTITY.fullmatch(name) for name in names):
        raise InputError(f"a question for pins must name 1 to {MAX_ASKED} ids")
    return [name.decode() for name in names]


def _json(payload: bytes, most: int, what: str) -> Any:
    if len(payload) > most:
        raise InputError(f"{what}: {len(payload)} bytes; at most {most} are read")
    try:
        return json.loads(payload.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{what}: no JSON ({str(error)[:80]})") from error
