"""A server that is started in flight knows what was before: from its own disk, and from the aircraft's memory."""

import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from contract.topics import FEATURES
from contract.wire.codec import encode
from ground.link_recorder import LinkRecorder
from ground.web.journal import Journal, _make_room
from ground.web.live import LiveSource
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.ports import free_endpoint
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import SMALL, opened
from tests.web.rendered import VEHICLE, rendered_set
from tests.web.served import Simulated
from tests.web.test_link_pictures import Aircraft
from tests.web.test_live import wait_for

pytestmark = pytest.mark.xdist_group("web: a flight in motion")


def test_a_server_started_again_has_the_sets_and_pictures_of_before(simulated: Simulated, tmp_path: Path) -> None:
    craft = Aircraft(simulated)
    source = LiveSource([craft.endpoint], journal=tmp_path / "link")
    wanted = {s.frame for s in craft.sets}

    def received_all() -> bool:
        craft.say(*(s for s in craft.sets if s.frame in wanted - {r.frame for r in source.frames(simulated.vehicle)}))
        return {row.frame for row in source.frames(simulated.vehicle)} == wanted

    try:
        wait_for(received_all, "all sets")
        craft.send_picture(source)
    finally:
        source.close()
        craft.publisher.close()
    again = LiveSource([craft.endpoint], journal=tmp_path / "link")  # no one flies any more
    try:
        wait_for(lambda: {row.frame for row in again.frames(simulated.vehicle)} == wanted, "the sets of before")
        wait_for(lambda: any(row.has_picture for row in again.frames(simulated.vehicle)), "the picture of before")
        assert [row.frame for row in again.frames(simulated.vehicle) if row.has_picture] == [craft.picture.frame]
        got = again.picture(simulated.vehicle, None, craft.picture.frame)
        assert got is not None
        assert got.content == craft.picture.content
        newest = again.feature_set(simulated.vehicle, None, craft.sets[-1].frame)
        assert newest is not None
        assert newest.uv_px.tobytes() == source.feature_set(simulated.vehicle, None, newest.frame).uv_px.tobytes()  # type: ignore[union-attr]
        assert again.age_s(newest) is None  # by no clock that runs: nothing has been received yet
        assert again.damage() == []
    finally:
        again.close()


def test_a_server_that_comes_late_asks_the_aircraft_for_the_minutes_before(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    publisher = Publisher(VEHICLE, listen=[endpoint], rate=Rate(5e6, 1.0, 30.0))
    source: LiveSource | None = None
    try:
        flight = [rendered_set(frame) for frame in range(40)]
        for one in flight:
            publisher.publish(one)  # to no one
        source = LiveSource([endpoint], journal=tmp_path / "link")

        def is_back(received: LiveSource = source) -> bool:
            publisher.publish(flight[-1])
            return bool(rows := received.frames(VEHICLE)) and rows[0].frame <= 2

        wait_for(is_back, "the sets of before")
        frames = [row.frame for row in source.frames(VEHICLE)]
        assert frames[-1] == 39
        assert len(frames) >= 19  # every other second of the flight
        asked = source.feature_set(VEHICLE, None, frames[3])
        assert asked is not None
        assert source.age_s(asked) == pytest.approx(39 - frames[3], abs=20.0)
    finally:
        if source is not None:
            source.close()
        publisher.close()


def test_sets_of_before_do_not_make_their_session_the_one_that_runs(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    publisher = Publisher(VEHICLE, listen=[endpoint], rate=Rate(5e6, 1.0, 30.0))
    source = LiveSource([endpoint])
    try:
        now = rendered_set(5)

        def is_received() -> bool:
            publisher.publish(now)
            return source.vehicles() == [VEHICLE]

        wait_for(is_received, "a set")
        (cache,) = source._caches.values()
        for frame in range(20):
            cache.bring_in(replace(rendered_set(frame), session=now.session - 100))
        assert {row.session for row in source.frames(VEHICLE)} == {now.session}
    finally:
        source.close()
        publisher.close()


def test_a_copy_of_yesterday_s_journal_is_not_of_today(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copied or restored, its files bear today's time: the page had yesterday's aircraft in flight, and well."""
    taken = {"copy": 86_400.0, "own": 120.0, "ahead": -7200.0}  # by so much before now
    for name, ago_s in taken.items():
        with monkeypatch.context() as at, LinkRecorder(tmp_path / name) as recorder:
            came_ns = time.time_ns() - round(ago_s * 1e9)
            at.setattr("ground.link_recorder.time.time_ns", partial(int, came_ns))
            recorder.take(FEATURES.key(VEHICLE), encode(rendered_set(3)))
    for name in taken:
        journal = Journal(tmp_path / name)
        journal.begun_unix_s += 60.0
        found = [(age_s, len(list(messages))) for _, age_s, messages in journal.recent(3600.0)]
        journal.close()
        assert len(found) == (name == "own"), name
        assert all(count == 1 and age_s == pytest.approx(120.0, abs=60.0) for age_s, count in found)


def test_the_journal_makes_room_and_stops_before_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(4):
        (tmp_path / f"uav-{k}.001.mcap").write_bytes(b"x" * 1000)
        os.utime(tmp_path / f"uav-{k}.001.mcap", (1.7e9 + k, 1.7e9 + k))
    _make_room(tmp_path, 2500)
    assert sorted(path.name[4] for path in tmp_path.glob("*.mcap")) == ["2", "3"]
    monkeypatch.setattr("ground.web.journal.MIN_FREE_BYTES", 1 << 62)
    journal = Journal(tmp_path / "full")
    try:
        wait_for(lambda: "nearly full" in journal.error, "a word of it")
        journal.take(f"pc/{VEHICLE}/features", b"")
        assert list((tmp_path / "full").glob("*.mcap")) == []
    finally:
        journal.close()


@pytest.mark.long
def test_a_page_that_is_open_while_a_journal_is_read_gets_all_of_it(chromium: Any, tmp_path: Path) -> None:
    """Far more pictures at once than an event holds."""
    page_is_built()
    with Flight(tmp_path / "pins.sqlite") as flight:
        page = opened(chromium, flight.url, SMALL)
        try:
            flight.source.fly_to(1500)
            page.wait_for_function("() => document.querySelector('#time-bar').max === '1499'")
        finally:
            page.context.close()
