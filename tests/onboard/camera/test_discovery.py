"""Which device is which, from /dev and /sys."""

from pathlib import Path

from onboard.__main__ import main
from onboard.camera.discovery import Identity, device_paths, identity, same_camera, stable_names
from onboard.camera.v4l2_device import Card
from onboard.config.schema import parse_config

CARD = Card("uvcvideo", "Cam", "usb-1", True)


def house(folder: Path) -> tuple[Path, Path]:
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


def test_no_camera_is_one_line_and_exit_1(capsys, monkeypatch) -> None:
    monkeypatch.setattr("onboard.commands.cameras.device_paths", lambda: [])
    monkeypatch.setattr("onboard.commands.cameras.libcamera_names", lambda: ([], ""))
    monkeypatch.setattr("onboard.commands.cameras.decoders_text", lambda: "H264 by avdec_h264")
    assert main(["cameras"]) == 1
    none = "no camera: no V4L2 capture device under /dev/video*"
    assert capsys.readouterr() == ("streams: H264 by avdec_h264\n", f"{none}, and none of libcamera's\n")
    assert main(["cameras", "--json"]) == 1
    assert capsys.readouterr().out == "[]\n"
    monkeypatch.setattr("onboard.commands.cameras.libcamera_names", lambda: ([], "GStreamer is not installed: sudo"))
    assert main(["cameras"]) == 1
    why = "libcamera's cameras are not listed: GStreamer is not installed: sudo\n"
    assert capsys.readouterr() == ("streams: H264 by avdec_h264\n", f"{why}{none}\n")


def test_each_camera_comes_with_the_line_to_write(capsys, monkeypatch) -> None:
    monkeypatch.setattr("onboard.commands.cameras.device_paths", lambda: [])
    monkeypatch.setattr("onboard.commands.cameras.libcamera_names", lambda: (["/base/soc/i2c0mux/imx219@10"], ""))
    monkeypatch.setattr("onboard.commands.cameras.decoders_text", lambda: "H264 by avdec_h264")
    assert main(["cameras"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["libcamera:/base/soc/i2c0mux/imx219@10", '  device = "libcamera:/base/soc/i2c0mux/imx219@10"']
    assert lines[2:] == ["", "streams: H264 by avdec_h264"]
    config = parse_config("[camera]\n" + lines[1])
    assert config.camera.device == lines[0] and config.camera.sigma_latency_s == 0.1
