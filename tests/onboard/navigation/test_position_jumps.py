"""Recorded positions that are shaken, jump, return or are dragged away: their sigma has to be right meanwhile.

Faults are put into the positions of `plane_rough`, whose filter is shaken in rough air, and of `plane_clean`. Errors
are horizontal and counted in radii of their own 90 % circle.
"""

import functools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.autopilots import ground_amsl_m, recording
from benchmarks.sensor_faults import DRAG, POSITION, Disturbance, disturbed
from contract.geodesy import LocalFrame
from onboard.config.schema import parse_config
from onboard.events.types import FilterStatus, GpsQuality, NavEvent, PositionFix
from onboard.navigation.navigator import Navigation, NavState

Array = NDArray[np.float64]

CONFIG = parse_config('[solve]\nattitude = "none"')
CIRCLE_90 = 2.146
BEGIN_S, END_S = 20.0, 120.0
FAULT_S = 60.0
FOR_GOOD = 1e3


@functools.lru_cache(maxsize=2)
def reports(path: str) -> list[NavEvent]:
    log, _ = recording(path)
    return [event for event in log.events if isinstance(event, PositionFix | GpsQuality | FilterStatus)]


def accepted(
    path: Path, faults: tuple[Disturbance, ...], begin_s: float = BEGIN_S, *, of_filter: bool = False
) -> tuple[Array, Array]:
    """Sigma, m, and error in radii, of each second's position that is accepted; faults of the filter alone or both."""
    _, truth = recording(str(path))
    first_s = float(truth.unix_time_s[0])
    place = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), ground_amsl_m(path.name))
    trajectory = truth.trajectory(place, first_s, 0.0)
    navigation, moment_s, found = Navigation(CONFIG), begin_s + 3.0, []
    for event in reports(str(path)):
        second = event.stamp_ns / 1e9 - first_s
        if not begin_s <= second <= END_S:
            continue
        is_right = of_filter and isinstance(event, GpsQuality)
        navigation.add(event if is_right else disturbed(event, round(first_s * 1e9), faults, place))
        if isinstance(event, PositionFix) and second > moment_s + 4.0:
            moment_s += 1.0
            state = navigation.state_at(round((first_s + moment_s) * 1e9))
            if isinstance(state, NavState) and navigation.frame is not None:
                at = place.to_enu(*(float(c) for c in navigation.frame.to_geodetic(state.position_enu_m)))
                error = at - trajectory.camera_pose(moment_s, np.eye(3)).centre_m
                found.append((state.sigma_horizontal_m, np.hypot(*error[:2]) / CIRCLE_90 / state.sigma_horizontal_m))
    sigmas, ratios = np.array(found).T
    return sigmas, ratios


@pytest.mark.parametrize(
    ("name", "begin_s"),
    [
        ("plane_rough", 10.0),
        pytest.param("plane_rough", 15.0, marks=pytest.mark.long),
        pytest.param("plane_rough", 30.0, marks=pytest.mark.long),
        # On the ground its filter held a place 4 m from its receiver's, and came to that.
        pytest.param("qp_transition", 0.0, marks=pytest.mark.long),
    ],
)
def test_a_filter_that_is_shaken_is_not_doubted_for_long(shared_data: Path, name: str, begin_s: float) -> None:
    """Median sigmas in rough air before: 7.4, 5.4 and 6.3 m for errors of 1.5 m, all of them inside."""
    sigmas, ratios = accepted(shared_data / "sitl" / name, (), begin_s)
    assert np.median(sigmas) < 2.2
    assert np.mean(ratios < 1.0) >= 0.9
    assert 0.35 < np.quantile(ratios, 0.9) < 1.1
    assert ratios.max() < 2.0


FAULTS = {
    "jump of 5 m that stays": Disturbance(POSITION, FAULT_S, FOR_GOOD, 5.0),
    "jump of 8 m that stays": Disturbance(POSITION, FAULT_S, FOR_GOOD, 8.0),
    "jump of 20 m that stays": Disturbance(POSITION, FAULT_S, FOR_GOOD, 20.0),
    "jump of 40 m that stays": Disturbance(POSITION, FAULT_S, FOR_GOOD, 40.0),
    "jump of 8 m and back": Disturbance(POSITION, FAULT_S, 20.0, 8.0),
    "jump of 20 m and back": Disturbance(POSITION, FAULT_S, 20.0, 20.0),
    "drag by 30 m and back": Disturbance(DRAG, FAULT_S, 20.0, 1.5),
    "drag by 60 m and back": Disturbance(DRAG, FAULT_S, 40.0, 1.5),
}
SHORT = {
    ("plane_rough", "the receiver's", "jump of 8 m that stays"),
    ("plane_rough", "the filter's alone", "drag by 30 m and back"),
}


@pytest.mark.parametrize(
    ("name", "of_filter", "disturbance"),
    [
        pytest.param(
            name, whose != "the receiver's", FAULTS[fault], id=f"{fault}-{whose}-{name}",
            marks=[] if (name, whose, fault) in SHORT else pytest.mark.long,
        )
        for fault in FAULTS
        for whose in ("the receiver's", "the filter's alone")
        for name in ("plane_rough", "plane_clean")
    ],
)  # fmt: skip
def test_a_position_that_jumped_is_held_in_the_sigma(
    shared_data: Path, name: str, of_filter: bool, disturbance: Disturbance
) -> None:
    """Before: drags accepted 5.6 circles off (their jump back undid the doubt of the time before), jumps 2.5."""
    sigmas, ratios = accepted(shared_data / "sitl" / name, (disturbance,), of_filter=of_filter)
    assert len(ratios) > 0.4 * (END_S - BEGIN_S)
    assert ratios.max() < 2.0
    assert np.mean(ratios < 1.0) >= 0.85
    if disturbance.seconds == FOR_GOOD and disturbance.size > 5.0:
        # One sigma is what it jumped by, not much more.
        assert 0.6 * disturbance.size < sigmas[-1] < 1.4 * disturbance.size
    elif disturbance.seconds < FOR_GOOD:
        # What has come back is explained; but a drag is not seen whole where a turn hides it.
        assert sigmas[-1] < (6.0 if disturbance.sensor == DRAG else 2.5)
