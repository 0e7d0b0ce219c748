"""The participants at a ground station's router: the list that `make-credentials` writes and the router reads."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from contract.errors import InputError
from contract.stated_values import check_keys
from contract.topics import DEFAULT_ENDPOINT

FLEET_FILE = "fleet.toml"
ROLES = ("aircraft", "operators", "viewers", "stations", "pins")
NAME = re.compile(r"[A-Za-z0-9_.-]{1,32}")
MAX_BYTES = 1_000_000  # of the file: some 30,000 names

_MEANINGS = {
    "router": "the router's own certificate: a folder next to this file",
    "listen": "zenoh endpoints that aircraft and people connect to: tls/ADDRESS:PORT or quic/ADDRESS:PORT",
    "connect": "zenoh endpoints of other stations' routers; one of two connects to the other",
    "sets_hz": "feature sets of each aircraft to each who listens, a second at most; 0: all",
    "aircraft": "each publishes under its own name, and nothing else",
    "operators": "read and ask",
    "viewers": "only read",
    "stations": "the routers of other stations: trusted with all that they pass on of their own aircraft and people",
    "pins": "ground servers and people who share pins (pc-ground web --share-connect); also an operator or viewer",
}


@dataclass(frozen=True)
class Fleet:
    """Names are the common names of certificates; an aircraft's is its `vehicle.id`."""

    router: str = "router"
    listen: tuple[str, ...] = (DEFAULT_ENDPOINT.replace("tcp/", "tls/", 1),)
    connect: tuple[str, ...] = ()
    sets_hz: float = 0.0
    aircraft: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()
    viewers: tuple[str, ...] = ()
    stations: tuple[str, ...] = ()
    pins: tuple[str, ...] = ()

    def with_more(self, **names: tuple[str, ...]) -> Fleet:
        """Return a copy with these names added to their roles. Raises as `checked`."""
        more = {role: tuple(dict.fromkeys((*getattr(self, role), *added))) for role, added in names.items()}
        return checked(replace(self, **more), "the list of who takes part")  # type: ignore[arg-type]  # roles are tuples

    def to_toml(self) -> str:
        """The file, each key with what it means."""
        lines = [
            "# Who takes part at this ground station's router: pc-ground router --config THIS_FILE (docs/fleet.md)."
        ]
        for field in fields(self):
            value = getattr(self, field.name)
            lines += ["", f"# {_MEANINGS[field.name]}"]
            lines.append(f"{field.name} = {json.dumps(value, ensure_ascii=False)}")
        return "\n".join(lines) + "\n"


def read_fleet(path: Path) -> Fleet:
    """The list in a file. Raises InputError with the key that is wrong."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
        content = tomllib.loads(text.decode("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {error}") from error
    if len(text) > MAX_BYTES:
        raise InputError(f"{path}: more than {MAX_BYTES} bytes")
    check_keys(content, tuple(_MEANINGS), str(path))
    return checked(Fleet(**{key: _value(path, key, value) for key, value in content.items()}), str(path))


def checked(fleet: Fleet, where: str) -> Fleet:
    """The list itself. Raises InputError where a name is none, or stands for two kinds of participant."""
    kinds = [("router", (fleet.router,)), *((role, getattr(fleet, role)) for role in ROLES)]
    seen: dict[str, str] = {}
    for role, names in kinds:
        for name in names:
            if not NAME.fullmatch(name):
                raise InputError(f"{where}: {role}: name {name!r} must be 1 to 32 letters, digits, '_', '.' or '-'")
            if role != "pins" and name in seen:
                raise InputError(f"{where}: {name!r} is named twice, under {seen[name]} and {role}")
            if role == "pins" and seen.get(name) in ("router", "aircraft", "stations"):
                raise InputError(f"{where}: {name!r} cannot share pins: it stands under {seen[name]} too")
            seen.setdefault(name, role)
    return fleet


def _value(path: Path, key: str, value: Any) -> Any:
    """A value of the file as Fleet has it. Raises InputError."""
    if key == "router":
        if isinstance(value, str):
            return value
        raise InputError(f"{path}: {key} must be a name in quotes")
    if key == "sets_hz":
        if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= 1000.0:
            return float(value)
        raise InputError(f"{path}: {key} must be a number from 0 to 1000")
    if isinstance(value, list) and all(isinstance(one, str) for one in value):
        return tuple(value)
    raise InputError(f'{path}: {key} must be a list of texts, such as ["one", "two"]')
