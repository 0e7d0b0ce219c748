"""A damaged recording, as the readers on the ground and on board have it: what is lost, and what is reported."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from contract.wire.codec import decode
from ground.recording import Recording
from onboard.config.schema import Config, to_toml
from onboard.events.types import Frame
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set
from tests.scenarios.flights import CAMERA

pytestmark = pytest.mark.xdist_group("damaged recordings")  # one worker: the recording is made once

START_NS = 1_700_000_000_000_000_000
SETS = 100
END_OF_DATA = 0x0F
Read = tuple[list[int], list[str]]  # frames that have a set, and a line for each damage


def by_ground(path: Path) -> Read:
    recording = Recording(path)
    return recording.frames("uav-1"), recording.damage


def by_aircraft(path: Path) -> Read:
    recorded = RecordedFlight.open([path])
    assert list(recorded.events())
    return [decode(payload).frame for payload in recorded.sets()], [
        line for line in recorded.caveats if "damaged" in line
    ]


@dataclass(frozen=True)
class Whole:
    """A recording and where the records of its sets begin and end."""

    content: bytes
    sets: list[tuple[int, int]]

    def with_length(self, index: int, length: int) -> bytes:
        begin = self.sets[index][0]
        return self.content[: begin + 1] + length.to_bytes(8, "little") + self.content[begin + 9 :]

    def with_zeros(self, first: int, last: int | None) -> bytes:
        begin = self.sets[first][0] + 3
        end = len(self.content) if last is None else self.sets[last][0] + 3
        return self.content[:begin] + bytes(end - begin) + self.content[end:]

    def with_opcode(self, index: int, opcode: int) -> bytes:
        begin = self.sets[index][0]
        return self.content[:begin] + bytes([opcode]) + self.content[begin + 1 :]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """A hundred sets, each behind its frame."""
    path = tmp_path_factory.mktemp("whole") / "session.mcap"
    with SessionRecorder(path, "uav-1", config_text=to_toml(Config()), camera_json=CAMERA.to_json()) as out:
        for k in range(SETS):
            out.write_event(Frame(START_NS + k * 10**9, k, None, f"{k}.png"))
            out.write_set(replace(plain_set(20), frame=k, capture_unix_ns=START_NS + k * 10**9))
    content, at, sets = path.read_bytes(), 8, []
    while content[at] != END_OF_DATA:
        end = at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        if content[at] == 5 and content[at + 31 : at + 34] == b"PC\x40":
            sets.append((at, end))
        at = end
    assert len(sets) == SETS
    return Whole(content, sets)


@dataclass(frozen=True)
class Damage:
    """The damage to a file, which sets are lost by it, and how many places are called damaged."""

    to: Callable[[Whole], bytes]
    lost: set[int]
    places: int = 1


def length(value: int) -> Damage:
    return Damage(lambda whole: whole.with_length(33, value), {33})


DAMAGES = {
    "none": Damage(lambda whole: whole.content, set(), 0),
    **{f"a length of {value}": length(value) for value in (2**64 - 1, 2**63, 2**31, 10**6, 5000, 100, 25, 3, 0)},
    "two lengths": Damage(
        lambda whole: replace(whole, content=whole.with_length(20, 1 << 60)).with_length(70, 1 << 60), {20, 70}, 2
    ),
    "a sector of zeros": Damage(lambda whole: whole.with_zeros(40, 43), {40, 41, 42, 43}),
    "zeros to the end": Damage(lambda whole: whole.with_zeros(60, None), set(range(60, SETS))),
    "a set that looks like the end": Damage(lambda whole: whole.with_opcode(50, END_OF_DATA), {50}),
    "the last set looks like the end": Damage(lambda whole: whole.with_opcode(SETS - 1, END_OF_DATA), {SETS - 1}),
    # No damage: a recorder was killed, or the card was full.
    "cut within a set": Damage(lambda whole: whole.content[: whole.sets[60][0] + 40], set(range(60, SETS)), 0),
    "cut between two sets": Damage(lambda whole: whole.content[: whole.sets[60][0]], set(range(60, SETS)), 0),
}


@pytest.mark.parametrize("read", [by_ground, by_aircraft])
@pytest.mark.parametrize("name", DAMAGES)
def test_what_is_lost_is_what_was_hit_and_is_reported(
    whole: Whole, tmp_path: Path, name: str, read: Callable[[Path], Read]
) -> None:
    damage, path = DAMAGES[name], tmp_path / "session.mcap"
    path.write_bytes(damage.to(whole))
    frames, reported = read(path)
    missing = set(range(SETS)) - set(frames)
    assert missing <= damage.lost
    assert missing == damage.lost or name.startswith("a length")  # too short a length may leave the set whole
    assert len(frames) == len(set(frames)) and frames == sorted(frames)
    assert bool(reported) == bool(damage.places)
    if damage.places == 1:
        (line,) = reported
        found = re.search(r"byte (\d+)", line)
        assert found is not None and path.name in line
        first, last = whole.sets[min(damage.lost)][0], whole.sets[max(damage.lost)][1]
        assert first <= int(found[1]) <= last
