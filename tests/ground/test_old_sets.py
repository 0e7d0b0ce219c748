"""Sets of yesterday that come again today, and sets stamped ahead: over real sessions, by what people look at."""

import dataclasses
import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from contract.link_config import link_config
from contract.topics import FEATURES, STATUS, TRACKS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from contract.wire.track_code import encode_track
from ground.__main__ import main
from ground.client import SetCache
from ground.commands.watch import _row, _Silence
from ground.pins.store import PinStore
from ground.web.api_vehicles import vehicle_json
from ground.web.context import ServerContext
from ground.web.live import LiveSource
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.test_tracks_on_the_link import REPORT
from tests.waiting import eventually

KEY = FEATURES.key("uav-1")
DAY_S = 86_400.0
BASE = plain_set(40)
ELSEWHERE_DEG = BASE.camera_lat_deg + 0.1


class Sender:
    """An aircraft of today, if it flies, and somebody who puts packets of another day on its key."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.session = zenoh.open(zenoh.Config.from_json5(link_config("peer", listen=[endpoint])))
        self.began_s = time.time()
        self.frame = 0

    def put(self, ago_s: float = 0.0) -> None:
        """A set, 0.1 s old when it was sent, `ago_s` ago; elsewhere if that is another day."""
        self.frame += 1
        stamp_ns = time.time_ns() - round((ago_s + 0.1) * 1e9)
        s = dataclasses.replace(
            BASE, frame=self.frame, capture_unix_ns=stamp_ns, session=round(self.began_s - (DAY_S if ago_s > 0 else 0)),
            camera_lat_deg=ELSEWHERE_DEG if ago_s else BASE.camera_lat_deg,
        )  # fmt: skip
        self.session.put(KEY, encode(s), attachment=b"0.10")

    def status(self, ago_s: float) -> None:
        unix_s = time.time() - ago_s
        track = dataclasses.replace(
            REPORT, session=round(self.began_s - ago_s), capture_unix_ns=round(unix_s * 1e9), vehicle="uav-1"
        )
        self.session.put(TRACKS.key("uav-1"), encode_track(track))
        self.session.put(STATUS.key("uav-1"), encode_status(VehicleStatus(unix_s, round(self.began_s - ago_s), "ok")))


@pytest.fixture
def sender() -> Iterator[Sender]:
    sending = Sender(free_endpoint())
    yield sending
    sending.session.close()


def while_sending(send: Callable[[], None], *words: str) -> int:
    """A command, with packets meanwhile."""
    end = threading.Event()

    def again() -> None:
        while not end.wait(0.05):
            send()

    thread = threading.Thread(target=again)
    thread.start()
    try:
        return main(list(words))
    finally:
        end.set()
        thread.join()


def yesterday(sender: Sender) -> None:
    sender.put(DAY_S)
    sender.status(DAY_S)


def both_days(sender: Sender) -> None:
    sender.put()
    for _ in range(6):
        sender.put(DAY_S)
        sender.status(DAY_S)


def watched(sender: Sender, send: Callable[[Sender], None], capsys: pytest.CaptureFixture[str]) -> tuple[Any, str]:
    words = "watch", "--json", "--count", "3", "--period", "0.7", "--connect", sender.endpoint
    assert while_sending(lambda: send(sender), *words) == 0
    printed = capsys.readouterr()
    rows = [row for line in printed.out.splitlines() if "track" not in (row := json.loads(line))]
    assert len(rows) == len(printed.out.splitlines())  # of no track of another day
    return (rows[-1] if rows else None), printed.err


def test_watch_shows_yesterday_s_sets_a_day_old_and_next_to_today_s_not_at_all(
    sender: Sender, capsys: pytest.CaptureFixture[str]
) -> None:
    row: Any = None

    def is_old() -> bool:
        nonlocal row
        row, _ = watched(sender, yesterday, capsys)
        return row is not None and row["age_s"] is not None

    assert eventually(is_old), row
    assert row["state"] == "old?" and DAY_S <= row["age_s"] < DAY_S + 60.0
    assert "stamped 24 h behind this computer's clock: they are old, or a clock is wrong" in row["reason"]
    err = ""

    def is_today_s() -> bool:
        nonlocal row, err
        row, err = watched(sender, both_days, capsys)
        return row is not None and row["age_s"] is not None and "sends sets of session" in err

    assert eventually(is_today_s), (row, err)
    assert row["lat_deg"] == pytest.approx(BASE.camera_lat_deg, abs=1e-6) and row["age_s"] < 3.0
    assert "old" not in row["state"]


def test_of_an_aircraft_whose_clock_is_known_an_old_set_that_comes_again_is_late(
    sender: Sender, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its clock is off by a day, as it has answered: its newest picture is old, and not perhaps old."""
    sender.put(DAY_S)
    newest = dataclasses.replace(
        BASE, frame=1, capture_unix_ns=time.time_ns() - round(DAY_S * 1e9), session=round(sender.began_s - DAY_S)
    )
    answer = encode(newest)

    def answers(query: zenoh.Query) -> None:
        with query:
            query.reply(KEY, answer, attachment=b'{"age_s":20}')

    sender.session.declare_queryable(KEY, answers)
    row: Any = None

    def again(sender: Sender) -> None:
        sender.session.put(KEY, answer, attachment=b"20")

    def is_late() -> bool:
        nonlocal row
        row, _ = watched(sender, again, capsys)
        return row is not None and row["state"] == "late"

    assert eventually(is_late), row
    assert (
        row["reason"].startswith("its sets are of pictures 2")
        and "the aircraft's clock is 24 h behind" in row["reason"]
    )


