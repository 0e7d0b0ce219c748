"""Our service with `camera.device = "libcamera:"`: GStreamer and libcamera inside its cage, on the kernel's vimc."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from contract.camera import Camera
from tests.bench import cameras
from tests.bench.sortie import Sortie, sortie

SIZE_PX = (312, 240)  # vimc enlarges three times what has an even number of pixels
RATE_HZ = 4.0  # of the 25 that it would give on a computer of its own
WAIT_S = 300.0  # the guest's one processor first looks through all of GStreamer's plugins


def sees(report: dict[str, Any]) -> bool:
    """Pictures come, and it is said whose clock stamps them."""
    camera = report["camera"]
    return bool(camera["state"] == "ok" and "stamps of the camera's driver" in camera["detail"])


def is_absent(report: dict[str, Any]) -> bool:
    """The camera is away, and libcamera has been asked for it."""
    return bool(report["camera"]["state"] == "lost" and "libcamera has no camera" in report["camera"]["detail"])


def taken(report: dict[str, Any]) -> float:
    """Pictures since the service began, those left out that only repeated the one before."""
    figures = report["camera"]["figures"]
    return float(figures["pictures"] - figures["repeated"])


def counted(flying: Sortie) -> tuple[float, float]:
    """Return the pictures since the service began, new and repeated."""
    report, _ = flying.wait_for("a report", bool, WAIT_S)
    return taken(report), float(report["camera"]["figures"]["repeated"])


def helper_of(flying: Sortie) -> tuple[str, list[str]]:
    """Whose process the helper is, and the devices that it holds open."""
    pid = flying.machine.shell("pgrep -of 'python3 -I .*/gstreamer_helper.py'").strip()
    held = flying.machine.shell(f"readlink /proc/{pid}/fd/* || true").split()
    return flying.machine.shell(f"stat -c %U /proc/{pid}").strip(), [path for path in held if path.startswith("/dev/")]


def test_the_service_waits_for_libcameras_camera_reads_it_and_takes_it_up_again(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    camera_file = tmp_path / "camera.json"
    camera_file.write_text(Camera.from_field_of_view(*SIZE_PX, 40.0).to_json())
    with sortie(camera_file, device="libcamera:", rate_hz=RATE_HZ) as flying, flying.autopilot:
        absent, _ = flying.wait_for("no camera", is_absent, WAIT_S)
        assert taken(absent) == 0
        # What took so long is kept where the service may write, for the next start.
        flying.machine.shell("test -s /var/cache/pointclick/gstreamer-1.0/registry.*.bin")
        pid = flying.unit("MainPID")
        cameras.load_vimc(flying.machine)
        flying.wait_for("pictures", lambda report: sees(report) and taken(report) >= cameras.PICTURES, WAIT_S)
        user, held = helper_of(flying)
        assert user == "pointclick"
        assert any(path.startswith("/dev/media") for path in held), held
        assert any(path.startswith("/dev/v4l-subdev") for path in held), held
        cameras.plug_vimc(flying.machine, is_in=False)
        flying.wait_for("camera lost", is_absent, WAIT_S)
        times = cameras.plug_in_until_new(partial(counted, flying), partial(cameras.plug_vimc, flying.machine))
        record_property("plugged in", times)
        flying.wait_for("a camera that sees", sees, WAIT_S)
        assert flying.unit("MainPID") == pid
