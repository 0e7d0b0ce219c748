"""`pc-ground live`: one command next to a downlink and a telemetry radio, until a click is answered on the page."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.onboard.link.ports import free_udp_port
from tests.rest_long import rest_long
from tests.scenarios.flights import simulated
from tests.streamed_flight import StreamedFlight
from tests.waiting import PATIENCE_S, eventually
from tests.web.browsing import Operator
from tests.web.conftest import page_is_built
from tests.web.served import TURNS, PageProgram

RATE_HZ = TURNS.rate_hz
START_S = PATIENCE_S  # two programs, GStreamer and a browser on a loaded machine
TO_CLICK_S = 15.0  # of flight


class Live(PageProgram):
    def __init__(self, home: Path, *arguments: object) -> None:
        super().__init__("live", *arguments, "--no-browser", "--port", "0", home=home)

    def onboard(self) -> list[int]:
        """The aircraft's programs that it has started."""
        listed = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(self.process.pid)], capture_output=True, text=True, check=False
        )
        return [int(word) for word in listed.stdout.split()]


@pytest.fixture(scope="module")
def session() -> Path:
    """Turns in real time, for as long as the first click may take."""
    assert TURNS.seconds >= TO_CLICK_S + 3.0
    return simulated(TURNS)


@pytest.fixture
def flight(session: Path, tmp_path: Path, gstreamer: None) -> Iterator[tuple[StreamedFlight, list[object]]]:
    page_is_built()
    port = free_udp_port()
    with StreamedFlight(session, tmp_path, RATE_HZ, port, delay_s=0.2, jitter_s=0.03, bit_rate=4_000_000) as streamed:
        camera = ["--camera", streamed.server.url("rtspt"), "--camera-file", session / "camera.json"]
        yield streamed, [*camera, "--telemetry", f"udpin:127.0.0.1:{port}", "--set", f"camera.rate_hz={RATE_HZ}"]


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.long
@pytest.mark.wall_clock
def test_from_one_command_to_an_answered_click_and_both_programs_end(
    flight: tuple[StreamedFlight, list[object]], tmp_path: Path, chromium: Any
) -> None:
    streamed, arguments = flight
    live = Live(tmp_path / "home", *arguments)
    try:
        assert live.url, live.printed
        began_ns = streamed.server.wait_for_client(START_S)
        assert began_ns is not None, live.printed
        operator = Operator(chromium, live, has_map=False)  # type: ignore[arg-type]
        deadline = began_ns / 1e9 + TO_CLICK_S
        while not _answered(operator):
            assert time.monotonic() < deadline, operator.ask("api/status")
            time.sleep(0.3)
        operator.context.close()
        (onboard,) = live.onboard()
        assert live.end(signal.SIGINT) == 130
    finally:
        live.process.kill()
    assert is_gone(onboard)
    log = tmp_path / "home" / "pointclick" / "live" / "onboard.log"
    assert "the daemon failed" not in log.read_text()


def _answered(operator: Operator) -> bool:
    """Whether the newest picture that can be clicked gives a place in its middle."""
    vehicles = operator.ask("api/status")["vehicles"]
    if not vehicles:
        return False
    rows = operator.ask(f"api/vehicles/{vehicles[0]['id']}/frames")
    good = [row for row in rows if row["status"] == "ok" and row["has_picture"]]
    if not good:
        return False
    operator.click(240, 180)
    place = operator.newest_pin()["place"]
    return bool(place["status"] == "ok" and place["ce90_m"] < 60.0)


@pytest.mark.long  # short: both programs end, of one command
def test_each_program_ends_with_the_other(flight: tuple[StreamedFlight, list[object]], tmp_path: Path) -> None:
    _, arguments = flight
    live = Live(tmp_path / "home", *arguments)
    try:
        (onboard,) = live.onboard()
        os.kill(onboard, signal.SIGKILL)
        assert live.process.wait(PATIENCE_S) == 2
        live.reader.join(PATIENCE_S)
        assert "pc-ground: error: pc-onboard has ended" in live.printed.splitlines()[-1]
        again = Live(tmp_path / "home", *arguments)
        (onboard,) = again.onboard()
        again.process.kill()
        assert eventually(lambda: is_gone(onboard))
    finally:
        live.process.kill()


@pytest.mark.parametrize(
    ("arguments", "why"),
    rest_long(
        [
            (("--camera", "foo:bar"), "camera.device = 'foo:bar' is none of /dev/NAME, libcamera:ID, rtsp://HOST/PATH"),
            (("--set", "mount.pich_deg=3"), "unknown key 'mount.pich_deg'; did you mean 'mount.pitch_deg'?"),
            (("--telemetry", "foo:1"), "telemetry.url 'foo:1': unknown kind 'foo'; one of serial:/dev/NAME:BAUD"),
            (("--set", "mount"), "--set mount: it is SECTION.KEY=VALUE, as mount.pitch_deg=-45"),
            (("--camera-file", "none.json"), "none.json: no such file; pc-onboard calibrate makes one"),
        ]
    ),
)
def test_what_cannot_work_is_reported_in_one_line(tmp_path: Path, arguments: tuple[str, ...], why: str) -> None:
    page_is_built()
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"width_px": 1}))
    from contract.camera import Camera  # noqa: PLC0415

    camera.write_text(Camera.from_field_of_view(320, 240, 60.0).to_json())
    telemetry = f"udpin:127.0.0.1:{free_udp_port()}"
    usual = ["--camera", "rtsp://127.0.0.1:1/x", "--telemetry", telemetry, "--camera-file", camera]
    live = Live(tmp_path / "home", *usual, *arguments)
    assert live.process.returncode == 2
    assert why in live.printed and live.printed.startswith("pc-ground: error: ") and live.printed.count("\n") == 1
