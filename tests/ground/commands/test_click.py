"""`pc-ground click` as its user sees it: arguments in; text, JSON and exit status out."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from contract.answer import time_utc
from contract.errors import InputError
from contract.feature_set import FeatureSet, Status
from contract.locate import locate
from contract.wire.codec import decode, encode
from ground.__main__ import main
from ground.commands.click import line_click
from tests.ground.recorded import record
from tests.ground.worlds import CAMERA, build

pytestmark = pytest.mark.xdist_group("click")  # one worker: what they share is made once

START_NS = 1_700_000_000_250_000_000
FIELDS = ["status", "lat_deg", "lon_deg", "height_ellipsoid_m", "height_amsl_m", "ellipse", "sigma_height_m", "method",
          "frame", "time_utc", "age_s", "vehicle"]  # fmt: skip


def sets() -> list[FeatureSet]:
    rng = np.random.default_rng(0)
    out = [build(rng, frame=i, capture_unix_ns=START_NS + i * 10**9).feature_set for i in range(3)]
    return [*out, FeatureSet("uav-1", 7, 3, START_NS + 3 * 10**9, Status.TURNING, CAMERA)]


SETS = sets()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> str:
    return record(tmp_path_factory.mktemp("session") / "s.mcap", SETS)


@pytest.mark.parametrize(
    ("which", "frame"),
    [
        ([], 2),
        (["--frame", "0"], 0),
        (["--file", "picture_1.png"], 1),
        (["--file", "/some/where/picture_1.png"], 1),
        (["--time", str(START_NS / 1e9 + 0.4)], 0),
        (["--vehicle", "uav-1", "--frame", "1"], 1),
    ],
)
def test_a_click_answers_in_json(
    session: str, capsys: pytest.CaptureFixture[str], which: list[str], frame: int
) -> None:
    assert main(["click", "300.25", "240", *which, "--from", session, "--format", "json"]) == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    expected = locate(decode(encode(SETS[frame])), (300.25, 240.0))
    assert err == ""
    assert list(answer) == FIELDS
    assert answer["status"] == "ok" and answer["frame"] == frame and answer["vehicle"] == "uav-1"
    assert answer["lat_deg"] == pytest.approx(expected.lat_deg, abs=1e-9)
    assert answer["lon_deg"] == pytest.approx(expected.lon_deg, abs=1e-9)
    assert answer["height_amsl_m"] == pytest.approx(expected.height_amsl_m, abs=1e-3)
    assert answer["height_ellipsoid_m"] - answer["height_amsl_m"] == pytest.approx(20.0, abs=2e-3)
    assert list(answer["ellipse"]) == ["confidence", "semi_major_m", "semi_minor_m", "azimuth_deg"]
    assert answer["ellipse"]["confidence"] == 0.9
    assert answer["ellipse"]["semi_major_m"] == pytest.approx(expected.ellipse.semi_major_m, abs=1e-3)
    assert answer["method"] == "interpolated"
    assert answer["time_utc"] == f"2023-11-14T22:13:{20 + frame}.250000Z"
    assert re.search(r'"lat_deg": -\d+\.\d{9},', out) and re.search(r'"lon_deg": \d+\.\d{9},', out)


def test_a_batch_answers_every_click_in_order_refusals_included(
    session: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clicks = tmp_path / "clicks.csv"
    clicks.write_text("\ufeffv,frame,u,note\n240,2,300,tower\n5000,0,5,\n240,3,300,\n200.5,1,310.25,\n1,50,1,\n")
    assert main(["click", "--batch", str(clicks), "--from", session]) == 0
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [a["status"] for a in answers] == ["ok", "outside", "turning", "ok", "unknown_frame"]
    assert [a["frame"] for a in answers] == [2, 0, 3, 1, 50]
    assert [a["age_s"] for a in answers] == [1.0, 3.0, 0.0, 2.0, None]
    expected = locate(decode(encode(SETS[1])), (310.25, 200.5))
    assert answers[3]["lat_deg"] == pytest.approx(expected.lat_deg, abs=1e-9)


def test_a_batch_may_name_pictures_by_their_files(
    session: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_file, by_frame = tmp_path / "files.csv", tmp_path / "frames.csv"
    by_file.write_text("file,u,v\npicture_1.png,310.25,200.5\n/some/where/picture_0.png,300,240\nother.png,1,2\n")
    by_frame.write_text("frame,u,v\n1,310.25,200.5\n0,300,240\n")
    assert main(["click", "--batch", str(by_file), "--from", session]) == 0
    named = capsys.readouterr().out.splitlines()
    assert main(["click", "--batch", str(by_frame), "--from", session]) == 0
    assert named[:2] == capsys.readouterr().out.splitlines()
    assert json.loads(named[2])["status"] == "unknown_frame" and "'other.png'" in named[2]


def test_the_ground_needs_nothing_but_numpy_and_zenoh(session: str) -> None:
    """Every other package is blocked; a click from a recording and the link's client still load and answer."""
    script = """
import sys
allowed = {"numpy", "zenoh", "contract", "ground"}
class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in allowed or top in sys.stdlib_module_names or top.startswith("_"):
            return None
        raise ImportError(f"{name} is not part of the ground's installation")
sys.meta_path.insert(0, Blocker())
import ground.client
from ground.__main__ import main
code = main(sys.argv[1:])
heavy = {"cv2", "scipy", "mavsdk", "pymavlink", "mcap", "onboard"} & set(sys.modules)
assert not heavy, heavy
sys.exit(code)
"""
    command = [sys.executable, "-c", script, "click", "300", "240", "--from", session]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "interpolated" in done.stdout


