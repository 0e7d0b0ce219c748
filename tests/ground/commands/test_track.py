"""`pc-ground track`, CoT and files of paths: what is printed and written of followed things."""

import json
import threading
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.geodesy import LocalFrame
from contract.topics import TRACKS
from contract.track import Course, TrackReport, TrackState, Unseen
from contract.wire.message import TRACK_REPORTS
from contract.wire.track_code import decode_track, encode_track
from ground.__main__ import main
from ground.commands.track import _Silent
from ground.formats import cot, track_path
from ground.received_tracks import SILENT_S, ReceivedTracks
from ground.recording import Recording
from onboard.link.publisher import Publisher, Rate
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set
from tests.contract.test_track_code import REPORT
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

NOW_NS = 1_700_000_001_000_000_000


class Following(threading.Thread):
    """An aircraft that follows whatever it is asked to, and loses it in its fifth report; `most` it makes."""

    most = 10**9

    def __init__(self, publisher: Publisher) -> None:
        super().__init__(daemon=True)
        self.publisher, self.asked, self.ended = publisher, list[str](), threading.Event()
        publisher.follow = self.follow

    def follow(self, text: str) -> tuple[bytes, bool]:
        self.asked.append(text)
        if text.startswith("u=1.0"):
            return b'{"status": "outside", "reason": "off the picture"}', True
        return (b'{"track": 3, "frame": 7}' if text.startswith("u=") else b'{"tracks": [3, 5]}'), False

    def run(self) -> None:
        count = 0
        while not self.ended.wait(0.05):
            if any(text.startswith("u=") for text in self.asked):
                count += 1
            if count > self.most:
                continue
            state = TrackState.LOST if count >= 5 else TrackState.FOLLOWED
            other = replace(REPORT, number=9, state=TrackState.FOLLOWED)
            self.publisher.report(TRACKS, encode_track(other) + encode_track(replace(REPORT, state=state)))


@pytest.fixture
def aircraft() -> Iterator[tuple[str, Following]]:
    endpoint = free_endpoint()
    with Publisher("uav-1", [endpoint], rate=Rate(max_bit_rate=1e7)) as publisher:
        following = Following(publisher)
        following.start()
        yield endpoint, following
        following.ended.set()
        following.join(5.0)


