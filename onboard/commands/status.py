"""`pc-onboard status`: how the running daemon is. Exit code 0 running, 3 not running."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from contract.link_config import Tls
from contract.supervised_thread import ThreadReport
from onboard.config.files import load_config_files
from onboard.config.schema import Config
from onboard.events.source import SourceStatus
from onboard.link.status_query import ask
from onboard.service.reports import Report

NOT_RUNNING = 3


def run(arguments: argparse.Namespace) -> int:
    """Ask and print: a few lines, or the whole report as JSON."""
    config = configuration(arguments.config)
    link = config.link
    tls = Tls.of(link.ca, link.certificate, link.key)
    answer = ask(arguments.vehicle or config.vehicle.id, link.listen, tls)
    if answer is None:
        print("not running", file=sys.stderr)
        return NOT_RUNNING
    report = Report.from_json(answer)
    print(json.dumps(json.loads(report.to_json()), indent=1) if arguments.json else text(report))
    return 0


def configuration(path: Path) -> Config:
    """The service's configuration; all defaults where there is no such file."""
    return load_config_files(path) if path.exists() else Config()


def text(report: Report) -> str:
    """The report in a few aligned lines; below the state, whatever else is not well."""
    status = report.status
    reason = f": {status.reason}" if status.reason else ""
    lost = f", {status.lost} lost by the camera" if status.lost else ""
    rows = [
        ("state", f"{status.state}{reason}"),
        *(("", f"{f.state.value}: {f.reason}") for f in report.findings[1:] if f.reason != status.reason),
        ("session", f"{status.session}, {_span(status.up_s)}"),
        ("pictures", f"{status.camera_hz:.1f} a second, {status.dropped} dropped{lost}"),
        ("answers", f"{status.ok_hz:.1f} a second, {status.delay_s:.2f} s after capture"),
        ("tracks", f"{status.tracks}"),
        *([("left out", str(report.pictures.left_out))] if str(report.pictures.left_out) else []),
        ("camera", _source(report.camera)),
        *([("thermal", _source(report.thermal_camera))] if report.thermal_camera is not None else []),
        ("telemetry", _source(report.telemetry)),
        ("gps", "not reported" if report.gps is None else str(report.gps)),
        ("recording", "on" if report.recording.is_on else report.recording.fault or "off"),
        ("threads", ", ".join(_thread(thread) for thread in report.threads)),
    ]
    if status.cpu_c is not None:
        rows.append(("processor", f"{status.cpu_c:.0f} deg C"))
    return "\n".join(f"{name:<11}{value}".rstrip() for name, value in rows)


def _source(source: SourceStatus) -> str:
    figures = ", ".join(f"{name} {value:.3g}" for name, value in source.figures.items())
    return ", ".join(part for part in (source.state.value, source.detail, figures) if part)


def _thread(thread: ThreadReport) -> str:
    error = f" ({thread.last_error})" if thread.last_error else ""
    again = f", begun again {thread.restarts} times" if thread.restarts else ""
    return f"{thread.name} {thread.state.value}{again}{error}"


def _span(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {rest} s"
