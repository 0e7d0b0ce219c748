"""Events <-> JSON, for recordings: each event's own fields, nothing else. docs/wire-format.md, section 9."""

from __future__ import annotations

import json
import types
import typing
from dataclasses import asdict
from typing import Any

from pydantic import TypeAdapter, ValidationError

from contract import recording_format as names
from contract.errors import InputError
from onboard.events.types import (
    Attitude,
    Event,
    FilterStatus,
    Frame,
    GimbalAttitude,
    GpsQuality,
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)

CHANNELS: dict[type[Event], str] = {
    Frame: names.FRAMES,
    PositionFix: names.POSITIONS,
    GpsQuality: names.GPS_QUALITY,
    Attitude: names.ATTITUDES,
    FilterStatus: names.FILTERS,
    GimbalAttitude: names.GIMBALS,
    RangeFinder: names.RANGES,
    Zoom: names.ZOOMS,
    Home: names.HOMES,
}
NAV_EVENTS: dict[str, type[NavEvent]] = {t: kind for kind, t in CHANNELS.items() if kind is not Frame}  # type: ignore[misc]

_HINTS: dict[type[Event], dict[str, Any]] = {kind: typing.get_type_hints(kind) for kind in CHANNELS}
_ADAPTERS: dict[type[NavEvent], TypeAdapter[NavEvent]] = {kind: TypeAdapter(kind) for kind in NAV_EVENTS.values()}
_PLAIN = {int: "integer", float: "number", str: "string", bool: "boolean"}


def event_json(event: Event, picture: str = "", counts: str = "") -> bytes:
    """An event as it is recorded; `picture` and `counts` are the formats in which a frame's are, if they are."""
    if isinstance(event, Frame):
        content: dict[str, Any] = {
            "stamp_ns": event.stamp_ns,
            "frame": event.index,
            "name": event.name,
            "picture": picture or ("none" if event.image is not None else "undecodable"),
            "stamp_sigma_s": event.stamp_sigma_s,
            **({"counts": counts} if counts else {}),
        }
    else:
        content = asdict(event)
    return json.dumps(content, separators=(",", ":")).encode()


def event_schema(kind: type[Event]) -> tuple[str, str]:
    """Name and JSON Schema of an event's records."""
    if kind is Frame:
        properties: dict[str, Any] = {
            "stamp_ns": {"type": "integer"},
            "frame": {"type": "integer"},
            "name": {"type": "string"},
            "picture": {"type": "string"},
            "stamp_sigma_s": {"type": "number"},
            "counts": {"type": "string"},
        }
        schema: dict[str, Any] = {"type": "object", "properties": properties}
    else:
        schema = _schema(kind)
    return f"pointclick.{kind.__name__}", json.dumps(schema, separators=(",", ":"))


def nav_event(kind: type[NavEvent], data: bytes) -> NavEvent:
    """The event that `event_json` wrote; fields added since then take their defaults. Raises InputError."""
    try:
        return _ADAPTERS[kind].validate_json(data, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        fault = f"without {where}" if first["type"] == "missing" else f"that is none: {where} {first['msg']}"
        raise InputError(f"a {kind.__name__} {fault}") from error


def frame_event(data: bytes) -> tuple[Frame, str, str]:
    """A frame as it was recorded, without its picture; the formats of that and of its counts. Raises InputError."""
    content = _object(data)
    try:
        name, sigma_s = str(content.get("name", "")), float(content.get("stamp_sigma_s", 0.0))
        frame = Frame(int(content["stamp_ns"]), int(content["frame"]), None, name, sigma_s)
        return frame, str(content.get("picture", "none")), str(content.get("counts", ""))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"a frame that is none: {error}") from error


def _object(data: bytes) -> dict[str, Any]:
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"an event that is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError("an event that is not a JSON object")
    return content


def _schema(hint: Any) -> dict[str, Any]:
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if hint in CHANNELS:  # an event that is part of another
        return {"type": "object", "properties": {name: _schema(inner) for name, inner in _HINTS[hint].items()}}
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return {"enum": list(inner)}
    if origin is tuple:
        return {"type": "array", "items": _schema(inner[0]), "minItems": len(inner), "maxItems": len(inner)}
    assert origin is types.UnionType, hint
    return {"anyOf": [{"type": "null"} if option is types.NoneType else _schema(option) for option in inner]}
