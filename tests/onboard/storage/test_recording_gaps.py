"""What a recording does with a disk that stalls or fails and with what it cannot write: gaps, faults, no waiting."""

import dataclasses
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from contract.errors import InputError
from contract.supervised_thread import ThreadState
from ground.recording import Recording
from onboard.events.types import Frame, GpsQuality
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.recording_queue import Entry
from onboard.storage.rotating_recorder import Recorded
from tests.contract.sets import plain_set
from tests.onboard.storage.test_rotating_recorder import Disk, configured, first, holds, recorder
from tests.scenarios.flights import CAMERA
from tests.waiting import PATIENCE_S, eventually


@pytest.fixture
def sink(tmp_path: Path) -> Iterator[Recorded]:
    with recorder(tmp_path, configured("none", keep_free_mb=100.0), free=Disk(), retry_s=0.1) as opened:
        yield opened


def test_a_disk_slower_than_a_moment_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = SessionRecorder.write_set

    def write_set(self: SessionRecorder, *given: object) -> None:
        time.sleep(0.01)
        slow(self, *given)

    monkeypatch.setattr(SessionRecorder, "write_set", write_set)
    base = plain_set(20)
    with recorder(tmp_path, configured("none")) as sink:
        for frame in range(60):
            sink.feature_set(dataclasses.replace(base, frame=frame))
        assert sink.fault == ""
    assert Recording(tmp_path).frames("uav-1") == list(range(60))
    assert sink.dropped == 0 and metadata_of(first(tmp_path)) == ["yes"]


def metadata_of(path: Path) -> list[str]:
    """What each of a file's metadata records says of its being complete."""
    with path.open("rb") as stream:
        return [m.metadata["complete"] for m in make_reader(stream).iter_metadata()]


def gaps_of(path: Path) -> list[dict[str, object]]:
    with path.open("rb") as stream:
        return [json.loads(m.data) for _, _, m in make_reader(stream).iter_messages(topics=["pc/uav-1/gaps"])]


class Stalled:
    """A disk that takes its time over each set until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.release, self.is_in_a_write = threading.Event(), threading.Event()
        write = SessionRecorder.write_set

        def write_set(recorder: SessionRecorder, *given: object) -> None:
            self.is_in_a_write.set()
            self.release.wait(30.0)
            write(recorder, *given)

        monkeypatch.setattr(SessionRecorder, "write_set", write_set)


class NoWaiting:
    """Whoever made it may not wait for anything, be it for a moment, while it is entered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._is_on, me = False, threading.get_ident()

        def refused(wait: Callable[..., Any]) -> Callable[..., Any]:
            def waited(*given: Any, **named: Any) -> Any:
                assert not (self._is_on and threading.get_ident() == me), "it waits"
                return wait(*given, **named)

            return waited

        monkeypatch.setattr(threading.Condition, "wait", refused(threading.Condition.wait))
        monkeypatch.setattr(time, "sleep", refused(time.sleep))

    def __enter__(self) -> None:
        self._is_on = True

    def __exit__(self, *_: object) -> None:
        self._is_on = False


def test_a_stalled_disk_holds_up_no_one_and_leaves_a_gap_that_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onboard.storage.rotating_recorder.MAX_WAITING", 10)
    disk = Stalled(monkeypatch)
    base = plain_set(20)
    picture = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint8)
    with recorder(tmp_path, configured()) as sink:
        sink.event(0, Frame(1_700_000_000_000_000_000, 0, picture))
        sink.feature_set(dataclasses.replace(base, frame=0))
        assert disk.is_in_a_write.wait(PATIENCE_S)
        began_s = time.monotonic()
        with NoWaiting(monkeypatch):
            for frame in range(1, 31):  # ten wait, twenty are dropped
                sink.feature_set(dataclasses.replace(base, frame=frame, capture_unix_ns=10**18 + frame))
            sink.event(10**18 + 31, Frame(10**18 + 31, 1, picture))
        assert time.monotonic() - began_s < 20.0  # the disk stalls for 30 s
        assert "does not keep up" in sink.fault and sink.dropped == 21
        disk.release.set()
        assert eventually(lambda: holds(tmp_path, 10))
        sink.feature_set(dataclasses.replace(base, frame=31))
    assert Recording(tmp_path).frames("uav-1") == [*range(11), 31]
    (gap,) = gaps_of(first(tmp_path))
    assert (gap["sets"], gap["pictures"], gap["events"]) == (20, 1, 0)
    assert (gap["begin_ns"], gap["end_ns"]) == (10**18 + 11, 10**18 + 31)
    assert metadata_of(first(tmp_path)) == ["yes", "no"]  # it was, to the gap
    (caveat,) = RecordedFlight.open([tmp_path]).caveats
    assert "1 picture and 20 sets" in caveat and "did not keep up" in caveat


