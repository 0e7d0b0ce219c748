"""What `spots`, `track` and `seen` have in common where nothing is found, nothing is received, or they are ended.

Recordings, files and wrong usage: their transcripts.
"""

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer

from contract.feature_set import FeatureSet, Status
from contract.topics import FEATURES, TRACKS
from contract.wire.codec import encode
from contract.wire.track_code import encode_track
from ground.__main__ import main
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.contract.test_track_code import REPORT
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S, eventually

COMMANDS = ("spots", "track", "seen")
NOTHING = {"spots": "no hot spot found", "track": "nothing is followed", "seen": "nothing was surely seen"}
THERE = replace(plain_set(5), vehicle="uav-1")
TRACK = encode_track(REPORT)
REFUSED = FeatureSet("uav-1", THERE.session, THERE.frame, THERE.capture_unix_ns, Status.TURNING, THERE.camera)


@pytest.fixture
def aircraft() -> Iterator[str]:
    """One that answers no click, finds no hot spot and follows nothing."""
    endpoint, ended = free_endpoint(), threading.Event()
    with Publisher("uav-1", [endpoint], rate=Rate(max_bit_rate=1e7)) as publisher:
        publisher.follow = lambda _: (b'{"tracks": []}', False)

        def publish() -> None:
            while not ended.wait(0.05):
                publisher.publish(REFUSED)

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        yield endpoint
        ended.set()
        thread.join(5.0)


@pytest.mark.parametrize("command", COMMANDS)
def test_an_aircraft_without_a_find_is_3_and_one_that_is_not_received_is_2(
    command: str, aircraft: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before, nothing received was "no hot spot found" as well, and `seen` waited for a first set for ever."""
    out = tmp_path / "out.geojson"
    words = [command, "--connect", aircraft, "--seconds", "1", "--json", "--out", str(out)]
    assert eventually(lambda: main(words) == 3)
    printed = capsys.readouterr()
    assert NOTHING[command] in printed.err and printed.out == "" and not out.exists()
    assert main([*words, "--vehicle", "kite"]) == 2
    complaint = capsys.readouterr().err.splitlines()
    assert len(complaint) == 1 and "aircraft 'kite'" in complaint[0]


@pytest.mark.parametrize("command", COMMANDS)
def test_ctrl_c_ends_it_as_the_time_given_does(command: str, aircraft: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "ground", command, "--connect", aircraft, "--seconds", str(PATIENCE_S)],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert eventually(lambda: _listens(process.pid))
        process.send_signal(signal.SIGINT)
        printed, complaint = process.communicate(timeout=PATIENCE_S)
    assert process.returncode in (2, 3) and printed == ""  # 2: it was ended before the first message came
    assert NOTHING[command] in complaint or "nothing received" in complaint


def _listens(pid: int) -> bool:
    """True once SIGTERM has a handler there."""
    caught = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) & 1 << (signal.SIGTERM - 1))


def test_of_a_recording_all_aircraft_are_shown_with_their_names_and_every_file_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "both.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start()
        for name in ("a", "b"):
            there = replace(THERE, vehicle=name)
            for topic, payload in ((FEATURES, encode(there)), (TRACKS, TRACK)):
                channel = writer.register_channel(topic.key(name), topic.encoding, 0)
                writer.add_message(channel, 1, payload, 1)
        writer.finish()
    outs = [tmp_path / "all.kml", tmp_path / "all.geojson"]
    words = ["track", "--from", str(path), *(word for out in outs for word in ("--out", str(out)))]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines[:2]] == [["a", "track", "3"], ["b", "track", "3"]]
    assert lines[2:] == [f"written: {out}" for out in outs] and all(out.exists() for out in outs)
    assert main([*words, "--json"]) == 0
    assert [json.loads(line)["vehicle"] for line in capsys.readouterr().out.splitlines()] == ["a", "b"]