@pytest.mark.parametrize(
    ("set_s", "status_s", "state", "words"),
    [
        (40.0, 0.5, "no sets", "its status comes, and no set for 40.0 s; it reports: degraded: no GPS"),
        (0.5, 0.5, "late", "its sets are of pictures 40.0 s old; it reports: degraded: no GPS"),
        (0.5, 40.0, "late", "its sets are of pictures 40.0 s old; last: degraded: no GPS"),
        (40.0, 40.0, "no link", "nothing received for 40.0 s; last: degraded"),
        (0.5, math.inf, "late", "its sets are of pictures 40.0 s old; picture: ok"),
    ],
)
def test_of_an_old_picture_it_is_said_what_still_comes(set_s: float, status_s: float, state: str, words: str) -> None:
    status = None if math.isinf(status_s) else VehicleStatus(0.0, 1, "degraded", "no GPS")
    row = _row("uav-1", BASE, status, 40.0, 0.0, silence=_Silence(set_s, status_s))
    assert (row.state, row.reason) == (state, words)


def test_the_page_has_them_as_old_and_cot_sends_no_position(sender: Sender, tmp_path: Path) -> None:
    source = LiveSource([sender.endpoint])
    try:

        def is_received() -> bool:
            yesterday(sender)
            return bool(source.vehicles() and source.frames("uav-1"))

        assert eventually(is_received)
        with PinStore(tmp_path / "pins.sqlite") as store:
            shown = vehicle_json(ServerContext(source, store, tmp_path), "uav-1")
        assert shown["state"] == "warning" and shown["picture_age_s"] >= DAY_S, shown
        assert "stamped 24 h behind" in shown["trouble"]

        def is_today_s() -> bool:
            both_days(sender)
            age_s = source.report("uav-1").picture_age_s
            return age_s is not None and age_s < 3.0

        assert eventually(is_today_s)
        places = [source.feature_set("uav-1", r.session, r.frame) for r in source.frames("uav-1")]
        assert {s.camera_lat_deg > BASE.camera_lat_deg + 0.05 for s in places if s is not None} == {False}

        def is_reported() -> bool:  # yesterday's may all have come before today's
            both_days(sender)
            return any("sends sets of session" in line for line in source.damage())

        assert eventually(is_reported)
    finally:
        source.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as display:
        display.bind(("127.0.0.1", 0))
        display.settimeout(0.5)
        send_to = f"udp://127.0.0.1:{display.getsockname()[1]}"
        words = "cot", "--to", send_to, "--once", "--only-aircraft", "--connect", sender.endpoint
        assert while_sending(lambda: yesterday(sender), *words) == 0
        with pytest.raises(TimeoutError):
            display.recv(65_000)
        assert while_sending(lambda: both_days(sender), *words) == 0
        assert f'lat="{str(BASE.camera_lat_deg)[:8]}' in display.recv(65_000).decode()


def test_one_set_an_hour_ahead_leaves_the_others_where_they_are(sender: Sender) -> None:
    with SetCache(sender.endpoint) as cache:

        def are_there(count: int) -> bool:
            sender.put()
            return len(cache.entries("uav-1")) >= count

        assert eventually(lambda: are_there(5))
        sender.put(-3600.0)
        assert eventually(lambda: cache.dropped.count)
        assert "dropped, 'uav-1' stamps sets more than 60 s ahead of its own clock: 1 messages" in cache.dropped.lines()
        assert eventually(lambda: are_there(20))
        age_s = cache.age_s("uav-1")
        assert age_s < 3.0


def test_invented_vehicles_stay_bounded_and_the_aircraft_stays(sender: Sender, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.client.MOST_VEHICLES", 20)
    with SetCache(sender.endpoint) as cache:
        for k in range(60):
            name = f"v{k}"
            stamp_ns = time.time_ns()
            made = dataclasses.replace(BASE, vehicle=name, capture_unix_ns=stamp_ns, session=stamp_ns // 10**9)
            sender.session.put(FEATURES.key(name), encode(made))
            sender.put()
            assert len(cache.vehicles) <= 20

        def is_there() -> bool:
            sender.put()
            return "uav-1" in cache.vehicles

        assert eventually(is_there) and len(cache.vehicles) <= 20