def test_pictures_that_are_too_many_bytes_are_dropped_and_telemetry_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onboard.storage.rotating_recorder.MAX_WAITING_BYTES", 200_000)
    disk = Stalled(monkeypatch)
    picture = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint8)  # 76,800 bytes
    with recorder(tmp_path, configured()) as sink:
        sink.feature_set(plain_set(20))
        assert disk.is_in_a_write.wait(PATIENCE_S)
        for frame in range(5):
            sink.event(frame, Frame(frame, frame, picture))
            sink.event(frame, GpsQuality(frame, 3))
        assert sink.dropped == 3
        disk.release.set()
    gaps = [(gap["pictures"], gap["events"], gap["sets"]) for gap in gaps_of(first(tmp_path))]
    assert gaps == [(1, 0, 0)] * 3  # each where its picture would stand
    (caveat,) = RecordedFlight.open([tmp_path]).caveats
    assert "lacks 3 pictures, in 3 places" in caveat
    events = [event for _, event in RecordedFlight.open([tmp_path]).events()]
    assert [e.index for e in events if isinstance(e, Frame)] == [0, 1]
    assert sum(isinstance(e, GpsQuality) for e in events) == 5


def test_a_disk_that_never_comes_back_does_not_hold_up_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onboard.storage.rotating_recorder.CLOSE_SILENT_S", 0.2)
    monkeypatch.setattr("onboard.storage.rotating_recorder.CLOSE_S", 25.0)  # a slow disk's, and none that is silent
    disk = Stalled(monkeypatch)
    sink = recorder(tmp_path, configured("none"))
    sink.__enter__()
    sink.feature_set(plain_set(20))
    assert disk.is_in_a_write.wait(PATIENCE_S)
    began_s = time.monotonic()
    with pytest.raises(InputError, match="did not take the end"):
        sink.__exit__(None, None, None)
    assert time.monotonic() - began_s < 15.0
    disk.release.set()
    assert sink.thread.join(PATIENCE_S)


@pytest.mark.parametrize("error", [RuntimeError("a bug"), OSError(5, "Input/output error"), KeyError("no such")])
def test_an_unforeseen_error_of_the_writer_is_a_fault_and_recording_goes_on(
    sink: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    writes, is_broken = SessionRecorder.write_set, threading.Event()
    is_broken.set()

    def write_set(self: SessionRecorder, *given: object) -> None:
        if is_broken.is_set():
            raise error
        writes(self, *given)

    monkeypatch.setattr(SessionRecorder, "write_set", write_set)
    sink.feature_set(plain_set(20))
    assert eventually(lambda: str(error) in sink.fault)
    assert sink.thread.report().state is ThreadState.RUNNING
    is_broken.clear()

    def again() -> bool:
        sink.feature_set(dataclasses.replace(plain_set(20), frame=7))
        return sink.fault == ""

    assert eventually(again)
    assert eventually(lambda: holds(tmp_path, 7))


def test_a_set_that_cannot_be_encoded_leaves_a_gap_and_the_file_goes_on(
    sink: Recorded, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    base = plain_set(20)
    sink.feature_set(dataclasses.replace(base, frame=0))
    for frame in (1, 2):
        sink.feature_set(dataclasses.replace(base, frame=frame, camera_height_m=float("nan")))
    sink.feature_set(dataclasses.replace(base, frame=3))
    assert eventually(lambda: holds(tmp_path, 3))
    assert sink.fault == "" and sink.unencodable == 2
    assert Recording(first(tmp_path)).frames("uav-1") == [0, 3]
    (line,) = [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]
    assert "frame 1 cannot be encoded" in line


class Minutes:
    def __init__(self) -> None:
        self.s = 1_700_000_000.0

    def now_ns(self) -> int:
        return round(self.s * 1e9)


def test_a_disk_that_fails_again_and_again_is_reported_once_a_minute_and_tried_ever_more_seldom(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Each file takes three seconds of sets, as one that may grow to a size and no further does."""
    caplog.set_level("INFO", "pointclick")
    clock, base = Minutes(), plain_set(20)
    writes = SessionRecorder.write_set
    taken: dict[Path, int] = {}

    def write_set(self: SessionRecorder, *given: object) -> None:
        if taken.get(self.path, 0) >= 3:
            raise InputError(f"recording {self.path}: File too large")
        taken[self.path] = taken.get(self.path, 0) + 1
        writes(self, *given)

    monkeypatch.setattr(SessionRecorder, "write_set", write_set)
    sink = Recorded(tmp_path, configured("none", keep_free_mb=1.0), CAMERA, clock, "", free=Disk())
    for second in range(240):
        clock.s += 1.0
        sink._work(Entry("sets", clock.now_ns(), 0, lambda f, n=second: f.write_set(base, None)))
    stops = [r for r in caplog.records if "recording stops until there is room" in r.message]
    goes_on = [r for r in caplog.records if "recording again" in r.message]
    assert 2 <= len(stops) <= 4  # of a minute each
    assert len(stops) - 1 <= len(goes_on) <= len(stops)  # none that answers nothing
    assert 4 <= len(taken) <= 9  # 5, 10, 20, 40, 60, 60 s apart; at every 5 s it would be 30 files
    sink._finish_file()
