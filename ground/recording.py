"""The sets of a recorded session, read with the standard library.

A file cut off anywhere (a killed process, a lost disk) is read up to the cut, one damaged in the middle on both sides
of it. A session's further parts (`NAME.002.mcap`, ...) are read along with it. A file with chunks, which pc-onboard
does not write but other tools may, is read through the `mcap` package if that is installed.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar

from contract import recording_format as names
from contract.errors import ForeignMessage, InputError, WireError
from contract.feature_set import FeatureSet, Status
from contract.mcap_records import CHANNEL, CHUNK, MAGIC, MESSAGE, MESSAGE_HEAD, Damage, Data, read_channel, records
from contract.topics import TIME_TOLERANCE_S
from contract.wire.codec import decode
from contract.wire.message import SETS, Payload, payload_of, peek_set
from ground.dropped_messages import DroppedMessages

T = TypeVar("T")

SOME = 5  # sets of a session that are looked at where a recording seems to hold several
NEIGHBOURS = 2  # messages before and after one, that show when it was recorded
_Found = tuple[str, str, int, int, int]  # topic, encoding, start, length and log time (ns) of a message
_FRAMES_BEFORE, _FRAMES_AFTER = names.FRAMES.split("{vehicle}")


@dataclass(frozen=True)
class _Held:
    """The position in the files of the latest revision of one frame's set."""

    frame: int
    revision: int
    capture_unix_ns: int
    status: Status
    file: int
    start: int
    length: int

    @property
    def is_ok(self) -> bool:
        return self.status is Status.OK


@dataclass(eq=False)
class _Index:
    sets: dict[str, dict[int, _Held]] = field(default_factory=dict)  # by vehicle and frame
    frames: dict[str, list[tuple[int, int, int]]] = field(
        default_factory=dict
    )  # by vehicle: file, start, length of frame events
    # By vehicle and session: where some of its sets are.
    sessions: dict[str, dict[int, list[tuple[int, int, int]]]] = field(default_factory=dict)
    # Keys, places and log times of the reports, by topic and vehicle.
    reports: dict[tuple[str, str], list[tuple[str, int, int, int, int]]] = field(default_factory=dict)


