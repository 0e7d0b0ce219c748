"""A click whose picture's time is known to some tenths of a second: its ellipse has that, and no more."""

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_so3, log_so3
from contract.untimed_click import UntimedClick, locate_untimed, pixel_at
from contract.wire.codec import decode, encode
from onboard.link.swings import Swings
from tests.onboard.tracks.flat_world import CAMERA, EPOCH_NS, LOOKING_DOWN, M_PX, PLACE, RATE_HZ, World

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

SPEED_M_S, SIGMA_S = 8.0, 0.3
POSE_ERROR_M = np.array([0.8, -0.5])  # of every set of that world; one sigma of it is stated as 1 m
SHARE = (0.25, 0.4)


def its_sets(world: World) -> list[FeatureSet]:
    return [world.its_set(number) for number in range(60)]


@cache
def world() -> World:
    return World(camera=lambda t: (SPEED_M_S * t, 0.0))


@cache
def passing() -> list[FeatureSet]:
    return its_sets(world())


def at_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)


def clicked(moment_s: float, sets: list[FeatureSet] | None = None, sigma_s: float = SIGMA_S) -> UntimedClick:
    return locate_untimed(passing() if sets is None else sets, SHARE, at_ns(moment_s), sigma_s)


def error_m(found: UntimedClick, shown_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """East, north from what was at SHARE of the picture of `shown_s`."""
    assert isinstance(found.answer, Fix)
    u, v = (share * size - 0.5 for share, size in zip(SHARE, (CAMERA.width_px, CAMERA.height_px), strict=True))
    truth = np.array([SPEED_M_S * shown_s + (u - CAMERA.cx_px) * M_PX, -(v - CAMERA.cy_px) * M_PX])
    where: np.ndarray[tuple[int], np.dtype[np.float64]] = PLACE.to_enu(
        found.answer.lat_deg, found.answer.lon_deg, found.answer.height_amsl_m or 0.0
    )[:2]
    return where - truth


def test_a_moment_that_is_known_gives_the_place_of_then_also_between_two_pictures() -> None:
    for moment_s in (2.0, 2.05):
        found = clicked(moment_s, sigma_s=0.0)
        assert np.allclose(error_m(found, moment_s), POSE_ERROR_M, atol=0.03)
        assert np.max(np.abs(found.by_delay_m2)) < 1e-3


def test_nine_of_ten_clicks_are_inside_whatever_the_delay_was_and_the_ellipse_is_no_wider_than_it() -> None:
    found = clicked(3.0)
    rng = np.random.default_rng(1)
    # Each with a delay and a pose of its own: those of its sets are taken off.
    errors = np.array([error_m(found, 3.0 + rng.normal(0.0, SIGMA_S)) for _ in range(2000)])
    errors += rng.normal(0.0, 1.0, errors.shape) - POSE_ERROR_M
    chi2 = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(found.answer.covariance_enu_m2[:2, :2]), errors)
    assert 0.88 <= np.mean(chi2 < 4.605) <= 0.92
    stated_m, truly_m = found.answer.ellipse.semi_major_m, 2.146 * math.hypot(SPEED_M_S * SIGMA_S, 1.0)
    assert 0.97 <= stated_m / truly_m <= 1.05
    assert np.isclose(found.by_delay_m2[0, 0], (SPEED_M_S * SIGMA_S) ** 2, rtol=0.03)


def test_a_turn_that_no_straight_line_follows_widens_it() -> None:
    """The camera swings to and fro within the delay: its mean is known, where it was is not."""
    swinging = World(camera=lambda t: (4.0 * math.sin(2.0 * math.pi * t / 0.5), 0.0))
    found = clicked(3.0, its_sets(swinging))
    assert 2.0 <= math.sqrt(found.by_delay_m2[0, 0]) <= 4.5


def test_a_hovering_aircraft_owes_nothing_to_the_delay() -> None:
    found = clicked(3.0, its_sets(World()))
    assert np.max(np.abs(found.by_delay_m2)) < 1e-6
    assert np.isclose(found.answer.ellipse.semi_major_m, 2.146, rtol=0.02)


