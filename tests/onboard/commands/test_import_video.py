"""A video and the log of its flight become a flight: frame times, beginning, lens and mount, listed and settable."""

import csv
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from contract.rotations import euler_from_matrix, matrix_from_quaternion
from onboard.__main__ import main
from onboard.camera.picture_files import open_frames
from onboard.camera.video_times import frame_times_s, rate_text
from onboard.commands.imported_flight import UNKNOWN, optics_of
from onboard.config.files import load_config_files
from onboard.events.types import Attitude, PositionFix
from onboard.telemetry import exiftool_reader
from onboard.telemetry.log_files import read_log
from onboard.telemetry.mp4_container import creation_ns
from simulation.flight import RecordedSpec, find_recording
from simulation.session import SessionSpec
from tests.onboard.telemetry.log_writers import (
    T0_S,
    Moment,
    box,
    gopro_seconds,
    misb_items,
    misb_set,
    with_track,
    written,
)
from tests.onboard.telemetry.picture_messages import message, snapshot
from tests.own_flights import set_creation, show_from, turn, vary_rate, with_metadata, write_video
from tests.rest_long import rest_long
from tests.scenarios.flights import simulated

CAMERA = Camera.from_field_of_view(64, 48, 60.0)
BEGAN = datetime(2026, 6, 12, 10, 15, 23, tzinfo=UTC)


def clip(path: Path, frames: int = 20, rate_hz: float = 10.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate_hz, (64, 48))
    assert writer.isOpened()
    for index in range(frames):
        writer.write(np.full((48, 64, 3), (0, 5 * index, 60 + 8 * index), np.uint8))
    writer.release()
    return path


def test_a_variable_frame_rate_is_taken_as_it_is(tmp_path: Path) -> None:
    video = clip(tmp_path / "20260612T101523Z.mp4", 6)
    even = frame_times_s(video)
    assert np.allclose(even, 0.1 * np.arange(6), atol=1e-3) and rate_text(even) == "10 frames a second"
    tick_s = 0.1 / 1024  # of the file that OpenCV writes
    apart = [1024, 2048, 512, 512, 1536, 512]  # together as before: an edit list ends the file
    vary_rate(video, apart)
    times = frame_times_s(video)
    assert np.allclose(times, tick_s * np.cumsum([0, *apart[:-1]]), atol=2e-3)
    assert "variable" in rate_text(times)
    stamps = open_frames(video, CAMERA).stamps_ns
    assert np.allclose((np.array(stamps) - stamps[0]) / 1e9, times, atol=1e-6)


def test_a_faster_video_is_thinned_and_its_frames_keep_their_own_pictures_and_colours(tmp_path: Path) -> None:
    video = clip(tmp_path / "20260612T101523Z.mp4")
    whole = list(open_frames(video, CAMERA).frames())
    thin = list(open_frames(video, CAMERA, max_rate_hz=5.0, in_colour=True).frames())
    assert [frame.name for frame in thin] == [frame.name for frame in whole[::2]]
    assert [frame.index for frame in thin] == list(range(10))
    for frame, same in zip(thin, whole[::2], strict=True):
        assert frame.stamp_ns == same.stamp_ns and same.colour is None
        assert frame.image is not None and np.array_equal(frame.image, same.image)
        assert frame.colour[20, 20, 2] > frame.colour[20, 20, 0] + 40


def test_when_a_file_says_that_it_began(tmp_path: Path) -> None:
    video = clip(tmp_path / "clip.mp4")
    assert creation_ns(video) is None  # OpenCV writes none
    set_creation(video, BEGAN)
    assert creation_ns(video) == int(BEGAN.timestamp()) * 10**9
    (tmp_path / "no.mp4").write_bytes(b"\0\0\0\0moov" + bytes(50))
    assert creation_ns(tmp_path / "no.mp4") is None
    assert frame_times_s(tmp_path / "no.mp4") == []


def table(folder: Path, began_s: float = BEGAN.timestamp(), seconds: int = 60) -> Path:
    rows = ["unix_time_s,lat_deg,lon_deg,height_amsl_m"]
    rows += [f"{began_s + k},{-43.38 + 1e-5 * k:.7f},172.4,200.0" for k in range(-10, seconds)]
    (folder / "flight.csv").write_text("\n".join(rows))
    return folder / "flight.csv"


