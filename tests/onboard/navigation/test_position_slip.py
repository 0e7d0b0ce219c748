"""What acceleration does to a filter in order is no slip; what a receiver's fault does is, in a turn as on a leg."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from benchmarks.drawn_flight import EPOCH_NS, PLACE, DrawnFlight, DrawnSpec
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED
from onboard.config.schema import parse_config
from onboard.events.types import Frame, NavEvent, PositionFix
from onboard.navigation.navigator import Navigation, NavState
from onboard.navigation.position_interpolation import Position
from onboard.navigation.position_slip import DYNAMIC_TIME_S, RESPONSE_SHARE, SlipTest, integrated
from onboard.navigation.time_series import Series
from onboard.telemetry.tlog_reader import read_tlog
from simulation.paths import PathSpec

Array = NDArray[np.float64]

DATA = Path(__file__).parents[2] / "data"
CONFIG = parse_config("")
LATENCY_S = CONFIG.gps.sigma_latency_s
TURNS = PathSpec("turns", speed_m_s=15.0, height_m=200.0, bank_deg=45.0, leg_m=60.0)
STRAIGHT = replace(TURNS, kind="straight")
SECONDS = 26.0
DRAWS = 20
FAULT_S = (8.0, 18.0)


@dataclass(frozen=True)
class Judged:
    """Of a flight: the share of moments refused, and the largest horizontal sigma of those accepted, m."""

    refused: float
    largest_sigma_m: float

    @property
    def is_doubted(self) -> bool:
        """Whether a position was refused, or is no longer as good as declared."""
        return self.refused > 0.0 or self.largest_sigma_m > CONFIG.gps.sigma_correlated_horizontal_m


def telemetry(path: PathSpec, filter_late_s: float, seed: int) -> Iterator[NavEvent]:
    flight = DrawnFlight(DrawnSpec(CONFIG, path, SECONDS, 1.0, filter_late_s=filter_late_s), seed)
    yield from (event for event in flight.events() if not isinstance(event, Frame))


def judged(events: Iterable[NavEvent], begin_s: float, end_s: float) -> Judged:
    navigation = Navigation(CONFIG)
    for event in events:
        navigation.add(event)
    moments = EPOCH_NS + np.round(np.arange(begin_s, end_s, 0.5) * 1e9).astype(np.int64)
    states = [navigation.state_at(t) for t in moments.tolist()]
    sigmas = [s.sigma_horizontal_m for s in states if isinstance(s, NavState)]
    return Judged(1.0 - len(sigmas) / len(states), max(sigmas, default=np.inf))


def misled(event: NavEvent, begin_s: float, end_s: float, off_m: float, filter_s: float) -> NavEvent:
    """The report of a filter whose receiver is `off_m` east of the truth from one moment until another: critically
    damped, as (5.15) with k1 = 2 / T, k2 = 1 / T^2.
    """
    if not isinstance(event, PositionFix) or event.velocity_ned_m_s is None:
        return event
    after = (event.stamp_ns - EPOCH_NS) / 1e9 - np.array([begin_s, end_s])
    share, fading = np.maximum(after, 0.0) / filter_s, np.exp(-np.maximum(after, 0.0) / filter_s) * (after > 0.0)
    x, v = (after > 0.0) - (1.0 - share) * fading, share * fading / filter_s
    east_m, east_m_s = off_m * (x[0] - x[1]), off_m * (v[0] - v[1])
    moved = PLACE.to_enu(event.lat_deg, event.lon_deg, event.height_amsl_m) + [east_m, 0.0, 0.0]
    lat, lon, height = (float(c) for c in PLACE.to_geodetic(moved))
    north, east, down = event.velocity_ned_m_s
    return replace(
        event, lat_deg=lat, lon_deg=lon, height_amsl_m=height, velocity_ned_m_s=(north, east + east_m_s, down)
    )


@pytest.mark.parametrize("times", [1.0, 2.0, 3.0])
def test_what_a_late_filter_does_in_steep_turns_is_no_slip(times: float) -> None:
    """Later than declared by two and three sigmas too: with a factor of two 5 and 20 of 20 flights were."""
    found = [judged(telemetry(TURNS, times * LATENCY_S, seed), 0.0, SECONDS) for seed in range(DRAWS)]
    assert sum(f.is_doubted for f in found) <= 1, found


@pytest.mark.parametrize(("path", "least"), [(STRAIGHT, 20), (TURNS, 18)], ids=["straight", "turns"])
def test_a_receiver_five_metres_off_for_ten_seconds_is_found(path: PathSpec, least: int) -> None:
    """In turns in 17 with a factor of two on the latency's sigma, which took late filters for faults as well."""
    found = [
        judged((misled(e, *FAULT_S, 5.0, 3.0) for e in telemetry(path, late * LATENCY_S, seed)), *FAULT_S)
        for seed, late in zip(range(DRAWS), itertools.cycle([-1.0, -0.5, 0.0, 0.5, 1.0]), strict=False)
    ]
    assert sum(f.is_doubted for f in found) >= least, found
    assert 2.0 < np.median([f.largest_sigma_m for f in found]) < 8.0, found


