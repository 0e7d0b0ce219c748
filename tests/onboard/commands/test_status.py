"""`pc-onboard status` against a publisher on this computer, and against no one."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from contract.supervised_thread import ThreadReport, ThreadState
from contract.vehicle_status import VehicleStatus, encode_status
from onboard.__main__ import main
from onboard.events.source import SourceStatus, State
from onboard.link.publisher import Publisher
from onboard.link.status_query import ask, local_endpoints
from onboard.pipeline.summary import LeftOut
from onboard.service.reports import PictureCounts, RecordingReport, Report
from onboard.service.vehicle_state import Finding, Subject, VehicleState
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

STATUS = VehicleStatus(1.7e9, 7, "camera lost", "unplugged", 4000.0, 0.0, 0.0, 300, 0.125, 97, 12, 3, True, 61.0)
REPORT = Report(
    STATUS,
    SourceStatus(State.LOST, "unplugged"),
    SourceStatus(State.OK, "", {"rate_hz": 71.25}),
    (
        Finding(Subject.CAMERA, VehicleState.CAMERA_LOST, "unplugged"),
        Finding(Subject.RECORDING, VehicleState.NOT_RECORDING, "disk full"),
    ),
    threads=(ThreadReport("link", ThreadState.RESTARTING, None, 2, "OSError: gone"),),
    recording=RecordingReport(False, "disk full"),
    pictures=PictureCounts(left_out=LeftOut(standing=0.12)),
    thermal_camera=SourceStatus(State.LOST, "no such device"),
)


@pytest.fixture
def config(tmp_path: Path) -> tuple[str, Path]:
    endpoint = free_endpoint()
    (tmp_path / "config.toml").write_text(f'[vehicle]\nid = "kiwi"\n[link]\nlisten = ["{endpoint}"]\n')
    return endpoint, tmp_path / "config.toml"


def test_a_running_daemon_is_reported(config: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    endpoint, file = config
    with Publisher("kiwi", (endpoint,)) as publisher:
        publisher.publish_status(encode_status(STATUS), REPORT.to_json())

        def status(*more: str) -> str:
            """What it says of a daemon that is there; asked again where a busy machine was too slow to answer."""
            assert eventually(lambda: capsys.readouterr() and main(["status", "--config", str(file), *more]) == 0)
            return capsys.readouterr().out

        first, second, *rest = status().splitlines()
        assert second.strip() == "not recording: disk full"
        lines = dict(line.split(maxsplit=1) for line in (first, *rest))
        assert lines["state"] == "camera lost: unplugged"
        assert lines["session"] == "7, 1 h 6 min"
        assert lines["thermal"] == "lost, no such device"
        assert lines["telemetry"] == "ok, rate_hz 71.2"
        assert lines["threads"] == "link restarting, begun again 2 times (OSError: gone)"
        assert lines["recording"] == "disk full"
        assert lines["left"].startswith("out   12 % found: stands still while the ground moves")
        assert lines["processor"] == "61 deg C"
        assert json.loads(status("--json")) == json.loads(REPORT.to_json())
        assert main(["status", "--config", str(file), "--vehicle", "weka"]) == 3


def test_a_long_report_is_given_again_and_again_next_to_a_flights_sets(config: tuple[str, Path]) -> None:
    # A report in flight is 2 to 3 kB, more than the link sends in a burst.
    long = REPORT.to_json() + b" " * (3000 - len(REPORT.to_json()))
    with Publisher("kiwi", (config[0],)) as publisher:
        for number in range(3):
            publisher.publish(replace(plain_set(), vehicle="kiwi", frame=number))
            publisher.publish_status(encode_status(STATUS), long)
            assert eventually(lambda: main(["status", "--config", str(config[1])]) == 0)


def test_no_one_there_is_one_line_and_an_exit_code(
    config: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "--config", str(config[1])]) == 3
    assert capsys.readouterr() == ("", "not running\n")


def test_a_report_that_is_none_is_one_line(config: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    with Publisher("kiwi", (config[0],)) as publisher:
        publisher.publish_status(encode_status(STATUS), b'{"status": 5}')
        assert eventually(lambda: ask("kiwi", [config[0]]) == b'{"status": 5}')
        assert eventually(lambda: capsys.readouterr() and main(["status", "--config", str(config[1])]) == 2)
    out, complaint = capsys.readouterr()
    assert (out, complaint.count("\n")) == ("", 1)
    assert "another version" in complaint


def test_what_listens_everywhere_is_reached_on_loopback() -> None:
    assert local_endpoints(["tcp/0.0.0.0:7447", "udp/[::]:7447", "tls/10.0.0.1:7448"]) == [
        "tcp/127.0.0.1:7447", "udp/127.0.0.1:7447", "tls/10.0.0.1:7448",
    ]  # fmt: skip
