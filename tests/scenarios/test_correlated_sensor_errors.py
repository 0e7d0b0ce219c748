"""Errors that all pictures of a window share (velocity, heading, mount) are no smaller for having many pictures.

Simulated flights with truth. The share inside has bounds on both sides, and so has the share of clicks that are
answered.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.sampled_flight import EPOCH_NS, SampledFlight, SampledSpec, fly
from contract.answer import CHI2_2
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from onboard.config.schema import parse_config
from onboard.events.types import Attitude, Event, Frame, GpsQuality, PositionFix
from simulation.paths import PathSpec
from simulation.trajectory import Trajectory
from tests.sampled_clicks import chi2_of, located

Array = NDArray[np.float64]
AFTER_TURNS = PathSpec("turns", height_m=150.0, leg_m=200.0)
CLICKS_PX = np.array([[320.0, 240.0], [100.0, 100.0], [500.0, 400.0]])


@dataclass(frozen=True)
class Clicks:
    """Of several flights: errors over their own 90 % ellipses, and how many clicks were asked."""

    ratio: Array
    asked: int

    @property
    def inside(self) -> float:
        return float(np.mean(self.ratio < 1.0))

    @property
    def answered(self) -> float:
        return len(self.ratio) / self.asked


class Changed(SampledFlight):
    """A simulated flight whose telemetry is changed: `change(event, seconds, draws)`, `draws` the flight's own."""

    def __init__(self, spec: SampledSpec, seed: int, change: Callable[[Event, float, Array], Event]) -> None:
        super().__init__(spec, seed)
        self._change, self._draws = change, np.random.default_rng([seed, 5]).standard_normal((400, 3))

    def events(self) -> Iterator[Event]:
        for event in super().events():
            yield self._change(event, (event.stamp_ns - EPOCH_NS) / 1e9, self._draws)


def clicks_of(flights: list[SampledFlight], after_s: float) -> Clicks:
    """Every picture of every flight from `after_s` on, three clicks each."""
    chi2: list[float] = []
    asked = 0
    for flight in flights:
        sets, _ = fly(flight)
        asked += len(CLICKS_PX) * int(np.count_nonzero(flight.times_s >= after_s))
        for k, found in sets.items():
            if flight.times_s[k] >= after_s and found.is_ok:
                chi2 += [chi2_of(error, answer) for error, answer in located(flight, found, CLICKS_PX)]
    return Clicks(np.sqrt(np.array(chi2) / CHI2_2), asked)


def climb(spec: PathSpec, seconds: float, seed: int) -> Trajectory:
    time = np.arange(-6.0, seconds + 6.0, 0.05)
    drift = np.random.default_rng([seed, 77]).normal(0.0, 0.2, 2)
    level = drift * time[:, None] + 0.3 * np.stack([np.sin(0.4 * time), np.cos(0.33 * time)], axis=1)
    sway = np.radians(1.0)
    angles = sway * np.sin(0.8 * time), sway * np.cos(0.7 * time) - 0.02, 0.5 + 2.0 * sway * np.sin(0.3 * time)
    R = R_ENU_NED @ matrix_from_euler(*angles)
    return Trajectory(time, np.column_stack([level, 30.0 + 2.7 * (time + 6.0)]), R)


def velocity_off(event: Event, t: float, draws: Array) -> Event:
    """By 0.35 m/s an axis, correlated over 6 s; the receiver claims 0.4."""
    if isinstance(event, GpsQuality):
        return replace(event, sigma_velocity_m_s=0.4)
    if not isinstance(event, PositionFix) or event.velocity_ned_m_s is None:
        return event
    # A sum of exponentially fading pushes, one a second: a Gauss-Markov process at the seconds.
    age_s = t + 10.0 - np.arange(len(draws))
    push = np.where(age_s >= 0.0, np.exp(-np.maximum(age_s, 0.0) / 6.0), 0.0) @ draws
    off = 0.35 * np.sqrt(1.0 - np.exp(-2.0 / 6.0)) * push
    north, east, down = event.velocity_ned_m_s
    return replace(event, velocity_ned_m_s=(north + off[0], east + off[1], down + off[2]))


