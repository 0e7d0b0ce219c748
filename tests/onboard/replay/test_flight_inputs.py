"""What a replay's inputs have to do with each other: a video next to its subtitles, EXIF cut to the second, help."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.__main__ import main
from onboard.config.schema import Config, parse_config
from onboard.replay.runner import Flight
from tests.onboard.telemetry.log_writers import T0_S, written

CAMERA = Camera.from_field_of_view(64, 48, 40.0)


def test_a_video_next_to_its_subtitles_needs_no_stamps_and_no_name(tmp_path: Path) -> None:
    """Their own times are the video's, to the frame, whatever the clock in either says."""
    log = written(tmp_path, "srt")
    flight = Flight.open(Config(), CAMERA, video_of(tmp_path / "DJI_0042.MP4", 360), log, None)
    assert flight.stamps_ns == [round(T0_S * 1e9) + round(i / 30 * 1e9) for i in range(360)]


@pytest.mark.parametrize("frames", [340, 396])
def test_of_a_video_that_was_cut_or_is_another_the_subtitles_times_are_not_its_own(tmp_path: Path, frames: int) -> None:
    """The first six seconds cut off put all clicks 59 m off with an ellipse of 17 m, and no word of it."""
    video = video_of(tmp_path / "cut.MP4", frames)
    with pytest.raises(InputError, match=r"its log is of a video of 12\.0 s and it has .* import-video"):
        Flight.open(Config(), CAMERA, video, written(tmp_path, "srt"), None)


def video_of(path: Path, frames: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (64, 48))
    for i in range(frames):
        writer.write(np.full((48, 64, 3), i % 256, np.uint8))
    writer.release()
    return path


def photographs(folder: Path, seconds: list[int]) -> Path:
    folder.mkdir()
    for index, second in enumerate(seconds):
        tags = Image.Exif()
        # T0_S is 2026-11-20 23:23:20 UTC.
        tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = f"2026:11:20 23:23:{20 + second:02d}"
        Image.new("L", (64, 48), 100).save(folder / f"IMG_{index:04d}.JPG", exif=tags)
    return folder


def test_exif_cut_to_the_second_serves_where_it_is_declared(tmp_path: Path) -> None:
    frames, log = photographs(tmp_path / "frames", [2, 4, 5, 5, 7]), written(tmp_path, "csv")
    with pytest.raises(InputError, match=r"camera\.latency_s = -0\.5 and camera\.sigma_jitter_s = 0\.3"):
        Flight.open(Config(), CAMERA, frames, log, None)
    declared = parse_config("[camera]\nlatency_s = -0.5\nsigma_jitter_s = 0.3\n")
    flight = Flight.open(declared, CAMERA, frames, log, None)
    # In the middle of what each second leaves open; two in one second share it, in the order of their names.
    assert [stamp / 1e9 - T0_S for stamp in flight.stamps_ns] == [2.5, 4.5, 5.5, 6.0, 7.5]


@pytest.mark.parametrize(
    ("command", "example"),
    [("replay", "--telemetry 00000042.BIN"), ("import-photos", "pc-onboard import-photos /media/card")],
)
def test_help_has_an_example(command: str, example: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    assert example in capsys.readouterr().out


def test_exif_of_a_video_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"x")
    with pytest.raises(InputError, match="is a video; pictures in a folder have EXIF"):
        Flight.open(Config(), CAMERA, tmp_path / "a.mp4", "exif", None)