def swung(seed: int) -> World:
    """It flies, and nods and yaws by some metres on the ground, with periods of 1.2 to 6 s."""
    rng = np.random.default_rng(seed)
    turning = 2.0 * np.pi / np.exp(rng.uniform(math.log(1.2), math.log(6.0), (2, 4)))
    phase, size_m = rng.uniform(0.0, 2.0 * np.pi, (2, 4)), rng.uniform(1.0, 4.0)

    def camera(t: float) -> tuple[float, float]:
        east_m, north_m = np.sum(size_m * np.sin(turning * t + phase), axis=1)
        return SPEED_M_S * t + float(east_m), float(north_m)

    out = copy.copy(world())  # its ground is no part of a set
    out.camera = camera
    return out


def test_what_swings_between_two_sets_a_second_apart_is_in_the_ellipse() -> None:
    """A straight line through three of them had 75 % inside, and 3.7 ellipses off."""
    inside = []
    for seed in range(60):
        swinging = swung(seed)
        rng = np.random.default_rng([seed, 1])
        shown_s = 40.0 + rng.uniform(0.0, 1.0)
        sets = [swinging.its_set(number) for number in range(320, 420, 10)]
        found = locate_untimed(sets, SHARE, at_ns(shown_s + rng.normal(0.0, 0.1)), 0.1)
        if not isinstance(found.answer, Fix):
            assert found.answer.status is Status.UNCERTAIN
            continue
        swings_m = np.subtract(swinging.camera(shown_s), [SPEED_M_S * shown_s, 0.0])
        error = error_m(found, shown_s) - swings_m - POSE_ERROR_M + rng.normal(0.0, 1.0, 2)
        inside.append(error @ np.linalg.solve(found.answer.covariance_enu_m2[:2, :2], error) / 4.605)
    assert len(inside) >= 50
    assert np.mean(np.array(inside) < 1.0) >= 0.9 and max(inside) < 3.0**2
    assert np.mean(np.array(inside) < 0.5**2) < 0.9  # nor is it wider than it need be


class Nodding:
    """A plane in wind, seen obliquely: it nods by some 4 degrees at 0.9 Hz, rolls and yaws more slowly, and climbs."""

    def __init__(self, seed: int, calm: float = 1.0, readout_s: float = 0.0) -> None:
        rng = np.random.default_rng([seed, 2])
        self._size_rad = calm * np.radians(rng.uniform([3.0, 1.0, 1.0], [5.0, 4.0, 3.0]))
        self._turning = 2.0 * math.pi * rng.uniform([0.8, 0.3, 0.1], [0.9, 0.6, 0.3])
        self._phase, self._readout_s = rng.uniform(0.0, 2.0 * math.pi, 3), readout_s

    def pose(self, t: float) -> tuple[Array, Array]:
        """The camera's place (3,), east, north, up, and R_enu_cam."""
        nod, roll, yaw = self._size_rad * np.sin(self._turning * t + self._phase)
        tilted = exp_so3([0.0, 0.0, yaw]) @ LOOKING_DOWN @ exp_so3([0.5 + nod, 0.0, 0.0]) @ exp_so3([0.0, roll, 0.0])
        return np.array([18.0 * t, 20.0 * math.sin(0.2 * t), 150.0 + 0.5 * t]), tilted

    def place(self, t: float, share: tuple[float, float]) -> Array:
        """The ground (2,) at a share of the picture whose middle row is exposed then."""
        u, v = pixel_at(CAMERA, share)
        centre, R_enu_cam = self.pose(t + self._readout_s * ((v + 0.5) / CAMERA.height_px - 0.5))
        ray = R_enu_cam @ [(u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px, 1.0]
        return np.asarray(centre[:2] - ray[:2] * centre[2] / ray[2], float)

    def its_set(self, number: int, error_m: Array, error_rad: Array) -> FeatureSet:
        """The set of a picture, ten of them a second; the errors of its pose are as stated: 1 m and 0.5 degrees."""
        centre, R_true = self.pose(number / RATE_HZ)
        R_enu_cam = exp_so3(error_rad) @ R_true
        lat, lon, height = PLACE.to_geodetic(centre + [*error_m, 0.0])
        a, b, c = (R_true.T @ [0.0, 0.0, -1.0 / centre[2]])[[2, 0, 1]]  # as parallax shows it
        later = self.pose(number / RATE_HZ + 1e-3)
        rate = log_so3(R_true.T @ later[1]) * 1e3
        moving = RollingShutter(self._readout_s, rate, R_true.T @ (later[0] - centre) * 1e3)
        covariance = np.diag([1.0, 1.0, 0.0, *[math.radians(0.5) ** 2] * 3, 0.0, 0.0, 0.0])
        place = {"camera_lat_deg": float(lat), "camera_lon_deg": float(lon), "camera_height_m": float(height)}
        return replace(
            world().its_set(number), **place, R_enu_cam=R_enu_cam, plane_per_m=np.array([a, b, c]),
            shutter=moving if self._readout_s else None, common_cov=covariance,
        )  # fmt: skip


def nodding_click(
    seed: int, sigma_s: float = 0.1, every: int = 10, calm: float = 1.0, readout_s: float = 0.0
) -> tuple[Nodding, list[FeatureSet], tuple[float, float], float, float]:
    """A flight, its sets of every so many pictures as they come over a link, and a click: its share, when what it means
    was shown, and when it seems to have been.
    """
    flight, rng = Nodding(seed, calm, readout_s), np.random.default_rng([seed, 3])
    share = float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.2, 0.8))
    shown_s = 40.0 + float(rng.uniform(0.0, 1.0))
    errors = rng.normal(0.0, 1.0, 2), rng.normal(0.0, math.radians(0.5), 3)
    swings, sets = Swings(), list[FeatureSet]()
    for number in range(320, 430):
        made = flight.its_set(number, *errors)
        swings.add(made)
        if number % every == 0:
            swing = swings.since(sets[-1].capture_unix_ns, made) if sets else None
            sets.append(decode(encode(replace(made, swing=swing))))
    return flight, sets, share, shown_s, shown_s + float(rng.normal(0.0, sigma_s))


