"""`pc-ground click` through the autopilot's radio: a daemon, a router by the autopilot's rules, and the ground.

With the aircraft's end in the test's process: tests/ground/test_mavlink_link.py.
"""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from contract.geodesy import LocalFrame
from contract.wire.click_code import TUNNEL_TYPE
from ground.recording import Recording
from tests.onboard.link.mavlink_router import Line, Router, Udp
from tests.onboard.link.ports import free_udp_port
from tests.onboard.service.air import STRAIGHT
from tests.onboard.service.process import ROOT, aircraft
from tests.onboard.telemetry.standard_client import StandardClient, standard
from tests.scenarios.flights import CAMERA
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.xdist_group("processes in real time")


# A click that is measured later has more pictures to be found in: two answers would differ by more than their rounding.
UNMEASURED = "\n[tracks]\nenabled = false\n"


def pc_ground(*arguments: object, lines: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ground", *map(str, arguments)]
    return subprocess.run(
        command, cwd=ROOT, input=lines, capture_output=True, text=True, check=False, timeout=2.0 * PATIENCE_S
    )


def started(*arguments: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "ground", *map(str, arguments)], cwd=ROOT)


@pytest.mark.long
def test_a_click_is_answered_through_the_autopilot_as_over_the_link(tmp_path: Path) -> None:
    onboard, ground, other = (free_udp_port() for _ in range(3))
    radio, uv = f"mavlink:udpin:127.0.0.1:{ground}", (CAMERA.width_px // 2, CAMERA.height_px // 2)
    with aircraft(tmp_path, STRAIGHT) as plane:
        text = plane.config.read_text().replace(f'"{plane.autopilot.url}"', f'"udpin:127.0.0.1:{onboard}"')
        plane.config.write_text(text.replace("[link]", "[link]\nmavlink = true") + UNMEASURED)
        with Router(Line(plane.autopilot.url), Udp(onboard), Udp(ground), Udp(other)) as router:
            plane.start()
            plane.wait_for("ok")
            command = ["record", "--out", tmp_path / "kept", "--seconds", 12, "--connect"]
            listener = started(*command, f"mavlink:udpin:127.0.0.1:{other}?system=246")
            newest = pc_ground("click", *uv, "--connect", radio, "--format", "json")
            answer = json.loads(newest.stdout)
            frame = answer["frame"]
            clicks = f"{frame} {uv[0]} {uv[1]}\n999999 1 1\n{frame} 9999 1\n"
            lines = pc_ground("click", "--connect", radio, "--format", "json", lines=clicks)
            expected = json.loads(
                pc_ground("click", *uv, "--frame", frame, "--connect", plane.endpoint, "--format", "json").stdout
            )
            masked = pc_ground("click", *uv, "--connect", f"{radio}?system=255&ground_stations=250")
            assert listener.wait(PATIENCE_S) == 0
            passed = list(router.passed)
            plane.signal(signal.SIGTERM)
            assert plane.ended() == 0
    assert newest.returncode == 0 and 0.0 < answer["age_s"] < 3.0
    again, unknown, outside = (json.loads(line) for line in lines.stdout.splitlines())
    for key in ("lat_deg", "lon_deg"):
        assert abs(again[key] - expected[key]) < 2e-9
    assert abs(again["height_amsl_m"] - expected["height_amsl_m"]) <= 0.002
    for axis in ("semi_major_m", "semi_minor_m"):
        assert abs(again["ellipse"][axis] / expected["ellipse"][axis] - 1.0) < 0.002
    assert [again[key] for key in ("frame", "vehicle", "method")] == [frame, "uav", expected["method"]]
    assert (unknown["status"], unknown["frame"], outside["status"]) == ("unknown_frame", 999999, "outside")
    assert masked.returncode == 2 and "MAV_GCS_SYSID 255 to 255" in masked.stderr  # said by the aircraft itself
    tunnels = [(message, to) for message, _, to in passed if message.get_type() == "TUNNEL"]
    assert len(tunnels) >= 10
    for message, to in tunnels:  # each to one link, short, and of our kind
        assert message.payload_type == TUNNEL_TYPE and to in ([1], [2], [3])
        assert message.payload_length <= {1: 24, 2: 60, 3: 101}[to[0]]
    kept, own = Recording(tmp_path / "kept"), Recording(plane.recordings[0])
    frames = kept.frames("uav")
    assert 4 <= len(frames) <= 12  # in 12 s of 4.8 kbit/s
    for frame in frames:
        one, other_set = kept.by_frame("uav", frame), own.by_frame("uav", frame)
        assert one.revision <= other_set.revision and one.capture_unix_ns == other_set.capture_unix_ns


@pytest.mark.long
def test_a_ground_station_s_click_in_the_video_is_answered_through_the_autopilot(tmp_path: Path) -> None:
    """Its short ones: tests/onboard/telemetry/test_mavlink_camera.py, tests/onboard/service/test_camera_clicks.py."""
    onboard, ground = free_udp_port(), free_udp_port()
    stated = "\n[mavlink_camera]\nenabled = true\ndelay_s = 0.6\nsigma_delay_s = 0.2\n"
    with aircraft(tmp_path, STRAIGHT) as plane:
        text = plane.config.read_text().replace(f'"{plane.autopilot.url}"', f'"udpin:127.0.0.1:{onboard}"')
        plane.config.write_text(text + stated)
        client = StandardClient(ground, plane.autopilot.system, listens=True)
        with Router(Line(plane.autopilot.url), Udp(onboard), Udp(ground)) as router:
            plane.start()
            plane.wait_for("ok")
            assert client.wait("HEARTBEAT").type == standard.MAV_TYPE_CAMERA
            information = client.wait(
                "CAMERA_INFORMATION", client.request(standard.MAVLINK_MSG_ID_CAMERA_INFORMATION)[1]
            )
            clicked_s = time.time()
            answer, since = client.command(standard.MAV_CMD_CAMERA_TRACK_POINT, 0.5, 0.5, 0.02)
            geo = client.wait("CAMERA_TRACKING_GEO_STATUS", since)
            client.command(
                standard.MAV_CMD_SET_MESSAGE_INTERVAL, standard.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS, 5e5
            )
            image = client.wait("CAMERA_TRACKING_IMAGE_STATUS", since)
            u, v = 0.5 * (CAMERA.width_px - 1), 0.5 * (CAMERA.height_px - 1)
            when = "--time", f"{clicked_s - 0.6:.3f}"
            shown = pc_ground("click", u, v, *when, "--connect", plane.endpoint, "--format", "json")
            passed = list(router.passed)
            plane.signal(signal.SIGTERM)
            assert plane.ended() == 0
        client.close()
    assert (information.resolution_h, answer.result, image.tracking_status) == (CAMERA.width_px, 0, 1)
    expected = json.loads(shown.stdout)
    frame = LocalFrame(expected["lat_deg"], expected["lon_deg"], expected["height_amsl_m"])
    east_m, north_m, up_m = frame.to_enu(geo.lat * 1e-7, geo.lon * 1e-7, geo.alt)
    assert (east_m**2 + north_m**2) ** 0.5 < geo.h_acc and abs(up_m) < geo.v_acc
    assert expected["ellipse"]["semi_major_m"] < geo.h_acc < 60.0
    for message, came, to in passed:  # of ours nothing commands the autopilot, and acknowledgements go to who asked
        if came == 1 and message.get_srcComponent() == 100:
            assert not hasattr(message, "target_system") or (message.get_type(), to) == ("COMMAND_ACK", [2])
