"""Which device is which, from /dev and /sys."""

from __future__ import annotations

from pathlib import Path

from onboard.__main__ import main
from onboard.camera.discovery import Identity, device_paths, identity, same_camera, stable_names
from onboard.camera.v4l2_device import Card

CARD = Card("uvcvideo", "Cam", "usb-1", True)


def house(folder: Path) -> tuple[Path, Path]:
    """A /dev and a /sys with two nodes of one camera and a second camera."""
    dev, sys = folder / "dev", folder / "sys"
    for kind in ("by-id", "by-path"):
        (dev / "v4l" / kind).mkdir(parents=True)
    for number, index in ((10, 0), (2, 0), (3, 1)):
        (dev / f"video{number}").touch()
        (sys / f"video{number}").mkdir(parents=True)
        (sys / f"video{number}" / "index").write_text(f"{index}\n")
    (dev / "video-enc").touch()
    (dev / "v4l" / "by-id" / "usb-Cam_123-video-index0").symlink_to("../../video2")
    (dev / "v4l" / "by-path" / "pci-1-video-index0").symlink_to("../../video2")
    return dev, sys


def test_devices_are_listed_by_number(tmp_path: Path) -> None:
    dev, _ = house(tmp_path)
    assert [Path(path).name for path in device_paths(dev)] == ["video2", "video3", "video10"]


def test_names_that_last_are_found_for_node_and_link(tmp_path: Path) -> None:
    dev, sys = house(tmp_path)
    by_id = dev / "v4l" / "by-id" / "usb-Cam_123-video-index0"
    for path in (dev / "video2", by_id):
        assert stable_names(str(path), dev)["by-id"] == [str(by_id)]
        assert identity(str(path), CARD, dev, sys) == Identity("uvcvideo", "Cam", "usb-1", frozenset({str(by_id)}), "0")
    assert stable_names(str(dev / "video9"), dev) == {}
    assert identity(str(dev / "video3"), CARD, dev, sys).index == "1"


def test_the_serial_number_outweighs_the_plug() -> None:
    ours = Identity("uvc", "Cam", "usb-1", frozenset({"a"}), "0")
    moved = Identity("uvc", "Cam", "usb-2", frozenset({"a"}), "0")
    stranger = Identity("uvc", "Cam", "usb-1", frozenset({"b"}), "0")
    assert same_camera(ours, [("/dev/video0", stranger), ("/dev/video1", moved)]) == "/dev/video1"
    assert same_camera(ours, [("/dev/video0", stranger)]) is None


def test_another_node_of_the_same_camera_is_not_it() -> None:
    ours = Identity("uvc", "Cam", "usb-1", frozenset(), "0")
    assert same_camera(ours, [("/dev/video1", Identity("uvc", "Cam", "usb-1", frozenset(), "1"))]) is None


def test_the_same_device_by_two_paths_is_one(tmp_path: Path) -> None:
    dev, _ = house(tmp_path)
    ours = Identity("uvc", "Cam", "usb-1", frozenset(), "0")
    link = str(dev / "v4l" / "by-id" / "usb-Cam_123-video-index0")
    found = same_camera(ours, [(link, ours), (str(dev / "video2"), ours)])
    assert found is not None and Path(found).name == "video2"


def test_no_camera_is_one_line_and_exit_1(capsys, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("onboard.commands.cameras.device_paths", lambda: [])
    assert main(["cameras"]) == 1
    assert capsys.readouterr() == ("", "no camera: no V4L2 capture device under /dev/video*\n")
    assert main(["cameras", "--json"]) == 1
    assert capsys.readouterr().out == "[]\n"
