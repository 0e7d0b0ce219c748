"""A video of the downlink as the pictures of the sets: the delay is found, the right frame is given, or none is."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.errors import InputError
from contract.secrets import without_secrets
from ground.__main__ import main
from ground.pins.store import PinStore
from ground.web import command, startup, video_reader
from ground.web.api_vehicles import picture
from ground.web.context import ServerContext
from ground.web.recorded import RecordedSource
from ground.web.video_delay import DelayEstimate, best_time_s, is_seen
from ground.web.video_file import FileFootage
from ground.web.video_frames import Ring, VideoFrame, corner_strength, open_video
from ground.web.video_live import LiveFootage
from ground.web.video_reader import FrameClock, VideoReader
from ground.web.with_video import WithVideo
from tests.web.rendered import VEHICLE, record_rendered, rendered_set
from tests.web.served import Simulated
from tests.web.test_live import wait_for
from tests.web.video_flight import SPEED_PX_S, VIDEO_HZ, SampledFlight, shift_px, time_of, write_video

pytestmark = pytest.mark.xdist_group("web: served alone")

SETS = 32
SESSION = rendered_set(0).session
HALF_INTERVAL_S = 0.5 / VIDEO_HZ
DELAY_S = 1.31
# What half an interval and the tolerance of arrivals move the picture by, and half a pixel of measuring it.
MOST_PX = 1.1 * SPEED_PX_S * (HALF_INTERVAL_S + 0.01) + 0.5


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Begun DELAY_S before the flight's first picture, ended before its last."""
    return write_video(tmp_path_factory.mktemp("video") / "downlink.avi", -DELAY_S, 8.0)


def finished(footage: FileFootage) -> list[str]:
    wait_for(lambda: not footage._thread.is_alive(), "the end of the file")
    return footage.notes()


def read_through(path: Path, delay_s: float | None = None, flight: SampledFlight | None = None) -> FileFootage:
    footage = FileFootage(str(path), flight or SampledFlight(SETS), VEHICLE, delay_s)
    finished(footage)
    footage.close()
    return footage


def with_frame(footage: FileFootage | LiveFootage, sets: int = SETS) -> list[int]:
    return [k for k in range(sets) if footage.has(SESSION, k)]


def test_the_delay_of_a_recorded_flight_is_found_and_each_set_gets_its_own_frame(video: Path) -> None:
    flight = SampledFlight(SETS)
    flight.own_picture, flight.refused = 3, {9}
    footage = FileFootage(str(video), flight, VEHICLE, None)
    source = WithVideo(flight, footage)
    notes = finished(footage)
    stated = re.fullmatch(r"video: delay (\S+) s, measured from (\d+) pictures \(\+- (\S+) s\)", notes[0])
    assert stated is not None, notes
    assert float(stated[1]) == pytest.approx(DELAY_S, abs=HALF_INTERVAL_S)
    assert int(stated[2]) >= 15 and float(stated[3]) < HALF_INTERVAL_S
    # The file ends 6.69 s into the flight; a refused set gets no picture.
    expected = [k for k in range(SETS) if time_of(k) < 8.0 - DELAY_S - 0.05 and k != 9]
    rows = {row.frame: row.has_picture for row in source.frames(VEHICLE)}
    assert [k for k, has in rows.items() if has] == expected
    for k in expected:
        found = source.picture(VEHICLE, None, k)
        assert found is not None
        if k == flight.own_picture:
            assert (found.content, found.is_unchanging) == (b"own", True)  # what came with the sets goes first
        else:
            assert (found.media_type, found.is_unchanging) == ("image/jpeg", False)
            assert shift_px(found.content, k) < MOST_PX
    assert source.picture(VEHICLE, SESSION + 1, 5) is None
    assert source.version(VEHICLE) > flight.version(VEHICLE)
    assert source.damage() == notes
    source.close()


