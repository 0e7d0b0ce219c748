"""Bounded, damaged inputs for everything that reads what came over a radio or off a disk: sets, status, recordings.

`python -m tests.fuzz.payloads 1000000` takes a few minutes; a part of it is among the tests. Inputs are true ones,
damaged: bits, bytes, numbers, lengths, cuts, splices. Most sets get their length and checksum put right again, or every
one of them would end there. An input passes if it is read or refused by the errors that are promised, and quickly.
"""

import random
import struct
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

import numpy as np

from contract.errors import InputError, WireError
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from contract.wire.click_code import ClickAnswer, ClickQuestion, TurnedAway, encode_answer, encode_question
from contract.wire.click_code import decode as read_packet
from contract.wire.codec import decode, encode
from contract.wire.picture_code import cut, read_piece
from contract.wire.set_pieces import (
    ReceiverReport,
    SetAssembly,
    SetPiece,
    cut_set,
    encode_piece,
    encode_report,
    read_report,
)
from contract.wire.set_pieces import read_piece as read_set_piece
from ground.link_pictures import PictureCache
from ground.recording import Recording
from onboard.events.types import Attitude, Frame, GpsQuality, PositionFix
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set

MAX_INPUT_BYTES = 12_000
SLOW_S = 1.0
GOLDEN = Path(__file__).parents[1] / "contract" / "golden"
_NUMBERS = (0, 1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)


@dataclass
class Result:
    """What became of the inputs, by kind of input and of end."""

    ends: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0

    @property
    def count(self) -> int:
        return self.ends.total()


