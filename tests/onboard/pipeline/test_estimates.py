"""What a flight found is named with units, and only what is news is said."""

import numpy as np
import pytest

from onboard.config.schema import parse_config
from onboard.estimation.boresight import PlatformEstimate, Unconfirmed
from onboard.estimation.platform_states import OFFSET, STATES
from onboard.estimation.reobservation import RelativeVariance
from onboard.estimation.sensor_groups import Failing
from onboard.estimation.sensor_table import PARTS
from onboard.estimation.variance_components import Evidence, VarianceFactors
from onboard.pipeline.estimates import (
    as_rows,
    contradictions_of,
    estimates_of,
    in_words,
    larger_than_declared,
    not_adopted,
    relative_variance_of,
    sensor_errors,
    unconfirmed_of,
)
from onboard.pipeline.summary import Contradiction

CONFIG = parse_config("")
PLATFORM = PlatformEstimate(
    1,
    np.array([*np.radians([0.5, -1.0, 2.0]), 0.12, -0.03, 0.04, *np.radians([4.0, -1.0])]),
    np.diag(np.square([*np.radians([0.1, 0.2, 0.3]), 0.01, 0.02, 0.05, *np.radians([0.5, 0.6])])),
)
FOUND = VarianceFactors().with_evidence(Evidence({"heading": 4000.0, "tilt": 5.0}, {"heading": 1e3, "tilt": 10.0}), 1)


def test_every_state_is_reported_once_with_its_unit_and_sigma() -> None:
    found = {e.name: e for e in estimates_of(PLATFORM)}
    assert {name: e.unit for name, e in found.items()} == {
        "boresight": "radians", "camera_time_offset": "seconds", "position_delay": "seconds",
        "velocity_delay": "seconds", "heading_error_by_heading": "radians",
    }  # fmt: skip
    assert [v for e in found.values() for v in e.values] == pytest.approx(PLATFORM.mean)
    assert [s for e in found.values() for s in e.sigmas] == pytest.approx(PLATFORM.sigma)
    assert sum(len(e.values) for e in found.values()) == STATES
    assert estimates_of(None) == ()


def test_sensor_errors_are_the_configured_ones_times_what_was_found() -> None:
    errors = {e.name: e for e in sensor_errors(CONFIG, FOUND)}
    assert tuple(errors) == tuple(PARTS)
    assert errors["heading"].declared == CONFIG.solve.heading_sigma_deg
    assert errors["heading"].sigma == pytest.approx(2.0 * CONFIG.solve.heading_sigma_deg, rel=0.01)
    assert errors["tilt"].declared == CONFIG.solve.attitude_sigma_deg
    assert errors["tilt"].sigma == pytest.approx(np.sqrt(15.0 / 20.0) * CONFIG.solve.attitude_sigma_deg)
    assert errors["velocity"].sigma == errors["velocity"].declared == CONFIG.gps.sigma_velocity_correlated_m_s
    assert errors["velocity"].declared == CONFIG.gps.sigma_velocity_correlated_m_s
    assert errors["velocity_white"].declared == CONFIG.gps.sigma_velocity_m_s
    assert errors["position"].declared == CONFIG.gps.sigma_correlated_horizontal_m


def test_the_summary_has_a_row_for_each_and_names_a_sensor_only_where_it_is_worse() -> None:
    rows = dict(as_rows(estimates_of(PLATFORM), sensor_errors(CONFIG, FOUND)))
    assert rows == {
        "boresight": "x +0.50 +-0.10, y -1.00 +-0.20, z +2.00 +-0.30 deg, camera axes",
        "time offset": "+0.120 +-0.010 s, camera to autopilot",
        "position delay": "-0.030 +-0.020 s off gps.latency_s",
        "velocity delay": "+0.040 +-0.050 s off gps.latency_s",
        "heading error": "+4.00 +-0.50 deg times cos heading, -1.00 +-0.60 deg times sin heading",
        "sensor errors": "heading 4 deg, declared 2",
    }
    assert as_rows((), sensor_errors(CONFIG, VarianceFactors())) == []
    assert larger_than_declared(sensor_errors(CONFIG, VarianceFactors())) == ""


def test_what_is_not_confirmed_is_reported_with_its_sigma_and_apart_from_what_is_used() -> None:
    mean, sigma = np.zeros(STATES), np.full(STATES, 0.1)
    mean[OFFSET], sigma[OFFSET] = 0.81, 0.12
    outside = np.arange(STATES) == OFFSET
    found = unconfirmed_of(Unconfirmed(PlatformEstimate(1, mean, np.diag(np.square(sigma))), outside))
    assert [(e.name, e.values, e.sigmas) for e in found] == [
        ("camera_time_offset", (pytest.approx(0.81),), (pytest.approx(0.12),))
    ]
    assert not_adopted(found) == "time offset +0.810 +-0.120 s, camera to autopilot"
    rows = as_rows((), sensor_errors(CONFIG, VarianceFactors()), found)
    assert rows == [("not confirmed", "time offset +0.810 +-0.120 s, camera to autopilot")]
    assert unconfirmed_of(None) == ()


def test_a_sensor_that_contradicts_the_others_is_reported_while_it_does_and_remembered_after() -> None:
    second_ns = 1_000_000_000
    failing = (
        Failing().after(0, 10 * second_ns, {"heading": 100.0}).after(5 * second_ns, 22 * second_ns, {"heading": 400.0})
    )
    (now,) = contradictions_of(failing, 22 * second_ns)
    assert now == Contradiction("heading", 20.0, 12.0, 2)
    assert in_words([now]) == "heading contradicts the other sensors for 12 s and counts with 20 times its sigma"
    assert dict(as_rows((), (), (), [now])) == {"contradictions": str(now)}
    (later,) = contradictions_of(failing, 600 * second_ns)
    assert later.sigma_times == pytest.approx(1.0) and in_words([later]) == ""
    assert str(later) == "heading contradicted the other sensors in 2 windows"
    assert contradictions_of(Failing(), 0) == ()


def test_relative_errors_are_reported_once_points_were_seen_again() -> None:
    assert relative_variance_of(RelativeVariance()) == ()
    (estimate,) = relative_variance_of(RelativeVariance(1, found=50.0, expected=14.0))
    assert estimate.name == "relative_variance_factor" and estimate.unit == "ratio"
    assert estimate.values[0] == pytest.approx(71.0 / 35.0)
    ((name, text),) = as_rows((estimate,), ())
    assert name == "relative errors" and text.startswith("variance 2.03 +-")
