"""`pc-ground open`: a pilot's own flight in one command, until its first click is answered in a real browser."""

import argparse
import csv
import json
import resource
import subprocess
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ground.web import open_command
from onboard.telemetry.log_formats import SUFFIXES
from tests.own_flights import write_named_photographs, write_video
from tests.rest_long import rest_long
from tests.scenarios.flights import simulated
from tests.waiting import PATIENCE_S
from tests.web.browsing import Operator
from tests.web.conftest import page_is_built
from tests.web.served import TURNS, PageProgram

pytestmark = pytest.mark.xdist_group("open")  # one worker: the flight is sampled once
LIMIT_S = 60.0  # of processor time, from the command to the page


class Opened(PageProgram):
    def __init__(self, home: Path, *arguments: object) -> None:
        super().__init__("open", *arguments, "--no-browser", "--port", "0", home=home)

    def close(self) -> None:
        if self.process.poll() is None:
            self.end()


@pytest.fixture(scope="module")
def session() -> Path:
    return simulated(TURNS)


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., Opened]]:
    """Opens a flight; its folder of data is the test's own."""
    page_is_built()
    running: list[Opened] = []

    def start(*arguments: object) -> Opened:
        running.append(Opened(tmp_path / "home", *arguments))
        return running[-1]

    yield start
    for each in running:
        each.close()


def photographs(session: Path, folder: Path) -> list[object]:
    write_named_photographs(session, folder / "photos")
    return [folder / "photos", "--set", f"camera.file={session / 'camera.json'}"]


def video(session: Path, folder: Path) -> list[object]:
    write_video(session, folder / "DJI_0042.MP4")
    return [folder / "DJI_0042.MP4"]


@pytest.mark.parametrize("made", rest_long([video, photographs]))
def test_one_command_from_the_card_to_an_answered_click(
    session: Path, tmp_path: Path, opened: Callable[..., Opened], chromium: Any, made: Callable[..., list[object]]
) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    arguments = made(session, tmp_path)
    first = opened(*arguments)
    assert first.url, first.printed
    for words in ("camera", "mount", "log", "--set", "solved"):
        assert words in first.printed
    _answers(chromium, first)
    first.close()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime - before.ru_utime < LIMIT_S
    again = opened(*arguments)  # without a replay; and a session is opened as it is
    assert "replayed before" in again.printed
    (recorded,) = (tmp_path / "home").rglob("session.mcap")
    third = opened(recorded)
    _answers(chromium, third)


def _answers(chromium: Any, server: Opened) -> None:
    """The page has the pictures, and a click in the middle of one that is solved has a coordinate."""
    operator = Operator(chromium, server, has_map=False)  # type: ignore[arg-type]
    try:
        rows = operator.ask(f"api/vehicles/{operator.ask('api/status')['vehicles'][0]['id']}/frames")
        assert all(row["has_picture"] for row in rows)
        operator.click(240, 180)
        place = operator.newest_pin()["place"]
        assert place["status"] == "ok" and place["ce90_m"] < 60.0
        operator.clear()
        operator.check()
    finally:
        operator.context.close()


