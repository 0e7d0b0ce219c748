"""Our service under a real systemd, on a camera of the kernel's: faults of both, and the cage it lives in."""

import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from contract.camera import Camera
from tests.bench import cameras
from tests.bench.aircraft import UNIT
from tests.bench.cameras import VIVID
from tests.bench.sortie import Sortie, sortie

RATE_HZ = 15.0
THERE = ("ok", "degraded")
MOST_EXPOSED = 2.0
Record = Callable[[str, object], None]


def sees(report: dict[str, Any]) -> bool:
    """Pictures and telemetry flow. That no answers do is right: colour bars do not fit the flight."""
    sources = (report["camera"]["state"], report["telemetry"]["state"])
    return all(state in THERE for state in sources) and report["status"]["camera_hz"] > 0.5 * RATE_HZ


def is_lost(report: dict[str, Any]) -> bool:
    """The camera is said to be away."""
    return bool(report["status"]["state"] == "camera lost" and report["camera"]["state"] == "lost")


@pytest.fixture(scope="module")
def flying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sortie]:
    """In the air over colour bars; the autopilot flies its minute again and again."""
    camera_file = tmp_path_factory.mktemp("camera") / "camera.json"
    camera_file.write_text(Camera.from_field_of_view(640, 480, 40.0).to_json())
    with sortie(camera_file, device=VIVID, rate_hz=RATE_HZ) as begun, begun.autopilot:
        begun.wait_for("pictures and telemetry", sees, 20.0)
        yield begun


@pytest.fixture(autouse=True)
def in_good_order(flying: Sortie) -> None:
    """Every test begins so, whatever the one before it did."""
    flying.wait_for("in good order before the test", sees, 20.0)


def test_dropped_buffers_are_counted_and_nothing_else_happens(flying: Sortie) -> None:
    pid = flying.unit("MainPID")
    cameras.set_control(flying.machine, VIVID, "percentage_of_dropped_buffers", 30)
    before = flying.report()  # its command takes some seconds on a slow machine, of which none are lost

    def shows_it(now: dict[str, Any]) -> bool:
        return sum(_taken(before, now)) >= 60 and 0.5 * RATE_HZ < now["status"]["camera_hz"] < 0.9 * RATE_HZ

    report, _ = flying.wait_for("sixty pictures, some of them lost", shows_it, 20.0)
    cameras.set_control(flying.machine, VIVID, "percentage_of_dropped_buffers", 0)
    seen, lost = _taken(before, report)
    assert 0.15 < lost / (seen + lost) < 0.45, (before, report)
    assert report["camera"]["state"] in THERE
    assert flying.unit("MainPID") == pid


def _taken(before: dict[str, Any], now: dict[str, Any]) -> tuple[int, int]:
    """The numbers of pictures that came between two reports, and that the driver dropped."""
    seen = now["camera"]["figures"]["pictures"] - before["camera"]["figures"]["pictures"]
    return round(seen), now["status"]["lost"] - before["status"]["lost"]


def test_an_input_output_error_of_the_driver_costs_a_moment(flying: Sortie) -> None:
    pid = flying.unit("MainPID")
    cameras.set_control(flying.machine, VIVID, "inject_fatal_streaming_error", 1)
    time.sleep(1.0)
    flying.wait_for("pictures again", sees, 6.0)
    assert "input/output error" in flying.machine.journal()
    assert flying.unit("MainPID") == pid


def test_an_unplugged_camera_is_reported_and_taken_up_again_under_another_name(
    flying: Sortie, record_property: Record
) -> None:
    pid = flying.unit("MainPID")
    cameras.unplug_vivid(flying.machine, 0)
    lost, _ = flying.wait_for("camera lost", is_lost, 10.0)
    after_s = _noticed_after_s(flying.machine.journal())
    record_property("camera lost after", f"{after_s:.1f} s")
    assert -1.0 < after_s < 2.0
    assert re.search("unplugged|not there|not among", lost["status"]["reason"])
    time.sleep(2.0)
    assert is_lost(flying.report())
    cameras.load_vivid(flying.machine, 5)
    flying.wait_for("pictures from /dev/video5", sees, 6.0)
    assert flying.machine.run("test", "-e", VIVID).code == 1
    # And back, for the tests that follow: a new process looks where the configuration says.
    cameras.unplug_vivid(flying.machine, 5)
    cameras.load_vivid(flying.machine, 0)
    flying.wait_for("pictures from /dev/video0", sees, 6.0)
    assert flying.unit("MainPID") == pid


