"""A camera that ends with any error is seen by the commands that watch it: it is raised, or stands in the report."""

import time
from collections.abc import Callable

import pytest

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.commands.calibrate import Live
from onboard.commands.doctor import Look
from onboard.config.schema import parse_config
from onboard.events.source import Emit, Stop
from tests.waiting import PATIENCE_S, eventually

ERRORS = [
    ConfigError("no such format"),
    InputError("not a camera"),
    OSError(5, "Input/output error"),
    ValueError("a bug"),
]


def ends_with(error: Exception) -> Callable[[V4l2Camera, Emit, Stop], None]:
    def run(camera: V4l2Camera, emit: Emit, stop: Stop) -> None:
        raise error

    return run


@pytest.mark.parametrize("error", [*ERRORS, None], ids=repr)
def test_calibration_ends_with_what_ended_the_camera(error: Exception | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(V4l2Camera, "run", ends_with(error) if error else lambda *_: None)
    raised = error or InputError("the camera has ended")
    with Live("/dev/video0", (640, 480), "auto") as live, pytest.raises(type(raised), match=str(raised.args[-1])):
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            live.picture()


@pytest.mark.parametrize("error", ERRORS, ids=repr)
def test_the_doctor_s_report_names_what_ended_the_camera(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(V4l2Camera, "run", ends_with(error))
    config = parse_config('[camera]\ndevice = "/dev/video0"\n[telemetry]\nurl = "udpin:127.0.0.1:0"\n')
    reported: list[str] = []

    def is_named() -> bool:
        """Within 0.3 s; looked again where the camera's thread had no time to end by then."""
        report = Look(config, Camera.from_field_of_view(640, 480, 60.0)).report(0.3)
        reported.append(report.camera.detail)
        return str(error.args[-1]) in reported[-1]

    assert eventually(is_named), reported
