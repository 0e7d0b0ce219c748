"""An aircraft that flies: guest, radio, autopilot on its serial line, and our service, installed and running."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight as Recorded
from tests.bench import aircraft, cameras
from tests.bench.flight import MOUNT_DEG
from tests.bench.image.root import CHECKOUT
from tests.bench.machine import Machine, boot
from tests.bench.network import Link, link

VEHICLE = "bench"
PORT = 7447
TELEMETRY = CHECKOUT / "tests" / "data" / "plane_turn.tlog"
START_S = 90.0
"""Bound on the start; systemd itself ends it after 60 s."""

CONFIG = """
[vehicle]
id = "{vehicle}"

[mount]
roll_deg = {mount[0]}
pitch_deg = {mount[1]}
yaw_deg = {mount[2]}

[camera]
device = "{device}"
file = "/etc/pointclick/camera.json"
format = "{fourcc}"
rate_hz = {rate_hz}

[telemetry]
url = "serial:/dev/ttyS0:115200"

[link]
listen = ["tcp/0.0.0.0:{port}"]

[recording]
keep_free_mb = 50.0
"""


@dataclass(frozen=True)
class Sortie:
    """What a test flies with. Times are wall time in seconds."""

    machine: Machine
    radio: Link
    autopilot: FakeAutopilot

    @property
    def endpoint(self) -> str:
        """What the ground connects to."""
        return f"tcp/{self.radio.guest}:{PORT}"

    def report(self) -> dict[str, Any]:
        """What `pc-onboard status` reads on board; empty while no daemon answers it."""
        done = self.machine.run(aircraft.PROGRAM, "status", "--json", timeout_s=60.0)
        return dict(json.loads(done.text)) if done.code == 0 else {}

    def unit(self, *properties: str) -> dict[str, str]:
        """Properties of our unit, as systemd has them."""
        reported = self.machine.shell(f"systemctl show {aircraft.UNIT} -p {','.join(properties)}")
        return dict(line.split("=", 1) for line in reported.splitlines())

    def wait_for(
        self, what: str, holds: Callable[[dict[str, Any]], bool], within_s: float
    ) -> tuple[dict[str, Any], float]:
        """The first report for which something holds, and how long that took; fails if none does in time."""
        began_s = time.monotonic()
        seen: list[str] = []
        while time.monotonic() - began_s < within_s:
            report = self.report()
            if report and holds(report):
                return report, time.monotonic() - began_s
            word = f"{report['status']['state']}: {report['status']['reason']}" if report else "no answer"
            if not seen or seen[-1] != word:
                seen.append(word)
            time.sleep(0.1)
        raise AssertionError(f"not {what} within {within_s} s; seen: {seen}; newest: {json.dumps(report, indent=1)}")


@contextlib.contextmanager
def sortie(
    camera_file: Path,
    *,
    device: str,
    fourcc: str = "GREY",
    rate_hz: float = 30.0,
    telemetry: Path = TELEMETRY,
    loop: bool = True,
) -> Iterator[Sortie]:
    """Boot, install, configure, start; the autopilot is silent until the test enters it.

    A failure inside the block carries the guest's journal in its notes.
    """
    autopilot = FakeAutopilot(Recorded.read(telemetry), "pty", loop=loop)
    line = Path(autopilot.url.split(":")[1])
    with link() as radio, boot(serial=line, interface=radio.interface) as machine:
        simulated = Sortie(machine, radio, autopilot)
        try:
            radio.up(machine)
            cameras.load(machine)
            aircraft.install(machine)
            words = {"vehicle": VEHICLE, "mount": MOUNT_DEG, "device": device, "fourcc": fourcc.strip()}
            config = CONFIG.format(**words, rate_hz=rate_hz, port=PORT)
            aircraft.configure(machine, config, camera_file.read_text())
            machine.run("systemctl", "start", aircraft.UNIT, timeout_s=START_S).ok()
            yield simulated
        except BaseException as error:
            error.add_note(f"the guest's journal:\n{machine.journal()}")
            raise