def one_turn() -> tuple[Array, Array, Array]:
    """Seconds (300,), velocity (300, 3) in a turn that begins and ends, and the slip (300, 3), m/s, of a filter that is
    1 s later than it assumes: by its own differential equation.
    """
    t = np.arange(0.0, 30.0, 0.1)
    course = np.cumsum(np.where((t > 10.0) & (t < 13.0), 0.6, 0.0)) * 0.1
    velocity = 15.0 * np.stack([np.sin(course), np.cos(course), np.zeros_like(t)], axis=1)
    k1, k2 = 2.0 / DYNAMIC_TIME_S, 1.0 / DYNAMIC_TIME_S**2
    steps = velocity - velocity[0]
    return t, velocity, np.stack([lsim(([k1, 0.0, 0.0], [1.0, k1, k2]), axis, t)[1] for axis in steps.T], axis=1)


def positions_of(late_s: float, faulty_m_s: float) -> Series[Position]:
    """Of that turn: by a filter that is so late, and that a fault moves eastwards besides."""
    t, velocity, slips = one_turn()
    places = integrated(velocity + late_s * slips, t) + np.outer(t, [faulty_m_s, 0.0, 0.0])
    positions: Series[Position] = Series()
    for moment, place, v in zip(t, places, velocity, strict=True):
        positions.insert(round(moment * 1e9), Position(place, v, None))
    return positions


def test_acceleration_s_part_is_that_of_a_critically_damped_filter() -> None:
    """(5.21) against the filter's own differential equation."""
    (t, _, slips), positions = one_turn(), positions_of(1.0, 3.0)  # enough to be looked at
    test = SlipTest(CONFIG.gps)
    for moment in (9.0, 11.0, 12.5, 14.0, 18.0):
        about = np.abs(t - moment) < 1.001
        slope = np.polyfit(t[about], np.cumsum(slips, axis=0)[about] * 0.1, 1)[0]
        along, across = test.at(positions, round(moment * 1e9)).in_turns_m_s
        response_s = RESPONSE_SHARE * LATENCY_S
        turning = np.linalg.norm(slope)
        assert across == pytest.approx(response_s * turning, abs=0.05 * response_s * 9.0), moment
        assert along == pytest.approx(np.hypot(LATENCY_S, response_s) * turning, abs=0.05 * LATENCY_S * 9.0), moment


@pytest.mark.parametrize("late_s", [-0.15, 0.0, 0.2])
def test_turns_show_by_how_much_a_filter_is_late(late_s: float) -> None:
    """(5.23): later turns are explained by it, and less than half of its sigma is left."""
    test, positions = SlipTest(CONFIG.gps), positions_of(late_s, 0.0)
    before = test.at(positions, 12_000_000_000)
    for moment in range(4, 27):
        test.learn(positions, moment * 1_000_000_000)
    after = test.at(positions, 12_000_000_000)
    assert before.speed_m_s > 0.5 if late_s else before.speed_m_s < 0.1, before
    assert after.speed_m_s < 0.25, after
    if late_s:
        assert after.in_turns_m_s[0] < 0.5 * before.in_turns_m_s[0], (before, after)
        assert 0.5 * RESPONSE_SHARE * LATENCY_S < test.response_sigma_s < RESPONSE_SHARE * LATENCY_S


def test_nothing_is_learned_of_a_fault_nor_twice_of_one_position() -> None:
    faulty, once, again = (SlipTest(CONFIG.gps) for _ in range(3))
    for moment in range(4, 27):
        faulty.learn(positions_of(0.0, 9.0), moment * 1_000_000_000)
    assert faulty.response_sigma_s == RESPONSE_SHARE * LATENCY_S
    positions = positions_of(0.1, 0.0)
    for moment in range(4, 27):
        once.learn(positions, moment * 1_000_000_000)
        for part in range(10):
            again.learn(positions, moment * 1_000_000_000 + part * 100_000_000)
    assert again.response_sigma_s == once.response_sigma_s


@pytest.mark.parametrize("name", ["plane_turn", "qp_climb", "copter_leg"])
def test_recorded_filters_in_order_do_not_slip_in_turns(name: str) -> None:
    """What all of their turns show is a filter whose response is no farther from (5.21) than assumed."""
    log = read_tlog(DATA / f"{name}.tlog")
    test, positions, place = SlipTest(CONFIG.gps), Series[Position](), None
    for event in log.events:
        if not isinstance(event, PositionFix) or event.velocity_ned_m_s is None:
            continue
        place = place or LocalFrame(event.lat_deg, event.lon_deg, event.height_amsl_m)
        here = place.to_enu(event.lat_deg, event.lon_deg, event.height_amsl_m)
        positions.insert(event.stamp_ns, Position(here, R_ENU_NED @ np.array(event.velocity_ned_m_s), None))
    for moment_ns in positions.stamps_ns[20:-20]:
        test.learn(positions, moment_ns)
        assert not test.at(positions, moment_ns).exceeds(CONFIG.gps.max_slip_m_s), moment_ns
    assert test.response_sigma_s < RESPONSE_SHARE * LATENCY_S


def test_the_noise_of_rare_positions_is_no_slip() -> None:
    """Five positions in two seconds do not show what they scatter by; then what is declared counts."""
    config = parse_config("[gps]\nsigma_white_m = 1.0")
    rng, found = np.random.default_rng(3), []
    for _ in range(200):
        positions: Series[Position] = Series()
        for t in np.arange(0.0, 2.01, 0.5):
            positions.insert(round(t * 1e9), Position(rng.standard_normal(3), np.zeros(3), None))
        found.append(SlipTest(config.gps).at(positions, 1_000_000_000).exceeds(config.gps.max_slip_m_s))
    assert not any(found)
