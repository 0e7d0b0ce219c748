"""`pc-onboard status` against a publisher on this computer, and against nobody."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from contract.errors import LinkError
from contract.vehicle_status import VehicleStatus, encode_status
from onboard.__main__ import main
from onboard.link.publisher import Publisher
from onboard.link.status_query import ask, local_endpoints
from tests.onboard.link.ports import free_endpoint

STATUS = VehicleStatus(1.7e9, 7, "camera lost", "unplugged", 4000.0, 0.0, 0.0, 300, 0.125, 97, 12, 3, True, 61.0)
DETAIL = {
    "status": asdict(STATUS),
    "camera": {"state": "lost", "detail": "unplugged", "figures": {}},
    "telemetry": {"state": "ok", "detail": "", "figures": {"rate_hz": 71.25}},
    "recording_fault": "",
}


@pytest.fixture
def config(tmp_path: Path) -> tuple[str, Path]:
    endpoint = free_endpoint()
    (tmp_path / "config.toml").write_text(f'[vehicle]\nid = "kiwi"\n[link]\nlisten = ["{endpoint}"]\n')
    return endpoint, tmp_path / "config.toml"


def test_a_running_daemon_is_told_of(config: tuple[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    endpoint, file = config
    with Publisher("kiwi", (endpoint,)) as publisher:
        publisher.publish_status(encode_status(STATUS), json.dumps(DETAIL).encode())
        assert main(["status", "--config", str(file)]) == 0
        lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
        assert lines["state"] == "camera lost: unplugged"
        assert lines["session"] == "7, 1 h 6 min"
        assert lines["telemetry"] == "ok, rate_hz 71.2"
        assert lines["processor"] == "61 deg C"
        assert main(["status", "--config", str(file), "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == DETAIL
        assert main(["status", "--config", str(file), "--vehicle", "weka"]) == 3


def test_nobody_there_is_one_line_and_an_exit_code(
    config: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "--config", str(config[1])]) == 3
    assert capsys.readouterr() == ("", "not running\n")


@pytest.mark.parametrize("detail", [b"{half", b"[]", b'{"status": 5}'])
def test_a_report_that_is_none_is_an_error(config: tuple[str, Path], detail: bytes) -> None:
    with Publisher("kiwi", (config[0],)) as publisher:
        publisher.publish_status(encode_status(STATUS), detail)
        with pytest.raises(LinkError):
            ask("kiwi", [config[0]])


def test_what_listens_everywhere_is_reached_on_loopback() -> None:
    assert local_endpoints(["tcp/0.0.0.0:7447", "udp/[::]:7447", "tls/10.0.0.1:7448"]) == [
        "tcp/127.0.0.1:7447", "udp/127.0.0.1:7447", "tls/10.0.0.1:7448",
    ]  # fmt: skip
