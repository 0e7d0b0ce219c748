"""A recorded session, read back: the events as they entered the pipeline, and the sets that came of them.

Every part of the session in order, each up to where it ends or was cut off, past what is damaged in it.
"""

from __future__ import annotations

import base64
import contextlib
import functools
import io
import json
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Message, Metadata
from numpy.typing import NDArray
from PIL import Image

from contract import recording_format as names
from contract.camera import Camera
from contract.errors import InputError, WireError
from contract.mcap_records import MAGIC, Damage
from contract.topics import FEATURES
from contract.wire.codec import peek
from onboard.events.types import Event, Frame
from onboard.storage.event_json import NAV_EVENTS, frame_event, nav_event
from onboard.storage.mcap_records import Found, Lost, walk
from onboard.storage.recording_queue import Gap

# Exceptions of a damaged message or a damaged picture's head (binascii's error is a ValueError).
_NO_PICTURE = (
    ValueError,
    KeyError,
    TypeError,
    OSError,
    SyntaxError,
    EOFError,
    struct.error,
    Image.DecompressionBombError,
)


def parts_of(path: Path) -> list[Path]:
    """All parts of the session that a file belongs to, or of the one session in a folder. Raises InputError."""
    if not path.exists():
        raise InputError(f"recording {path}: no such file")
    return names.session_files(path)


@dataclass(eq=False)
class RecordedFlight:
    """A session's files, opened and looked through. It replays as `onboard.replay.runner.Flight` does."""

    paths: list[Path]
    vehicle: str
    config_text: str
    camera: Camera
    state_json: str
    version: str
    second_camera: Camera | None = None  # next to it
    session: int | None = None  # number of its sets; None: it holds none
    stamps_ns: list[int] = field(default_factory=list)  # of the pictures
    formats: Counter[str] = field(default_factory=Counter)  # in which they were recorded
    counts: Counter[str] = field(default_factory=Counter)  # records by channel, the vehicle's name left out
    gaps: list[Path] = field(default_factory=list)  # parts before which something is missing
    dropped: dict[Path, list[Gap]] = field(default_factory=dict)  # what the recorder reports to have left out

    damaged: dict[Path, list[Damage]] = field(default_factory=dict)  # stretches that cannot be read
    lost: dict[Path, Counter[str]] = field(default_factory=dict)  # what they held, by channel, so far as is known
    # Events whose content cannot be read, by channel: known once `events` has come by them.
    unreadable: dict[Path, Counter[str]] = field(default_factory=dict)

    @classmethod
    def open(cls, paths: Sequence[Path]) -> RecordedFlight:
        """Look through them. Raises InputError, one line, for what is no recording of ours or cannot be replayed."""
        files = list(dict.fromkeys(part for path in paths for part in parts_of(path)))
        flight: RecordedFlight | None = None
        for file in files:
            flight = _look_through(file, flight)
        if flight is None:
            raise InputError(f"recording {', '.join(map(str, files))}: ends before its metadata")
        flight.paths = files
        if not flight.stamps_ns or flight.formats["none"] == len(flight.stamps_ns):
            raise InputError(
                f"recording {files[0]}: holds no pictures, and they are what a replay starts from (record with "
                f'recording.pictures = "lossless"); in it: {flight.content}'
            )
        return flight

    @property
    def content(self) -> str:
        return ", ".join(f"{count} {name}" for name, count in sorted(self.counts.items())) or "nothing"

    @property
    def caveats(self) -> list[str]:
        """Reasons why a replay may not give the same bytes; none if it does."""
        found = [f"events are missing before {path.name}" for path in self.gaps]
        found += [f"{path.name} lacks {_in_words(gaps)}" for path, gaps in self.dropped.items()]
        found += [self._damage_of(path) for path in self.paths if path in self.damaged or path in self.lost]
        for path, names_of in self.unreadable.items():
            content = ", ".join(f"{count} {name}" for name, count in sorted(names_of.items()))
            found.append(f"{path.name} has events whose content is damaged: {content} left out")
        if self.formats["jpeg"]:
            found.append(f"{self.formats['jpeg']} pictures are JPEG, not as the pipeline saw them")
        if self.formats["none"]:
            found.append(f"{self.formats['none']} pictures were not recorded")
        return found

    def _damage_of(self, path: Path) -> str:
        stretches = self.damaged.get(path, [])
        places = "in its channels" if not stretches else f"at byte {stretches[0].start}"
        places += f" and {len(stretches) - 1} later" if stretches[1:] else ""
        size = sum(damage.end - damage.start for damage in stretches)
        lost = ", ".join(f"{count} {name}" for name, count in sorted(self.lost.get(path, Counter()).items()))
        return f"{path.name} is damaged {places}, {size} bytes passed over: {lost or 'nothing known'} lost"

    def events(self) -> Iterator[tuple[int, Event]]:
        """Every event with its arrival (Unix ns), in the order of the pipeline; `unreadable` counts what is left out.

        Raises InputError, at the end, if none of a channel's could be read: that is no damage but another format.
        """
        self.unreadable.clear()
        read: set[str] = set()
        errors: dict[str, InputError] = {}
        for path in self.paths:
            frames = _Frames(names.FIRST_CAMERA, self.camera)
            for record in _records(path):
                if not isinstance(record, tuple):
                    frames.is_damaged = frames.is_damaged or isinstance(record, Damage)
                    continue
                channel, message = record
                kind, name = _kind(channel.topic, self.vehicle), _name(channel.topic, self.vehicle)
                try:
                    event: Event | None = frames.take(kind, message)
                    if kind in NAV_EVENTS:
                        event = nav_event(NAV_EVENTS[kind], message.data)
                except InputError as error:
                    errors.setdefault(name, InputError(f"recording {path}: {error}"))
                    self.unreadable.setdefault(path, Counter())[name] += 1
                    continue
                if event is not None:
                    read.add(name)
                    yield message.log_time, event
        for name, unread in errors.items():
            if name not in read:
                raise unread

    @property
    def has_second_counts(self) -> bool:
        """True if counts of the second camera were recorded, in which hot spots can be looked for."""
        return self.second_camera is not None and self.counts[_name(names.SECOND_CAMERA.counts, "{vehicle}")] > 0

    def second_pictures(self) -> Iterator[Frame]:
        """The second camera's recorded pictures in their order; those that cannot be read are left out."""
        if self.second_camera is None:
            return
        for path in self.paths:
            frames = _Frames(names.SECOND_CAMERA, self.second_camera)
            for channel, message in _messages(path):
                with contextlib.suppress(InputError):
                    frame = frames.take(_kind(channel.topic, self.vehicle), message)
                    if frame is not None:
                        yield frame

    def sets(self) -> Iterator[bytes]:
        """The payloads of the sets, in the order in which they were made."""
        for path in self.paths:
            for channel, message in _messages(path):
                if channel.message_encoding == FEATURES.encoding and channel.topic == FEATURES.key(self.vehicle):
                    yield message.data


