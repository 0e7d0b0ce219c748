"""The thread that looks for spots: each picture once, the newest of those that wait, and what it finds goes out."""

import csv
import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.spot import SpotReport
from contract.topics import SPOTS
from contract.wire.spot_code import MAX_SPOT_BYTES, decode_spots
from onboard.__main__ import main
from onboard.config.schema import parse_config
from onboard.events.types import Frame
from onboard.replay.spotted import Spotted
from onboard.service.spot_thread import SpotThread
from onboard.storage.mcap_reader import RecordedFlight
from simulation.heat_sources import HeatSource
from simulation.thermal import ThermalSpec
from tests.onboard.service.air import STRAIGHT, simulated
from tests.onboard.spots.scenes import Scene
from tests.waiting import eventually

Pictures = list[tuple[Frame, FeatureSet]]
CONFIG = parse_config('[vehicle]\nid = "uav-1"\n[thermal]\nenabled = true\nscale = 0.01\n')
SCENE = Scene(ThermalSpec(contrast=0.3, sources=(HeatSource.person((5.0, 10.0)),)))


@pytest.fixture(scope="module")
def pictures() -> Pictures:
    return [SCENE.picture(k) for k in range(4)]


def test_each_picture_gives_one_packet_and_the_spots_are_those_of_a_replay(pictures: Pictures) -> None:
    sent: list[tuple[int, bytes]] = []
    spots = SpotThread(CONFIG, [lambda stamp_ns, payload: sent.append((stamp_ns, payload))])
    again: list[SpotReport] = []
    with Spotted(CONFIG, [again.append]) as spotted:
        for frame, its_set in pictures:
            for sink in (spots, spotted):
                sink.event(0, frame)
                sink.feature_set(its_set)
            spots.work()
            spots.work()  # nothing waits
    assert len(sent) == len(again) == 4
    assert all(len(payload) <= MAX_SPOT_BYTES for _, payload in sent)
    found = [decode_spots(payload, "uav-1") for _, payload in sent]
    assert [stamp_ns for stamp_ns, _ in sent] == [its_set.capture_unix_ns for _, its_set in pictures]
    assert [len(report.spots) for report in found] == [len(report.spots) for report in again] == [0, 1, 1, 1]


def test_a_picture_that_it_has_not_come_to_makes_way_for_a_newer_one(pictures: Pictures) -> None:
    sent: list[bytes] = []
    spots = SpotThread(CONFIG, [lambda _, payload: sent.append(payload)])
    for frame, its_set in pictures:
        spots.event(0, frame)
        spots.feature_set(its_set)
    spots.work()
    assert [decode_spots(payload).frame for payload in sent] == [3]


def test_in_a_thread_of_its_own_it_finds_the_same_and_ends(pictures: Pictures) -> None:
    sent: list[bytes] = []
    with SpotThread(CONFIG, [lambda _, payload: sent.append(payload)]) as spots:
        for count, (frame, its_set) in enumerate(pictures, start=1):
            spots.event(0, frame)
            spots.feature_set(its_set)
            assert eventually(lambda count=count: len(sent) == count)
    assert not spots.thread.is_alive()
    assert len(decode_spots(sent[-1]).spots) == 1


