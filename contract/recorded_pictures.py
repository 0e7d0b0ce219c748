"""The places of the pictures of a session's files, found once and read when asked for.

Pictures as `recording.pictures` writes them: channel `pc/<vehicle>/pictures`, each before its frame's event. A file
with chunks has none here: its sets are read, its pictures not.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from contract import recording_format as names
from contract.mcap_records import CHANNEL, MESSAGE, MESSAGE_HEAD, Data, mapped, read_channel, records


@dataclass(frozen=True)
class _Place:
    file: int
    start: int
    length: int


@dataclass(eq=False)
class _Vehicle:
    by_frame: dict[int, _Place] = field(default_factory=dict)
    by_stamp_ns: dict[int, _Place] = field(default_factory=dict)


class PictureIndex:
    """Indexed once over all files of a session; damaged places are passed over (`ground.recording` names them)."""

    def __init__(self, path: Path) -> None:
        self._data: list[Data] = []
        self._vehicles: dict[str, _Vehicle] = {}
        for file, part in enumerate(names.session_files(path)):
            data = mapped(part)
            self._data.append(data)
            self._index(file, data)

    def has(self, vehicle: str, frame: int) -> bool:
        """Return whether a frame's picture is there."""
        known = self._vehicles.get(vehicle)
        return known is not None and frame in known.by_frame

    def has_any(self, vehicle: str) -> bool:
        """Return whether any picture of a vehicle is there."""
        known = self._vehicles.get(vehicle)
        return known is not None and bool(known.by_frame)

    def message(self, vehicle: str, frame: int) -> bytes | None:
        """The message of a frame's picture, a `foxglove.CompressedImage` as JSON, unchecked; None if there is none."""
        known = self._vehicles.get(vehicle)
        place = None if known is None else known.by_frame.get(frame)
        return None if place is None else bytes(self._data[place.file][place.start : place.start + place.length])

    def _index(self, file: int, data: Data) -> None:
        channels: dict[int, tuple[str, str]] = {}  # kind, vehicle
        for opcode, start, length in records(data, lambda _: None):
            if opcode == CHANNEL:
                number, topic, _ = read_channel(bytes(data[start : start + length]))
                kind = _kind(topic)
                if kind is not None:
                    channels[number] = kind
            elif opcode == MESSAGE:
                number, _, log_ns, _ = MESSAGE_HEAD.unpack_from(data, start)
                if number in channels:
                    kind_name, vehicle = channels[number]
                    body = start + MESSAGE_HEAD.size
                    self._note(kind_name, vehicle, file, body, length - MESSAGE_HEAD.size, log_ns)

    def _note(self, kind: str, vehicle: str, file: int, start: int, length: int, log_ns: int) -> None:
        known = self._vehicles.setdefault(vehicle, _Vehicle())
        data = self._data[file]
        if kind == "pictures":
            known.by_stamp_ns[log_ns] = _Place(file, start, length)
        else:
            event = _object(bytes(data[start : start + length]))
            frame, stamp_ns = event.get("frame"), event.get("stamp_ns")
            if isinstance(frame, int) and isinstance(stamp_ns, int):
                place = known.by_stamp_ns.pop(stamp_ns, None)
                if place is not None:
                    known.by_frame[frame] = place


def _kind(topic: str) -> tuple[str, str] | None:
    for kind, template in (
        ("pictures", names.PICTURES),
        ("frames", names.FRAMES),
    ):
        before, after = template.split("{vehicle}")
        if topic.startswith(before) and topic.endswith(after) and len(topic) > len(before) + len(after):
            return kind, topic[len(before) : len(topic) - len(after)]
    return None


def _object(content: bytes) -> dict[str, Any]:
    try:
        message = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