def _kind(topic: str, vehicle: str) -> str:
    """A channel's template, if it is this vehicle's."""
    return topic.replace(f"pc/{vehicle}/", "pc/{vehicle}/", 1)


def _name(topic: str, vehicle: str) -> str:
    return _kind(topic, vehicle).removeprefix("pc/{vehicle}/") or "of unknown channels"


def _note_lost(flight: RecordedFlight, path: Path, name: str, count: int) -> None:
    flight.lost.setdefault(path, Counter())[name] += count


class _Frames:
    """A camera's frames in one file of a session, message by message; each takes the picture before it."""

    def __init__(self, channels: names.CameraChannels, camera: Camera) -> None:
        self.is_damaged = False  # so far
        self._channels, self._camera = channels, camera
        self._picture: tuple[int, bytes] | None = None
        self._counts: tuple[int, bytes] | None = None

    def take(self, kind: str, message: Message) -> Frame | None:
        """The frame that a message ends, if it ends one. Raises InputError for content that cannot be read."""
        if kind == self._channels.pictures:
            self._picture = message.publish_time, message.data
        elif kind == self._channels.counts:
            self._counts = message.publish_time, message.data
        elif kind == self._channels.frames:
            return self._frame(message.data)
        return None

    def _frame(self, data: bytes) -> Frame | None:
        frame, as_recorded, counted = frame_event(data)
        if as_recorded not in ("png", "jpeg"):
            return None if as_recorded == "none" else frame
        if self._picture is None or self._picture[0] != frame.stamp_ns:
            if self.is_damaged:
                return None  # its picture was in a stretch that cannot be read
            raise InputError(f"frame {frame.index} without its picture")
        image = decoded_picture(self._picture[1], self._camera).astype(np.uint8, copy=False)
        counts = None
        if counted == "png" and self._counts is not None and self._counts[0] == frame.stamp_ns:
            counts = decoded_picture(self._counts[1], self._camera, True).astype(np.uint16, copy=False)
        return replace(frame, image=image, counts=counts)


