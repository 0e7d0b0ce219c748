"""`pc-onboard status`: how the running daemon is. Exit code 0 running, 3 not running."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from contract.link_config import Tls
from onboard.config.files import load_config_files
from onboard.config.schema import Config
from onboard.link.status_query import ask

NOT_RUNNING = 3


def run(arguments: argparse.Namespace) -> int:
    """Ask and print: a few lines, or the whole report as JSON."""
    config = configuration(arguments.config)
    link = config.link
    tls = Tls.of(link.ca, link.certificate, link.key)
    report = ask(arguments.vehicle or config.vehicle.id, link.listen, tls)
    if report is None:
        print("not running", file=sys.stderr)
        return NOT_RUNNING
    print(json.dumps(report, indent=1) if arguments.json else text(report))
    return 0


def configuration(path: Path) -> Config:
    """The service's configuration; all defaults where there is no such file."""
    return load_config_files(path) if path.exists() else Config()


def text(report: dict[str, Any]) -> str:
    """The report in a few aligned lines."""
    status, camera, telemetry = report["status"], report["camera"], report["telemetry"]
    reason = f": {status['reason']}" if status["reason"] else ""
    lost = f", {status['lost']} lost by the camera" if status["lost"] else ""
    rows = [
        ("state", f"{status['state']}{reason}"),
        ("session", f"{status['session']}, {_span(status['up_s'])}"),
        ("pictures", f"{status['camera_hz']:.1f} a second, {status['dropped']} dropped{lost}"),
        ("answers", f"{status['ok_hz']:.1f} a second, {status['delay_s']:.2f} s after capture"),
        ("tracks", f"{status['tracks']}"),
        ("camera", _source(camera)),
        ("telemetry", _source(telemetry)),
        ("recording", "on" if status["recording"] else report.get("recording_fault") or "off"),
    ]
    if status["cpu_c"] is not None:
        rows.append(("processor", f"{status['cpu_c']:.0f} deg C"))
    return "\n".join(f"{name:<11}{value}" for name, value in rows)


def _source(health: dict[str, Any]) -> str:
    figures = ", ".join(f"{name} {value:.3g}" for name, value in health["figures"].items())
    return ", ".join(part for part in (health["state"], health["detail"], figures) if part)


def _span(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {rest} s"
