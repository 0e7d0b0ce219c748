"""One vehicle's wrong clock, or a false stamp, hides nothing that others, or it itself, have found."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from contract.spot import Spot, SpotReport
from contract.topics import FEATURES, SPOTS
from contract.wire.codec import encode
from contract.wire.spot_code import encode_spots
from ground.__main__ import main
from ground.link_recorder import LinkRecorder
from ground.recording import Recording
from ground.report_clocks import ReportClocks
from ground.spots.received import ReceivedSpots
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set
from tests.ground.spots.sampled_spots import covariance, spot_at

COV = covariance(1.5, 1.0, 30.0)
RING = ((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0))
HOUR_S, FIRES = 3600.0, 6
AREA_M2 = 400.0


def burning(east_m: float) -> Spot:
    return replace(spot_at(east_m, 0.0, COV, temperature_c=300.0, area_m2=AREA_M2), outline_en_m=RING)


def report(vehicle: str, k: int, now_ns: int, ahead_s: float, *spots: Spot) -> SpotReport:
    """The picture that is taken `k` seconds from now, as a clock so far ahead stamps it."""
    return SpotReport(5, k, now_ns + round((k + ahead_s) * 1e9), True, spots, 0, 0.8, 0.6, vehicle)


def received(
    *off_s: float, false_at: int | None = None, false_s: float = HOUR_S, last_ago_s: float = 0.0
) -> ReceivedSpots:
    """A fire each of vehicles whose clocks are so far ahead; of the first one picture is stamped falsely besides."""
    view, now_ns = ReceivedSpots(), time.time_ns() - round(last_ago_s * 1e9)
    for k in range(FIRES):
        for number, ahead_s in enumerate(off_s):
            ahead = ahead_s + (false_s if (number, k) == (0, false_at) else 0.0)
            sent = report(f"uav-{number}", k, now_ns, ahead, burning(200.0 * number))
            view.take(SPOTS.key(sent.vehicle), encode_spots(sent), now_ns + round((k + 0.3) * 1e9))
    return view


@pytest.mark.parametrize("off_s", [(HOUR_S, 0.0), (-HOUR_S, 0.0), (HOUR_S, 0.0, -86_400.0), (400.0, 0.0, -400.0)])
def test_fires_of_vehicles_whose_clocks_differ_are_all_there(off_s: tuple[float, ...]) -> None:
    fire = received(*off_s).fire(5.0)
    assert fire is not None and fire.pictures == FIRES * len(off_s)
    assert fire.burned.area_m2 > 0.8 * AREA_M2 * len(off_s)
    assert abs(fire.last_unix_ns - time.time_ns()) < 60e9  # and when is stated by this clock


@pytest.mark.parametrize("false_at", range(FIRES))
@pytest.mark.parametrize("false_s", [HOUR_S, -HOUR_S])
def test_a_false_stamp_hides_no_fire_and_no_thing(false_at: int, false_s: float) -> None:
    view = received(0.0, 0.0, false_at=false_at, false_s=false_s)
    fire = view.fire(5.0)
    assert fire is not None and fire.pictures == 2 * FIRES and fire.burned.area_m2 > 1.6 * AREA_M2
    assert abs(fire.last_unix_ns - time.time_ns()) < 60e9
    assert sorted(thing.pictures for thing in view.things()) == [FIRES - 1, FIRES]
    assert view.false_stamps == (false_at < FIRES - 1)  # that of the last is still open


def test_what_burned_before_the_window_is_left_out_by_any_clock() -> None:
    view = received(HOUR_S, last_ago_s=1000.0)
    now_ns = time.time_ns()
    for k in range(FIRES):
        sent = report("uav-1", k, now_ns, -HOUR_S, burning(200.0))
        view.take(SPOTS.key("uav-1"), encode_spots(sent), now_ns + k * 10**9)
    fire = view.fire(5.0)
    assert fire is not None and fire.pictures == FIRES


def test_things_of_the_last_half_minute_are_those_of_all_vehicles() -> None:
    assert {thing.vehicles for thing in received(HOUR_S, 0.0, -HOUR_S).recent(30.0)} == {
        ("uav-0",), ("uav-1",), ("uav-2",)
    }  # fmt: skip


def test_a_recording_keeps_when_its_messages_came_and_its_fire_is_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    now_ns = time.time_ns()
    with LinkRecorder(tmp_path / "flight") as recorder:
        recorder.take(FEATURES.key("uav-1"), encode(replace(plain_set(5), vehicle="uav-1", session=5)))
        for k in range(FIRES):
            sent = report("uav-1", k, now_ns, HOUR_S if k == FIRES - 1 else 0.0, burning(0.0))
            recorder.take(SPOTS.key("uav-1"), encode_spots(sent))
    assert main(["spots", "--fire", "--from", str(tmp_path / "flight")]) == 0
    assert f"in {FIRES} pictures" in capsys.readouterr().out


def test_a_recording_of_an_aircraft_whose_times_are_its_stamps_is_judged_by_its_order(tmp_path: Path) -> None:
    now_ns = time.time_ns()
    with SessionRecorder(tmp_path / "a.mcap", "uav-1") as file:
        file.write_set(replace(plain_set(5), vehicle="uav-1", session=5))
        for k in range(FIRES):
            sent = report("uav-1", k, now_ns, HOUR_S if k == 2 else 0.0, burning(0.0))
            file.write_report(SPOTS, sent.capture_unix_ns, encode_spots(sent))
    view = ReceivedSpots()
    view.read(Recording(tmp_path / "a.mcap"), ["uav-1"])
    fire = view.fire(5.0)
    assert fire is not None and fire.pictures == FIRES and [t.pictures for t in view.things()] == [FIRES - 1]


def test_sessions_that_a_peer_invents_are_bounded() -> None:
    clocks = ReportClocks()
    for k in range(3000):
        clocks.accepted(report(f"x-{k}", 0, 0, HOUR_S), 0)
    assert len(clocks._doubted) <= 1000 and len(list(clocks._lags)) <= 1000
