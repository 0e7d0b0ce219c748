"""The pictures that `pc-ground record` kept of a link: pieces as they came, joined when a picture is asked for."""

from __future__ import annotations

from pathlib import Path

from contract import recording_format as names
from contract.errors import WireError
from contract.mcap_records import CHANNEL, MESSAGE, MESSAGE_HEAD, Data, mapped, read_channel, records
from contract.picture import LinkPicture
from contract.topics import PICTURE
from contract.wire.message import read_picture_piece
from contract.wire.picture_code import Whole, join, read_piece
from ground.link_pictures import Identity

_Place = tuple[int, int, int]  # file, start, length


class RecordedLinkPictures:
    """Indexed once over all files of a session; `path` as for `ground.recording.Recording`. Raises InputError.

    Damaged stretches are passed over: `Recording` names them. A file with chunks, which we do not write, has none here.
    """

    def __init__(self, path: Path | str) -> None:
        self._data: list[Data] = []
        self._found: dict[Identity, dict[Whole, dict[int, _Place]]] = {}
        for file, part in enumerate(names.session_files(Path(path))):
            data = mapped(part)  # `Recording` reports a file that is no recording
            self._data.append(data)
            self._index(file, data)

    def picture(self, vehicle: str, session: int, frame: int) -> LinkPicture | None:
        """The picture of a frame; None if it is not there, or not whole."""
        for whole, places in reversed(self._found.get((vehicle, session, frame), {}).items()):
            try:
                pieces = {number: read_piece(self._bytes(place)).content for number, place in places.items()}
                found = join(whole, pieces)
            except WireError:
                continue
            if found is not None:
                return found
        return None

    def frames(self, vehicle: str, session: int) -> set[int]:
        return {
            frame
            for (name, of, frame), wholes in self._found.items()
            if (name, of) == (vehicle, session) and any(_is_enough(whole, places) for whole, places in wholes.items())
        }

    def _bytes(self, place: _Place) -> bytes:
        file, start, length = place
        return bytes(self._data[file][start : start + length])

    def _index(self, file: int, data: Data) -> None:
        channels: dict[int, str] = {}
        for opcode, start, length in records(data, lambda _: None):
            if opcode == CHANNEL:
                channel, topic, encoding = read_channel(bytes(data[start : start + length]))
                if encoding == PICTURE.encoding:
                    channels[channel] = topic
            elif opcode == MESSAGE and (data[start] | data[start + 1] << 8) in channels:
                topic = channels[data[start] | data[start + 1] << 8]
                self._note(topic, (file, start + MESSAGE_HEAD.size, length - MESSAGE_HEAD.size))

    def _note(self, topic: str, place: _Place) -> None:
        try:
            piece = read_picture_piece(topic, self._bytes(place))
        except (WireError, ValueError):
            return
        w = piece.whole
        wholes = self._found.setdefault((w.vehicle, w.session, w.frame), {})
        wholes.setdefault(w, {})[piece.number] = place


def _is_enough(whole: Whole, places: dict[int, _Place]) -> bool:
    """Return whether each group lacks at most one piece, and has its parity if it lacks one."""
    if not whole.groups:
        return len(places) == whole.pieces
    for group in range(whole.groups):
        missing = sum(i not in places for i in range(group, whole.pieces, whole.groups))
        if missing > 1 or (missing and whole.pieces + group not in places):
            return False
    return True