def imported(folder: Path, *arguments: object) -> int:
    return main(["import-video", *map(str, arguments), "--out", str(folder / "flight")])


def test_it_lists_what_it_took_and_what_was_set_goes_before_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table(tmp_path)
    video = clip(tmp_path / "20260612T101525Z.mp4")
    settings = (
        "--clock-offset",
        "0",
        "--set",
        "mount.pitch_deg=-45",
        "--set",
        "camera.fov_deg=80",
        "--set",
        "recording.pictures=jpeg",
    )
    assert imported(tmp_path, video, *settings) == 0
    printed = capsys.readouterr().out
    for words in (
        "20 frames, 10 frames a second, 5 of them taken",
        "its name and its clock",
        "80 deg wide",
        "flight.csv",
    ):
        assert words in printed, printed
    assert printed.splitlines()[-1].startswith("pc-onboard replay ") and printed.splitlines()[-1].endswith("--rate 5")
    config = load_config_files(tmp_path / "flight" / "config.toml")
    assert (config.mount.pitch_deg, config.recording.pictures, config.solve.attitude) == (-45.0, "jpeg", "none")
    assert config.camera.latency_s == 0.0 and config.camera.sigma_latency_s == pytest.approx(1.04, abs=0.02)
    assert config.camera.sigma_readout_s > 0.0  # such cameras read row by row
    with (tmp_path / "flight" / "stamps.csv").open(newline="") as stream:
        stamps = [float(row["unix_time_s"]) for row in csv.DictReader(stream)]
    assert len(stamps) == 20 and stamps[0] == pytest.approx(BEGAN.timestamp() + 2.5, abs=0.05)  # cut to the second


@pytest.mark.parametrize(
    ("arguments", "began_s"),
    [
        (("--start", "2026-06-12T10:15:30.25Z"), 7.25), (("--start", "2026-06-12T12:15:30+02:00"), 7.0),
        (("--utc-offset", "2", "--clock-offset", "0.0"), 1.5),
    ],
)  # fmt: skip
def test_when_it_began_may_be_reported(tmp_path: Path, arguments: tuple[str, ...], began_s: float) -> None:
    log = table(tmp_path)
    video = clip(tmp_path / "20260612T121524Z.mp4")  # a local time
    assert imported(tmp_path, video, "--telemetry", log, *arguments) == 0
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(BEGAN.timestamp() + began_s, abs=0.05)


def test_a_row_of_another_year_costs_no_search_through_all_years(tmp_path: Path) -> None:
    """It had no end: the log was sampled ten times a second from the one row to the others."""
    log = table(tmp_path)
    head, *rows = log.read_text().splitlines()
    log.write_text("\n".join([head, f"{BEGAN.timestamp() - 26 * 365 * 86_400},-43.38,172.4,200.0", *rows]))
    assert imported(tmp_path, clip(tmp_path / "clip.mp4"), "--start", f"{BEGAN:%Y-%m-%dT%H:%M:%S}Z") == 0


