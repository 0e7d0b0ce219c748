"""An on-screen display in every picture: with its mask no feature is taken on it, and the ground is followed."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from contract.errors import InputError
from onboard.camera.picture_mask import read_mask
from onboard.vision.reduced_tracker import tracker_for

STEP_PX = 12


def scene(size_px: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """Two pictures of a ground of little contrast that moves by STEP_PX, with the same display, and where that is."""
    width, height = size_px
    rng = np.random.default_rng(4)
    ground = cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width + STEP_PX)).astype(np.float32), (0, 0), 2.5)
    ground = 120.0 + 12.0 * ground / ground.std()
    display = np.zeros((height, width), np.uint8)
    for row in range(60, height - 20, 60):
        cv2.putText(display, "ALT 123 SPD 17 HDG 271 BAT 15.2", (10, row), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 255, 3)
    shown = []
    for shift in (0, STEP_PX):
        picture = ground[:, shift : shift + width] + rng.normal(0.0, 1.0, (height, width))
        shown.append(np.where(display > 0, 250, np.clip(picture, 0, 255)).astype(np.uint8))
    around = np.asarray(cv2.dilate(display, np.ones((5, 5), np.uint8))) > 0
    return shown[0], shown[1], around


@pytest.mark.parametrize("size_px", [(640, 480), (2000, 1500)])
def test_with_the_mask_the_ground_is_followed_and_without_it_the_display(size_px: tuple[int, int]) -> None:
    first, second, burned_in = scene(size_px)
    followed = {}
    for is_masked in (False, True):
        tracker = tracker_for(size_px, 100)
        if is_masked:
            tracker.leave_out(burned_in)
        tracker.track(first, None)
        _, uv = tracker.promote(tracker.nothing())
        on_display = burned_in[np.rint(uv[:, 1]).astype(int), np.rint(uv[:, 0]).astype(int)]
        tracks = tracker.track(second, None)
        moved = tracks.uv_px - tracks.keyframe_uv_px
        with_ground = np.linalg.norm(moved - [-STEP_PX, 0.0], axis=1) < 1.0
        followed[is_masked] = (float(on_display.mean()), int(with_ground.sum()), int((~with_ground).sum()))
    assert followed[True][0] == 0.0 and followed[True][1] > 50 and followed[True][2] == 0
    assert followed[False][0] > 0.2 and followed[False][1] < 0.8 * followed[True][1]


def write(path: Path, mask: NDArray[np.uint8]) -> Path:
    Image.fromarray(mask).save(path)
    return path


def test_a_mask_is_black_where_something_is_burned_in(tmp_path: Path) -> None:
    mask = np.full((48, 64), 255, np.uint8)
    mask[:10, :20] = 0
    burned_in = read_mask(write(tmp_path / "mask.png", mask), (64, 48))
    assert burned_in.dtype == bool
    np.testing.assert_array_equal(burned_in, mask == 0)
    assert read_mask(None, (64, 48)) is None


def test_what_is_no_mask_of_this_camera_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "mask.png", np.full((48, 64), 255, np.uint8))
    with pytest.raises(InputError, match=r"camera.mask: .*mask.png is 64x48; the camera file is for 640x480"):
        read_mask(path, (640, 480))
    with pytest.raises(InputError, match="No such file"):
        read_mask(tmp_path / "none.png", (64, 48))
    path.write_bytes(b"no picture")
    with pytest.raises(InputError, match="no picture"):
        read_mask(path, (64, 48))
    black = write(tmp_path / "black.png", np.zeros((48, 64), np.uint8))
    with pytest.raises(InputError, match="leaves 0 % of the picture: the ground is white"):
        read_mask(black, (64, 48))
