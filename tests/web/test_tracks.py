"""Things that are followed, on the page and behind it: asked for, drawn, ended; viewers only look."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from contract.answer import Ellipse, Fix, Place
from contract.errors import LinkError
from contract.locate import Locator
from contract.topics import TRACKS
from contract.track import Course, StartTrack, StopTrack, TrackReport, TrackState, Unseen
from contract.wire.track_code import decode_tracks, encode_track
from ground.track_paths import MOST_NEWS, TrackPaths
from ground.web.guard import Rules
from ground.web.live import LiveSource
from ground.web.view import placed_in
from onboard.link.publisher import Publisher, Rate
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.test_track_code import REPORT
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually
from tests.web.browsing import Operator
from tests.web.conftest import page_is_built
from tests.web.flying import Flight, Flying, requests_to
from tests.web.rendered import VEHICLE, record_rendered, rendered_set
from tests.web.served import Server

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

WALK = Course(1.4, 0.1, 92.0, 4.0)
REST = Course(0.03, 0.05)
OPERATOR_TOKEN, VIEWER_TOKEN = "operators-token-1234", "viewers-token-1234"


def report_at(frame: int, u: float, v: float, number: int = 1, **more: Any) -> TrackReport:
    """Of a thing that a rendered picture shows there: where it then is on the ground."""
    s = rendered_set(frame)
    found = Locator(s).locate((u, v))
    assert isinstance(found, Fix)
    place = Place(
        found.lat_deg, found.lon_deg, found.height_amsl_m, found.height_ellipsoid_m, Ellipse(2.5, 1.5, 30.0), 3.0
    )
    made = TrackReport(
        number, TrackState.FOLLOWED, Unseen.NONE, s.session, frame, s.capture_unix_ns, u, v, 20.0, s.status, place,
        WALK, VEHICLE,
    )  # fmt: skip
    return replace(made, **more)


# Behind the page.


def test_reports_become_paths_in_the_order_of_capture_and_none_twice() -> None:
    paths = TrackPaths()
    made = [report_at(k, 300.0 + 5.0 * k, 240.0) for k in range(5)]
    paths.add([made[0], made[2], made[1], made[2], replace(made[0], number=2)])
    assert [[r.frame for r in path] for path in paths.paths()] == [[0, 1, 2], [0]]
    version, news = paths.since(0)
    assert version == paths.version == 4 and news is not None and [r.frame for r in news] == [0, 2, 1, 0]
    paths.add(made)
    assert paths.since(version) == (6, made[3:])
    assert [r.frame for r in paths.paths(most=2)[0]] == [1, 4]  # thinned: always with the newest


def test_a_number_that_comes_again_after_a_loss_is_another_thing_and_too_much_news_is_none() -> None:
    paths = TrackPaths()
    lost = report_at(3, 300.0, 240.0, state=TrackState.LOST)
    paths.add([report_at(1, 300.0, 240.0), report_at(2, 300.0, 240.0), lost])
    paths.add([report_at(0, 300.0, 240.0)])  # late, and of the same
    assert len(paths.paths()[0]) == 4
    paths.add([report_at(9, 300.0, 240.0)])
    assert [r.frame for r in paths.paths()[0]] == [9]
    paths.add(replace(REPORT, capture_unix_ns=REPORT.capture_unix_ns + k) for k in range(MOST_NEWS + 1))
    assert paths.since(0)[1] is None and len(paths.since(paths.version - MOST_NEWS)[1] or []) == MOST_NEWS


def body(frame: int, u: float = 320.0, v: float = 200.0, **more: Any) -> dict[str, Any]:
    return {"vehicle": VEHICLE, "frame": frame, "u": u, "v": v, **more}


def test_a_track_is_begun_and_ended_by_a_request_and_refused_with_the_aircrafts_reason(tmp_path: Path) -> None:
    with requests_to(tmp_path) as (client, source):
        made = client.post("/api/tracks", json=body(0, session=rendered_set(0).session))
        assert (made.status_code, made.json()) == (201, {"vehicle": VEHICLE, "track": 1, "frame": 0})
        assert client.delete(f"/api/tracks/{VEHICLE}/1").status_code == 200
        assert source.asked == [StartTrack(320.0, 200.0, 0), StopTrack(1)]
        for _ in range(7):
            assert client.post("/api/tracks", json=body(0)).status_code == 201
        full = client.post("/api/tracks", json=body(0))
        assert full.status_code == 422 and "eight" in full.json()["detail"]
        old = client.post("/api/tracks", json=body(0, session=5))
        assert old.status_code == 422 and "restarted" in old.json()["detail"]
        for wrong in (body(0, u=-1.0), body(-1), {**body(0), "more": 1}):
            assert client.post("/api/tracks", json=wrong).status_code == 422
        assert client.delete(f"/api/tracks/{VEHICLE}/0").status_code == 422


def test_reports_are_there_as_paths_and_come_as_events(tmp_path: Path) -> None:
    with requests_to(tmp_path) as (client, source):
        source.views.tracks.add([report_at(k, 300.0, 240.0) for k in range(3)])
        (path,) = client.get("/api/tracks").json()["tracks"]
        assert [r["frame"] for r in path] == [0, 1, 2]
        assert path[2]["words"] == "1.4 +-0.1 m/s towards 92 +-4 deg" and path[2]["course"]["sigma_speed_m_s"] == 0.1
        with client.websocket_connect("/api/events", headers={"host": "127.0.0.1:8080"}) as socket:
            source.views.tracks.add([report_at(3, 300.0, 240.0, course=REST), report_at(4, 300.0, 240.0, place=None)])
            received: list[dict[str, Any]] = []
            while len(received) < 2:
                event = socket.receive_json()
                if event["type"] == "tracks":
                    received += [report for report in event["tracks"] if report["frame"] > 2]
        assert received[0]["words"] == "at rest (+-0.05 m/s)" and received[0]["course"]["course_deg"] is None
        assert received[1]["place"] is None


def test_who_has_a_viewers_token_looks_and_changes_nothing(tmp_path: Path) -> None:
    with requests_to(tmp_path, Rules(OPERATOR_TOKEN, viewer_token=VIEWER_TOKEN)) as (client, source):
        viewer, operator = ({"authorization": f"Bearer {token}"} for token in (VIEWER_TOKEN, OPERATOR_TOKEN))
        for path in ("/api/tracks", "/api/pins", "/api/status"):
            assert client.get(path, headers=viewer).status_code == 200
        assert client.get("/api/status", headers=viewer).json()["role"] == "viewer"
        assert client.get("/api/status", headers=operator).json()["role"] == "operator"
        for path in ("/api/click", "/api/place"):
            assert client.post(path, json=body(0), headers=viewer).status_code == 200
        for method, path in (
            ("POST", "/api/tracks"), ("DELETE", f"/api/tracks/{VEHICLE}/1"), ("POST", "/api/pins"),
            ("POST", "/api/undo"), ("POST", "/api/import"), ("POST", "/api/ties"), ("PATCH", "/api/pins/x"),
        ):  # fmt: skip
            refused = client.request(method, path, json=body(0), headers=viewer)
            assert refused.status_code == 403 and "only looks" in refused.text, path
        assert not source.asked
        assert client.post("/api/tracks", json=body(0), headers=operator).status_code == 201
        opened = client.get(f"/?token={VIEWER_TOKEN}", follow_redirects=False)
        assert opened.status_code == 303 and VIEWER_TOKEN in opened.headers["set-cookie"]
        assert client.get("/api/status").json()["role"] == "viewer"


def test_a_live_aircraft_is_asked_and_what_it_reports_is_kept_through_a_restart(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    publisher = Publisher(VEHICLE, listen=[endpoint], rate=Rate(1e6, 1.0, 30.0))
    asked: list[str] = []

    def follow(text: str) -> tuple[bytes, bool]:
        asked.append(text)
        full = b'{"status": "full", "reason": "eight are followed"}'
        return (full, True) if len(asked) > 1 else (b'{"track": 4, "frame": 7}', False)

    publisher.follow = follow
    source = LiveSource([endpoint], journal=tmp_path / "link")
    try:
        with pytest.raises(LinkError, match="no vehicle"):
            source.follow("nobody", StopTrack(1))
        report = report_at(0, 320.0, 200.0, 4)

        def is_received() -> bool:
            publisher.publish(rendered_set(0))
            publisher.report(TRACKS, encode_track(report) + encode_track(replace(report, number=5)))
            return source.views.tracks.version >= 2 and source.vehicles() == [VEHICLE]

        assert eventually(is_received)
        assert [path[0].number for path in source.views.tracks.paths()] == [4, 5]
        assert source.follow(VEHICLE, StartTrack(320.0, 200.0, 7)) == {"track": 4, "frame": 7}
        with pytest.raises(LinkError, match="full: eight are followed"):
            source.follow(VEHICLE, StartTrack(10.0, 20.0, 7))
        assert asked == ["u=320.0;v=200.0;frame=7", "u=10.0;v=20.0;frame=7"]
    finally:
        source.close()
        publisher.close()
    again = LiveSource([free_endpoint()], journal=tmp_path / "link")
    try:
        assert eventually(lambda: again.views.tracks.version == 2)
        assert again.views.tracks.paths()[0][0] == decode_tracks(encode_track(report), VEHICLE)[0]
    finally:
        again.close()


# On the page.


def fly(operator: Operator, flight: Flight, frame: int, *reports: TrackReport) -> None:
    flight.source.views.tracks.add(reports)
    flight.source.fly_to(frame + 1)
    operator.wait_for_frame(frame)


def is_boxed(operator: Operator, key: str, u: float, v: float, within_px: float = 2.0) -> bool:
    def is_there() -> bool:
        boxes = operator.page.locator(f'[data-testid=track-box][data-track="{key}"]').all()
        box = boxes[0].bounding_box() if boxes else None
        if box is None:
            return False
        middle = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
        return bool(middle == pytest.approx(operator.at(u, v), abs=within_px))

    return eventually(is_there)


def test_what_was_clicked_is_followed_shown_and_ended(flying: Flying) -> None:
    flight, anna = flying()
    page, key = anna.page, f"{VEHICLE}/{rendered_set(0).session}/1"
    assert anna.by("track-list").is_hidden()
    assert "90 % within" in anna.click(400.0, 300.0)
    button = anna.by("follow-it")
    box = button.bounding_box()
    assert box["height"] >= 40.0 and box["width"] >= 90.0  # for gloves
    button.click()
    page.wait_for_function("() => document.querySelector('[data-testid=answer]').textContent.includes('track 1')")
    assert flight.source.asked == [StartTrack(pytest.approx(400.0, abs=0.6), pytest.approx(300.0, abs=0.6), 0)]
    for k in range(1, 6):
        fly(anna, flight, k, report_at(k, 400.0 - 6.0 * k, 300.0))
    page.wait_for_selector("[data-testid=track-box][data-phase=followed]")
    assert is_boxed(anna, key, 370.0, 300.0)
    assert anna.by("track-words").inner_text() == "1  followed: 1.4 +-0.1 m/s towards 92 +-4 deg"
    page.wait_for_function("() => (document.querySelector('#map').dataset.tracks ?? '').includes('towards 92')")
    # A picture between two reports, or after the last: where its place is seen from it.
    fly(anna, flight, 6)
    ahead = Locator(rendered_set(5)).locate((370.0, 300.0))
    assert isinstance(ahead, Fix) and ahead.height_ellipsoid_m is not None
    uv = placed_in(rendered_set(6), ahead.lat_deg, ahead.lon_deg, ahead.height_ellipsoid_m)
    assert uv is not None and uv[1] > 305.0  # the aircraft went on to the north: what stands moves down
    a_metre_px = rendered_set(6).camera.fx_px / -ahead.offset_enu_m[2]
    assert is_boxed(anna, key, uv[0] + WALK.speed_m_s * a_metre_px, uv[1])  # and this walks on to the east
    unseen = {"state": TrackState.COASTING, "unseen": Unseen.HIDDEN}
    fly(anna, flight, 7, report_at(7, 360.0, 300.0, **unseen))
    page.wait_for_selector("[data-testid=track-box][data-phase=coasting]")
    # On a busy machine the look may be some time ago by the time the page is read.
    assert re.match(r"1  coasting \(hidden\)(, seen \d\.\d s ago)?: 1\.4", anna.by("track-words").inner_text())
    fly(anna, flight, 8, report_at(8, 360.0, 300.0, course=REST))
    page.wait_for_function("() => document.querySelector('[data-testid=track-words]').textContent.includes('at rest')")
    assert anna.by("track-words").inner_text() == "1  followed: at rest (+-0.05 m/s)"
    anna.by("track-end").click()
    assert eventually(lambda: flight.source.asked[-1] == StopTrack(1))
    fly(anna, flight, 9, report_at(9, 360.0, 300.0, state=TrackState.LOST, unseen=Unseen.OFF_PICTURE, course=REST))
    page.wait_for_selector("[data-testid=track][data-phase=lost]")
    assert "lost (off the picture)" in anna.by("track-words").inner_text()
    assert anna.by("track-box").count() == 0 and anna.by("track-end").is_hidden()


@pytest.mark.long
def test_the_ninth_is_refused_and_the_key_asks_too(flying: Flying) -> None:
    flight, anna = flying(has_map=False)
    anna.click(400.0, 300.0)
    for k in range(1, 9):
        anna.page.keyboard.press("g")
        assert eventually(lambda k=k: len(flight.source.asked) == k)
        anna.page.wait_for_function(f"() => document.querySelector('#answer').textContent.includes('track {k} ')")
    anna.page.keyboard.press("g")
    anna.page.wait_for_function("() => document.querySelector('#answer').dataset.kind === 'refused'")
    assert "eight things are followed" in anna.by("answer").inner_text()


def test_nothing_is_offered_to_be_followed_where_the_aircraft_does_not_and_the_key_states_why(flying: Flying) -> None:
    flight, anna = flying(has_map=False)
    flight.source.why_unfollowed = "uav-1 does not follow things"
    anna.open()
    assert "90 % within" in anna.click(400.0, 300.0)
    assert anna.by("follow-it").count() == 0
    anna.page.keyboard.press("g")
    anna.page.wait_for_function("() => document.querySelector('#answer').dataset.kind === 'refused'")
    assert "Not followed: uav-1 does not follow things." in anna.by("answer").inner_text()
    assert flight.source.asked == []


@pytest.mark.long
def test_tracks_of_several_aircraft_are_distinguished(flying: Flying) -> None:
    flight, anna = flying(2)
    other = replace(report_at(1, 330.0, 240.0), vehicle="uav-2")
    fly(anna, flight, 1, report_at(1, 400.0, 300.0), other)
    anna.page.wait_for_function("() => document.querySelectorAll('[data-testid=track]').length === 2")
    assert [text.split("  ")[0] for text in anna.by("track-words").all_inner_texts()] == ["uav-1 1", "uav-2 1"]
    # What the other aircraft follows is in this one's picture too: by its place.
    anna.page.wait_for_function("() => document.querySelectorAll('[data-testid=track-box]').length === 2")
    assert is_boxed(anna, f"uav-2/{other.session}/1", 330.0, 240.0, 3.0)


@pytest.mark.long
def test_of_a_recording_what_was_followed_then_is_shown(tmp_path: Path, chromium: Any) -> None:
    page_is_built()
    path = tmp_path / "flight.mcap"
    record_rendered(path.with_name("one.001.mcap"))
    with SessionRecorder(path.with_name("one.002.mcap"), VEHICLE, part=2) as out:
        for k in range(2, 9):
            state = TrackState.LOST if k == 8 else TrackState.FOLLOWED
            report = report_at(k, 300.0 + 8.0 * k, 200.0, state=state)
            out.write_report(TRACKS, report.capture_unix_ns, encode_track(report))
    server = Server("--from", path.with_name("one.001.mcap"), "--pins", tmp_path / "pins.sqlite")
    try:
        anna = Operator(chromium, server)
        page = anna.page
        for frame, phase in ((5, "followed"), (8, "lost"), (3, "followed")):
            page.locator("#time-bar").fill(str(frame))
            anna.wait_for_frame(frame)
            page.wait_for_selector(f"[data-testid=track][data-phase={phase}]")
            assert anna.by("track-box").count() == (phase == "followed")
        assert is_boxed(anna, f"{VEHICLE}/{rendered_set(0).session}/1", 324.0, 200.0)
        page.locator("#time-bar").fill("0")
        page.wait_for_selector("[data-testid=track-list]", state="hidden")
        anna.click(320.0, 240.0)
        assert anna.by("follow-it").count() == 0  # no one follows in a recording: said where it is asked
        page.keyboard.press("g")
        page.wait_for_function("() => document.querySelector('#answer').textContent.includes('pc-onboard replay')")
        anna.context.close()
        anna.check()
    finally:
        server.close()


@pytest.mark.long
def test_a_viewer_is_shown_places_and_has_nothing_to_press(tmp_path: Path, chromium: Any) -> None:
    page_is_built()
    record_rendered(tmp_path / "flight.mcap", 3)
    server = Server(
        "--from", tmp_path / "flight.mcap", "--pins", tmp_path / "pins.sqlite", "--token", OPERATOR_TOKEN,
        "--viewer-token", VIEWER_TOKEN,
    )  # fmt: skip
    try:
        assert server.url.endswith(OPERATOR_TOKEN)
        found = re.search(r"to look and change nothing: (\S+)", server.printed)
        assert found is not None and found[1].endswith(VIEWER_TOKEN)
        server.url = found[1]
        ben = Operator(chromium, server)
        assert "90 % within" in ben.click(320.0, 240.0)
        assert ben.by("follow-it").count() == 0 and ben.by("tie").is_hidden() and ben.by("pin").count() == 0
        assert json.loads(ben.page.request.get(f"{server.local}api/pins").text())["pins"] == []
        ben.context.close()
        ben.check()
    finally:
        server.close()
