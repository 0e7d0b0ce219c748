"""The daemon's figures for Prometheus, over HTTP from a thread of its own: base units, one unit a metric.

prometheus_client writes the text. A source's figures are named with their unit (`delay_ms`); here they become metrics
of the base unit (`pointclick_camera_delay_seconds`), those without a unit counters (`pointclick_camera_lost_total`).
"""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self
from wsgiref.simple_server import WSGIRequestHandler, make_server

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.exposition import ThreadingWSGIServer

from contract.errors import ConfigError, LinkError
from contract.supervised_thread import Policy, SupervisedThread, ThreadState
from onboard.events.source import SourceStatus, State
from onboard.pipeline.summary import Estimate
from onboard.service.reports import Report
from onboard.service.vehicle_state import Subject, VehicleState

POLL_S = 0.5
REQUEST_S = 5.0  # a client that sends nothing for so long is disconnected
# The end of a figure's name -> the base unit, and what a figure is to be multiplied by.
_UNITS = {
    "_hz": ("hertz", 1.0),
    "_ms": ("seconds", 1e-3),
    "_s": ("seconds", 1.0),
    "_ppm": ("ratio", 1e-6),
    "_share": ("ratio", 1.0),
    "_m": ("meters", 1.0),
    "_rad": ("radians", 1.0),
    "_px": ("pixels", 1.0),
    "_mb": ("bytes", 1e6),
}


def metrics(vehicle: str, report: Report) -> Iterator[Metric]:
    """Every figure of a report as a metric with the label `vehicle`; what is not known is left out."""
    one = _Labelled(vehicle)
    status = report.status
    yield one.info("session", "the session that runs", {"session": str(status.session)})
    yield one.states("state", "1 for the state of the vehicle that holds", VehicleState, status.state)
    well = {subject: all(f.subject is not subject for f in report.findings) for subject in Subject}
    yield one.gauges("well", "1 where nothing is amiss", "", "subject", {s.value: float(w) for s, w in well.items()})
    yield one.gauge("up", "age of the session", "seconds", status.up_s)
    yield one.gauge("pictures", "pictures taken a second", "hertz", status.camera_hz)
    yield one.gauge("answered_pictures", "pictures a second that can be clicked", "hertz", status.ok_hz)
    yield one.gauge("delay", "from the newest picture's capture to its set", "seconds", status.delay_s)
    yield one.gauge("tracks", "features followed into the newest picture", "", status.tracks)
    yield one.counter("dropped_pictures", "pictures dropped for want of time", status.dropped)
    yield one.counter("lost_pictures", "pictures lost by the camera", status.lost)
    yield one.gauge("recording", "1 while the session is being recorded", "", status.recording)
    yield one.gauge("host_clock_step", "the host's clock against the session's", "seconds", report.clock.host_step_s)
    if status.cpu_c is not None:
        yield one.gauge("cpu", "temperature of the processor", "celsius", status.cpu_c)
    yield from _source(one, "camera", report.camera)
    yield from _source(one, "telemetry", report.telemetry)
    if report.thermal_camera is not None:
        yield from _source(one, "thermal_camera", report.thermal_camera)
    yield from _gps(one, report)
    yield from _pictures(one, report)
    for estimate in report.estimates:
        yield from _estimate(one, estimate)
    ratios = {error.name: error.sigma / error.declared for error in report.sensor_errors if error.declared}
    if ratios:
        yield one.gauges("sensor_error", "one sigma as estimated, of what is configured", "ratio", "sensor", ratios)
    times = {c.name: c.sigma_times for c in report.contradictions}
    if times:
        meaning = "what a sensor that contradicts the others counts with, of its sigma; 1: it agrees again"
        yield one.gauges("sensor_contradiction", meaning, "ratio", "sensor", times)
    yield from _threads(one, report)


class _Labelled:
    """Makes metrics of one vehicle."""

    def __init__(self, vehicle: str) -> None:
        self._vehicle = vehicle

    def gauge(self, name: str, meaning: str, unit: str, value: float) -> Metric:
        metric = GaugeMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle"], unit=unit)
        metric.add_metric([self._vehicle], float(value))
        return metric

    def gauges(self, name: str, meaning: str, unit: str, label: str, values: Mapping[str, float]) -> Metric:
        metric = GaugeMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle", label], unit=unit)
        for key, value in values.items():
            metric.add_metric([self._vehicle, key], float(value))
        return metric

    def counter(self, name: str, meaning: str, value: float) -> Metric:
        metric = CounterMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle"])
        metric.add_metric([self._vehicle], float(value))
        return metric

    def counters(self, name: str, meaning: str, label: str, values: Mapping[str, float]) -> Metric:
        metric = CounterMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle", label])
        for key, value in values.items():
            metric.add_metric([self._vehicle, key], float(value))
        return metric

    def states(self, name: str, meaning: str, of: Any, holds: str) -> Metric:
        metric = StateSetMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle"])
        metric.add_metric([self._vehicle], {state.value: state.value == holds for state in of})
        return metric

    def info(self, name: str, meaning: str, values: dict[str, str]) -> Metric:
        metric = InfoMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle"])
        metric.add_metric([self._vehicle], values)
        return metric

    def state_of_each(self, name: str, meaning: str, label: str, of: Any, holds: Mapping[str, str]) -> Metric:
        metric = StateSetMetricFamily(f"pointclick_{name}", meaning, labels=["vehicle", label])
        for key, state_now in holds.items():
            metric.add_metric([self._vehicle, key], {state.value: state.value == state_now for state in of})
        return metric