class Recording:
    """The sets of a session, indexed once. Raises InputError for what is no recording of this project, and for one of
    several sessions, as files that were joined or renamed are: a frame's number would mean a picture of each.

    `path` is any of the session's files, or a folder that holds one session. `damage` reports, a line each, where a
    file is damaged so that records are missing; a file that ends early is not.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._index = _Index()
        self._data: list[Data] = []
        self.damage: list[str] = []
        self._foreign = DroppedMessages()
        parts = names.session_files(self.path)
        for file, part in enumerate(parts):
            data = _read(part, may_be_empty=len(parts) > 1)
            self._data.append(data)
            found: Iterable[_Found] = _messages(data, partial(self._warn, part))
            if _is_chunked(data):
                self._data[file], found, trouble = _chunked_messages(part)
                if trouble:
                    self.damage.append(f"recording {part}: {trouble}; what comes after is missing")
            for topic, encoding, *where in found:
                self._note(topic, encoding, file, *where)
        self.damage += [f"recording {self.path}: {line}" for line in self._foreign.lines()]
        if not self._index.sets:
            raise InputError("; ".join([f"recording {self.path}: holds no feature sets", *self._foreign.lines()]))
        for name in self._index.sets:
            self._check_is_one_session(name)
        self._newest_ns = {
            name: max(held.capture_unix_ns for held in sets.values()) for name, sets in self._index.sets.items()
        }

    @property
    def vehicles(self) -> list[str]:
        return sorted(self._index.sets)

    def frames(self, vehicle: str) -> list[int]:
        return sorted(self._index.sets[vehicle])

    def rows(self, vehicle: str) -> list[tuple[int, int, int, Status]]:
        """Frame, revision, capture time (Unix ns) and status of every set, in capture order; nothing is decoded."""
        held = sorted(self._index.sets[vehicle].values(), key=lambda h: (h.capture_unix_ns, h.frame))
        return [(h.frame, h.revision, h.capture_unix_ns, h.status) for h in held]

    def by_frame(self, vehicle: str, frame: int) -> FeatureSet | None:
        return self._decoded(self._index.sets[vehicle].get(frame))

    def age_s(self, feature_set: FeatureSet) -> float:
        """Seconds by which a set's picture is older than the newest one of its vehicle."""
        return (self._newest_ns[feature_set.vehicle] - feature_set.capture_unix_ns) / 1e9

    def newest_picture(self, vehicle: str) -> FeatureSet | None:
        """The newest set, whether it answers or refuses."""
        held = self._index.sets[vehicle].values()
        return self._decoded(max(held, key=lambda h: (h.capture_unix_ns, h.frame), default=None))

    def newest(self, vehicle: str) -> FeatureSet | None:
        """The newest set that answers clicks, or the newest refusal if none does."""
        held = self._index.sets[vehicle].values()
        return self._decoded(max(held, key=lambda h: (h.is_ok, h.capture_unix_ns, h.frame), default=None))

    def by_time(self, vehicle: str, unix_s: float) -> FeatureSet | None:
        """The set captured nearest to a time, within half a second."""
        asked = round(unix_s * 1e9)
        held = min(self._index.sets[vehicle].values(), key=lambda h: abs(h.capture_unix_ns - asked), default=None)
        if held is None or abs(held.capture_unix_ns - asked) > TIME_TOLERANCE_S * 1e9:
            return None
        return self._decoded(held)

    def reports(self, kind: Payload[T], vehicles: Iterable[str]) -> list[T]:
        """The reports of a kind from flight, each vehicle's in recorded order; what cannot be read is left out."""
        return [report for name in vehicles for _, report in self._reports(kind, name)]

    def received(self, kind: Payload[T], vehicles: Iterable[str]) -> list[tuple[int, T]]:
        """The same with the time (Unix ns) at which each was recorded, in its order.

        An aircraft notes a stamp as the time of recording: a false one is not that of the messages next to it, so the
        median of theirs is taken.
        """
        out = [came for name in vehicles for came in _by_neighbours(self._reports(kind, name))]
        return sorted(out, key=lambda came: came[0])

    def _reports(self, kind: Payload[T], vehicle: str) -> list[tuple[int, T]]:
        places = self._index.reports.get((kind.topic.name, vehicle), [])
        messages = ((key, bytes(self._data[file][a : a + length]), at) for key, file, a, length, at in places)
        return [(at_ns, report) for key, message, at_ns in messages for report in kind.found(key, message)]

    def frame_of_file(self, vehicle: str, name: str) -> int | None:
        """The frame a picture file of this name was. Raises InputError if the recording holds no names."""
        events = self._index.frames.get(vehicle, [])
        if not events:
            raise InputError(f"recording {self.path}: holds no picture names, use --frame")
        quoted = json.dumps(name).encode()
        for file, start, length in events:
            text = self._data[file][start : start + length]
            if quoted in text:
                event = self._json(text)
                if event.get("name") == name and isinstance(event.get("frame"), int):
                    return int(event["frame"])
        return None

    def _warn(self, part: Path, where: Damage) -> None:
        size = where.end - where.start
        self.damage.append(f"recording {part}: damaged from byte {where.start} on; {size} bytes were passed over")

    def _json(self, text: bytes) -> dict[str, Any]:
        try:
            event = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"recording {self.path}: a frame event is not JSON ({error})") from error
        if not isinstance(event, dict):
            raise InputError(f"recording {self.path}: a frame event is not an object: {event!r}")
        return event

    def _decoded(self, held: _Held | None) -> FeatureSet | None:
        if held is None:
            return None
        try:
            return decode(bytes(self._data[held.file][held.start : held.start + held.length]))
        except WireError as error:
            raise InputError(f"recording {self.path}: the set of frame {held.frame}: {error}") from error

    def _check_is_one_session(self, vehicle: str) -> None:
        """Raise InputError for sets of several sessions; a number that damage made is none."""
        found = self._index.sessions[vehicle]
        if len(found) < 2:
            return
        whole = [session for session, some in sorted(found.items()) if any(self._is_whole(*at) for at in some)]
        if len(whole) > 1:
            listed = ", ".join(str(session) for session in whole[:3]) + ", ..." * (len(whole) > 3)
            raise InputError(
                f"recording {self.path}: holds {len(whole)} sessions of {vehicle!r} ({listed}), whose frames have the "
                "same numbers: give the recording of one session"
            )

    def _is_whole(self, file: int, start: int, length: int) -> bool:
        try:
            decode(bytes(self._data[file][start : start + length]))
        except (WireError, ValueError):
            return False
        return True

    def _note(self, topic: str, encoding: str, file: int, start: int, length: int, log_ns: int) -> None:
        kind = _recorded(topic, encoding)
        if kind is SETS:
            try:
                identity = peek_set(topic, self._data[file][start : start + length])
            except ForeignMessage as error:
                self._foreign.failed(error)
                return
            except (WireError, ValueError):
                return  # not one of our sets; a damaged one is found by its checksum when it is asked for
            some = self._index.sessions.setdefault(identity.vehicle, {}).setdefault(identity.session, [])
            if len(some) < SOME:
                some.append((file, start, length))
            sets = self._index.sets.setdefault(identity.vehicle, {})
            held = sets.get(identity.frame)
            if held is None or held.revision <= identity.revision:
                sets[identity.frame] = _Held(
                    identity.frame, identity.revision, identity.capture_unix_ns, identity.status, file, start, length
                )
        elif kind is not None:
            with contextlib.suppress(ValueError):
                of = kind.topic.name, kind.topic.vehicle(topic)
                self._index.reports.setdefault(of, []).append((topic, file, start, length, log_ns))
        elif vehicle_name := _frames_vehicle(topic):
            self._index.frames.setdefault(vehicle_name, []).append((file, start, length))