def test_a_name_in_local_time_is_no_beginning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What else is missing or wrong: tests/transcripts/pc-onboard-import-video.txt."""
    table(tmp_path)
    assert imported(tmp_path, clip(tmp_path / "20260612T121525Z.mp4")) == 2
    complaint = capsys.readouterr().err
    assert "error: clock: " in complaint and complaint.count("\n") == 1
    assert not (tmp_path / "flight").exists()


def local_record(log: Path, to: Path, ahead_s: float) -> Path:
    """The same flight as a DJI flight record whose times are local."""
    rows = ["CUSTOM.date [local],CUSTOM.updateTime [local],OSD.latitude,OSD.longitude,OSD.height [m],OSD.altitude [m],"
            "OSD.pitch,OSD.roll,OSD.yaw"]  # fmt: skip
    events = read_log(log).events
    turned = [event for event in events if isinstance(event, Attitude)]
    for fix in (event for event in events if isinstance(event, PositionFix)):
        at = datetime.fromtimestamp(fix.stamp_ns / 1e9 + ahead_s, UTC)
        q = min(turned, key=lambda attitude: abs(attitude.stamp_ns - fix.stamp_ns)).q_ned_body
        roll, pitch, yaw = np.degrees(euler_from_matrix(matrix_from_quaternion(q)))
        rows.append(f"{at:%Y-%m-%d},{at:%H:%M:%S.%f},{fix.lat_deg:.8f},{fix.lon_deg:.8f},{fix.height_above_home_m},"
                    f"{fix.height_amsl_m},{pitch:.2f},{roll:.2f},{yaw:.2f}")  # fmt: skip
    to.write_text("\n".join([*rows, ""]))
    return to


@pytest.mark.parametrize(
    ("arguments", "ahead_s", "zone_s"),
    rest_long([((), 7.3, 0.0), (("--start", "2026-11-20T22:00:00Z"), 0.4, 0.0), (("--start",), 0.4, 46_800.0)]),
)
def test_a_beginning_that_is_off_is_found_by_the_frames_own_motion(
    tmp_path: Path, arguments: tuple[str, ...], ahead_s: float, zone_s: float
) -> None:
    """A creation time of another clock, or one that a person gives to the second, was taken as good to 0.1 s.

    And UTC that a person gives counts for nothing against a log's times that are local.
    """
    spec = SessionSpec(
        RecordedSpec("plane_turn", 3.0, whole_log=True), seconds=24.0, rate_hz=2.5, clicks_per_frame=1,
        camera=Camera.from_field_of_view(400, 300, 70.0),
    )  # fmt: skip
    session = simulated(spec)
    with (session / "truth.csv").open(newline="") as stream:
        began_s = float(next(csv.DictReader(stream))["unix_time_s"])
    shown = datetime.fromtimestamp(began_s + ahead_s, UTC)
    video = tmp_path / f"{shown:%Y%m%dT%H%M%S}{shown.microsecond // 1000:03d}Z.mp4"
    write_video(session, video, subtitles=False)
    words = [*arguments[:1], *([f"{shown:%Y-%m-%dT%H:%M:%S}Z"] if arguments else [])]
    log = session / "telemetry.tlog"
    if zone_s:
        log = local_record(log, tmp_path / "record.csv", zone_s)
    assert imported(tmp_path, video, "--telemetry", log, *words, "--set", "camera.fov_deg=70") == 0
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(began_s + zone_s, abs=0.1)
    assert load_config_files(tmp_path / "flight" / "config.toml").camera.sigma_latency_s < 0.2


def test_two_logs_of_the_flight_are_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The subtitles have the video's own time, the flight record the angles; its clock shows local time, and is off."""
    spec = SessionSpec(
        RecordedSpec("plane_turn", 3.0, whole_log=True), seconds=40.0, rate_hz=1.0, clicks_per_frame=1,
        camera=Camera.from_field_of_view(64, 48, 70.0),
    )  # fmt: skip
    session = simulated(spec)
    video = tmp_path / "DJI_0042.MP4"
    write_video(session, video)
    (subtitles,) = (path for path in tmp_path.iterdir() if path.suffix.lower() == ".srt")
    record = local_record(session / "telemetry.tlog", tmp_path / "record.csv", 13 * 3600.0 + 7.3)
    logs = ("--telemetry", subtitles, "--telemetry", record)
    assert imported(tmp_path, video, *logs, "--set", "camera.fov_deg=70") == 0
    printed = capsys.readouterr().out
    assert "attitude from record.csv" in printed and "clock of record.csv moved by -468" in printed
    assert f"--telemetry {subtitles} --telemetry {record}" in printed.splitlines()[-1]
    assert load_config_files(tmp_path / "flight" / "config.toml").solve.attitude == "autopilot"
    shutil.rmtree(tmp_path / "flight")
    other = local_record(find_recording("plane_glitch")[0], tmp_path / "other.csv", 0.0)
    assert imported(tmp_path, video, "--telemetry", subtitles, "--telemetry", other) == 2
    complaint = capsys.readouterr().err
    assert "other.csv: not two logs of one flight" in complaint and complaint.count("\n") == 1


