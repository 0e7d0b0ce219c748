"""Digital zoom that a log states: the focal length goes with it, and a picture of another zoom is not used."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from onboard.config.schema import Config
from onboard.events.types import Zoom
from onboard.replay.digital_zoom import SIGMA_EQUIVALENT, enlarged, optical_zoom
from onboard.replay.runner import Flight

CAMERA = Camera(
    64, 48, 80.0, 82.0, 30.0, 26.0, (-0.1, 0.02, 0.001, -0.001, 0.0), stated_sigma=(0.02, 0.01, 0.01, 0.05, 0.05)
)


def flight(tmp_path: Path, ratios: list[str], word: str = "dzoom_ratio") -> Flight:
    video, log = tmp_path / "DJI_0042.MP4", tmp_path / "DJI_0042.SRT"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (64, 48))
    lines = []
    for i, ratio in enumerate(ratios):
        writer.write(np.full((48, 64, 3), i, np.uint8))
        lines.append(
            f"{i + 1}\n00:00:{i // 10:02d},{i % 10}00 --> 00:00:{(i + 1) // 10:02d},{(i + 1) % 10}00\n"
            f"2024-06-01 09:00:{i // 10:02d}.{i % 10}00\n[{word}: {ratio}], [latitude: 41.3] "
            f"[longitude: 8.{300000 + i}] [rel_alt: 50.6 abs_alt: 300]\n"
        )
    writer.release()
    log.write_text("\n".join(lines))
    return Flight.open(Config(), CAMERA, video, log, None)


def test_an_enlarged_picture_shows_the_middle_under_the_same_rays() -> None:
    """A pixel of the enlarged picture has the ray of the pixel it was made from, distortion included."""
    twice = enlarged(CAMERA, 2.0)
    pixels = np.array([[10.0, 20.0], [31.5, 23.5], [60.0, 40.0]])
    middle = np.array([31.5, 23.5])
    rays, valid = CAMERA.unproject(middle + (pixels - middle) / 2.0)
    again, also = twice.unproject(pixels)
    assert valid.all() and also.all()
    assert again == pytest.approx(rays, abs=1e-9)
    assert twice.sigma == CAMERA.sigma


def test_the_camera_of_a_zoomed_flight_is_the_enlarged_one(tmp_path: Path) -> None:
    opened = flight(tmp_path, ["2.00"] * 30)
    assert opened.camera == enlarged(CAMERA, 2.0) and len(opened.stamps_ns) == 30
    assert any("digital zoom 2: " in note for note in opened.notes)


def test_without_zoom_nothing_changes(tmp_path: Path) -> None:
    opened = flight(tmp_path, ["1.00"] * 30)
    assert opened.camera is CAMERA and not any("zoom" in note for note in opened.notes)


def test_pictures_at_another_zoom_than_most_are_left_out_and_reported(tmp_path: Path) -> None:
    opened = flight(tmp_path, ["1.00"] * 20 + ["2.00"] * 6 + ["1.00"] * 4)
    assert opened.camera == CAMERA
    frames = list(opened.frames.frames())
    assert [frame.index for frame in frames] == [*range(20), *range(26, 30)]
    assert [frame.stamp_ns for frame in frames] == opened.stamps_ns and len(opened.frames.names) == 24
    assert any("6 of 30 pictures at digital zoom 2 are left out" in note for note in opened.notes)


def test_a_focal_length_that_changes_is_a_zoom_that_is_reported(tmp_path: Path) -> None:
    """80 px of 64 are 45 mm; nothing of it was reported, and 90 mm had the scale of 45."""
    opened = flight(tmp_path, ["45.00"] * 15 + ["90.00"] * 15, "focal_len")
    assert opened.camera == CAMERA and len(opened.stamps_ns) == 30
    assert any("from 45 to 90 mm: followed" in note for note in opened.notes)
    events = [(moment_ns, event) for moment_ns, event in opened.events() if isinstance(event, Zoom)]
    began_ns = opened.stamps_ns[0]
    for moment_ns, zoom in events:
        assert moment_ns == zoom.stamp_ns and zoom.unit == "focal_px" and zoom.step == 0.0
        assert zoom.value == pytest.approx(80.0 if zoom.stamp_ns < began_ns + 1_500_000_000 else 160.0)
    stamps_ns = [zoom.stamp_ns - began_ns for _, zoom in events]
    assert 1_499_999_999 in stamps_ns and 1_500_000_000 in stamps_ns and max(np.diff(stamps_ns)) <= 250_000_000


@pytest.mark.parametrize(
    ("lengths_mm", "digital", "note", "sigma"),
    [
        ((45.0, 45.0), 0, "", None),
        ((45.0, 90.0), 2, "and the digital zoom too", None),
        ((200.0, 300.0), 0, "is none of these", None),
        ((44.0, 48.0), 0, "followed", SIGMA_EQUIVALENT),  # which of both the file is for is not known that well
    ],
)
def test_a_zoom_is_followed_only_where_its_scale_is_known(
    lengths_mm: tuple[float, float], digital: int, note: str, sigma: float | None
) -> None:
    steps = [(k * 10**9, length) for k, length in enumerate(lengths_mm)]
    zooms, notes = optical_zoom(CAMERA, tuple(steps), tuple((k, 1.0 + k) for k in range(digital)), 2 * 10**9)
    assert bool(zooms) is (sigma is not None) and bool(notes) is bool(note)
    assert all(note in one for one in notes)
    assert all(zoom.step / zoom.value / 12.0**0.5 == pytest.approx(sigma) for zoom in zooms)