def _source(one: _Labelled, name: str, source: SourceStatus) -> Iterator[Metric]:
    yield one.states(f"{name}_state", f"1 for the state of the {name} that holds", State, source.state.value)
    for figure, value in sorted(source.figures.items()):
        ending = next((e for e in _UNITS if figure.endswith(e)), None)
        if ending is None:
            yield one.counter(f"{name}_{figure}", f"{name}: {figure} since the session began", value)
        else:
            unit, factor = _UNITS[ending]
            what = figure.removesuffix(ending)
            yield one.gauge(f"{name}_{what}", f"{name}: {what.replace('_', ' ')}", unit, value * factor)


def _gps(one: _Labelled, report: Report) -> Iterator[Metric]:
    gps = report.gps
    if gps is None:
        return
    yield one.gauge("gps_fix_type", "GPS_FIX_TYPE of MAVLink: 3 and up is usable", "", gps.fix_type)
    yield one.gauge("gps_age", "since the receiver's newest word", "seconds", gps.age_s)
    if gps.satellites is not None:
        yield one.gauge("gps_satellites", "satellites used", "", gps.satellites)
    claims = {"horizontal": gps.sigma_horizontal_m, "vertical": gps.sigma_vertical_m}
    known = {axis: sigma for axis, sigma in claims.items() if sigma is not None}
    if known:
        yield one.gauges("gps_sigma", "what the receiver claims", "meters", "direction", known)


def _pictures(one: _Labelled, report: Report) -> Iterator[Metric]:
    pictures, brightness = report.pictures, report.brightness
    yield one.counter("handled_pictures", "pictures that came through the pipeline", pictures.handled)
    yield one.counter("keyframes", "pictures that became keyframes", pictures.keyframes)
    yield one.counter("unencodable_sets", "sets that had no encoding and were left out", pictures.unencodable)
    # A picture counts by its latest revision: these two can go down.
    yield one.gauge("solved_pictures", "pictures that can be clicked", "", pictures.solved)
    yield one.gauges("refused_pictures", "pictures that cannot be clicked", "", "reason", pictures.refused)
    yield one.gauge("reprojection", "median residual of the window solves", "pixels", pictures.reprojection_px)
    shares = {"mask": pictures.left_out.masked, "found": pictures.left_out.standing}
    yield one.gauges("picture_left_out", "share of a picture where no features are taken", "ratio", "by", shares)
    if brightness is not None:
        yield one.gauge("picture_mean", "mean grey of a picture, 1 is white", "ratio", brightness.mean / 255.0)
        yield one.gauge("picture_black", "share of a picture that is black", "ratio", brightness.black)
        yield one.gauge("picture_white", "share of a picture that is white", "ratio", brightness.white)


def _estimate(one: _Labelled, estimate: Estimate) -> Iterator[Metric]:
    name = estimate.name.replace("_", " ")
    for suffix, what, numbers in (("", "as estimated", estimate.values), ("_sigma", "one sigma", estimate.sigmas)):
        values = {str(index): value for index, value in enumerate(numbers)}
        yield one.gauges(estimate.name + suffix, f"{name}, {what}", estimate.unit, "component", values)


def _threads(one: _Labelled, report: Report) -> Iterator[Metric]:
    if not report.threads:
        return
    names = {thread.name: thread for thread in report.threads}
    states = {name: thread.state.value for name, thread in names.items()}
    yield one.state_of_each("thread_state", "1 for the state of a thread that holds", "thread", ThreadState, states)
    ages = {name: t.heartbeat_age_s for name, t in names.items() if t.heartbeat_age_s is not None}
    yield one.gauges("thread_heartbeat_age", "since a thread last reported", "seconds", "thread", ages)
    restarts = {name: float(thread.restarts) for name, thread in names.items()}
    yield one.counters("thread_restarts", "times that a thread was begun again", "thread", restarts)


class PrometheusServer:
    """Serves the newest report on every path; nothing before there is one. A Reporter: `show`.

    Raises ConfigError for what is no address, LinkError for one that cannot be listened on.
    """

    def __init__(self, address: str, vehicle: str) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"service.prometheus = {address!r} is not usable: HOST:PORT, such as 127.0.0.1:9464")
        self._vehicle = vehicle
        self._report: Report | None = None
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server = _listen(host.strip("[]"), int(port), registry)
        except OSError as error:
            raise LinkError(f"service.prometheus = {address!r}: {error.strerror or error}") from error
        self.thread = SupervisedThread("metrics", self._serve, Policy.RESTART)
        self.thread.start()

    @property
    def port(self) -> int:
        return int(self._server.server_port)

    def show(self, report: Report) -> None:
        self._report = report

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of the newest report; prometheus_client calls this at each request."""
        report = self._report
        if report is not None:
            yield from metrics(self._vehicle, report)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.thread.end()
        self.thread.join(10.0 * POLL_S)
        self._server.server_close()

    def _serve(self, thread: SupervisedThread) -> None:
        while not thread.is_set():
            self._server.handle_request()


class _Handler(WSGIRequestHandler):
    timeout = REQUEST_S

    def log_message(self, format: str, *arguments: object) -> None:
        """A scrape each few seconds is nothing for the log."""


class _Server(ThreadingWSGIServer):
    timeout = POLL_S

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away in the middle is nothing for the log."""


class _Server6(_Server):
    address_family = socket.AF_INET6


def _listen(host: str, port: int, registry: CollectorRegistry) -> _Server:
    """Raises OSError, also for a name that is not known."""
    app = make_wsgi_app(registry)
    return make_server(host, port, app, _Server6 if ":" in host else _Server, _Handler)