def test_a_browser_keeps_no_frame_of_a_video(video: Path, tmp_path: Path) -> None:
    """Started again with another delay, the same address is another frame."""
    flight = SampledFlight(SETS)
    flight.own_picture = 3
    footage = FileFootage(str(video), flight, VEHICLE, DELAY_S)
    finished(footage)
    source = WithVideo(flight, footage)
    with PinStore(tmp_path / "pins.sqlite") as store:
        context = ServerContext(source, store, tmp_path)
        assert picture(context, VEHICLE, 3).headers["cache-control"] == "private, max-age=3600"
        assert picture(context, VEHICLE, 4).headers["cache-control"] == "no-store"
    source.close()


def test_an_entered_delay_is_used_and_a_wrong_one_offers_nothing(video: Path) -> None:
    right = read_through(video, DELAY_S)
    assert right.notes() == [f"video: delay {DELAY_S:.2f} s, as entered"]
    assert len(with_frame(right)) >= 25
    for wrong_s in (DELAY_S + 3.0 / VIDEO_HZ, DELAY_S - 1.0):
        wrong = read_through(video, wrong_s)
        assert with_frame(wrong) == []
        assert "do not show their sets' features: left out" in wrong.notes()[-1]


@pytest.mark.parametrize("kind", ["another place", "still"])
def test_a_video_of_something_else_offers_nothing_and_says_so(kind: str, tmp_path: Path) -> None:
    place = 2 if kind == "another place" else 1
    path = write_video(tmp_path / "v.avi", -1.0, 5.0, place, still=kind == "still")
    footage = read_through(path)
    assert with_frame(footage) == []
    assert "its delay is not known" in footage.notes()[0]
    entered = read_through(path, 1.0)
    # Of the still one it is the first set's picture indeed.
    assert len(with_frame(entered)) <= (1 if kind == "still" else 0)


def test_a_video_of_another_shape_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.avi", 0.0, 1.0, size_px=(640, 360))
    footage = read_through(path)
    assert with_frame(footage) == []
    assert footage.notes()[0].startswith("video: it is 640 x 360, the camera's pictures are 640 x 480")


def test_a_running_video_is_matched_with_the_sets_that_come(tmp_path: Path) -> None:
    flight = SampledFlight(400, is_live=True)
    flight.start_s = np.inf
    path = write_video(tmp_path / "v.avi", 0.0, 30.0)  # a slow machine needs more of it
    footage = LiveFootage(str(path), flight, None, None, (-0.5, 2.0))
    source = WithVideo(flight, footage)
    try:
        wait_for(lambda: len(footage._ring.frames()[1]) >= 20, "the first second of the video")
        frames = footage._ring.frames()[1]
        flight.start_s = frames[-1].time_s - (len(frames) - 1) / VIDEO_HZ - 0.4  # the video is so late
        assert not any(row.has_picture for row in source.frames(VEHICLE))
        version = source.version(VEHICLE) - flight.version(VEHICLE)

        def given() -> list[int]:
            return [row.frame for row in source.frames(VEHICLE) if row.has_picture]

        wait_for(lambda: len(given()) >= 12, "twelve pictures")
        assert source.version(VEHICLE) - flight.version(VEHICLE) > version
        for k in given():
            found = source.picture(VEHICLE, None, k)
            assert found is not None
            assert shift_px(found.content, k) < MOST_PX
        note = next(line for line in source.damage() if "measured" in line)
        stated = re.match(r"video: delay (\S+) s, measured from \d+ pictures", note)
        assert stated is not None
        # Until twenty frames have come, one that comes late may be left out.
        assert 0.4 - HALF_INTERVAL_S - 0.1 <= float(stated[1]) <= 0.4 + HALF_INTERVAL_S + 0.1
    finally:
        source.close()


