"""What a configuration opens, what it refuses in one line, and a log played in real time."""

import struct
import threading
from pathlib import Path

import numpy as np
import pytest

from contract.errors import ConfigError, InputError
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Attitude, PositionFix
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.tlog_reader import read_tlog
from onboard.telemetry.tlog_writer import TlogWriter
from simulation.autopilot.fake import FakeAutopilot
from tests.onboard.telemetry.listening import FLIGHT, TLOG, config_for, content, listening

CLOCK = SessionClock.start()


def test_keys_for_signing_are_checked_when_opening(tmp_path: Path) -> None:
    for text, word in ((None, "No such file"), ("abc", "not a key of 32 bytes"), ("é" * 16, "")):
        key = tmp_path / "key"
        if text is not None:
            key.write_text(text)
        if word:
            with pytest.raises(ConfigError, match=word):
                open_telemetry(config_for("udpin:127.0.0.1:1", signing_key=str(key)), CLOCK)
        else:  # 32 bytes, whatever they are
            open_telemetry(config_for("udpin:127.0.0.1:1", signing_key=str(key)), CLOCK)
            with pytest.raises(ConfigError, match="mavsdk does not sign"):
                open_telemetry(config_for("udpin:127.0.0.1:1", signing_key=str(key), backend="mavsdk"), CLOCK)


def test_a_source_can_be_asked_before_it_runs() -> None:
    for url in ("udpin:127.0.0.1:1", "nmea:/dev/null:9600", f"tlog:{TLOG}"):
        source = open_telemetry(config_for(url), CLOCK)
        assert source.health().state is State.STARTING


@pytest.mark.wall_clock(waits=True)
def test_a_log_is_played_as_if_it_came_now_and_ends_as_lost(tmp_path: Path) -> None:
    data, short = TLOG.read_bytes(), tmp_path / "short.tlog"
    short.write_bytes(data[: len(data) // 23])  # three seconds
    offline = read_tlog(short)
    with listening(config_for(f"tlog:{short}")) as received:
        received.wait(State.OK)
        received.until(lambda: received.source.health().detail == "the end of short.tlog")
        assert received.source.health().state is State.LOST
    fixes = received.of(PositionFix)
    assert len(fixes) >= 15
    known = {content(event): event.stamp_ns for event in offline.events}
    shifts = np.array([fix.stamp_ns - known[content(fix)] for fix in fixes])
    assert np.ptp(shifts) / 1e6 < 25.0  # a second of arrivals finds the least delay less well than all of them
    spacing = np.diff([fix.stamp_ns for fix in fixes])
    assert np.median(spacing) == pytest.approx(1e8, rel=0.05)
    assert len(received.of(Attitude)) > 35


def test_what_is_no_log_is_refused_by_running_it(tmp_path: Path) -> None:
    for name, data in (("empty.tlog", b""), ("text.tlog", b"hello " * 200)):
        (tmp_path / name).write_bytes(data)
        source = open_telemetry(config_for(f"tlog:{tmp_path / name}"), CLOCK)
        with pytest.raises(InputError, match=name):
            source.run(lambda arrival_ns, event: None, threading.Event())


def test_a_log_of_another_vehicle_is_refused() -> None:
    source = open_telemetry(config_for(f"tlog:{TLOG}", system=9), CLOCK)
    with pytest.raises(InputError, match="no messages of system 9"):
        source.run(lambda arrival_ns, event: None, threading.Event())


def test_the_log_writer_begins_a_new_file_and_gives_up_quietly(tmp_path: Path) -> None:
    writers = [TlogWriter(tmp_path / "logs", 0.0) for _ in range(2)]
    for writer in writers:
        writer.write(1_795_000_000_000_000_123, b"packet")
        writer.close()
    names = sorted(path.name for path in (tmp_path / "logs").iterdir())
    assert names == ["20261118T110640Z-1.tlog", "20261118T110640Z.tlog"]
    assert writers[0].path.read_bytes() == struct.pack(">Q", 1_795_000_000_000_000) + b"packet"
    full = TlogWriter(tmp_path / "logs", 1e9)
    full.write(10**18, b"packet")
    assert full.fault == "the disk is nearly full"
    nowhere = TlogWriter("/proc/nowhere", 0.0)
    nowhere.write(10**18, b"packet")
    assert nowhere.fault == "No such file or directory"


def test_a_log_that_cannot_be_written_is_reported_and_no_hindrance() -> None:
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", everything=True) as autopilot,
        listening(config_for(autopilot.url, log="/proc/nowhere")) as received,
    ):
        received.wait(State.DEGRADED)
        assert received.source.health().detail == "telemetry log: No such file or directory"
        received.until(lambda: received.of(PositionFix))


def test_every_key_has_a_default_that_opens() -> None:
    assert open_telemetry(parse_config(""), CLOCK).health().state is State.STARTING