def ellipses_off(flight: Nodding, found: UntimedClick, share: tuple[float, float], shown_s: float) -> float:
    """The error in its own 90 % ellipses."""
    assert isinstance(found.answer, Fix)
    where = PLACE.to_enu(found.answer.lat_deg, found.answer.lon_deg, found.answer.height_amsl_m or 0.0)[:2]
    error = where - flight.place(shown_s, share)
    return math.sqrt(float(error @ np.linalg.solve(found.answer.covariance_enu_m2[:2, :2], error)) / 4.605)


@pytest.mark.parametrize(
    ("seeds", "inside"),
    [
        pytest.param(range(24), (0.75, 1.0), id="some"),
        pytest.param(range(100, 260), (0.85, 0.97), id="many", marks=pytest.mark.long),
    ],
)
def test_nodding_that_sets_a_second_apart_do_not_show_is_stated_by_them_and_the_ellipse_holds(
    seeds: range, inside: tuple[float, float]
) -> None:
    """By sets alone 86 % were inside, 2.4 ellipses off at most, and those half as long again."""
    off, lengths_m, without_m, refused = [], [], [], 0
    for seed in seeds:
        flight, sets, share, shown_s, seems_s = nodding_click(seed)
        found = locate_untimed(sets, share, at_ns(seems_s), 0.1)
        bare = locate_untimed([replace(s, swing=None) for s in sets], share, at_ns(seems_s), 0.1).answer
        if not isinstance(found.answer, Fix):
            refused += 1
            continue
        off.append(ellipses_off(flight, found, share, shown_s))
        if isinstance(bare, Fix):
            lengths_m.append(found.answer.ellipse.semi_major_m)
            without_m.append(bare.ellipse.semi_major_m)
    assert refused <= 0.05 * len(seeds)
    assert inside[0] <= np.mean(np.array(off) < 1.0) <= inside[1] and max(off) < 2.5
    assert np.median(lengths_m) < 0.8 * np.median(without_m)