@pytest.mark.long
def test_in_a_climb_a_velocity_that_is_off_by_what_the_receiver_claims_is_allowed_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its direction acts as the tilt. Taken for known to 0.1 m/s, 42 % were inside, the farthest 2.7 ellipses off."""
    monkeypatch.setattr("benchmarks.sampled_flight.fly_path", climb)
    spec = SampledSpec(parse_config("[mount]\npitch_deg = -50.0"), seconds=30.0, rate_hz=2.0)
    clicks = clicks_of([Changed(spec, seed, velocity_off) for seed in (0, 2, 4)], 5.0)
    assert clicks.inside >= 0.85, clicks.inside
    # The wide side by the errors themselves: so few flights may all lie inside.
    assert 0.3 < np.quantile(clicks.ratio, 0.9) < 1.15, np.quantile(clicks.ratio, 0.9)
    assert clicks.ratio.max() < 1.7
    assert clicks.answered > 0.7


@pytest.mark.long  # short: another error that a window's pictures share, in a climb, above
def test_in_hover_over_terrain_a_mount_that_is_off_is_not_averaged_away() -> None:
    """3.2 degrees off, 3 declared. 27 % of the first flight's clicks were inside: a window with a baseline of half a
    metre, known to as much, placed the mount 4 degrees away from where it was.
    """
    flights: list[SampledFlight] = []
    for seed, pitch_deg, height_m, boresight_deg in (
        (0, -45.0, 79.0, (-1.6, -2.7, -0.5)),
        (3, -60.0, 89.0, (-3.1, 0.4, -0.5)),
    ):
        config = parse_config(f"[mount]\npitch_deg = {pitch_deg}\nsigma_deg = 3.0")
        path = PathSpec("hover", height_m=height_m, wobble_deg=1.5)
        spec = SampledSpec(config, path, seconds=20.0, rate_hz=2.0, has_terrain=True, boresight_deg=boresight_deg)
        flights.append(SampledFlight(spec, seed))
    clicks = clicks_of(flights, 0.0)
    assert clicks.inside >= 0.85, clicks.inside
    assert np.quantile(clicks.ratio, 0.9) > 0.4  # nor is it a radius twice too wide
    assert clicks.answered > 0.7  # three degrees at 35 below the horizon are more than 30 % of the height


def heading_moves(event: Event, t: float, draws: Array) -> Event:
    """By 5 degrees from second 20 to 40, as a compass does whose iron is magnetised again."""
    if not isinstance(event, Attitude):
        return event
    off = np.sign(draws[0, 0]) * np.radians(5.0) * float(np.clip((t - 20.0) / 20.0, 0.0, 1.0))
    R = exp_so3(np.array([0.0, 0.0, off])) @ matrix_from_quaternion(event.q_ned_body)
    w, x, y, z = quaternion_from_matrix(R).tolist()
    return replace(event, q_ned_body=(w, x, y, z))


@pytest.mark.long  # short, by windows: a heading that is off, tests/onboard/estimation/test_sensor_groups.py
@pytest.mark.parametrize("seeds", [(1,), (0, 1)])
def test_a_heading_that_moves_by_five_degrees_within_twenty_seconds_is_allowed_for(seeds: tuple[int, ...]) -> None:
    """Nor is it taken for another time offset: with a threshold of a thousand to one on (10.5) the first flight's clock
    was moved by 0.2 s, for attitudes' errors make some offset of twenty-one fit better by chance.
    """
    spec = SampledSpec(parse_config(""), PathSpec("straight", height_m=200.0), seconds=46.0, rate_hz=1.5)
    clicks = clicks_of([Changed(spec, seed, heading_moves) for seed in seeds], 20.0)
    assert clicks.inside >= 0.85, clicks.inside
    assert clicks.ratio.max() < 3.0
    assert clicks.answered > 0.9


class LateInTurns(SampledFlight):
    """A simulated flight whose pictures' stamps are 150 ms late in turns, which nothing declares."""

    def events(self) -> Iterator[Event]:
        for event in super().events():
            turns = isinstance(event, Frame) and self.bank_deg[event.index] > 8.0
            yield replace(event, stamp_ns=event.stamp_ns + 150_000_000) if turns else event


@pytest.mark.long
def test_level_flight_after_a_turn_in_which_stamps_were_late_is_honest() -> None:
    """Of an earlier version 29 to 73 % were inside for 9 s after such turns."""
    flight = LateInTurns(SampledSpec(parse_config(""), AFTER_TURNS, seconds=26.0, rate_hz=2.0, offset_s=0.0), 0)
    sets, _ = fly(flight)
    banked_s = flight.times_s[flight.bank_deg > 8.0]
    level = [k for k, t in enumerate(flight.times_s) if t > banked_s.min() and not np.any(np.abs(t - banked_s) < 0.4)]
    ratio = np.array([np.sqrt(chi2_of(*a) / CHI2_2) for k in level for a in located(flight, sets[k], CLICKS_PX)])
    assert len(level) >= 10, len(level)
    assert len(ratio) > 0.8 * len(CLICKS_PX) * len(level), len(ratio)
    assert np.mean(ratio < 1.0) >= 0.85, np.mean(ratio < 1.0)
    assert 0.3 < np.quantile(ratio, 0.9) < 1.15, np.quantile(ratio, 0.9)
