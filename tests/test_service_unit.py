"""The unit as systemd reads it: nothing unknown in it, nothing open that need not be."""

import configparser
import re
import subprocess
from pathlib import Path

import pytest

from onboard.service.daemon import FINISH_S, TICK_S
from onboard.service.vehicle_state import STUCK_S

SYSTEMD = Path(__file__).parents[1] / "systemd"
UNIT = SYSTEMD / "pointclick-onboard.service"


def settings(section: str) -> dict[str, str]:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read_string(UNIT.read_text())
    return dict(parser[section])


@pytest.fixture
def verifiable(tmp_path: Path) -> Path:
    """The unit with a program that exists here: verify insists on one."""
    unit = tmp_path / UNIT.name
    unit.write_text(re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text(), flags=re.MULTILINE))
    return unit


def test_systemd_finds_nothing_to_complain_of(systemd_analyze: str, verifiable: Path) -> None:
    done = subprocess.run(
        [systemd_analyze, "verify", "--man=no", verifiable], capture_output=True, text=True, check=False
    )
    ours = [line for line in done.stderr.splitlines() if "pointclick" in line]
    assert (done.returncode, ours) == (0, [])


def test_verify_would_complain_of_a_slip_of_the_pen(systemd_analyze: str, verifiable: Path) -> None:
    verifiable.write_text(verifiable.read_text().replace("NoNewPrivileges", "NoNewPriviliges"))
    done = subprocess.run(
        [systemd_analyze, "verify", "--man=no", verifiable], capture_output=True, text=True, check=False
    )
    assert "NoNewPriviliges" in done.stderr


def test_the_exposure_is_at_most_two(systemd_analyze: str) -> None:
    command = [systemd_analyze, "security", "--offline=yes", "--no-pager", "--threshold=20", UNIT]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    found = re.search(r"exposure level for \S+: ([0-9.]+)", done.stdout)
    assert found is not None
    assert 0.5 < float(found[1]) <= 2.0


def test_the_unit_and_the_daemon_agree_on_times() -> None:
    service = settings("Service")
    watchdog_s = float(service["WatchdogSec"])
    assert watchdog_s >= 8 * TICK_S
    assert STUCK_S < watchdog_s < 30.0
    assert float(service["TimeoutStopSec"]) > FINISH_S + 5.0
    assert service["Type"] == "notify"
    assert service["Restart"] == "always"
    assert service["ExecReload"].endswith("-HUP $MAINPID")
    assert settings("Unit")["StartLimitIntervalSec"] == "0"


def test_the_daemon_has_what_it_needs_and_no_privilege() -> None:
    service = settings("Service")
    assert set(service["SupplementaryGroups"].split()) == {"video", "dialout", "render"}
    assert service["User"] == "pointclick"
    assert "AF_NETLINK" in service["RestrictAddressFamilies"]
    assert "@resources" not in UNIT.read_text().split("SystemCallFilter=", 1)[1]
    assert service["CapabilityBoundingSet"] == ""
    assert service["StateDirectory"] == service["ConfigurationDirectory"] == service["CacheDirectory"] == "pointclick"


def test_the_rules_are_lines_udev_understands() -> None:
    lines = [line for line in (SYSTEMD / "70-pointclick.rules").read_text().splitlines() if line and line[0] != "#"]
    assert len(lines) == 3
    part = re.compile(r'^[A-Z]+(\{[A-Za-z_]+\})?(==|\+=|=)"[^"]*"$')
    for line in lines:
        assert all(part.match(text) for text in line.split(", ")), line
        assert 'SYMLINK+="flight-controller"' in line
