"""The thread that follows: requests answered at once, hostile ones refused, reports twice a second by its own clock."""

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.track import MOST_TRACKS, TrackState, Unseen
from contract.wire.track_code import MAX_TRACK_BYTES, decode_tracks
from onboard.config.schema import parse_config
from onboard.service.track_thread import MAX_BEHIND, MAX_HELD, MAX_ORDERS, TrackThread
from onboard.tracks.track_book import TrackBook
from tests.onboard.tracks.flat_world import Thing, World, at

CONFIG = parse_config('[vehicle]\nid = "uav-1"\n')
CAR = Thing(at(-10.0, 0.0, (4.0, 0.0)), 2.0)


class Simulated:
    """A thread that is never started: its work is done by hand, a clock goes on by a tenth of a second a picture."""

    def __init__(self, world: World | None = None) -> None:
        self.world = world or World((CAR,))
        self.now_s = 0.0
        self.sent: list[bytes] = []
        self.tracks = TrackThread(CONFIG, [self.take], lambda: self.now_s)

    def take(self, stamp_ns: int, payload: bytes) -> None:
        assert all(report.capture_unix_ns <= stamp_ns for report in decode_tracks(payload))
        self.sent.append(payload)

    def fly(self, first: int, end: int) -> None:
        for number in range(first, end):
            self.now_s += 0.1
            self.hand_over(number)
            self.tracks.work()

    def hand_over(self, number: int) -> None:
        self.tracks.event(0, self.world.frame(number))
        self.tracks.feature_set(self.world.its_set(number))

    def ask(self, text: str) -> tuple[dict[str, object], bool]:
        payload, is_error = self.tracks.answer(text)
        return json.loads(payload), is_error

    def click(self, number: int) -> str:
        u, v = self.world.pixel(self.world.things[0], number)
        return f"u={u:.2f};v={v:.2f};frame={number}"


def test_a_click_is_answered_at_once_and_reported_twice_a_second() -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    assert not simulated.sent
    assert simulated.ask(simulated.click(15)) == ({"track": 1, "frame": 15}, False)
    simulated.fly(16, 46)
    assert 5 <= len(simulated.sent) <= 7  # three seconds
    (report,) = decode_tracks(simulated.sent[-1], "uav-1")
    assert len(simulated.sent[-1]) <= MAX_TRACK_BYTES and report.state is TrackState.FOLLOWED
    assert abs(report.course.speed_m_s - 4.0) < 0.4
    assert simulated.ask("") == ({"tracks": [1]}, False)
    assert simulated.ask("stop=1") == ({"tracks": []}, False)
    reported = len(simulated.sent)
    simulated.fly(46, 60)
    assert len(simulated.sent) == reported


def test_the_same_question_again_begins_no_other_track() -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    assert (
        simulated.ask(simulated.click(15)) == simulated.ask(simulated.click(15)) == ({"track": 1, "frame": 15}, False)
    )
    simulated.fly(16, 18)
    assert simulated.ask(simulated.click(15))[0]["track"] == 1


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("u=1;v", "bad_request"), ("u=160;v=120;frame=999", "unknown_frame"), ("u=5;v=120;frame=15", "outside"),
        ("u=160;v=239;frame=15", "outside"), ("stop=9", "unknown_track"), ("\0;=;;=", "bad_request"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_with_its_reason(text: str, status: str) -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    reported, is_error = simulated.ask(text)
    assert is_error and reported["status"] == status and reported["reason"]
    assert simulated.ask("") == ({"tracks": []}, False)


def test_who_begins_and_ends_tracks_without_end_is_asked_to_wait() -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    reported = [
        simulated.ask(simulated.click(15) if n % 2 == 0 else f"stop={n // 2 % 255 + 1}") for n in range(3 * MAX_ORDERS)
    ]
    assert (
        not reported[MAX_ORDERS - 1][1]
        and reported[MAX_ORDERS] == (reported[-1][0], True)
        and reported[-1][0]["status"] == "busy"
    )
    simulated.tracks.work()
    assert not simulated.ask(simulated.click(15))[1]


def test_before_the_first_picture_nothing_can_be_followed() -> None:
    assert Simulated().ask("u=100;v=100")[0]["status"] == "unknown_frame"


def test_the_ninth_is_refused_until_one_is_stopped() -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    for n in range(MOST_TRACKS):
        assert not simulated.ask(f"u={40 + 25 * n};v=100;frame=15")[1]
    reported, is_error = simulated.ask("u=160;v=160;frame=15")
    assert is_error and reported["status"] == "full"
    simulated.fly(16, 18)
    assert simulated.ask("u=160;v=160;frame=15")[0]["status"] == "full"
    assert not simulated.ask("stop=3")[1] and not simulated.ask("u=160;v=160;frame=15")[1]
    simulated.fly(18, 30)
    assert max(len(message) for message in simulated.sent) <= MOST_TRACKS * MAX_TRACK_BYTES
    assert len(decode_tracks(simulated.sent[-1])) == MOST_TRACKS


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.text(max_size=40) | st.text(alphabet="uv=;0159.frametop", max_size=30), max_size=40))
def test_no_requests_bring_it_down_or_fill_it(texts: list[str]) -> None:
    simulated = QUIET
    for text in texts:
        payload, _ = simulated.tracks.answer(text)
        assert len(payload) < 400 and isinstance(json.loads(payload), dict)
    simulated.tracks.work()
    assert len(json.loads(simulated.tracks.answer("")[0])["tracks"]) <= MOST_TRACKS


QUIET = Simulated()
QUIET.fly(0, 8)


def test_pictures_that_it_cannot_keep_up_with_are_passed_over() -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    simulated.ask(simulated.click(15))
    simulated.tracks.work()
    frame = simulated.world.frame(16)
    for number in range(16, 16 + 3 * MAX_HELD):
        simulated.tracks.event(0, type(frame)(frame.stamp_ns + number, number, frame.image))
    assert len(simulated.tracks._held) <= MAX_HELD
    for number in range(20, 34):  # and of those with a set the newest are looked at
        simulated.hand_over(number)
    simulated.hand_over(25)
    simulated.tracks.work()
    assert sorted(simulated.tracks._frames)[-MAX_BEHIND - 1 :] == [15, *range(34 - MAX_BEHIND, 34)]
    simulated.now_s += 1.5
    simulated.tracks.work()
    (report,) = decode_tracks(simulated.sent[-1])
    assert (report.state, report.unseen) == (TrackState.COASTING, Unseen.NO_PICTURE)


def test_a_track_that_brings_the_thread_down_is_not_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = Simulated()
    simulated.fly(0, 16)
    simulated.ask(simulated.click(15))
    simulated.tracks.work()
    simulated.tracks.thread.error = ValueError("as the supervisor has it when it begins the work again")
    simulated.tracks.thread.end()
    simulated.tracks._run(simulated.tracks.thread)
    assert simulated.ask("") == ({"tracks": []}, False)
    simulated.fly(16, 30)
    assert simulated.ask(simulated.click(29)) == ({"track": 2, "frame": 29}, False)


def test_without_tracks_a_picture_costs_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr("onboard.tracks.ground_steps.step", lambda *_: asked.append(1))
    simulated = Simulated()
    simulated.fly(0, 20)
    assert not asked and len(simulated.tracks._book.frames) == 20
    assert isinstance(simulated.tracks._book, TrackBook)