def test_a_calm_flight_s_ellipse_is_no_longer_by_what_its_sets_state() -> None:
    ratios = []
    for seed in range(8):
        _, sets, share, _, seems_s = nodding_click(seed, calm=0.05)
        both = (sets, [replace(s, swing=None) for s in sets])
        with_it, without = (locate_untimed(of, share, at_ns(seems_s), 0.1).answer for of in both)
        assert isinstance(with_it, Fix) and isinstance(without, Fix)
        ratios.append(with_it.ellipse.semi_major_m / without.ellipse.semi_major_m)
    assert np.median(ratios) <= 1.03


@pytest.mark.parametrize("readout_s", [0.0, 0.06], ids=["all rows at once", "rolling"])
def test_where_the_moment_is_known_the_place_between_two_sets_is_that_of_then(readout_s: float) -> None:
    """Within a metre, of a camera whose pixel sways by 20 m; each row is seen at its own moment."""
    for seed in range(5):
        flight, sets, share, shown_s, _ = nodding_click(seed, readout_s=readout_s)
        exact = [flight.its_set(s.frame, np.zeros(2), np.zeros(3)) for s in sets]
        true = [replace(e, swing=s.swing) for e, s in zip(exact, sets, strict=True)]
        found = locate_untimed(true, share, at_ns(shown_s), 0.0).answer
        assert isinstance(found, Fix)
        where = PLACE.to_enu(found.lat_deg, found.lon_deg, found.height_amsl_m or 0.0)[:2]
        assert np.linalg.norm(where - flight.place(shown_s, share)) < 1.5


@pytest.mark.long
def test_a_set_that_was_lost_or_comes_besides_does_no_harm() -> None:
    """A gap of two seconds is half known; two that state nearly the same moment make no motion of their errors."""
    off = []
    for seed in range(40):
        flight, sets, share, shown_s, seems_s = nodding_click(seed)
        rng = np.random.default_rng([seed, 4])
        few = [s for s in sets if rng.uniform() > 0.3]
        more = [replace(flight.its_set(s.frame - 4, rng.normal(0.0, 0.5, 2), rng.normal(0.0, 0.003, 3))) for s in few]
        for there in (few, few + more[::3]):
            found = locate_untimed(there, share, at_ns(seems_s), 0.1)
            if isinstance(found.answer, Fix):
                off.append(ellipses_off(flight, found, share, shown_s))
    assert len(off) >= 30 and max(off) < 3.0 and np.mean(np.array(off) < 1.0) >= 0.8


def test_a_camera_that_swings_too_much_between_its_pictures_is_refused() -> None:
    swinging = World(camera=lambda t: (25.0 * math.sin(2.0 * math.pi * t / 1.7), 0.0))
    assert clicked(3.0, its_sets(swinging)[::10], 0.1).answer.status is Status.UNCERTAIN
    assert isinstance(clicked(3.0, its_sets(swinging), 0.1).answer, Fix)  # ten pictures a second show how


def test_sets_that_come_seldom_still_state_how_far_it_moves() -> None:
    found = clicked(3.0, passing()[::15])
    assert np.isclose(found.by_delay_m2[0, 0], (SPEED_M_S * SIGMA_S) ** 2, rtol=0.1)


@pytest.mark.parametrize(
    ("sets", "moment_s", "status"),
    [
        pytest.param(list, 3.0, Status.STALE, id="none"),
        pytest.param(passing, 30.0, Status.STALE, id="long ago"),
        pytest.param(lambda: passing()[30:31], 3.0, Status.STALE, id="one alone knows no speed"),
        pytest.param(lambda: its_sets(World(status=Status.TURNING)), 3.0, Status.TURNING, id="no pose"),
    ],
)
def test_what_cannot_be_known_is_refused(sets: Callable[[], list[FeatureSet]], moment_s: float, status: Status) -> None:
    answer = clicked(moment_s, sets()).answer
    assert answer.status is status and answer.reason


def test_pictures_without_a_place_among_others_that_have_one_hold_up_no_click() -> None:
    lost = World(status=Status.TURNING, camera=world().camera)
    mixed = [(lost if number % 3 == 0 else world()).its_set(number) for number in range(60)]
    assert np.allclose(error_m(clicked(3.0, mixed), 3.0), POSE_ERROR_M, atol=0.05)
    assert RATE_HZ == 10.0  # so that every third of them is 0.3 s from the next