def _noticed_after_s(journal: str) -> float:
    """From the kernel's line of the camera that is gone to the service's, by the guest's own clock.

    Negative where the service was faster: the driver tells those who read before it writes its line.
    """
    lines = journal.splitlines()
    gone = [line for line in lines if "unregistering video" in line][-1]
    reported = [line for line in lines if re.search("state: camera lost: .*(unplugged|not there|not among)", line)][-1]
    begun_s, reported_s = (float(line[1:].split("]", 1)[0]) for line in (gone, reported))
    return reported_s - begun_s


def test_a_killed_process_is_back_within_seconds(flying: Sortie, record_property: Record) -> None:
    before = flying.unit("MainPID", "NRestarts")
    flying.machine.shell(f"kill -9 {before['MainPID']}")
    # The guest takes 6 to 9 s of them to start a daemon, and its host is not always as quick.
    took_s = _wait_restarted(flying, before, 15.0)
    _, sees_s = flying.wait_for("pictures again", sees, 30.0)
    record_property("running, seeing after", f"{took_s:.1f}, {took_s + sees_s:.1f} s")


def test_a_hung_process_is_ended_by_the_watchdog_and_started_again(flying: Sortie, record_property: Record) -> None:
    before = flying.unit("MainPID", "NRestarts", "WatchdogUSec")
    watchdog_s = _seconds(before["WatchdogUSec"])
    assert 2.0 <= watchdog_s <= 30.0
    # User Mode Linux does not wake a serial line again that its reader had let run full: nothing is sent meanwhile.
    flying.autopilot.mute(watchdog_s + 10.0)
    flying.machine.shell(f"kill -STOP {before['MainPID']}")
    took_s = _wait_restarted(flying, before, watchdog_s + 15.0)
    record_property("running after", f"{took_s:.1f} s of a watchdog of {watchdog_s:g} s")
    assert took_s > 0.3 * watchdog_s  # it was the watchdog, and nothing sooner
    assert re.search(r"[Ww]atchdog timeout", flying.machine.journal(400))
    flying.wait_for("pictures again", sees, 30.0)


def test_the_process_lives_in_a_narrow_cage(flying: Sortie, record_property: Record) -> None:
    reported = flying.machine.run("systemd-analyze", "security", "--no-pager", UNIT).text
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", reported)
    record_property("exposure", found[1] if found else reported)
    assert found is not None and 0.1 < float(found[1]) <= MOST_EXPOSED, reported
    pid = flying.unit("MainPID")["MainPID"]
    process = dict(line.split(":\t", 1) for line in flying.machine.shell(f"cat /proc/{pid}/status").splitlines())
    assert "0" not in process["Uid"].split()
    assert int(process["CapEff"], 16) == int(process["CapBnd"], 16) == 0
    assert (process["NoNewPrivs"], process["Seccomp"]) == ("1", "2")


def _wait_restarted(flying: Sortie, before: dict[str, str], within_s: float) -> float:
    began_s = time.monotonic()
    while True:
        now = flying.unit("MainPID", "NRestarts", "ActiveState")
        if now["ActiveState"] == "active" and now["MainPID"] not in ("0", before["MainPID"]):
            break
        assert time.monotonic() - began_s < within_s, f"{now}\n{flying.machine.journal(80)}"
        time.sleep(0.1)
    assert int(now["NRestarts"]) == int(before["NRestarts"]) + 1
    return time.monotonic() - began_s


def _seconds(span: str) -> float:
    """systemd's words for a span: "5s", "1min 30s", "500ms"."""
    units = {"min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6}
    return sum(float(number) * units[unit] for number, unit in re.findall(r"([\d.]+)(min|ms|us|s)", span))
