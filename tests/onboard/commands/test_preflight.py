"""The doctor's lines, each turned red by its own fault and by no other's."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from contract.camera import Camera
from onboard.commands.preflight import Surroundings, diagnose
from onboard.config.schema import Config

CONFIG = Config.model_validate({"telemetry": {"url": "serial:/dev/ttyAMA0:921600"}, "camera": {"exposure_us": 2000.0}})
CAMERA = Camera.from_field_of_view(640, 480, 40.0)
WELL: dict[str, Any] = {
    "camera": {"state": "ok", "detail": "/dev/video0: 640x480 GREY", "figures": {"rate_hz": 29.8, "lost": 0.0}},
    "telemetry": {
        "state": "ok",
        "detail": "",
        "figures": {"attitude_hz": 49.0, "position_hz": 10.0, "round_trip_ms": 2.5, "clock_sigma_ms": 0.9},
    },
    "picture": {"mean": 120.0, "black": 0.01, "white": 0.02},
    "gps": {"fix_type": 3, "satellites": 14, "sigma_horizontal_m": 0.8, "age_s": 0.2},
    "learned": None,
}
AROUND = Surroundings(CAMERA, "", 20000.0, 61.0)


def verdicts(report: dict[str, Any], around: Surroundings = AROUND, config: Config = CONFIG) -> dict[str, bool]:
    return {line.name: line.is_good for line in diagnose(config, report, around)}


def text(report: dict[str, Any], name: str) -> str:
    return next(line.text for line in diagnose(CONFIG, report, AROUND) if line.name == name)


def test_before_a_good_flight_all_is_green() -> None:
    assert verdicts(WELL) == dict.fromkeys(
        ["camera", "rate", "exposure", "telemetry", "rates", "time sync", "gps", "mount", "calibration", "link", "disk",
         "processor"], True,
    )  # fmt: skip
    assert text(WELL, "exposure") == "fixed at 2000 us, mean grey 120 of 255"
    assert text(WELL, "time sync") == "+-0.9 ms, round trip 2.5 ms"
    assert text(WELL, "calibration") == "640 x 480, 40 deg wide"


def put(*path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def spoil(report: dict[str, Any]) -> None:
        for key in path[:-1]:
            report = report[key]
        if value is ...:
            del report[path[-1]]
        else:
            report[path[-1]] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "red"),
    [
        (put("camera", "state", value="degraded"), "camera"),
        (put("camera", "state", value="frozen"), "camera"),
        (put("camera", "figures", "rate_hz", value=20.0), "rate"),
        (put("camera", "figures", "rate_hz", value=...), "rate"),
        (put("picture", value=None), "exposure"),
        (put("picture", "mean", value=12.0), "exposure"),
        (put("picture", "white", value=0.5), "exposure"),
        (put("picture", "black", value=0.5), "exposure"),
        (put("telemetry", "state", value="lost"), "telemetry"),
        (put("telemetry", "figures", "position_hz", value=1.0), "rates"),
        (put("telemetry", "figures", "position_hz", value=...), "rates"),
        (put("telemetry", "figures", "attitude_hz", value=4.0), "rates"),
        (put("telemetry", "figures", "clock_sigma_ms", value=...), "time sync"),
        (put("telemetry", "figures", "clock_sigma_ms", value=float("nan")), "time sync"),
        (put("telemetry", "figures", "clock_sigma_ms", value=50.0), "time sync"),
        (put("telemetry", "figures", "round_trip_ms", value=300.0), "time sync"),
        (put("gps", value=None), "gps"),
        (put("gps", "fix_type", value=2), "gps"),
        (put("gps", "age_s", value=9.0), "gps"),
        (put("gps", "sigma_horizontal_m", value=12.0), "gps"),
        (
            put("learned", value={"boresight_rad": [0.2, 0.0, 0.0], "sigma_boresight_rad": [0.002] * 3}),
            "mount",
        ),
    ],
)
def test_each_fault_turns_its_own_line_red(spoil: Callable[[dict[str, Any]], None], red: str) -> None:
    report = copy.deepcopy(WELL)
    spoil(report)
    assert [name for name, is_good in verdicts(report).items() if not is_good] == [red]


@pytest.mark.parametrize(
    ("around", "red"),
    [
        (Surroundings("camera.file is not set", "", 20000.0, 61.0), "calibration"),
        (Surroundings(CAMERA, "the port is already in use", 20000.0, 61.0), "link"),
        (Surroundings(CAMERA, "", 900.0, 61.0), "disk"),
        (Surroundings(CAMERA, "", None, 61.0), "disk"),
        (Surroundings(CAMERA, "", 20000.0, 85.0), "processor"),
    ],
)
def test_what_surrounds_it_counts_too(around: Surroundings, red: str) -> None:
    assert [name for name, is_good in verdicts(WELL, around).items() if not is_good] == [red]


def test_what_is_not_needed_is_not_missed() -> None:
    report = copy.deepcopy(WELL)
    report["telemetry"]["figures"] = {"position_hz": 10.0}
    report["gps"]["sigma_horizontal_m"] = report["gps"]["satellites"] = None
    config = Config.model_validate({"telemetry": {"url": "nmea:/dev/ttyUSB0:9600"}, "recording": {"enabled": False}})
    assert all(verdicts(report, Surroundings(CAMERA, "", None, None), config).values())


def test_a_boresight_within_its_prior_is_well() -> None:
    report = copy.deepcopy(WELL)
    report["learned"] = {"boresight_rad": [0.01, 0.01, 0.0], "sigma_boresight_rad": [0.002] * 3}
    assert verdicts(report)["mount"]
    assert "learned in flight: 0.8 +-0.1 deg" in text(report, "mount")
