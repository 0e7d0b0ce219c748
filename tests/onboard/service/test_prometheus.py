"""Prometheus text: every figure once, in a form that Prometheus reads, served where configured and nowhere else."""

from __future__ import annotations

import re
import urllib.error
import urllib.request

import pytest

from contract.errors import ConfigError, LinkError
from contract.vehicle_status import VehicleStatus
from onboard.service.prometheus import PrometheusServer, exposition

STATUS = VehicleStatus(1.7e9, 7, "no gps", "", 12.5, 29.9, 0.0, 300, 0.125, 97, 12, 3, True, None)
DETAIL = {
    "camera": {"state": "ok", "figures": {"rate_hz": 29.97, "lost": 3}},
    "telemetry": {"state": "ok", "figures": {}},
    "pictures": {"refused": {"no_gps": 12}},
}
LINE = re.compile(r'^pointclick_[a-z_]+\{vehicle="kiwi"(,[a-z]+="[^"]*")?\} -?[0-9.e+-]+$')


def test_every_figure_is_one_line_of_the_format() -> None:
    lines = exposition("kiwi", STATUS, DETAIL).splitlines()
    samples = [line for line in lines if not line.startswith("#")]
    assert all(LINE.match(line) for line in samples), [line for line in samples if not LINE.match(line)]
    assert len(samples) == len({line.rsplit(" ", 1)[0] for line in samples})
    for name in {line.split("{")[0] for line in samples}:
        assert sum(line.startswith(f"# TYPE {name} ") for line in lines) == 1
    assert 'pointclick_state{vehicle="kiwi",state="no gps"} 1' in lines
    assert sum(line.startswith("pointclick_state") and line.endswith(" 1") for line in lines) == 1
    assert 'pointclick_delay_seconds{vehicle="kiwi"} 0.125' in lines
    assert 'pointclick_camera{vehicle="kiwi",figure="rate_hz"} 29.97' in lines
    assert 'pointclick_refused_pictures{vehicle="kiwi",reason="no_gps"} 12' in lines
    assert "cpu_celsius" not in "".join(samples)


def test_the_newest_text_is_served_and_nothing_before_there_is_one() -> None:
    with PrometheusServer("127.0.0.1:0") as server:
        url = f"http://127.0.0.1:{server.port}/metrics"
        with pytest.raises(urllib.error.HTTPError, match="503"):
            urllib.request.urlopen(url, timeout=5.0)
        server.show("pointclick_up 1\n")
        with urllib.request.urlopen(url, timeout=5.0) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            assert answer.read() == b"pointclick_up 1\n"
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=5.0)


@pytest.mark.parametrize("address", ["9464", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:99999"])
def test_what_is_no_address_names_the_key(address: str) -> None:
    with pytest.raises(ConfigError, match=r"service\.prometheus"):
        PrometheusServer(address)


def test_a_port_in_use_may_be_free_again_soon() -> None:
    with (
        PrometheusServer("127.0.0.1:0") as server,
        pytest.raises(LinkError, match=r"service\.prometheus.*in use"),
    ):
        PrometheusServer(f"127.0.0.1:{server.port}")
