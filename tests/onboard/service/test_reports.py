"""The daemon's report: there and back as JSON, whatever it holds."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from contract.errors import LinkError
from onboard.events.source import SourceStatus, State
from onboard.events.types import GpsQuality
from onboard.pipeline.estimates import BORESIGHT
from onboard.pipeline.summary import Estimate, LeftOut, SensorError
from onboard.service.reports import Brightness, PictureCounts, Report, gps_report
from onboard.service.vehicle_state import Inputs
from tests.onboard.service.reported import WELL, inputs, report_of, unhurried


@unhurried
@given(inputs())
def test_a_report_is_the_same_there_and_back(messages: Inputs) -> None:
    report = replace(
        report_of(messages),
        pictures=PictureCounts(300, 40, 280, {"no_gps": 12, "starting": 8}, 0.25, 1, LeftOut(0.0, 0.1)),
        estimates=(Estimate(BORESIGHT, "radians", (0.01, -0.02, 0.0), (0.001,) * 3),),
        sensor_errors=(SensorError("heading", "deg", 3.8, 2.0),),
        unconfirmed=(Estimate(BORESIGHT, "radians", (0.2, 0.0, 0.0), (0.01,) * 3),),
    )
    again = Report.from_json(report.to_json())
    assert again == report


def test_numbers_that_are_none_survive_and_the_text_is_json_for_all() -> None:
    report = replace(report_of(WELL), telemetry=SourceStatus(State.OK, "", {"clock_sigma_ms": math.nan, "a": math.inf}))
    strict = json.loads(report.to_json(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert strict["telemetry"]["figures"] == {"clock_sigma_ms": "NaN", "a": "Infinity"}
    figures = Report.from_json(report.to_json()).telemetry.figures
    assert math.isnan(figures["clock_sigma_ms"])
    assert figures["a"] == math.inf


def test_a_later_version_may_say_more_and_an_earlier_one_less() -> None:
    content = json.loads(report_of(WELL).to_json())
    later = content | {"news": 1, "camera": content["camera"] | {"colour": "red"}}
    assert Report.from_json(json.dumps(later).encode()) == report_of(WELL)
    earlier = {name: content[name] for name in ("status", "camera", "telemetry")}
    assert Report.from_json(json.dumps(earlier).encode()).pictures == PictureCounts()


@pytest.mark.parametrize("payload", [b"{half", b"[]", b'{"status": 5}', b"", b"\xff", b'{"status": {"unix_s": 1}}'])
def test_what_is_no_report_is_one_line(payload: bytes) -> None:
    with pytest.raises(LinkError, match="the daemon's report cannot be read") as caught:
        Report.from_json(payload)
    assert "\n" not in str(caught.value)


def test_brightness_is_of_the_picture() -> None:
    image = np.full((480, 640), 100, np.uint8)
    assert Brightness.of(image) == Brightness(100.0, 0.0, 0.0)
    image[:, :160], image[:, 480:] = 0, 255
    assert Brightness.of(image) == Brightness(0.5 * 100.0 + 0.25 * 255.0, 0.25, 0.25)


def test_the_receivers_word_ages() -> None:
    assert gps_report(None, 5_000_000_000) is None
    report = gps_report(GpsQuality(1_000_000_000, 3, 14, 0.8), 5_000_000_000)
    assert (report.age_s, str(report)) == (4.0, "3D fix, 14 satellites, +-0.8 m, 4 s old")