def test_each_report_is_a_line_until_the_thing_is_lost(
    aircraft: tuple[str, Following], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    endpoint, following = aircraft
    path = tmp_path / "car.geojson"
    assert main(["track", "320", "119.5", "--frame", "7", "--connect", endpoint, "--json", "--out", str(path)]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert following.asked == ["u=320.0;v=119.5;frame=7"]  # lost: there is nothing to stop
    assert lines[-1]["state"] == "lost" and {line["track"] for line in lines} == {3}
    assert lines[-1]["speed_m_s"] == pytest.approx(14.98) and lines[-1]["course_deg"] == pytest.approx(271.4, abs=0.01)
    assert lines[-1]["ellipse"]["semi_major_m"] == pytest.approx(2.5, rel=1e-3)
    assert json.loads(path.read_text())["features"][-1]["properties"]["track"] == 3


def test_what_the_aircraft_refuses_ends_with_its_reason(
    aircraft: tuple[str, Following], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", "1", "1", "--connect", aircraft[0]]) == 3
    assert capsys.readouterr().err == "outside: off the picture\n"


def test_all_tracks_are_listened_to_listed_and_stopped(
    aircraft: tuple[str, Following], capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint, following = aircraft
    assert main(["track", "--connect", endpoint, "--count", "6"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("track 9 followed") for line in lines)
    assert any("15.0 +-0.2 m/s towards 271 +-1 deg" in line for line in lines)
    assert main(["track", "--list", "--connect", endpoint]) == 0
    assert main(["track", "--stop", "5", "--connect", endpoint]) == 0
    assert capsys.readouterr().out == "3 5\n3 5\n"
    assert following.asked == ["", "stop=5"]


def test_ended_by_the_time_given_the_track_is_stopped_or_left(aircraft: tuple[str, Following]) -> None:
    endpoint, following = aircraft
    assert main(["track", "320", "100", "--connect", endpoint, "--seconds", "0.01"]) == 0
    assert following.asked[-1] == "stop=3"
    assert main(["track", "320", "100", "--connect", endpoint, "--seconds", "0.01", "--leave"]) == 0
    assert following.asked[-1].startswith("u=320.0")


def test_where_reports_stop_the_lines_go_on_until_it_is_lost(
    aircraft: tuple[str, Following], capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint, following = aircraft
    following.most = 3
    assert main(["track", "320", "100", "--connect", endpoint, "--seconds", "4", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["state"] for line in lines[:3]] == ["followed"] * 3
    silent = lines[3:]
    assert {line["unseen"] for line in silent} == {"no report"} and len(silent) >= 2
    widths = [line["ellipse"]["semi_major_m"] for line in (lines[2], silent[0])]
    assert silent[0]["state"] == "coasting" and widths[1] > widths[0]
    assert silent[-1]["state"] == "lost" and "lat_deg" not in silent[-1]


def test_a_program_that_stood_still_says_of_no_track_that_nothing_came_before_it_has_looked() -> None:
    """It was stopped for longer than a track may be silent, and the reports of that time wait for it."""
    silent = _Silent()
    times_s = [10.0, 10.2, 10.4, 11.8, 11.81, *np.arange(12.0, 15.0, 0.2).tolist()]
    shown = []
    for now_s in times_s:
        shown += [(now_s, report.state) for report in silent.passed(now_s, None)]
        if now_s in (10.0, 11.81):
            silent.take(replace(REPORT, state=TrackState.FOLLOWED), now_s)
    assert [state for _, state in shown][:: len(shown) - 1] == [TrackState.COASTING, TrackState.LOST]
    assert 11.81 + 1.0 < shown[0][0] < 11.81 + 1.8 and len(shown) in (3, 4)


def path_of(name: str) -> str:
    assert REPORT.place is not None
    reports: list[TrackReport] = []
    for k in range(4):
        place = replace(REPORT.place, lat_deg=REPORT.place.lat_deg + 1e-5 * k)
        reports.append(replace(REPORT, place=None if k == 2 else place, capture_unix_ns=NOW_NS + k * 500_000_000))
    return track_path.write(reports, name)


def test_a_path_is_a_line_with_times_in_geojson() -> None:
    features = json.loads(path_of("a.geojson"))["features"]
    assert [f["geometry"]["type"] for f in features] == ["LineString", "Point", "Point", "Point"]
    assert len(features[0]["geometry"]["coordinates"]) == len(features[0]["properties"]["times"]) == 3
    assert features[0]["properties"]["times"][0].startswith("2023-11-14T22:13:21")
    assert features[1]["geometry"]["coordinates"][:2] == [172.987654321, -43.123456789]


def test_a_path_is_a_track_with_times_in_kml() -> None:
    root = ET.fromstring(path_of("a.KML"))
    whens = [node.text for node in root.iter() if node.tag.endswith("}when")]
    places = [node.text for node in root.iter() if node.tag.endswith("}coord")]
    assert len(whens) == len(places) == 3 and str(places[0]).startswith("172.987654321 -43.123456789")


def test_cot_has_speed_and_course_and_of_a_thing_at_rest_no_course() -> None:
    text = cot.track_event(REPORT, NOW_NS, 30.0)
    assert text is not None
    track = ET.fromstring(text).find("detail/track")
    assert (track.get("course"), track.get("speed")) == ("271.4", "14.98")
    still = cot.track_event(replace(REPORT, course=Course(0.05, 0.1)), NOW_NS, 30.0)
    assert still is not None
    track = ET.fromstring(still).find("detail/track")
    assert track.get("course") is None and track.get("speed") == "0.00"
    point = ET.fromstring(still).find("point")
    assert 2.0 < float(str(point.get("ce"))) < 2.5
    assert cot.track_event(replace(REPORT, state=TrackState.LOST), NOW_NS, 30.0) is None
    assert cot.track_event(replace(REPORT, place=None), NOW_NS, 30.0) is None


def test_tracks_that_are_no_longer_reported_are_forgotten() -> None:
    now = [0.0]
    received = ReceivedTracks(lambda: now[0])
    received.take("pc/uav-1/tracks", encode_track(REPORT))
    received.take("pc/uav-1/tracks", b"\xff\xff")
    received.take("no/key", encode_track(REPORT))
    assert [report.vehicle for report in received.newest()] == ["uav-1"]
    assert received.newest()[0] == decode_track(encode_track(REPORT), "uav-1")
    now[0] = SILENT_S + 0.1
    assert not received.newest()


def test_where_reports_stop_the_place_moves_on_and_widens_and_is_then_withdrawn() -> None:
    now, seen = [0.0], replace(REPORT, state=TrackState.FOLLOWED, unseen=Unseen.NONE)
    received = ReceivedTracks(lambda: now[0])
    received.take("pc/uav-1/tracks", encode_track(seen))
    assert seen.course is not None
    frame = LocalFrame(seen.place.lat_deg, seen.place.lon_deg, 0.0)
    for now[0], state in ((0.8, TrackState.FOLLOWED), (1.9, TrackState.COASTING)):
        (report,) = received.newest(lambda _, stamp_ns: now[0] + 0.2)  # 0.2 s on its way
        assert report.state is state and report.unseen_s == pytest.approx(now[0] + 0.2)
        way = frame.to_enu(report.place.lat_deg, report.place.lon_deg, 0.0)[:2]
        assert np.hypot(*way) == pytest.approx(14.98 * (now[0] + 0.2), rel=1e-3) and way[0] < -10.0  # westward
        assert 1.0 < report.place.ellipse.semi_major_m - seen.place.ellipse.semi_major_m < 20.0
        assert report.capture_unix_ns - seen.capture_unix_ns == pytest.approx((now[0] + 0.2) * 1e9, abs=1e4)
    now[0] = 2.1
    (report,) = received.newest()
    assert (report.state, report.unseen, report.place, report.course) == (TrackState.LOST, Unseen.NO_REPORT, None, None)
    assert "lost (no report), seen 2.1 s ago" in report.to_text()


def test_a_report_that_came_late_is_as_old_as_its_picture() -> None:
    received = ReceivedTracks(lambda: 0.0)
    received.take("pc/uav-1/tracks", encode_track(replace(REPORT, state=TrackState.FOLLOWED, unseen=Unseen.NONE)))
    (report,) = received.newest(lambda *_: 3.0)
    assert report.state is TrackState.FOLLOWED
    assert 20.0 < report.place.ellipse.semi_major_m < 50.0
    (report,) = received.newest(lambda *_: 50.0)
    assert report.state is TrackState.LOST and report.place is None


def test_cot_times_are_those_of_the_last_look() -> None:
    text = cot.track_event(replace(REPORT, capture_unix_ns=NOW_NS, unseen_s=1.5), NOW_NS + 50_000_000_000, 30.0)
    assert text is not None
    event = ET.fromstring(text)
    seen = "2023-11-14T22:13:19.500Z"
    assert (event.get("time"), event.get("start"), event.get("stale")) == (seen, seen, "2023-11-14T22:13:49.500Z")


def test_what_was_followed_is_in_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "flight.mcap"
    with SessionRecorder(path, "uav-1") as file:
        file.write_set(replace(plain_set(5), vehicle="uav-1"))
        for k in range(3):
            moved = replace(REPORT, capture_unix_ns=NOW_NS + k * 500_000_000)
            file.write_report(
                TRACKS, moved.capture_unix_ns, encode_track(moved) + encode_track(replace(moved, number=4))
            )
        file.write_report(TRACKS, NOW_NS + 9, b"\xff")
    assert main(["track", "--from", str(path), "--json", "--out", str(tmp_path / "all.kml")]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["track"] for line in lines] == [3, 4] * 3 and {line["vehicle"] for line in lines} == {"uav-1"}
    assert (tmp_path / "all.kml").read_text().count("<when>") == 6
    assert main(["track", "1", "2", "--from", str(path)]) == 2
    with SessionRecorder(tmp_path / "other.mcap", "uav-1") as file:
        file.write_set(replace(plain_set(5), vehicle="uav-1"))
    assert main(["track", "--from", str(tmp_path / "other.mcap")]) == 3
    assert "nothing was followed" in capsys.readouterr().err


def test_what_is_followed_is_watched_and_recorded_from_the_link(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint, ended = free_endpoint(), threading.Event()
    there = replace(plain_set(5), vehicle="uav-1", session=REPORT.session)
    report = replace(REPORT, capture_unix_ns=there.capture_unix_ns)
    with Publisher("uav-1", [endpoint], rate=Rate(max_bit_rate=1e7)) as publisher:

        def publish() -> None:
            while not ended.wait(0.05):
                publisher.publish(there)
                publisher.report(TRACKS, encode_track(report) + encode_track(replace(report, number=4)))

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        try:
            watched: list[str] = []

            def is_watched() -> bool:
                assert main(["watch", "--connect", endpoint, "--count", "1", "--period", "0.5"]) == 0
                watched[:] = capsys.readouterr().out.splitlines()
                return len(watched) == 4

            assert eventually(is_watched), watched
            assert watched[2].strip().startswith("uav-1 track 3 coasting (hidden)") and "track 4" in watched[3]
            tries = iter(range(1000))
            folder = tmp_path

            def is_recorded() -> bool:
                nonlocal folder
                folder = tmp_path / f"try {next(tries)}"
                assert main(["record", "--out", str(folder), "--seconds", "0.8", "--connect", endpoint]) == 0
                printed = capsys.readouterr().out
                return "uav-1-1700000000.001.mcap" in printed and bool(
                    Recording(folder).reports(TRACK_REPORTS, ["uav-1"])
                )

            assert eventually(is_recorded)
        finally:
            ended.set()
            thread.join(5.0)
    assert main(["track", "--from", str(folder), "--json", "--out", str(tmp_path / "path.kml")]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["track"] for line in lines} == {3, 4} and "<when>" in (tmp_path / "path.kml").read_text()
    assert main(["watch", "--from", str(folder), "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row.get("track") for row in rows] == [None, 3, 4]