def test_a_gopro_s_own_track_is_its_log_and_another_s_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exiftool_reader, "PROGRAM", "no-exiftool-here")
    video = clip(tmp_path / "GX010042.MP4")
    with_track(video, b"gpmd", *gopro_seconds())
    assert imported(tmp_path, video) == 0
    assert "the times of the telemetry in it" in capsys.readouterr().out
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(T0_S, abs=0.1)
    assert 0.4 < load_config_files(tmp_path / "flight" / "config.toml").camera.sigma_latency_s < 0.6
    parrot = clip(tmp_path / "P0042.MP4")
    with_track(parrot, b"mett", [b"x"], [0.0], b"application/octet-stream;type=com.parrot.videometadata2")
    assert main(["import-video", str(parrot), "--out", str(tmp_path / "other")]) == 2
    complaint = capsys.readouterr().err
    assert "no log of the flight next to it" in complaint and "In the video is a Parrot's telemetry" in complaint
    assert "DJI" not in complaint


def test_times_of_frames_from_a_file_go_before_all_others_and_one_for_each_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video, stamps = clip(tmp_path / "20260612T101525Z.mp4", 5), tmp_path / "taken.csv"
    times_s = [BEGAN.timestamp() + moment for moment in (7.0, 7.11, 7.19, 7.3, 7.4)]
    stamps.write_text("index,unix_time_s\n" + "".join(f"{k},{time:.3f}\n" for k, time in enumerate(times_s)))
    arguments = (video, "--telemetry", table(tmp_path), "--stamps", stamps)
    assert imported(tmp_path, *arguments) == 0
    assert f"times   {stamps}, from 2026-06-12 10:15:30.000 UTC" in capsys.readouterr().out
    with (tmp_path / "flight" / "stamps.csv").open(newline="") as stream:
        assert [float(row["unix_time_s"]) for row in csv.DictReader(stream)] == pytest.approx(times_s)
    config = load_config_files(tmp_path / "flight" / "config.toml")
    assert config.camera.sigma_latency_s == pytest.approx(0.1, abs=0.01)
    shutil.rmtree(tmp_path / "flight")
    assert imported(tmp_path, *arguments, "--start", "2026-06-12T10:15:23.4Z") == 2
    assert "--start and --stamps" in capsys.readouterr().err
    for row, why in (("", "no stamp for index 4"), (f"{'9' * 5000},{times_s[0]}\n", "is not 0 to 4")):
        stamps.write_text("".join(stamps.read_text().splitlines(keepends=True)[:5]) + row)
        assert imported(tmp_path, *arguments) == 2
        assert why in capsys.readouterr().err


def test_a_stream_s_metadata_are_its_log_and_its_field_of_view_the_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = clip(tmp_path / "clip.ts")
    with_metadata(video, {0.2 * k: misb_set(misb_items(Moment(0.2 * k))) for k in range(10)})
    assert imported(tmp_path, video) == 0
    printed = capsys.readouterr().out
    assert "the times of the telemetry in it" in printed and "59 deg wide" in printed  # 60, to 6 %
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(T0_S, abs=0.1)
    config = load_config_files(tmp_path / "flight" / "config.toml")
    assert (config.mount.gimbal, config.solve.attitude) == ("always", "autopilot")


def test_what_ardupilot_s_camera_wrote_into_each_picture_is_the_video_s_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = clip(tmp_path / "A_0042.mp4")
    every = b"".join(message(snapshot(0.1 * k)) for k in range(20))
    video.write_bytes(video.read_bytes() + box(b"free", every))
    assert imported(tmp_path, video) == 0
    printed = capsys.readouterr().out
    assert "the times of the telemetry in it" in printed and "the gimbal's angles as the log states" in printed
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(T0_S, abs=0.1)
    # Its clock and the log's are one, whatever UTC is.
    assert 0.4 < load_config_files(tmp_path / "flight" / "config.toml").camera.sigma_latency_s < 0.6


