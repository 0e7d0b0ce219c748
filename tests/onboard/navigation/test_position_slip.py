"""What acceleration does to a filter in order is no slip; what a receiver's fault does is, in a turn as on a leg."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.sampled_flight import EPOCH_NS, PLACE, SampledFlight, SampledSpec
from onboard.config.schema import parse_config
from onboard.events.types import Frame, NavEvent, PositionFix
from onboard.navigation.navigator import Navigation, NavState
from onboard.navigation.position_interpolation import Position
from onboard.navigation.position_slip import DYNAMIC_TIME_S, slip_at
from onboard.navigation.time_series import Series
from simulation.paths import PathSpec

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
    flight = SampledFlight(SampledSpec(CONFIG, path, SECONDS, 1.0, filter_late_s=filter_late_s), seed)
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


@pytest.mark.parametrize(
    ("times", "draws", "most"),
    [
        pytest.param(1.0, 5, 0, id="as declared"),
        pytest.param(1.0, DRAWS, 2, id="as declared, all draws", marks=pytest.mark.long),
        pytest.param(2.0, DRAWS, 13, id="twice", marks=pytest.mark.long),
    ],
)
def test_what_a_late_filter_does_in_steep_turns_is_no_slip(times: float, draws: int, most: int) -> None:
    """Before, in 17 and 20 of 20 flights positions were refused, or doubted by metres from then on."""
    found = [judged(telemetry(TURNS, times * LATENCY_S, seed), 0.0, SECONDS) for seed in range(draws)]
    assert sum(f.is_doubted for f in found) <= most, found


@pytest.mark.parametrize(
    ("path", "draws", "least"),
    [
        pytest.param(TURNS, 5, 3, id="turns"),
        pytest.param(TURNS, DRAWS, 16, id="turns, all draws", marks=pytest.mark.long),
        pytest.param(STRAIGHT, DRAWS, 20, id="straight", marks=pytest.mark.long),
    ],
)
def test_a_receiver_five_metres_off_for_ten_seconds_is_found(path: PathSpec, draws: int, least: int) -> None:
    """Before, in all flights; but in turns, nearly all flights without a fault were found as well."""
    found = [
        judged((misled(e, *FAULT_S, 5.0, 3.0) for e in telemetry(path, late * LATENCY_S, seed)), *FAULT_S)
        for seed, late in zip(range(draws), itertools.cycle([-1.0, -0.5, 0.0, 0.5, 1.0]), strict=False)
    ]
    assert sum(f.is_doubted for f in found) >= least, found
    assert 2.0 < np.median([f.largest_sigma_m for f in found]) < 8.0, found


def test_acceleration_s_part_is_that_of_a_critically_damped_filter() -> None:
    """(5.21) against the filter's own differential equation, in a turn that begins and ends."""
    from scipy.signal import lsim  # noqa: PLC0415  a second of processor time for each worker

    t = np.arange(0.0, 30.0, 0.1)
    course = np.cumsum(np.where((t > 10.0) & (t < 13.0), 0.6, 0.0)) * 0.1
    velocity = 15.0 * np.stack([np.sin(course), np.cos(course), np.zeros_like(t)], axis=1)
    k1, k2 = 2.0 / DYNAMIC_TIME_S, 1.0 / DYNAMIC_TIME_S**2
    steps = velocity - velocity[0]
    slips = np.stack([lsim(([k1, 0.0, 0.0], [1.0, k1, k2]), axis, t)[1] for axis in steps.T], axis=1)
    # Position strays by what it slips, at 1 s of latency, and by 3 m/s more, which is enough to be looked at.
    strayed = np.cumsum(slips, axis=0) * 0.1 + np.outer(t, [3.0, 0.0, 0.0])
    flown = np.cumsum(velocity, axis=0) * 0.1
    positions: Series[Position] = Series()
    for moment, place, v in zip(t, flown + strayed, velocity, strict=True):
        positions.insert(round(moment * 1e9), Position(place, v, None))
    for moment in (9.0, 11.0, 12.5, 14.0, 18.0):
        about = np.abs(t - moment) < 1.001
        slope = np.polyfit(t[about], np.cumsum(slips, axis=0)[about] * 0.1, 1)[0]
        slip = slip_at(positions, round(moment * 1e9), CONFIG.gps)
        assert slip.in_turns_m_s == pytest.approx(LATENCY_S * np.linalg.norm(slope), abs=0.05 * LATENCY_S * 9.0), moment


def test_the_noise_of_rare_positions_is_no_slip() -> None:
    """Five positions in two seconds do not show what they scatter by; then what is declared counts."""
    config = parse_config("[gps]\nsigma_white_m = 1.0")
    rng, found = np.random.default_rng(3), []
    for _ in range(200):
        positions: Series[Position] = Series()
        for t in np.arange(0.0, 2.01, 0.5):
            positions.insert(round(t * 1e9), Position(rng.standard_normal(3), np.zeros(3), None))
        found.append(slip_at(positions, 1_000_000_000, config.gps).exceeds(config.gps.max_slip_m_s))
    assert not any(found)