def _look_through(path: Path, flight: RecordedFlight | None) -> RecordedFlight | None:
    """Add a part to what is known of its session; None while that is nothing."""
    has_begun = False
    picture_ns: int | None = None
    for record in _records(path):
        if isinstance(record, Damage | Lost):
            _note_damage(flight, path, record)
        elif isinstance(record, Metadata) and record.name == names.METADATA_NAME:
            flight = _with_metadata(flight, path, record.metadata, has_begun)
            has_begun = True  # further metadata of a part repeat it after a gap, which has a record of its own
        elif isinstance(record, tuple):
            if flight is None:
                raise InputError(f"recording {path}: has no metadata of camera and configuration")
            channel, message = record
            picture_ns = _count(flight, path, channel, message, picture_ns)
    return flight


def _note_damage(flight: RecordedFlight | None, path: Path, record: Damage | Lost) -> None:
    if flight is None:
        raise InputError(f"recording {path}: damaged before its metadata")
    if isinstance(record, Damage):
        flight.damaged.setdefault(path, []).append(record)
    else:
        _note_lost(flight, path, _name(record.topic, flight.vehicle), record.count)


def _with_metadata(
    flight: RecordedFlight | None, path: Path, metadata: dict[str, str], has_begun: bool
) -> RecordedFlight:
    """The flight with what a part's own metadata state; begun by them if it is None."""
    if flight is None:
        flight = _begin(path, metadata)
    elif metadata.get("vehicle") != flight.vehicle:
        raise InputError(f"recording {path}: of vehicle {metadata.get('vehicle')!r}, not {flight.vehicle!r}")
    if metadata.get("complete") == "no" and not has_begun:
        flight.gaps.append(path)
    return flight


def _count(
    flight: RecordedFlight, path: Path, channel: Channel, message: Message, picture_ns: int | None
) -> int | None:
    """Count a message of a part; returns the stamp of the newest picture. `events` counts what cannot be read."""
    kind = _kind(channel.topic, flight.vehicle)
    flight.counts[_name(channel.topic, flight.vehicle)] += 1
    if kind == names.PICTURES:
        picture_ns = message.publish_time
    if channel.message_encoding == FEATURES.encoding and flight.session is None:
        with contextlib.suppress(WireError):
            flight.session = peek(message.data).session
    if kind == names.GAPS:
        flight.dropped.setdefault(path, []).append(Gap.from_json(message.data))
    if kind == names.FRAMES:
        with contextlib.suppress(InputError):
            frame, as_recorded, _ = frame_event(message.data)
            if path in flight.damaged and as_recorded in ("png", "jpeg") and picture_ns != frame.stamp_ns:
                _note_lost(flight, path, "frames without their pictures", 1)
            else:
                flight.stamps_ns.append(frame.stamp_ns)
                flight.formats[as_recorded] += 1
    return picture_ns


def _in_words(gaps: list[Gap]) -> str:
    whole = functools.reduce(Gap.and_then, gaps)
    places = "in one place" if len(gaps) == 1 else f"in {len(gaps)} places"
    return f"{str(whole) or 'records'}, {places}: {whole.reason}"


def _begin(path: Path, metadata: dict[str, str]) -> RecordedFlight:
    if not metadata.get("camera"):
        raise InputError(f"recording {path}: without the camera's optics")
    camera = Camera.from_text(metadata["camera"], f"recording {path}: camera")
    second = metadata.get("second_camera")
    return RecordedFlight(
        [],
        metadata.get("vehicle", ""),
        metadata.get("config", ""),
        camera,
        metadata.get("state", ""),
        metadata.get("version", ""),
        Camera.from_text(second, f"recording {path}: second camera") if second else None,
    )


def _messages(path: Path) -> Iterator[tuple[Channel, Message]]:
    return (record for record in _records(path) if isinstance(record, tuple))


def _records(path: Path) -> Iterator[Found]:
    """The content of a file, as `walk` finds it. Raises InputError if it is no MCAP file or cannot be read."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(f"recording {path}: not an MCAP file")
            yield from walk(stream)
    except OSError as error:
        raise InputError(f"recording {path}: {error.strerror}") from error


def decoded_picture(message: bytes, camera: Camera, is_deep: bool = False) -> NDArray[np.generic]:
    """The picture of a `foxglove.CompressedImage` (H, W), grey or, if asked for, as deep as it is.

    Of the camera's size: a damaged one may claim any other. Pillow decodes it: OpenCV takes seconds over some damaged
    pictures, and hands out others half grey.
    """
    try:
        encoded = base64.b64decode(json.loads(message)["data"], validate=True)
        with Image.open(io.BytesIO(encoded), formats=("PNG", "JPEG")) as picture:
            if picture.size == camera.size_px:
                return np.asarray(picture if is_deep and picture.mode.startswith("I") else picture.convert("L"))
            width_px, height_px = picture.size
    except _NO_PICTURE as error:
        raise InputError(f"a picture that cannot be decoded: {error}") from error
    raise InputError(f"a picture of {width_px} x {height_px}, which is not the camera's size")
