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
from contract.supervised_thread import ThreadReport, ThreadState
from onboard.events.source import SourceStatus, State
from onboard.pipeline.estimates import BORESIGHT, RELATIVE_VARIANCE
from onboard.pipeline.summary import Estimate, LeftOut, SensorError
from onboard.service.prometheus import PrometheusServer, metrics
from onboard.service.reports import ClockReport, PictureCounts
from onboard.service.vehicle_state import Inputs
from tests.onboard.service.reported import WELL, inputs, report_of, unhurried
from tests.waiting import PATIENCE_S

FULL = replace(
    report_of(replace(WELL, position_fault="", outcome=None)),
    camera=SourceStatus(State.OK, "", {"rate_hz": 29.97, "delay_ms": 12.5, "lost": 3.0}),
    telemetry=SourceStatus(State.DEGRADED, "", {"drift_ppm": 20.0, "lost_packets": 7.0, "clock_sigma_ms": 0.9}),
    pictures=PictureCounts(300, 40, 280, {"no_gps": 12}, 0.25, 0, LeftOut(0.02, 0.1)),
    estimates=(
        Estimate(BORESIGHT, "radians", (0.01, 0.0, 0.0), (0.001,) * 3),
        Estimate(RELATIVE_VARIANCE, "ratio", (1.4,), (0.2,)),
    ),
    sensor_errors=(SensorError("heading", "deg", 3.8, 2.0),),
    threads=(ThreadReport("camera", ThreadState.RUNNING, 0.25, 2, "OSError: gone"),),
    clock=ClockReport(-0.5),
)
UNITS = r"(seconds|bytes|ratio|hertz|meters|celsius|radians|pixels)"


def sample(families: list[Metric], name: str, **labels: str) -> float:
    (value,) = [
        s.value
        for family in families
        for s in family.samples
        if s.name == name and labels.items() <= s.labels.items() and s.labels["vehicle"] == "kiwi"
    ]
    return value


def test_figures_are_in_base_units_under_their_rules() -> None:
    families = list(metrics("kiwi", FULL))
    assert sample(families, "pointclick_camera_rate_hertz") == 29.97
    assert sample(families, "pointclick_camera_delay_seconds") == 0.0125
    assert sample(families, "pointclick_camera_lost_total") == 3.0
    assert sample(families, "pointclick_telemetry_drift_ratio") == pytest.approx(20e-6)
    assert sample(families, "pointclick_telemetry_clock_sigma_seconds") == pytest.approx(0.9e-3)
    assert sample(families, "pointclick_telemetry_lost_packets_total") == 7.0
    assert sample(families, "pointclick_delay_seconds") == 0.125
    assert sample(families, "pointclick_picture_mean_ratio") == pytest.approx(120.0 / 255.0)
    assert sample(families, "pointclick_picture_left_out_ratio", by="mask") == 0.02
    assert sample(families, "pointclick_picture_left_out_ratio", by="found") == 0.1
    assert sample(families, "pointclick_gps_sigma_meters", direction="horizontal") == 0.8
    assert sample(families, "pointclick_refused_pictures", reason="no_gps") == 12.0
    assert sample(families, "pointclick_boresight_radians", component="0") == 0.01
    assert sample(families, "pointclick_boresight_sigma_radians", component="2") == 0.001
    assert sample(families, "pointclick_relative_variance_factor_ratio", component="0") == 1.4
    assert sample(families, "pointclick_relative_variance_factor_sigma_ratio", component="0") == 0.2
    assert sample(families, "pointclick_sensor_error_ratio", sensor="heading") == 1.9
    assert sample(families, "pointclick_host_clock_step_seconds") == -0.5
    assert sample(families, "pointclick_state", pointclick_state="starting") == 1.0
    assert sample(families, "pointclick_state", pointclick_state="ok") == 0.0
    assert sample(families, "pointclick_telemetry_state", pointclick_telemetry_state="degraded") == 1.0
    assert sample(families, "pointclick_well", subject="answers") == 0.0
    assert sample(families, "pointclick_well", subject="gps") == 1.0
    assert sample(families, "pointclick_session_info", session="7") == 1.0
    assert sample(families, "pointclick_thread_state", thread="camera", pointclick_thread_state="running") == 1.0
    assert sample(families, "pointclick_thread_restarts_total", thread="camera") == 2.0
    assert sample(families, "pointclick_thread_heartbeat_age_seconds", thread="camera") == 0.25
    assert not [family for family in families if "cpu" in family.name], "no processor told its temperature"


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
