"""The state of the aircraft's side, once a second: a small JSON object. docs/wire-format.md, section 10.

Written for people and dashboards, so text; a reader ignores unknown keys, and keys may be added.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from contract.errors import CorruptPayload, NewerPayload

VERSION = 1
MAX_BYTES = 400
MAX_STATE = 24
MAX_REASON = 50
MAX_LOOK = 80
MAX_HEAT = 64
MAX_MODE = 24
MAX_SHARES = 3
MAX_CODE = 12
TEXTS = {"state": MAX_STATE, "reason": MAX_REASON, "look": MAX_LOOK, "heat": MAX_HEAT, "mode": MAX_MODE}
# Of the aircraft, where its autopilot reports them: what lies outside of these is no report.
BOUNDS = {"fix": (0, 15), "satellites": (0, 254), "battery_percent": (0, 100), "battery_v": (0.0, 100.0)}
# What is left out where there is no room, the first first, after the shares; then the reason is cut.
SPARE = ("satellites", "fix", "battery_v", "mode", "battery_percent")
FIXES = {
    **{0: "no fix", 1: "no fix", 2: "2D fix", 3: "3D fix", 4: "differential fix"},
    **{5: "RTK float", 6: "RTK fixed", 7: "fixed position", 8: "PPP fix"},
}
"""MAVLink's GPS_FIX_TYPE in words."""


def fix_words(fix: int) -> str:
    """Return MAVLink's GPS_FIX_TYPE in words."""
    return FIXES.get(fix, f"fix type {fix}")


@dataclass(frozen=True)
class VehicleStatus:
    """One moment of one vehicle. Rates are over the last seconds, counts since the session began."""

    unix_s: float  # on the session's clock
    session: int  # as in its feature sets; 0 before the first
    state: str  # one of docs/faults.md, "ok" when answers flow
    reason: str = ""
    up_s: float = 0.0
    camera_hz: float = 0.0
    ok_hz: float = 0.0  # pictures that can be clicked
    frame: int = -1  # newest picture that has a set; -1 before the first
    delay_s: float = 0.0  # from its capture to its set
    tracks: int = 0
    dropped: int = 0  # pictures, because time was short
    lost: int = 0  # pictures, by the camera
    recording: bool = False
    cpu_c: float | None = None  # its temperature
    follows: bool = False  # whether it follows what it is asked to (`contract.track`)
    looks: bool = False  # whether anybody may have its camera look at a place (`contract.look`)
    look: str = ""  # who had it look where last, and what the autopilot made of it
    heat: str = ""  # the state of a second camera, for hot spots, and why; empty where it is well or there is none
    # Of a click's variance in the middle of the newest picture, per cent by code (`contract.error_sources`); the
    # largest, or none while they are not known.
    shares: Mapping[str, int] = field(default_factory=dict)
    fix: int | None = None  # the receiver's, MAVLink's GPS_FIX_TYPE
    satellites: int | None = None
    battery_percent: int | None = None  # left, by the autopilot
    battery_v: float | None = None
    mode: str = ""  # the autopilot's flight mode by its name

    @property
    def gps_words(self) -> str:
        """The receiver's fix for people: "RTK fixed, 17 satellites"; empty where it is not known."""
        fix = None if self.fix is None else fix_words(self.fix)
        seen = None if self.satellites is None else f"{self.satellites} satellites"
        return ", ".join(text for text in (fix, seen) if text is not None)

    @property
    def battery_words(self) -> str:
        """The battery's charge and voltage for people: "64 %, 22.1 V"; empty where it is not known."""
        percent = None if self.battery_percent is None else f"{self.battery_percent} %"
        volts = None if self.battery_v is None else f"{self.battery_v:.1f} V"
        return ", ".join(text for text in (percent, volts) if text is not None)

    @property
    def amiss(self) -> str:
        """The state of a second camera in words, where the reason of the state is another; else empty."""
        known = not self.heat or self.reason.startswith("thermal camera")
        return "" if known else f"no hot spots: thermal camera {self.heat}"

    @property
    def fractions(self) -> dict[str, float]:
        """The shares from 0 to 1, the largest first."""
        return {code: share / 100.0 for code, share in sorted(self.shares.items(), key=lambda item: -item[1])}


def encode_status(status: VehicleStatus) -> bytes:
    """Return the status in at most MAX_BYTES of ASCII. Raises ValueError for a number that is not finite."""
    content = _content(status)
    payload = json.dumps(content, separators=(",", ":"), allow_nan=False).encode("ascii")
    over = len(payload) - MAX_BYTES
    if over <= 0:
        return payload
    if status.shares:
        fewer = dict(list(status.shares.items())[: min(len(status.shares), MAX_SHARES) - 1])
        return encode_status(replace(status, shares=fewer))
    for name in SPARE:
        if name in content:
            without: dict[str, Any] = {name: "" if name == "mode" else None}
            return encode_status(replace(status, **without))
    if not content["reason"]:
        return payload
    return encode_status(replace(status, reason=content["reason"][:-over]))  # only after months of counting


