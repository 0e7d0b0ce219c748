"""`pc-onboard calibrate --zoom`: one camera file out of a board seen at several zoom positions."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from contract.camera import Camera
from onboard.__main__ import main
from onboard.calibration.board import Board
from onboard.calibration.intrinsics import View
from onboard.commands import calibrate_zoom
from tests.onboard.calibration.board_pictures import poses_all_over
from tests.onboard.calibration.test_intrinsics import TRUTH, seen

TELE = replace(
    TRUTH, fx_px=2.0 * TRUTH.fx_px, fy_px=2.0 * TRUTH.fy_px, cx_px=330.0, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)
)


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders whose pictures were taken at 1x, at 2x, and too few of them."""

    def views(board: Board, folder: Path) -> tuple[list[View], tuple[int, int]]:
        times = 2.0 if folder.name == "tele" else 1.0
        poses = poses_all_over(4 if folder.name == "few" else 40, 5, 0.8, 0.33 * times)
        return seen(poses, camera=TELE if times > 1.0 else TRUTH), TRUTH.size_px

    monkeypatch.setattr(calibrate_zoom, "views_of_folder", views)
    return tmp_path


def test_a_table_of_two_positions_is_what_both_were(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folders / "camera.json"
    words = ["calibrate", "--zoom", f"2={folders / 'tele'}", "--zoom", f"1={folders / 'wide'}", "--out", str(out)]
    assert main(words) == 0, capsys.readouterr()
    camera = Camera.from_json(out)
    assert camera.zoom.unit == "times" and camera.zoom.position == (1.0, 2.0)
    assert camera.focal_px == pytest.approx(TRUTH.focal_px, rel=0.003)
    tele = camera.zoomed(math.log(camera.zoom.focal_px[1]))
    assert tele.focal_px == pytest.approx(TELE.focal_px, rel=0.006)
    assert tele.cx_px == pytest.approx(330.0, abs=12.0) and camera.cx_px == pytest.approx(TRUTH.cx_px, abs=3.0)
    assert 0.0 < camera.sigma[0] < 0.006
    assert "zoom 1 to 2 times" in capsys.readouterr().out
    assert json.loads(out.read_text())["calibration"]["verdict"]


@pytest.mark.long
def test_one_position_that_is_not_good_writes_nothing(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folders / "camera.json"
    words = ["calibrate", "--zoom", f"1={folders / 'wide'}", "--zoom", f"2={folders / 'few'}", "--out", str(out)]
    assert main(words) == 1
    assert "at zoom 2 is not good" in capsys.readouterr().out and not out.exists()
