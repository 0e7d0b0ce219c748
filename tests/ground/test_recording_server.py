"""The ground has a recording's clicks measured by `pc-onboard serve`, which it starts and ends, or states why not."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from contract.errors import InputError, LinkError
from contract.feature_set import FeatureSet, Measured
from ground import onboard_program
from ground.__main__ import main
from ground.pins.store import PinStore
from ground.recording_server import RecordingServer
from ground.web import serve
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.recorded import RecordedSource
from tests.onboard.measured.step_world import CLICKED
from tests.onboard.storage.test_recorded_pictures import ROOF, WORLD, recorded
from tests.waiting import eventually


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("recorded") / "session.mcap", pictures="jpeg")


def set_of(recording: Path) -> FeatureSet:
    found = RecordedSource(recording).feature_set("uav-1", None, CLICKED)
    assert found is not None
    return found


def test_a_roof_of_a_recording_is_measured_and_what_ends_the_program_is_named(recording: Path) -> None:
    its_set = set_of(recording)
    with RecordingServer(recording) as server:
        found = server.measured(its_set, ROOF)
        assert found.clicked.is_measured
        depth = float(WORLD.depths(CLICKED, np.array(ROOF))[0])
        assert found.clicked.inverse_depth_per_m * depth == pytest.approx(1.0, abs=0.01)
        assert np.array_equal(found.uv_px, its_set.uv_px) and found.revision == its_set.revision
        border = server.measured(its_set, (3.0, 3.0)).clicked
        assert border.measured is Measured.BORDER
        for strange in (replace(its_set, frame=99), replace(its_set, session=6)):
            with pytest.raises(LinkError, match="did not try"):
                server.measured(strange, ROOF)
        with pytest.raises(LinkError, match="did not try"):
            server.measured(its_set, (float("nan"), 1e300))
        os.kill(server._process.pid, signal.SIGKILL)
        server._process.wait()
        with pytest.raises(LinkError, match="pc-onboard serve has ended"):
            server.measured(its_set, ROOF)


def test_a_recording_that_cannot_be_measured_in_gives_the_program_s_own_line(tmp_path: Path, recording: Path) -> None:
    empty = recorded(tmp_path / "none.mcap", pictures="none")
    with (
        RecordingServer(empty) as server,
        pytest.raises(LinkError, match=r"has ended: pc-onboard: error: .*holds no pictures"),
    ):
        server.measured(set_of(recording), ROOF)


def test_the_commands_measure_in_a_recording_unless_interpolated_is_asked_for(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--from", str(recording), "--frame", str(CLICKED), "--json"]

    def answer(*words: object, source: list[str] = where) -> dict[str, Any]:
        assert main([*map(str, words), *source]) == 0
        printed = capsys.readouterr()
        assert printed.err == ""
        return json.loads(printed.out)

    found = answer("click", *ROOF)
    assert found["method"] == "measured" and found["above_ground_m"] == pytest.approx(8.0, abs=1.0)
    assert answer("click", *ROOF, "--interpolated")["method"] == "interpolated"
    assert answer("click", 3, 3)["unmeasured"] == "border"
    height = answer("measure", 160, 130, *ROOF)
    assert height["height_difference_m"] == pytest.approx(8.0, abs=0.4) and height["to"]["method"] == "measured"
    clicks = tmp_path / "clicks.csv"
    clicks.write_text(f"frame,u,v\n{CLICKED},{ROOF[0]},{ROOF[1]}\n")
    assert answer("click", "--batch", clicks, source=["--from", str(recording)])["method"] == "measured"
    plain = recorded(tmp_path / "none.mcap", pictures="none")
    assert "unmeasured" not in answer("click", *ROOF, source=["--from", str(plain), *where[2:]])


def test_the_page_s_pin_of_a_recording_is_measured_and_without_the_program_one_line_says_what_would(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = RecordedSource(recording)
    serve._have_measured(source, recording)
    try:
        store = PinStore(tmp_path / "pins.sqlite")
        app = create_app(ServerContext(source, store, tmp_path), Rules())
        with store, TestClient(app, base_url="http://127.0.0.1:8080") as client:
            assert client.get("/api/status").json()["measures"]
            click = {"vehicle": "uav-1", "frame": CLICKED, "u": ROOF[0], "v": ROOF[1]}
            assert json.loads(client.post("/api/click", json=click).text)["method"] == "interpolated"
            found = client.post("/api/click", json=click | {"measured": True}).json()
            assert found["method"] == "measured" and found["above_ground_m"] == pytest.approx(8.0, abs=1.0)
            assert client.post("/api/pins", json={"click": click}).status_code == 201
            assert eventually(lambda: store.pins()[0].clicks[0].method == "measured")
    finally:
        source.close()
    monkeypatch.setattr(onboard_program.os, "access", lambda *_: False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="install pointclick"):
        RecordingServer(recording)
    bare = RecordedSource(recording)
    serve._have_measured(bare, recording)
    assert not bare.measures
    line = "clicks are answered between measured points: pc-onboard is not installed"
    assert line in capsys.readouterr().err
    assert main(["click", *map(str, ROOF), "--from", str(recording)]) == 0
    printed = capsys.readouterr()
    assert line in printed.err and "interpolated" in printed.out
