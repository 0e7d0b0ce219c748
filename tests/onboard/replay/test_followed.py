"""Things followed in a recorded flight: as in the air, and the same again each time."""

import dataclasses
import json
from pathlib import Path

import pytest

from contract.track import TrackReport, TrackState
from contract.wire.message import TRACK_REPORTS
from ground.recording import Recording
from onboard.__main__ import main
from onboard.replay.followed import Clicked, Followed
from tests.onboard.service.air import STRAIGHT, simulated
from tests.onboard.tracks.flat_world import Thing, World, at

CAR = Thing(at(-10.0, 0.0, (4.0, 0.0)), 2.0)


def follow(*clicks: Clicked) -> tuple[list[list[TrackReport]], list[Clicked]]:
    world, out, failed = World((CAR,)), list[list[TrackReport]](), list[Clicked]()
    with Followed("uav-1", clicks, failed.append, [out.append]) as sink:
        for number in range(40):
            sink.event(0, world.frame(number))
            if number != 20:
                sink.feature_set(world.its_set(number))
        sink.feature_set(world.its_set(20))  # late: newer pictures have been looked at
    return out, failed


def test_reports_come_twice_a_second_of_the_flight_and_are_the_same_again() -> None:
    u, v = World().pixel(CAR, 15)
    out, failed = follow(Clicked(15, float(u), float(v)))
    assert not failed and len(out) == 5
    last = out[-1][0]
    assert last.state is TrackState.FOLLOWED and abs(last.course.speed_m_s - 4.0) < 0.4
    assert follow(Clicked(15, float(u), float(v)))[0] == out


def test_clicks_at_which_nothing_could_be_followed_are_named() -> None:
    border, unset, never = Clicked(15, 1.0, 1.0), Clicked(20, 160.0, 120.0), Clicked(99, 160.0, 120.0)
    assert follow(border, unset, never) == ([], [border, unset, never])


def test_a_replay_follows_prints_and_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = simulated(dataclasses.replace(STRAIGHT, seconds=5.0))
    given = [f"--{name}={folder / file}" for name, file in (
        ("config", "config.toml"), ("frames", "frames"), ("telemetry", "telemetry.tlog"), ("camera", "camera.json"),
        ("stamps", "stamps.csv"),
    )]  # fmt: skip
    out = tmp_path / "again.mcap"
    assert main(["replay", *given, "--out", str(out), "--track", "8,150,110", "--track", "900,5,5"]) == 0
    printed, output = capsys.readouterr()
    lines = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
    assert len(lines) >= 3 and {line["track"] for line in lines} == {1} and lines[-1]["state"] == "followed"
    assert "nothing could be followed at 5 5 of picture 900" in output
    recorded = Recording(out).reports(TRACK_REPORTS, ["uav"])
    assert [report.frame for report in recorded] == [line["frame"] for line in lines]