def damaged(true: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """One to four things done to it."""
    data = bytearray(true)
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        at = rng.randrange(len(data) + 1)
        kind = rng.randrange(7)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 1 and data:
            data[at % len(data)] = rng.randrange(256)
        elif kind == 2:
            width = rng.choice((1, 2, 4, 8))
            data[at : at + width] = (rng.choice(_NUMBERS) % 256**width).to_bytes(width, rng.choice(("little", "big")))
        elif kind == 3:
            del data[at:]
        elif kind == 4:
            del data[at : at + rng.randrange(1, 40)]
        elif kind == 5:
            data[at:at] = rng.randbytes(rng.randrange(1, 40))
        else:
            other = rng.choice(others)
            begin = rng.randrange(len(other) + 1)
            data[at : at + 40] = other[begin : begin + rng.randrange(1, 200)]
    return bytes(data[:MAX_INPUT_BYTES])


def sealed(payload: bytes, length_at: int = 3) -> bytes:
    """A set's payload, or of a picture, with its length and checksum put right, so that what is inside is read."""
    if len(payload) < 30:
        return payload
    body = payload[:length_at] + struct.pack("<H", len(payload) & 0xFFFF) + payload[length_at + 2 : -4]
    return body + struct.pack("<I", zlib.crc32(body))


def kept(data: bytes) -> Path:
    """A file that holds an input, to look into."""
    path = Path(gettempdir()) / f"pointclick-fuzz-{zlib.crc32(data):08x}.bin"
    path.write_bytes(data)
    return path


class Fuzz:
    """Reads damaged inputs; raises whatever is raised that was not promised, with the input."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._rng = random.Random(seed)
        self._path = folder / "damaged.mcap"
        self.result = Result()
        refused = FeatureSet("uav-1", 1, 2, 3, Status.TURNING, plain_set(1).camera)
        self._sets = [file.read_bytes() for file in sorted(GOLDEN.glob("*.bin"))]
        self._sets += [encode(plain_set(n)) for n in (0, 1, 12, 100)] + [encode(refused)]
        self._pieces = cut(small_picture(size=3000), with_parity=True)
        self._pictures = PictureCache()
        answer = Locator(plain_set(100)).locate((320.0, 240.0))
        self._packets = [
            encode_question(ClickQuestion(7, 320.0, 240.0, frame=3)),
            encode_report(ReceiverReport(9, 8, {9: 0.1})),
        ]
        self._packets += [encode_answer(a) for a in (ClickAnswer(7, answer), TurnedAway(7, 250, 255))]
        self._packets += [encode_piece(SetPiece(i, 1, *p)) for i, p in enumerate(cut_set(self._sets[-1], 0.5, 101))]
        self._assembly = SetAssembly()
        reported = VehicleStatus(1.7e9, 7, "ok", "all is well", 12.0, 30.0, 29.0, 77, 0.2, 99, 1, 2, True, 55.0)
        self._statuses = [encode_status(reported), encode_status(VehicleStatus(0.0, 0, "starting")), b'{"v":1}', b"[]"]
        self._recordings = [_a_recording(folder / "true.mcap", features) for features in (3, 12)]

    def run(self, count: int) -> Result:
        """So many inputs: of ten, six sets, and a piece of a picture, a packet of the autopilot's radio, a status and a
        recording."""
        for number in range(count):
            kind = number % 10
            if kind < 6:
                data = damaged(self._rng.choice(self._sets), self._sets, self._rng)
                self._one("set", sealed(data) if self._rng.random() < 0.8 else data, self._read_set)
            elif kind < 7:
                data = damaged(self._rng.choice(self._pieces), self._pieces, self._rng)
                self._one("picture", sealed(data, 4) if self._rng.random() < 0.8 else data, self._read_piece)
            elif kind < 8:
                data = damaged(self._rng.choice(self._packets), self._packets, self._rng)
                self._one("packet", data, self._read_packet)
            elif kind < 9:
                self._one("status", damaged(self._rng.choice(self._statuses), self._statuses, self._rng), _read_status)
            else:
                data = damaged(self._rng.choice(self._recordings), self._recordings, self._rng)
                self._one("recording", data, self._read_recording)
        return self.result

    def _one(self, name: str, data: bytes, read: Callable[[bytes], str]) -> None:
        began = time.thread_time()  # its own: the machine has other work
        try:
            end = read(data)
        except BaseException as error:
            error.add_note(f"{name}, kept in {kept(data)}")
            raise
        took_s = time.thread_time() - began
        self.result.ends[f"{name} {end}"] += 1
        self.result.slowest_s = max(self.result.slowest_s, took_s)
        if took_s > SLOW_S:
            raise AssertionError(f"{name} took {took_s:.1f} s, kept in {kept(data)}")

    def _read_set(self, data: bytes) -> str:
        try:
            found = decode(data)
        except WireError as error:
            return type(error).__name__
        if found.is_ok and self._rng.random() < 0.02:  # and a click in it, whatever its numbers say
            Locator(found).locate((found.camera.width_px / 2.0, found.camera.height_px / 2.0))
            return "clicked"
        return "read"

    def _read_piece(self, data: bytes) -> str:
        self._pictures.take("pc/uav-1/picture", data)
        try:
            read_piece(data)
        except WireError as error:
            return type(error).__name__
        return "read"

    def _read_packet(self, data: bytes) -> str:
        read_report(data)
        try:
            piece = read_set_piece(data)
            if piece is None:
                read_packet(data)
            else:
                self._assembly.take(piece, 0.0)
        except WireError as error:
            return type(error).__name__
        return "read"

    def _read_recording(self, data: bytes) -> str:
        # A new file each time: one that is mapped must not change.
        self._path.unlink(missing_ok=True)
        self._path.write_bytes(data)
        end = "read"
        try:
            recording = Recording(self._path)
            for vehicle in recording.vehicles:
                recording.newest(vehicle)
                recording.by_time(vehicle, 1.7e9)
                recording.frame_of_file(vehicle, "a.png")
                for frame in recording.frames(vehicle):
                    recording.by_frame(vehicle, frame)
        except InputError:
            end = "InputError"
        try:
            for _ in RecordedFlight.open([self._path]).events():
                pass
        except InputError:
            pass
        return end


def _read_status(data: bytes) -> str:
    try:
        decode_status(data)
    except WireError as error:
        return type(error).__name__
    return "read"


def _a_recording(path: Path, features: int) -> bytes:
    base = plain_set(features)
    with SessionRecorder(path, "uav-1", camera_json=base.camera.to_json(), pictures="lossless") as out:
        out.write_event(PositionFix(1, -35.0, 149.0, 600.0, (1.0, 2.0, 3.0)))
        out.write_event(GpsQuality(2, 3, 12))
        out.write_event(Attitude(3, (1.0, 0.0, 0.0, 0.0)))
        out.write_event(Frame(4, 77, np.zeros(base.camera.size_px[::-1], np.uint8), "a.png"))
        out.write_set(base)
    # Without what viewers get, which would be most of it, and without the summary: both are passed over.
    return path.read_bytes()[:MAX_INPUT_BYTES]


def main(count: int, seed: int) -> None:
    """Run and tell."""
    began = time.monotonic()
    with TemporaryDirectory() as folder:
        result = Fuzz(seed, Path(folder)).run(count)
    print(
        f"{result.count} inputs, seed {seed}, {time.monotonic() - began:.0f} s, slowest {1e3 * result.slowest_s:.1f} ms"
    )
    for end, number in sorted(result.ends.items()):
        print(f"{number:>9} {end}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
