"""A session as an MCAP file: every event the pipeline saw, every set it made. docs/wire-format.md, section 9.

No chunks, and every message is handed to the system at once: a killed process loses nothing, a power cut at most
`sync_interval_s`. The same session gives the same bytes.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import time
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer

from contract import recording_format as names
from contract.codec import encode
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.topics import FEATURES
from onboard.events import Attitude, Event, FilterStatus, Frame, GimbalAttitude, GpsQuality, PositionFix, RangeFinder

_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_NUMBER_OR_NULL = {"type": ["number", "null"]}
_STAMP = {"stamp_ns": _INTEGER}

# Channel template, schema name and properties of each event.
_EVENTS: dict[type[Event], tuple[str, str, dict[str, Any]]] = {
    Frame: (names.FRAMES, "pointclick.Frame", {**_STAMP, "frame": _INTEGER, "name": {"type": "string"}}),
    PositionFix: (
        names.POSITIONS,
        "pointclick.PositionFix",
        {
            **_STAMP,
            "lat_deg": _NUMBER,
            "lon_deg": _NUMBER,
            "height_amsl_m": _NUMBER,
            "velocity_ned_m_s": {"type": ["array", "null"], "items": _NUMBER},
            "height_above_home_m": _NUMBER_OR_NULL,
        },
    ),
    GpsQuality: (
        names.GPS_QUALITY,
        "pointclick.GpsQuality",
        {
            **_STAMP,
            "fix_type": _INTEGER,
            "satellites": {"type": ["integer", "null"]},
            "sigma_horizontal_m": _NUMBER_OR_NULL,
            "sigma_vertical_m": _NUMBER_OR_NULL,
            "sigma_velocity_m_s": _NUMBER_OR_NULL,
            "undulation_m": _NUMBER_OR_NULL,
        },
    ),
    Attitude: (
        names.ATTITUDES,
        "pointclick.Attitude",
        {**_STAMP, "q_ned_body": {"type": "array", "items": _NUMBER}},
    ),
    FilterStatus: (
        names.FILTER_STATUS,
        "pointclick.FilterStatus",
        {**_STAMP, "has_position": {"type": "boolean"}, "is_glitching": {"type": "boolean"}},
    ),
    GimbalAttitude: (
        names.GIMBAL_ATTITUDES,
        "pointclick.GimbalAttitude",
        {**_STAMP, "q_ref_gimbal": {"type": "array", "items": _NUMBER}, "reference": {"type": "string"}},
    ),
    RangeFinder: (
        names.RANGES,
        "pointclick.RangeFinder",
        {
            **_STAMP,
            "distance_m": _NUMBER,
            "direction_body": {"type": "array", "items": _NUMBER},
            "sigma_m": _NUMBER_OR_NULL,
        },
    ),
}


class SessionRecorder:
    """Writes events and sets of one vehicle to `path`, replacing what was there.

    The file appears with the first thing written, so that input which is refused before leaves nothing behind.
    Raises InputError where the file cannot be created or written.
    """

    def __init__(
        self,
        path: Path | str,
        vehicle: str,
        *,
        config_text: str = "",
        camera_json: str = "",
        software_version: str = "",
        sync_interval_s: float = 1.0,
    ) -> None:
        self.path = Path(path)
        self._vehicle = vehicle
        self._features_key = FEATURES.key(vehicle)
        self._metadata = {"vehicle": vehicle, "config": config_text, "camera": camera_json, "version": software_version}
        self._sync_interval_s = sync_interval_s
        self._synced_at = 0.0
        self._stream: io.BufferedWriter | None = None
        self._whole_bytes = 0  # of the file, up to its last whole message
        self._writer: Writer | None = None
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}

    def write_event(self, event: Event) -> None:
        """Record an event at its own stamp; a frame without its picture."""
        template, schema, properties = _EVENTS[type(event)]
        if isinstance(event, Frame):
            content: dict[str, Any] = {"stamp_ns": event.stamp_ns, "frame": event.index, "name": event.name}
        else:
            content = asdict(event)
        writer = self._open()
        key = template.format(vehicle=self._vehicle)
        if key not in self._channels:
            text = json.dumps({"type": "object", "properties": properties}, separators=(",", ":"))
            schema_id = writer.register_schema(schema, "jsonschema", text.encode())
            self._channels[key] = writer.register_channel(key, "json", schema_id)
        self._write(self._channels[key], event.stamp_ns, json.dumps(content, separators=(",", ":")).encode())

    def write_set(self, feature_set: FeatureSet, payload: bytes | None = None) -> None:
        """Record a set's wire bytes at its capture time; encoded here unless given. Raises ValueError as `encode`."""
        if payload is None:
            payload = encode(feature_set)
        writer = self._open()
        if self._features_key not in self._channels:
            self._channels[self._features_key] = writer.register_channel(self._features_key, names.SET_ENCODING, 0)
        self._write(self._channels[self._features_key], feature_set.capture_unix_ns, payload)

    def close(self) -> None:
        """Write the summary and close. A recorder that wrote nothing leaves no file."""
        if self._writer is None or self._stream is None:
            return
        try:
            self._writer.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise InputError(f"recording {self.path}: {error.strerror}") from error
        finally:
            stream, self._stream, self._writer = self._stream, None, None
            with contextlib.suppress(OSError):  # the same again that the flush above has said
                stream.close()

    def abandon(self) -> None:
        """Close after a failed write: the file ends with its last whole message, without a summary, as after a kill."""
        if self._stream is None:
            return
        stream, self._stream, self._writer = self._stream, None, None
        with contextlib.suppress(OSError):
            stream.close()
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._whole_bytes)

    def __enter__(self) -> SessionRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _open(self) -> Writer:
        if self._writer is None:
            try:
                self._stream = self.path.open("wb")
            except OSError as error:
                raise InputError(f"recording {self.path}: {error.strerror}") from error
            # Chunks would keep the last megabyte in memory, and without them there is nothing to compress.
            self._writer = Writer(self._stream, use_chunking=False, compression=CompressionType.NONE)
            self._writer.start(profile="", library="pointclick")
            self._writer.add_metadata(names.METADATA_NAME, self._metadata)
        return self._writer

    def _write(self, channel: int, stamp_ns: int, data: bytes) -> None:
        assert self._writer is not None and self._stream is not None
        sequence = self._sequences.get(channel, 0)
        self._sequences[channel] = sequence + 1
        try:
            self._writer.add_message(channel, stamp_ns, data, stamp_ns, sequence)
            self._stream.flush()
            self._whole_bytes = self._stream.tell()
            if time.monotonic() - self._synced_at >= self._sync_interval_s:
                os.fsync(self._stream.fileno())
                self._synced_at = time.monotonic()
        except OSError as error:
            raise InputError(f"recording {self.path}: {error.strerror}") from error