def test_a_video_that_ends_is_opened_again_and_the_notes_say_how_it_goes(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.avi", 0.0, 0.5)
    ring = Ring()
    reader = VideoReader(str(path), ring, (0.02, 0.1))
    try:
        wait_for(lambda: ring.epoch >= 1 and len(ring.frames()[1]) >= 1, "frames")
        away = path.rename(tmp_path / "away.avi")
        wait_for(lambda: "is not there; opened again in" in reader.trouble, "the word of it")
        before = ring.epoch
        away.rename(path)
        wait_for(lambda: ring.epoch > before and len(ring.frames()[1]) >= 3 and reader.trouble == "", "its return")
    finally:
        reader.close()


@pytest.fixture
def video_file(tmp_path: Path) -> Path:
    return write_video(tmp_path / "v.avi", 0.0, 0.5)


def test_a_fault_while_matching_is_noted_and_does_not_end_the_matching(
    video_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = SampledFlight(SETS)
    looks: list[str] = []

    def version(vehicle: str) -> int:
        looks.append(vehicle)
        if len(looks) < 4:
            raise RuntimeError("a fault of ours")
        return 0

    monkeypatch.setattr(flight, "version", version)
    footage = LiveFootage(str(video_file), flight, VEHICLE, None)
    try:
        wait_for(lambda: any("a fault of ours" in note for note in footage.notes()), "the note")
        wait_for(lambda: len(looks) > 5 and not any("a fault" in note for note in footage.notes()), "going on")
    finally:
        footage.close()


def test_a_fault_in_the_reader_is_noted_and_the_video_opened_again(
    video_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ring = Ring()
    opened: list[str] = []

    def failing(source: str) -> object:
        opened.append(source)
        if len(opened) == 2:
            raise RuntimeError("a fault of ours")
        return open_video(source)

    monkeypatch.setattr(video_reader, "open_video", failing)
    reader = VideoReader(str(video_file), ring, (0.02, 0.1))
    try:
        wait_for(lambda: "a fault of ours" in reader.trouble, "the note")
        before = ring.epoch
        wait_for(lambda: ring.epoch > before and reader.trouble == "", "frames again")
    finally:
        reader.close()


def test_a_fault_in_the_search_of_a_file_is_noted(video_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("a fault of ours")

    monkeypatch.setattr(FileFootage, "_frames", fail)
    (note,) = finished(FileFootage(str(video_file), SampledFlight(SETS), VEHICLE, None))
    assert note == f"video: {video_file}: stopped by RuntimeError: a fault of ours"


def test_the_ring_is_bounded_in_frames_and_bytes() -> None:
    made = [VideoFrame(float(k), (4, 4), np.zeros((2, 2), np.int8), bytes(96)) for k in range(50)]
    few, small = Ring(max_frames=10), Ring(max_bytes=1000)
    for frame in made:
        few.put(frame)
        small.put(frame)
    assert [frame.time_s for frame in few.frames()[1]] == [float(k) for k in range(40, 50)]
    assert [frame.time_s for frame in small.frames()[1]] == [float(k) for k in range(40, 50)]
    few.restart()
    assert few.frames() == (1, [])


def test_frames_that_a_network_held_back_keep_their_times() -> None:
    clock = FrameClock()
    stamps = np.arange(100) * 0.05
    arrivals = 7.0 + stamps + 0.02 * np.random.default_rng(1).random(100)
    arrivals[60:66] = arrivals[66]  # six at once
    times = np.array([clock.time_s(a, s) for a, s in zip(arrivals, stamps, strict=True)])
    assert np.max(np.abs(times[30:] - (7.0 + stamps[30:]))) < 0.02
    # Stamps of a rate that is not the video's, as some addresses give them, are not accepted.
    other = FrameClock()
    times = np.array([other.time_s(a, s) for a, s in zip(arrivals[:60], 0.4 * stamps[:60], strict=True)])
    assert np.max(np.abs(times[30:] - arrivals[30:60])) < 0.03


def test_a_delay_needs_pictures_that_agree_and_follows_a_cut() -> None:
    rng = np.random.default_rng(2)
    estimate = DelayEstimate()
    for k in range(7):
        estimate.take(0.4 + 0.01 * rng.normal(), 0.1)
        assert estimate.settled(0.1) is None, k
    estimate.take(0.4, 0.1)
    settled = estimate.settled(0.1)
    assert settled is not None and settled.seconds == pytest.approx(0.4, abs=0.02)
    for _ in range(3):
        estimate.take(2.0, 0.1)
    assert estimate.settled(0.1) is None  # not the old one, and of the new one too few
    scattered = DelayEstimate()
    for vote in rng.uniform(-1.0, 5.0, 31):
        scattered.vote(vote)
    assert scattered.settled(0.1) is None


def test_a_best_frame_at_the_end_or_not_alone_is_none() -> None:
    times = np.arange(60) * 0.1
    peak = 12.0 * np.exp(-(((times - 3.03) / 0.1) ** 2))
    found = best_time_s(times, peak)
    assert found == pytest.approx(3.03, abs=0.02)
    assert best_time_s(times, 12.0 * np.exp(-(((times - 5.9) / 0.1) ** 2))) is None
    assert best_time_s(times, peak + 9.0 * np.exp(-(((times - 1.0) / 0.1) ** 2))) is None
    assert best_time_s(times, np.full(60, 9.0)) is None


def test_features_that_the_pipeline_tracked_are_seen_in_their_own_picture_and_in_no_other(simulated: Simulated) -> None:
    """Also where the downlink is half the size and much compressed."""
    source = RecordedSource(simulated.path)
    sets, full, poor = [], [], []
    for row in source.frames(simulated.vehicle):
        picture = source.picture(simulated.vehicle, None, row.frame)
        found = source.feature_set(simulated.vehicle, None, row.frame)
        if picture is None or found is None or not found.is_ok:
            continue
        image = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        half = cv2.imencode(".jpg", cv2.resize(image, None, fx=0.5, fy=0.5), [cv2.IMWRITE_JPEG_QUALITY, 30])[1]
        sets.append(found)
        full.append(corner_strength(np.asarray(image, np.uint8)))
        poor.append(corner_strength(np.asarray(cv2.imdecode(half, cv2.IMREAD_COLOR), np.uint8)))
    assert len(sets) >= 10
    for kind in (full, poor):
        seen = [[is_seen(strength, s.uv_px, s.camera.size_px) for strength in kind] for s in sets]
        assert np.array_equal(np.array(seen), np.eye(len(sets), dtype=bool))
        for off_px in ((8.0, 0.0), (0.0, -20.0)):  # a click on such a picture would err by as much
            off = [is_seen(k, s.uv_px + off_px, s.camera.size_px) for k, s in zip(kind, sets, strict=True)]
            assert not any(off)


def test_a_login_is_not_shown() -> None:
    assert without_secrets("rtsp://anna:secret@10.0.0.9/live") == "rtsp://10.0.0.9/live"


def one_line(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["web", *arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1, printed
    return printed


def test_without_opencv_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "index.html").touch()
    there = command.importlib.util.find_spec
    monkeypatch.setattr(command.importlib.util, "find_spec", lambda name: None if name == "cv2" else there(name))
    monkeypatch.setattr(startup, "STATIC", tmp_path)
    assert "with its extra [video]" in one_line(capsys, "--video", "rtsp://127.0.0.1/")


@pytest.mark.parametrize(
    ("arguments", "output"),
    [
        (["--video", "{folder}/none.avi"], "none.avi: there is no such file"),
        (["--video", "{folder}/session.mcap"], "session.mcap: cannot be opened; is it a video"),
        (["--video", "rtsp://a:b@127.0.0.1:9/x"], "--video of a recording must be a file"),
        (["--video", "{folder}/none.avi", "--video-vehicle", "other"], f"must be one of {VEHICLE}"),
        (["--video-delay", "0.4"], "go with --video"),
    ],
)
def test_a_video_that_cannot_be_used_is_one_line(
    arguments: list[str],
    output: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    (tmp_path / "index.html").touch()
    monkeypatch.setattr(startup, "STATIC", tmp_path)
    record_rendered(tmp_path / "session.mcap", pictures=2)
    filled = [argument.format(folder=tmp_path) for argument in arguments]
    assert output in one_line(capfd, "--port", "0", "--from", str(tmp_path / "session.mcap"), *filled)


@pytest.mark.parametrize("address", ["rtsp://a:b@127.0.0.1:9/x", "/dev/video63"])
def test_an_address_or_a_grabber_that_does_not_answer_is_one_error(address: str) -> None:
    with pytest.raises(InputError, match=r"--video (rtsp://127.0.0.1:9/x|/dev/video63): cannot be opened; is it"):
        VideoReader(address, Ring())
