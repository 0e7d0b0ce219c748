"""Prometheus: every figure once, in base units, as its own library reads them; served where configured only."""

import re
import socket
import urllib.request
from dataclasses import replace

import pytest
from hypothesis import given
from prometheus_client import Metric
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families

from contract.errors import ConfigError, LinkError
from onboard.service.prometheus import PrometheusServer, metrics
from onboard.service.reports import ClockReport
from onboard.service.vehicle_state import Inputs
from tests.onboard.service.prometheus_page import FULL
from tests.onboard.service.reported import WELL, inputs, report_of, unhurried
from tests.waiting import PATIENCE_S

UNITS = r"(seconds|bytes|ratio|hertz|meters|celsius|radians|pixels)"


def sample(families: list[Metric], name: str, **labels: str) -> float:
    (value,) = [
        s.value
        for family in families
        for s in family.samples
        if s.name == name and labels.items() <= s.labels.items() and s.labels["vehicle"] == "kiwi"
    ]
    return value


@unhurried
@given(inputs())
def test_every_metric_is_there_once_and_has_one_unit(messages: Inputs) -> None:
    families = list(metrics("kiwi", report_of(messages)))
    names = [family.name for family in families]
    assert len(names) == len(set(names))
    series = [(s.name, *sorted(s.labels.items())) for family in families for s in family.samples]
    assert len(series) == len(set(series))
    for family in families:
        assert re.fullmatch(r"pointclick_[a-z_]+", family.name)
        assert family.documentation
        assert not family.unit or re.fullmatch(UNITS, family.unit)
        assert not re.search(r"_(hz|ms|s|mb|ppm|m)$", family.name), family.name
    (states,) = [family for family in families if family.name == "pointclick_state"]
    assert sum(s.value for s in states.samples) == 1.0


def fetch(url: str, accept: str = "text/plain") -> tuple[str, str]:
    request = urllib.request.Request(url, headers={"Accept": accept})
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
        return answer.headers["Content-Type"], answer.read().decode()


def test_the_newest_report_is_served_and_nothing_before_there_is_one() -> None:
    with PrometheusServer("127.0.0.1:0", "kiwi") as server:
        url = f"http://127.0.0.1:{server.port}/metrics"
        assert fetch(url)[1] == ""
        server.show(replace(FULL, clock=ClockReport(1.0)))
        server.show(FULL)
        kind, text = fetch(url)
        assert kind.startswith("text/plain; version=")
        families = list(text_string_to_metric_families(text))
        assert sample(families, "pointclick_host_clock_step_seconds") == -0.5
        kind, text = fetch(url, "application/openmetrics-text; version=1.0.0")
        assert kind.startswith("application/openmetrics-text")
        typed = {family.name: family.type for family in read_openmetrics(text)}
        assert (typed["pointclick_state"], typed["pointclick_session"]) == ("stateset", "info")
        assert typed["pointclick_camera_lost"] == "counter"
        assert server.thread.report().is_well
    with pytest.raises(OSError, match="refused"):
        fetch(url)


def test_a_client_that_says_nothing_holds_up_no_one() -> None:
    with PrometheusServer("127.0.0.1:0", "kiwi") as server:
        server.show(report_of(WELL))
        with socket.create_connection(("127.0.0.1", server.port)):
            assert "pointclick_up_seconds" in fetch(f"http://127.0.0.1:{server.port}/metrics")[1]


@pytest.mark.parametrize("address", ["9464", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:99999"])
def test_what_is_no_address_names_the_key(address: str) -> None:
    with pytest.raises(ConfigError, match=r"service\.prometheus"):
        PrometheusServer(address, "kiwi")


def test_a_port_in_use_may_be_free_again_soon() -> None:
    with (
        PrometheusServer("127.0.0.1:0", "kiwi") as server,
        pytest.raises(LinkError, match=r"service\.prometheus.*in use"),
    ):
        PrometheusServer(f"127.0.0.1:{server.port}", "kiwi")


def test_an_address_that_is_nobodys_is_one_line() -> None:
    with pytest.raises(LinkError, match=r"^service\.prometheus = [^\n]*$"):
        PrometheusServer("192.0.2.1:9464", "kiwi")