def test_two_logs_reach_the_import_and_name_the_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []

    def output(command: list[str]) -> subprocess.CompletedProcess[str]:
        asked.append(command)
        return subprocess.CompletedProcess(command, 2, "")

    monkeypatch.setattr(open_command, "_output", output)
    monkeypatch.setattr(open_command, "pc_onboard", lambda: "pc-onboard")
    video, one, other = (tmp_path / name for name in ("a.mp4", "a.srt", "record.csv"))
    for path in (video, one, other):
        path.write_bytes(b"x")
    parser = argparse.ArgumentParser()
    open_command.add_arguments(parser)
    for words in (["--telemetry", one, "--telemetry", other], [one, "--telemetry", other]):
        assert open_command.run(parser.parse_args(list(map(str, [video, *words])))) == 2
    assert open_command.run(parser.parse_args([str(video), str(one)])) == 2
    stamps = tmp_path / "stamps.csv"
    stamps.write_text("index,unix_time_s\n")
    assert open_command.run(parser.parse_args([str(video), str(one), "--stamps", str(stamps)])) == 2
    timed = asked.pop()
    assert timed[timed.index("--stamps") + 1] == str(stamps) and timed[-1] != asked[-1][-1]
    two, same, single = ([c[i + 1] for i, word in enumerate(c) if word == "--telemetry"] for c in asked)
    assert two == same == [str(one), str(other)] and single == [str(one)]
    assert asked[0][-1] == asked[1][-1] != asked[2][-1]  # the folder of the flight


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("day/flight/00000042.BIN", []), ("day/flight/camera.json", []), ("day/camera.json", []),
        ("day/flight/stamps.csv", []), ("day/flight/geo.txt", []), ("day/config.toml", []),
        ("day/flight/photos/camera.json", ["log.tlog"]), ("calibrated.json", ["--set", "camera.file=calibrated.json"]),
        ("calibrated.json", ["--set", 'camera.file="calibrated.json"']), ("dem/n43.tif", ["--set", "terrain.path=dem"]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("is_video", [False, True])
def test_a_flight_is_replayed_again_after_any_file_that_its_import_read_has_changed(
    where: str, words: list[str], is_video: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flight that was opened again with a camera file that had been calibrated meanwhile answered by the old one."""
    monkeypatch.chdir(tmp_path)
    photos = Path("day/flight/photos")
    photos.mkdir(parents=True)
    Path("dem").mkdir()
    (photos / "1.jpg").write_bytes(b"x")
    (photos / "1.mp4").write_bytes(b"x")
    parser = argparse.ArgumentParser()
    open_command.add_arguments(parser)
    if is_video and where == "day/flight/00000042.BIN":
        where = "day/flight/photos/00000042.BIN"  # a video's log lies next to it
    args = parser.parse_args([str(photos / "1.mp4") if is_video else str(photos), *words])

    def name() -> str:
        return open_command._name(args, open_command._import_words(args))

    first = name()
    Path("day/flight/other.txt").write_bytes(b"no log")
    assert name() == first
    Path(where).write_bytes(b"one")
    second = name()
    Path(where).write_bytes(b"another")
    assert len({first, second, name()}) == 3


def test_what_may_be_a_log_is_known_to_who_opens_a_flight() -> None:
    assert set(open_command.LOG_SUFFIXES) == set(SUFFIXES)


@pytest.mark.long
def test_a_session_without_pictures_says_why_and_what_helps(
    session: Path, tmp_path: Path, opened: Callable[..., Opened]
) -> None:
    write_named_photographs(session, tmp_path / "photos")
    for path in sorted((tmp_path / "photos").glob("*.png"))[10:]:  # some pictures of a flight are a flight
        path.unlink()
    camera = f"camera.file={session / 'camera.json'}"
    bare = opened(tmp_path / "photos", "--set", camera, "--set", "recording.pictures=none")
    assert "holds no pictures" in bare.printed and "--video" in bare.printed
    with urllib.request.urlopen(f"{bare.url}api/status", timeout=PATIENCE_S) as reported:
        assert "--video" in json.load(reported)["no_pictures"]


def no_log(session: Path, folder: Path) -> list[object]:
    write_video(session, folder / "clip.mp4", subtitles=False)
    return [folder / "clip.mp4"]


def another_day_s_log(session: Path, folder: Path) -> list[object]:
    write_named_photographs(session, folder / "photos")
    log = folder / "photos" / "flight.tlog"
    log.unlink()
    with (session / "truth.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    table = ["unix_time_s,lat_deg,lon_deg,height_amsl_m"]
    table += [f"{float(r['unix_time_s']) + 86400.0},{r['lat_deg']},{r['lon_deg']},{r['height_amsl_m']}" for r in rows]
    (folder / "other.csv").write_text("\n".join(table))
    return [folder / "photos", folder / "other.csv"]


def nothing_says_where(session: Path, folder: Path) -> list[object]:
    write_named_photographs(session, folder / "photos")
    (folder / "photos" / "flight.tlog").unlink()
    return [folder / "photos"]


def two_logs(session: Path, folder: Path) -> list[object]:
    write_video(session, folder / "clip.mp4", subtitles=False)
    for name in ("a.tlog", "b.tlog"):
        (folder / name).write_bytes(b"x")
    return [folder / "clip.mp4"]


def no_beginning(session: Path, folder: Path) -> list[object]:
    return [*no_log(session, folder), session / "telemetry.tlog"]


def not_there(session: Path, folder: Path) -> list[object]:
    return [folder / "nothing.mp4"]


def wrong_setting(session: Path, folder: Path) -> list[object]:
    return [*video(session, folder), "--set", "mount.pich_deg=-45"]


# What the import itself finds missing is in short of tests/onboard/commands/test_import_video.py and _photos.py.
@pytest.mark.parametrize(
    ("made", "reported"),
    rest_long(
        [
            (not_there, "no such file"), (wrong_setting, "mount.pitch_deg"), (another_day_s_log, "do not overlap"),
            (no_log, "no log of the flight next to it"), (nothing_says_where, "no GPS position with a height"),
            (two_logs, "several logs"), (no_beginning, "when it began: give --start"),
        ],
        kept=2,
    ),
)  # fmt: skip
def test_what_is_missing_is_reported_in_a_line(
    session: Path, tmp_path: Path, opened: Callable[..., Opened], made: Callable[..., list[object]], reported: str
) -> None:
    ended = opened(*made(session, tmp_path))
    assert ended.process.returncode == 2 and reported in ended.printed, ended.printed
    assert ended.printed.count("\n") == 1, ended.printed
