"""`check-config --fly` looks at what the configuration names, and says of each thing whether it is there."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from contract.camera import Camera
from onboard.__main__ import main
from onboard.camera.v4l2_device import Card
from onboard.commands import check_config

OPTICS = Camera.from_field_of_view(640, 480, 60.0)


class Opened:
    def __init__(self, can_capture: bool) -> None:
        self.can_capture, self.is_closed = can_capture, False

    def card(self) -> Card:
        return Card("uvcvideo", "Test Cam", "usb-1", self.can_capture)

    def close(self) -> None:
        self.is_closed = True


@pytest.fixture
def serial_line() -> Iterator[str]:
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def written(where: Path, device: object, url: str) -> Path:
    (where / "camera.json").write_text(OPTICS.to_json())
    (where / "config.toml").write_text(
        f'[camera]\nfile = "{where / "camera.json"}"\ndevice = "{device}"\n[telemetry]\nurl = "{url}"\n'
    )
    return where / "config.toml"


def checked(file: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    code = main(["check-config", "--fly", "--config", str(file)])
    return code, capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("look", ["circle_radius_m = 150.0", "circle_clearance_m = 80.0"])
def test_a_circle_that_no_one_may_ask_for_is_stated_and_is_no_error(
    look: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config.toml").write_text(f"[look]\n{look}\n")
    assert main(["check-config", "--config", str(tmp_path / "config.toml")]) == 0
    assert ("link.pointers names no one" in capsys.readouterr().out) == ("radius" in look)


def test_what_is_there_is_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], serial_line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = Opened(True)
    monkeypatch.setattr(check_config, "V4l2Device", lambda path: device)
    code, lines = checked(written(tmp_path, "/dev/video0", f"serial:{serial_line}:57600"), capsys)
    assert (code, lines[2]) == (0, "camera.device /dev/video0: Test Cam")
    assert "is there; whether an autopilot sends cannot be known" in lines[3]
    assert device.is_closed


def test_a_node_that_takes_no_pictures_is_no_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], serial_line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = Opened(False)
    monkeypatch.setattr(check_config, "V4l2Device", lambda path: device)
    code, lines = checked(written(tmp_path, "/dev/video1", f"serial:{serial_line}:57600"), capsys)
    assert (code, "MISSING: Test Cam takes no pictures" in lines[2]) == (1, True)
    assert device.is_closed


def test_keys_of_the_link_that_are_missing_or_closed_to_the_service_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A key that the daemon then could not read was `good`."""
    monkeypatch.setattr(check_config.Reader, "of_the_service", lambda: check_config.Reader("", 0, frozenset()))
    keys = {name: tmp_path / f"{name}.pem" for name in ("ca", "certificate", "key")}
    for name in ("ca", "certificate"):
        keys[name].write_text("x")
    file = written(tmp_path, "/dev/video77", "udpin:127.0.0.1:14550")
    plain = file.read_text()
    stated = "".join(f'{name} = "{path}"\n' for name, path in keys.items())
    file.write_text(f'{plain}[link]\nlisten = ["tls/0.0.0.0:7447"]\n{stated}')
    code, lines = checked(file, capsys)
    assert code == 1 and f"link.key {keys['key']}: MISSING: No such file or directory" in lines
    assert f"link.ca {keys['ca']}: is there and can be read" in lines
    keys["key"].write_text("x")
    keys["key"].chmod(0o600)
    other = check_config.Reader("pointclick", os.geteuid() + 4000, frozenset())
    monkeypatch.setattr(check_config.Reader, "of_the_service", lambda: other)
    code, lines = checked(file, capsys)
    (line,) = [line for line in lines if line.startswith("link.key")]
    assert code == 1 and "MISSING: the service's user pointclick may not" in line and "chgrp pointclick" in line


def test_a_password_is_not_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for device in ("rtsp://anna:hunter2@cam/live", "rtsp:/anna:hunter2@cam/live", "gst:x user-pw=hunter2 ! y"):
        main(["check-config", "--fly", "--config", str(written(tmp_path, device, "udpin:127.0.0.1:14550"))])
        printed = "".join(capsys.readouterr())
        assert "hunter2" not in printed
