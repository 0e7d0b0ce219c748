"""One MCAP file of a session: every event the pipeline saw, every set it made. docs/wire-format.md, section 9.

No chunks, and every message is handed to the system at once: a killed process loses nothing, a power cut what came
after the last `sync`. The same session gives the same bytes. `rotating_recorder` makes a live session's files of it.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from contract import recording_format as names
from contract.closing import Closing
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.secrets import new_recording
from contract.topics import FEATURES, Topic
from contract.wire.codec import encode
from onboard.events.types import Event, Frame, PositionFix
from onboard.storage import foxglove_schemas
from onboard.storage.event_json import CHANNELS, event_json, event_schema

# Messages for viewers are written at most so often, by the clock of the data: they are only looked at.
VIEW_LOCATION_NS = 200_000_000
VIEW_FEATURES_NS = 1_000_000_000
JPEG_QUALITY = 85
# A 640x480 picture of the ground takes 97 kB and 4.3 ms. Stronger compression takes twice the time for 2 %.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
_OBJECT_SCHEMA = '{"type":"object"}'


def encode_picture(image: NDArray[np.uint8] | NDArray[np.uint16], pictures: str) -> tuple[bytes, str]:
    """A picture (H, W) or, as JPEG, (H, W, 3) as `recording.pictures` asks, and the format; empty for "none"."""
    if pictures == "none":
        return b"", ""
    if pictures == "jpeg":
        is_done, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    else:
        is_done, encoded = cv2.imencode(".png", image, _PNG)
    assert is_done
    return encoded.tobytes(), "jpeg" if pictures == "jpeg" else "png"


class SessionRecorder(Closing):
    """Writes events, sets and status of one vehicle to `path`, replacing what was there.

    The file appears with the first thing written, so that input which is refused before leaves nothing behind.
    `state_json` is what had been learned when the session began; `part` counts the session's files from 1, and
    `is_complete` states that nothing is missing since its beginning: with these a replay knows what it has.
    Raises InputError where the file cannot be created or written.
    """

    def __init__(
        self,
        path: Path | str,
        vehicle: str,
        *,
        config_text: str = "",
        camera_json: str = "",
        second_camera_json: str = "",
        software_version: str = "",
        state_json: str = "",
        pictures: str = "none",
        part: int = 1,
        is_complete: bool = True,
    ) -> None:
        self.path = Path(path)
        self._vehicle = vehicle
        self._pictures = pictures
        self._metadata = {
            "vehicle": vehicle,
            "config": config_text,
            "camera": camera_json,
            "version": software_version,
            "state": state_json,
            "pictures": pictures,
            "part": str(part),
            "complete": "yes" if is_complete else "no",
            **({"second_camera": second_camera_json} if second_camera_json else {}),
        }
        self._stream: io.BufferedWriter | None = None
        self._whole_bytes = 0  # of the file, up to its last whole message
        self._writer: Writer | None = None
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._viewed_ns: dict[str, int] = {}

    @property
    def has_message(self) -> bool:
        """True if the file holds, or held when it was closed, at least one whole message."""
        return self._whole_bytes > 0

    @property
    def size_bytes(self) -> int:
        return 0 if self._stream is None else self._stream.tell()

    def write_event(self, event: Event, arrival_ns: int | None = None) -> None:
        """Record an event with the time at which it came; a frame after its picture, so that none is without."""
        arrival_ns = event.stamp_ns if arrival_ns is None else arrival_ns
        if isinstance(event, Frame):
            self._write_frame(event, arrival_ns, names.FIRST_CAMERA)
            return
        name, schema = event_schema(type(event))
        channel = self._channel(CHANNELS[type(event)], "json", name, schema)
        self._write(channel, arrival_ns, event.stamp_ns, event_json(event))
        if isinstance(event, PositionFix):
            fix = event
            self._view(
                names.VIEW_VEHICLE,
                foxglove_schemas.LOCATION,
                fix.stamp_ns,
                lambda: foxglove_schemas.vehicle_location(fix),
                VIEW_LOCATION_NS,
            )

    def write_second_picture(self, frame: Frame) -> None:
        if self._pictures != "none":
            self._write_frame(frame, frame.stamp_ns, names.SECOND_CAMERA)

    def _write_frame(self, frame: Frame, arrival_ns: int, to: names.CameraChannels) -> None:
        kind = counts = ""
        if frame.image is not None:
            if frame.counts is not None and self._pictures == "lossless":
                counts = self._write_picture(frame.counts, frame.stamp_ns, to.counts)
            shown = frame.image if frame.colour is None or self._pictures != "jpeg" else frame.colour
            kind = self._write_picture(shown, frame.stamp_ns, to.pictures)
        channel = self._channel(to.frames, "json", *event_schema(Frame))
        self._write(channel, arrival_ns, frame.stamp_ns, event_json(frame, kind, counts))

    def _write_picture(self, image: NDArray[np.uint8] | NDArray[np.uint16], stamp_ns: int, template: str) -> str:
        """Returns how, empty where pictures are not recorded."""
        encoded, kind = encode_picture(image, self._pictures)
        if encoded:
            message = foxglove_schemas.picture(stamp_ns, encoded, kind)
            self._view(template, foxglove_schemas.PICTURE, stamp_ns, lambda: message)
        return kind

    def write_set(self, feature_set: FeatureSet, payload: bytes | None = None) -> None:
        """Record a set's wire bytes at its capture time; encoded here unless given. Raises ValueError as `encode`."""
        s = feature_set
        if payload is None:
            payload = encode(s)
        channel = self._channel(FEATURES.template, FEATURES.encoding)
        self._write(channel, s.capture_unix_ns, s.capture_unix_ns, payload)
        if s.is_ok:
            at_ns = s.capture_unix_ns
            self._view(
                names.VIEW_CAMERA,
                foxglove_schemas.LOCATION,
                at_ns,
                lambda: foxglove_schemas.camera_location(s),
                VIEW_LOCATION_NS,
            )
            self._view(
                names.VIEW_FEATURES,
                foxglove_schemas.GEOJSON,
                at_ns,
                lambda: foxglove_schemas.features_on_the_map(s),
                VIEW_FEATURES_NS,
            )

    def write_report(self, topic: Topic, stamp_ns: int, payload: bytes) -> None:
        """Record a report of the link, as it was sent."""
        channel = self._channel(topic.template, topic.encoding, topic.schema, _OBJECT_SCHEMA)
        self._write(channel, stamp_ns, stamp_ns, payload)

    def write_gap(self, begin_ns: int, end_ns: int, content: bytes) -> None:
        """Record that something is missing here, and mark the file as not complete."""
        channel = self._channel(names.GAPS, "json", "pointclick.Gap", _OBJECT_SCHEMA)
        self._write(channel, end_ns, begin_ns, content)
        if self._metadata["complete"] == "yes":
            self._metadata["complete"] = "no"
            try:
                self._open().add_metadata(names.METADATA_NAME, self._metadata)
            except OSError as error:
                raise self._failure(error) from error

    def sync(self) -> None:
        """Wait until all that was written is on the disk."""
        if self._stream is not None:
            try:
                os.fdatasync(self._stream.fileno())
            except OSError as error:
                raise self._failure(error) from error

    def close(self) -> None:
        """Write the summary and close. A recorder that wrote nothing leaves no file."""
        if self._writer is None or self._stream is None:
            return
        try:
            self._writer.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._failure(error) from error
        finally:
            stream, self._stream, self._writer = self._stream, None, None
            with contextlib.suppress(OSError):  # the same error as of the flush above
                stream.close()

    def abandon(self) -> None:
        """Close after a failed write: the file ends with its last whole message, without a summary, as after a kill.

        One without a whole message is removed.
        """
        if self._stream is None:
            return
        stream, self._stream, self._writer = self._stream, None, None
        with contextlib.suppress(OSError):
            stream.close()
        with contextlib.suppress(OSError):
            if self._whole_bytes:
                os.truncate(self.path, self._whole_bytes)
            elif self.path.is_file():
                self.path.unlink()

    def _failure(self, error: OSError) -> InputError:
        return InputError(f"recording {self.path}: {error.strerror}")

    def _open(self) -> Writer:
        if self._writer is None:
            try:
                self._stream = new_recording(self.path, is_new=False)
                # Chunks would keep the last megabyte in memory, and without them there is nothing to compress.
                self._writer = Writer(self._stream, use_chunking=False, compression=CompressionType.NONE)
                self._writer.start(profile="", library="pointclick")
                self._writer.add_metadata(names.METADATA_NAME, self._metadata)
            except OSError as error:
                raise self._failure(error) from error
        return self._writer

    def _channel(self, template: str, encoding: str, schema_name: str = "", schema: str = "") -> int:
        key = template.format(vehicle=self._vehicle)
        if key not in self._channels:
            writer, schema_id = self._open(), 0
            try:
                if schema_name:
                    if schema_name not in self._schemas:
                        self._schemas[schema_name] = writer.register_schema(schema_name, "jsonschema", schema.encode())
                    schema_id = self._schemas[schema_name]
                self._channels[key] = writer.register_channel(key, encoding, schema_id)
            except OSError as error:
                raise self._failure(error) from error
        return self._channels[key]

    def _view(
        self, template: str, schema_name: str, stamp_ns: int, message: Callable[[], bytes], every_ns: int = 0
    ) -> None:
        """Write something for viewers, unless there was one a moment before."""
        last_ns = self._viewed_ns.get(template)
        if every_ns and last_ns is not None and stamp_ns < last_ns + every_ns:
            return
        self._viewed_ns[template] = stamp_ns
        channel = self._channel(template, "json", schema_name, foxglove_schemas.schema(schema_name))
        self._write(channel, stamp_ns, stamp_ns, message())

    def _write(self, channel: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        assert self._writer is not None and self._stream is not None
        sequence = self._sequences.get(channel, 0)
        self._sequences[channel] = sequence + 1
        try:
            self._writer.add_message(channel, log_ns, data, publish_ns, sequence)
            self._stream.flush()
            self._whole_bytes = self._stream.tell()
        except OSError as error:
            raise self._failure(error) from error