def test_angles_in_the_log_say_how_the_camera_is_held(tmp_path: Path) -> None:
    video = clip(tmp_path / "clip.mp4", 120)  # as long as the subtitles
    for kind, gimbal, attitude in (("srt", "always", "autopilot"), ("tlog", "auto", "autopilot")):
        log = written(tmp_path, kind)
        out = tmp_path / kind
        start = () if kind == "srt" else ("--start", "2026-11-20T23:23:25Z")
        assert main(["import-video", str(video), "--telemetry", str(log), "--out", str(out), *start]) == 0
        config = load_config_files(out / "config.toml")
        assert (config.mount.gimbal, config.solve.attitude) == (gimbal, attitude), kind


@pytest.mark.parametrize("change", [turn, lambda video: show_from(video, 0.55, 1.0)])
def test_a_video_that_is_shown_turned_or_in_part_is_read_to_its_end(
    tmp_path: Path, change: Callable[[Path], None]
) -> None:
    """A turned one had another size when it was opened than when it was read; of a cut one a frame is not shown."""
    video = clip(tmp_path / "20260612T101525Z.mp4")
    change(video)
    assert imported(tmp_path, video, "--telemetry", table(tmp_path), "--clock-offset", "0") == 0
    camera = Camera.from_json(tmp_path / "flight" / "camera.json")
    assert camera.size_px == (64, 48)
    frames = list(open_frames(video, camera).frames())
    assert len(frames) in (11, 20) and sum(frame.image is not None for frame in frames) >= len(frames) - 1


def test_subtitles_of_a_longer_video_are_on_a_clock_that_is_searched_or_stated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were taken for its own: of a video whose first six seconds were cut off all clicks were 59 m off."""
    log = written(tmp_path, "srt")
    video = clip(tmp_path / "cut.mp4")
    assert imported(tmp_path, video, "--telemetry", log) == 2
    complaint = capsys.readouterr().err
    assert "error: clock: " in complaint and complaint.count("\n") == 1
    assert "a video of 12.0 s and it has 1.9 s" in complaint and "--clock-offset -S" in complaint
    assert imported(tmp_path, video, "--telemetry", log, "--clock-offset=-6.0") == 0
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(T0_S + 6.0, abs=0.1)
    assert load_config_files(tmp_path / "flight" / "config.toml").camera.sigma_latency_s > 0.05


@pytest.mark.parametrize(("begin_s", "first_s"), [(0.5, 0.0), (0.52, 0.08), (0.6, 0.0)])
def test_of_a_video_cut_within_a_picture_the_next_is_shown_later(
    tmp_path: Path, begin_s: float, first_s: float
) -> None:
    """It was taken to be shown at once: a picture too early, 33 ms of 30 a second."""
    video = clip(tmp_path / "cut.mp4", 130)
    show_from(video, begin_s, 12.0)
    assert imported(tmp_path, video, "--telemetry", written(tmp_path, "srt")) == 0
    first = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()[1]
    assert float(first.split(",")[1]) == pytest.approx(T0_S + first_s, abs=0.001)


@pytest.mark.parametrize(("frames", "sigma_s"), [(120, 0.1), (116, 0.24)])
def test_what_a_video_lacks_of_its_log_may_have_been_cut_off_its_beginning(
    tmp_path: Path, frames: int, sigma_s: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cuts below half a second were not noticed, 10 m at 20 m/s: 0 % of clicks within 90 %."""
    video = clip(tmp_path / "cut.mp4", frames)
    assert imported(tmp_path, video, "--telemetry", written(tmp_path, "srt")) == 0
    camera = load_config_files(tmp_path / "flight" / "config.toml").camera
    assert camera.sigma_latency_s == pytest.approx(sigma_s, abs=0.01)
    assert ("its beginning may have been cut off" in capsys.readouterr().out) == (frames < 120)


def test_a_lens_of_which_nothing_is_known_is_wide_and_open(tmp_path: Path) -> None:
    optics = optics_of((1640, 1232), None, tmp_path / "photos", {})
    assert not optics.is_known and optics.text.startswith(UNKNOWN) and "camera.fov_deg" in optics.text
    (tmp_path / "camera.json").write_text(optics.file_text)
    read = Camera.from_json(tmp_path / "camera.json")
    assert read.sigma[0] == pytest.approx(0.2, rel=0.01) and read.sigma[3] == pytest.approx(0.1)