@pytest.mark.parametrize(
    ("unix_ns", "text"),
    [
        (0, "1970-01-01T00:00:00.000000Z"),
        (1_525_226_625_999_999_999, "2018-05-02T02:03:45.999999Z"),
        (2**63, "2262-04-11T23:47:16.854775Z"),
        (2**64 - 1, "2554-07-21T23:34:33.709551Z"),
    ],
)
def test_times_are_written_in_utc(unix_ns: int, text: str) -> None:
    assert time_utc(unix_ns) == text


def test_the_age_in_a_recording_is_against_its_newest_picture(session: str, capsys: pytest.CaptureFixture[str]) -> None:
    def click(*options: str) -> tuple[int, dict[str, object]]:
        code = main(["click", "300", "240", "--from", session, "--format", "json", *options])
        return code, json.loads(capsys.readouterr().out)

    # The newest picture, a second later, is refused; only who gives a limit is kept from the one before.
    assert click()[1]["age_s"] == 1.0
    assert click("--frame", "0")[1]["age_s"] == 3.0
    assert click("--max-age", "1")[0] == 0 and click("--max-age", "inf")[0] == 0
    code, answer = click("--max-age", "0.9")
    assert code == 3 and answer["status"] == "stale" and answer["frame"] == 2 and answer["age_s"] == 1.0
    assert "frame 3, 0.0 s old, is refused: turning: the aircraft was turning too fast" in str(answer["reason"])
    assert click("--frame", "3")[1]["age_s"] == 0.0
    assert click("--frame", "77")[1]["age_s"] is None


@pytest.mark.parametrize("line", ["38,5 384", "416,5, 384", "416, 384,5", "14 480,120"])
def test_a_line_with_commas_that_may_be_decimal_is_no_click(line: str) -> None:
    """Pixel 38,5 384 was answered as pixel 5 384 of picture 38."""
    with pytest.raises(InputError, match="are these commas decimal"):
        line_click(line)


@pytest.mark.parametrize("line", ["14 480 120", "14,480,120", "14, 480, 120", "14 , 480 , 120 # tent"])
def test_a_line_of_one_kind_of_separator_is_a_click(line: str) -> None:
    assert line_click(line) == (14, 480.0, 120.0)
