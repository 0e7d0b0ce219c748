"""The daemon's figures as Prometheus text (exposition format 0.0.4), over HTTP from a thread of its own."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

from contract.errors import ConfigError, LinkError
from contract.vehicle_status import VehicleStatus
from onboard.service.vehicle_state import Word

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
# Name, type, meaning, and the status' field.
_METRICS = (
    ("up_seconds", "gauge", "age of the session", "up_s"),
    ("camera_hertz", "gauge", "pictures taken a second", "camera_hz"),
    ("answered_hertz", "gauge", "pictures a second that can be clicked", "ok_hz"),
    ("delay_seconds", "gauge", "from the newest picture's capture to its set", "delay_s"),
    ("tracks", "gauge", "features followed into the newest picture", "tracks"),
    ("dropped_pictures_total", "counter", "pictures dropped for want of time", "dropped"),
    ("lost_pictures_total", "counter", "pictures lost by the camera", "lost"),
    ("recording", "gauge", "1 while the session is being recorded", "recording"),
    ("cpu_celsius", "gauge", "temperature of the processor", "cpu_c"),
)


def exposition(vehicle: str, status: VehicleStatus, detail: dict[str, Any]) -> str:
    """All figures of a report. The state is one series a word, 1 for the one that holds."""
    label = f'vehicle="{_escaped(vehicle)}"'
    lines = ["# HELP pointclick_state 1 for the state that holds", "# TYPE pointclick_state gauge"]
    lines += [f'pointclick_state{{{label},state="{word.value}"}} {int(word.value == status.state)}' for word in Word]
    for name, kind, meaning, field in _METRICS:
        value = getattr(status, field)
        if value is not None:
            lines += [f"# HELP pointclick_{name} {meaning}", f"# TYPE pointclick_{name} {kind}"]
            lines += [f"pointclick_{name}{{{label}}} {float(value):.10g}"]
    for source in ("camera", "telemetry"):
        figures = detail.get(source, {}).get("figures", {})
        if figures:
            lines += [f"# HELP pointclick_{source} figures of the {source}", f"# TYPE pointclick_{source} gauge"]
        lines += [
            f'pointclick_{source}{{{label},figure="{_escaped(name)}"}} {float(value):.10g}'
            for name, value in sorted(figures.items())
        ]
    refused = detail.get("pictures", {}).get("refused", {})
    if refused:
        lines += [
            "# HELP pointclick_refused_pictures pictures without an answer",
            "# TYPE pointclick_refused_pictures gauge",
        ]
    lines += [
        f'pointclick_refused_pictures{{{label},reason="{_escaped(why)}"}} {count}'
        for why, count in sorted(refused.items())
    ]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


class PrometheusServer:
    """Serves the newest text on every path. Raises ConfigError for what is no address, LinkError for one in use."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"service.prometheus = {address!r} is not usable: HOST:PORT, such as 127.0.0.1:9464")
        try:
            self._server = ThreadingHTTPServer((host.strip("[]"), int(port)), _Handler)
        except OSError as error:
            raise LinkError(f"service.prometheus = {address!r}: {error.strerror or error}") from error
        self._server.daemon_threads = True
        self._server.text = b""  # type: ignore[attr-defined]
        self._thread = threading.Thread(target=self._server.serve_forever, name="prometheus", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens: the configured port, or the one that was given for 0."""
        return int(self._server.server_address[1])

    def show(self, text: str) -> None:
        """Serve this from now on."""
        self._server.text = text.encode()  # type: ignore[attr-defined]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    timeout = 5.0

    def do_GET(self) -> None:
        """The text, whatever the path."""
        text: bytes = self.server.text  # type: ignore[attr-defined]
        self.send_response(200 if text else 503)
        self.send_header("Content-Type", CONTENT_TYPE)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *arguments: object) -> None:
        """A scrape each few seconds is nothing for the log."""