def _read(path: Path, may_be_empty: bool) -> Data:
    try:
        with path.open("rb") as stream:
            start = stream.read(len(MAGIC))
            if may_be_empty and len(start) < len(MAGIC):
                return b""  # a part begun in the moment of the end
            if start != MAGIC:
                raise InputError(f"recording {path}: not an MCAP file")
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise InputError(f"recording {path}: {error.strerror}") from error


def _is_chunked(data: Data) -> bool:
    """Return whether chunks come before any message."""
    for opcode, _, _ in records(data, lambda _: None):
        if opcode in (CHUNK, MESSAGE):
            return opcode == CHUNK
    return False


def _messages(data: Data, damaged: Callable[[Damage], None]) -> Iterator[_Found]:
    """Every message that matters here."""
    channels: dict[int, tuple[str, str]] = {}
    for opcode, start, length in records(data, damaged):
        if opcode == MESSAGE:
            known = channels.get(data[start] | data[start + 1] << 8)
            if known:
                log_ns = MESSAGE_HEAD.unpack_from(data, start)[2]
                yield *known, start + MESSAGE_HEAD.size, length - MESSAGE_HEAD.size, log_ns
        elif opcode == CHANNEL:
            channel, topic, encoding = read_channel(bytes(data[start : start + length]))
            if _recorded(topic, encoding) is not None or _frames_vehicle(topic):
                channels[channel] = topic, encoding


def _chunked_messages(path: Path) -> tuple[bytes, list[_Found], str]:
    """The same through the mcap package: the messages' bytes one after the other, where each is, and what ended it."""
    try:
        from mcap.exceptions import McapError  # noqa: PLC0415
        from mcap.reader import NonSeekingReader  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f"recording {path}: has chunks, which needs the package mcap") from error
    kept, trouble = bytearray(), ""
    found: list[_Found] = []
    with path.open("rb") as stream:
        try:
            # A damaged length must not become memory asked for.
            reader = NonSeekingReader(stream, record_size_limit=path.stat().st_size)
            for _, channel, message in reader.iter_messages(log_time_order=False):
                found.append((channel.topic, channel.message_encoding, len(kept), len(message.data), message.log_time))
                kept += message.data
        except (McapError, struct.error, ValueError, EOFError) as error:
            if not found:
                raise InputError(f"recording {path}: {error}") from error
            trouble = f"cannot be read to its end ({error or type(error).__name__})"
    return bytes(kept), found, trouble


def _by_neighbours(messages: list[tuple[int, T]]) -> list[tuple[int, T]]:
    """Messages in recorded order, each at the median of the log times about it, and none before the one before."""
    times = [at_ns for at_ns, _ in messages]
    near = (sorted(times[max(k - NEIGHBOURS, 0) : k + NEIGHBOURS + 1]) for k in range(len(times)))
    medians = accumulate((about[len(about) // 2] for about in near), max)
    return [(at_ns, message) for at_ns, (_, message) in zip(medians, messages, strict=True)]


def _recorded(topic: str, encoding: str) -> Payload[Any] | None:
    """The kind of a channel's messages, if it is that of sets or of a report."""
    kind = payload_of(topic)
    is_ours = kind is not None and kind.topic.encoding == encoding and (kind is SETS or kind.is_report)
    return kind if is_ours else None


def _frames_vehicle(topic: str) -> str:
    """The vehicle of a frames channel, or nothing."""
    if topic.startswith(_FRAMES_BEFORE) and topic.endswith(_FRAMES_AFTER):
        return topic[len(_FRAMES_BEFORE) : -len(_FRAMES_AFTER)]
    return ""