def test_it_begins_again_after_a_failure(pictures: Pictures, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []
    with SpotThread(CONFIG, [lambda _, payload: sent.append(payload)]) as spots:
        frame, its_set = pictures[0]
        spots.event(0, replace(frame, counts=np.zeros((3,), np.uint16)))  # not a picture
        spots.feature_set(its_set)
        assert eventually(lambda: spots.thread.error is not None)
        for frame, its_set in pictures[1:2]:
            spots.event(0, frame)
            spots.feature_set(its_set)
        assert eventually(lambda: len(sent) == 1)


def _files(folder: Path) -> list[str]:
    return [f"--{name}={folder / file}" for name, file in (
        ("config", "config.toml"), ("frames", "frames"), ("telemetry", "telemetry.tlog"), ("camera", "camera.json"),
        ("stamps", "stamps.csv"),
    )]  # fmt: skip


@pytest.mark.long
def test_a_replay_prints_and_records_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warm = ThermalSpec(contrast=0.5, sources=(HeatSource.car((0.0, 60.0), 25.0),))
    folder = simulated(dataclasses.replace(STRAIGHT, seconds=5.0, thermal=warm))
    out = tmp_path / "again.mcap"
    assert main(["replay", *_files(folder), "--out", str(out), "--spots"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    assert 8 <= len(lines) <= 11 and all(line["is_calibrated"] for line in lines)
    found = [spot for line in lines for spot in line["spots"]]
    assert any(spot["status"] == "ok" and spot["above_ground_k"] > 10.0 for spot in found)
    recorded = [
        decode_spots(message.data, "uav")
        for _, channel, message in make_reader(out.open("rb")).iter_messages()
        if channel.message_encoding == SPOTS.encoding
    ]
    assert [report.frame for report in recorded] == [line["frame"] for line in lines]


@pytest.mark.long  # short: each picture gives one packet, below
def test_a_replay_takes_a_second_cameras_pictures_by_their_own_stamps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    warm = ThermalSpec(contrast=0.5, sources=(HeatSource.car((0.0, 60.0), 25.0),))
    visible = dataclasses.replace(STRAIGHT, seconds=5.0)
    light, heat = simulated(visible), simulated(dataclasses.replace(visible, thermal=warm))
    rows = [row.split(",") for row in (heat / "stamps.csv").read_text().split()[1:]]
    late = ["file,unix_time_s", *(f"{name},{float(stamp) + 0.04:.6f}" for name, stamp in rows)]
    (tmp_path / "late.csv").write_text("\n".join(late) + "\n")
    plain = (light / "config.toml").read_text()
    optics = tmp_path / "thermal.json"
    optics.write_text((heat / "camera.json").read_text())
    plain += '\n[recording]\npictures = "lossless"\n'
    second = f'[camera.thermal]\nfile = "{optics}"\nscale = 0.01\nlatency_s = 0.04\nsigma_deg = 0.1\n'
    (tmp_path / "config.toml").write_text(f"{plain}\n{second}")
    out = tmp_path / "again.mcap"
    files = [f"--config={tmp_path / 'config.toml'}", *_files(light)[1:], "--spots", f"--out={out}"]
    assert main(["replay", *files]) == 2
    assert "name its pictures with --thermal" in capsys.readouterr().err
    assert main(["replay", *files, f"--thermal={heat / 'frames'}", f"--thermal-stamps={tmp_path / 'late.csv'}"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    seen = [spot for line in lines for spot in line["spots"] if spot["status"] == "ok"]
    assert len(lines) >= 6 and len(seen) >= 3
    assert all(spot["above_ground_k"] > 10.0 for spot in seen)
    recorded = [
        decode_spots(message.data, "uav")
        for _, channel, message in make_reader(out.open("rb")).iter_messages()
        if channel.message_encoding == SPOTS.encoding
    ]
    assert [report.frame for report in recorded] == [line["frame"] for line in lines]
    car = next(csv.DictReader((heat / "truth_heat.csv").open()))
    about = LocalFrame(float(car["lat_deg"]), float(car["lon_deg"]), 0.0)
    for spot in seen:
        off_m = float(np.hypot(*about.to_enu(spot["lat_deg"], spot["lon_deg"], 0.0)[:2]))
        assert off_m < 1.5 * spot["ellipse"]["semi_major_m"]
    # The recording brings what was looked at, and the second camera's optics: the file is not asked for.
    again = [str(out), "--spots", f"--out={tmp_path / 'third.mcap'}"]
    optics.unlink()
    assert main(["replay", *again]) == 0
    assert [json.loads(s) for s in capsys.readouterr().out.splitlines() if s.startswith("{")] == lines
    third = RecordedFlight.open([tmp_path / "third.mcap"])
    stamps_ns = [frame.stamp_ns for frame in third.second_pictures()]
    sent_ns = [report.capture_unix_ns for report in recorded]
    assert stamps_ns == pytest.approx(sent_ns, abs=100_000)  # what a packet resolves