def _content(status: VehicleStatus) -> dict[str, Any]:
    """Return what the status holds by its keys, rounded and cut, without what is empty or not known."""
    content: dict[str, Any] = {"v": VERSION, **asdict(status)}
    for key, digits in (("unix_s", 3), ("up_s", 0), ("camera_hz", 1), ("ok_hz", 1), ("delay_s", 3)):
        content[key] = _number(content[key], digits)
    content["state"] = status.state[:MAX_STATE]
    for key in ("reason", "look", "heat", "mode"):
        content[key] = _plain(content[key])[: TEXTS[key]]
    for key, digits in (("cpu_c", 0), ("battery_v", 1)):
        content[key] = None if content[key] is None else _number(content[key], digits)
    content["shares"] = dict(list(status.shares.items())[:MAX_SHARES])
    for key in ("follows", "looks", "look", "heat", "shares", "mode"):
        if not content[key]:
            del content[key]
    for key in ("cpu_c", *BOUNDS):
        if content[key] is None or (key in BOUNDS and not _is_within(key, content[key])):
            del content[key]
    return content


def _number(value: float, digits: int) -> float | int:
    if not math.isfinite(value):
        raise ValueError(f"{value} is not finite and has no place in a status")
    rounded = round(value, digits)
    return int(rounded) if rounded == int(rounded) else rounded


def _plain(text: str) -> str:
    """Replace every character that JSON would escape, so that each is one byte: the bound on the size counts on it."""
    return "".join(c if " " <= c <= "~" and c not in '"\\' else "'" if c == '"' else "?" for c in text)


def decode_status(payload: bytes) -> VehicleStatus:
    """Raises NewerPayload for a later major version and CorruptPayload for anything else that is not a status."""
    if len(payload) > 4 * MAX_BYTES:
        raise CorruptPayload(f"a status of {len(payload)} bytes; at most {4 * MAX_BYTES} are read")
    try:
        content = json.loads(payload.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise CorruptPayload(f"a status must be JSON: {error}") from error
    if not isinstance(content, dict):
        raise CorruptPayload("a status must be a JSON object")
    version = content.get("v")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise CorruptPayload(f"status version {version!r} must be a whole number from 1")
    if version > VERSION:
        raise NewerPayload(f"status version {version}; this program reads up to {VERSION}")
    known = {field.name: str(field.type) for field in fields(VehicleStatus)}
    for name in ("unix_s", "session", "state"):
        if name not in content:
            raise CorruptPayload(f"status without {name!r}")
    values = {name: content[name] for name in known if name in content}
    for name, value in values.items():
        if not _fits(value, known[name]):
            raise CorruptPayload(f"status with {name} = {str(value)[:40]!r}, which is not {known[name]}")
    _check_sizes(values)
    return VehicleStatus(**values)


def _check_sizes(values: Mapping[str, Any]) -> None:
    for name, most in TEXTS.items():
        text = values.get(name, "")
        if len(text) > most or not text.isprintable():
            raise CorruptPayload(f"status with a {name} that is too long or cannot be printed")
    for name in BOUNDS:
        if values.get(name) is not None and not _is_within(name, values[name]):
            raise CorruptPayload(f"status with {name} = {values[name]}, which cannot be")
    if len(values.get("shares", {})) > MAX_SHARES:
        raise CorruptPayload(f"status with more than {MAX_SHARES} shares")


def _is_within(name: str, value: float) -> bool:
    low, high = BOUNDS[name]
    return low <= value <= high


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_share(code: str, share: object) -> bool:
    return 0 < len(code) <= MAX_CODE and code.isascii() and code.isalnum() and _is_whole(share) and 0 <= share <= 100  # type: ignore[operator]


def _fits(value: object, kind: str) -> bool:
    if kind.startswith("Mapping"):
        return isinstance(value, dict) and all(_is_share(code, share) for code, share in value.items())
    if kind == "str":
        return isinstance(value, str)
    if kind == "bool":
        return isinstance(value, bool)
    if value is None:
        return "None" in kind
    if kind.startswith("int"):
        return _is_whole(value) and abs(int(value)) < 2**63  # type: ignore[call-overload]
    return (_is_whole(value) and abs(int(value)) < 2**63) or (  # type: ignore[call-overload]
        isinstance(value, float) and math.isfinite(value)
    )
