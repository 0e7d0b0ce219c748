"""Ties to known places: pins before and after get better, honestly; what cannot be is refused with its figures."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.errors import InputError
from ground.pins.fusion import Place, fuse
from ground.pins.model import PinClick, Tie
from ground.pins.ties import judge
from tests.ground.pins.flights import sightings
from tests.ground.pins.test_fusion import TARGET, inside
from tests.ground.worlds import ORIGIN

Array = NDArray[np.float64]
LANDMARK = np.array([-60.0, 45.0, 3.0])


def tied(click: PinClick, place_enu_m: Array, rng: np.random.Generator | None, sigma_m: float = 0.3) -> Tie:
    error = np.zeros(3) if rng is None else sigma_m * rng.normal(size=3)
    lat, lon, height = (float(v) for v in ORIGIN.to_geodetic(place_enu_m + error))
    return Tie(click, lat, lon, height, "ellipsoid", sigma_m, sigma_m)


def test_after_a_tie_the_ellipse_still_holds_ninety_percent_and_is_smaller() -> None:
    """Landmark clicked at 10 s; pins of 4 s before and of 4 s, 100 s and 1000 s after it."""
    rng = np.random.default_rng(11)
    times_s = np.array([6.0, 10.0, 14.0, 110.0, 1010.0])
    targets = np.array([TARGET, LANDMARK, TARGET, TARGET, TARGET])
    held: dict[int, list[bool]] = {0: [], 2: [], 3: [], 4: []}
    ratio: dict[int, list[float]] = {0: [], 2: [], 3: [], 4: []}
    for _ in range(80):
        clicks = sightings(rng, times_s, targets)
        tie = tied(clicks[1], LANDMARK, rng)
        assert judge(tie, []).is_accepted
        for k, hits in held.items():
            before, after = fuse([clicks[k]]), fuse([clicks[k]], [tie])
            assert (before.tied, after.tied) == (0, 1)
            hits.append(inside(after))
            ratio[k].append(after.ce90_m / before.ce90_m)
    for k, hits in held.items():
        assert 0.82 <= np.mean(hits) <= 0.97, k  # 90 %, as 80 flights scatter
    # What drifts is known as long as it has not drifted on; what stays (mount, clock) is known for good.
    assert np.mean(ratio[0]) < 0.8 and np.mean(ratio[2]) < 0.8
    assert np.mean(ratio[2]) < np.mean(ratio[3]) < np.mean(ratio[4]) < 1.0


@pytest.mark.long
def test_several_ties_are_adjusted_together_and_beat_one() -> None:
    rng = np.random.default_rng(12)
    held, one_m, all_m = [], [], []
    for _ in range(60):
        times_s = np.array([0.0, 8.0, 16.0, 24.0, 12.0])
        order = np.argsort(times_s)
        places = [LANDMARK, np.array([50.0, 60.0, -2.0]), np.array([-40.0, -70.0, 1.0]), np.array([10.0, 90.0, 0.0])]
        targets = np.array([*places, TARGET])
        sampled = sightings(rng, times_s[order], targets[order])
        clicks = [sampled[int(np.flatnonzero(order == k)[0])] for k in range(5)]
        ties = [tied(c, p, rng) for c, p in zip(clicks, places, strict=False)]
        assert all(judge(tie, ties[:k]).is_accepted for k, tie in enumerate(ties))
        single, together = fuse([clicks[4]], ties[:1]), fuse([clicks[4]], ties)
        assert single.ce90_m is not None and together.ce90_m is not None
        one_m.append(single.ce90_m)
        all_m.append(together.ce90_m)
        held.append(inside(together))
    assert 0.82 <= np.mean(held) <= 0.98  # 90 %, as 60 flights scatter
    assert np.mean(all_m) < 0.8 * np.mean(one_m)


def test_a_fused_pin_is_tied_with_all_of_its_clicks() -> None:
    rng = np.random.default_rng(13)
    held = []
    for _ in range(60):
        clicks = sightings(rng, np.array([0.0, 4.0, 8.0, 12.0]), np.array([TARGET, TARGET, LANDMARK, TARGET]))
        place = fuse([clicks[0], clicks[1], clicks[3]], [tied(clicks[2], LANDMARK, rng)])
        assert isinstance(place, Place)
        held.append(inside(place))
    assert 0.82 <= np.mean(held) <= 0.98  # 90 %, as 60 flights scatter


def test_a_tie_that_cannot_be_is_judged_with_its_figures() -> None:
    rng = np.random.default_rng(14)
    (click,) = sightings(rng, np.zeros(1), LANDMARK[None])
    assert judge(tied(click, LANDMARK, rng), []).is_accepted
    wrong = judge(tied(click, LANDMARK + [80.0, 0.0, 0.0], rng), [])
    assert not wrong.is_accepted
    assert 60.0 < wrong.misses_m < 100.0
    assert 5.0 < wrong.allowed_m < 40.0


def test_a_tie_is_judged_by_the_ties_before_it() -> None:
    """Twelve metres may be the session's error; not when a tie has just shown that it is another."""
    rng = np.random.default_rng(15)
    clicks = sightings(rng, np.array([0.0, 1.0]), np.array([LANDMARK, TARGET]))
    first = tied(clicks[0], LANDMARK, None)
    found = fuse([clicks[1]], [first])
    assert found.height_ellipsoid_m is not None
    here = np.asarray(ORIGIN.to_enu(found.lat_deg, found.lon_deg, found.height_ellipsoid_m))
    alone = fuse([clicks[1]])
    assert alone.height_ellipsoid_m is not None
    untied = np.asarray(ORIGIN.to_enu(alone.lat_deg, alone.lon_deg, alone.height_ellipsoid_m))
    away = (untied - here) * [1.0, 1.0, 0.0]
    away *= 12.0 / np.linalg.norm(away)
    assert judge(tied(clicks[1], here, None), [first]).is_accepted
    second = tied(clicks[1], here + away, None)
    assert judge(second, []).chi2 < judge(second, [first]).chi2
    assert not judge(tied(clicks[1], here + 2.0 * away, None), [first]).is_accepted


def test_a_tie_says_nothing_of_other_sessions_and_vehicles() -> None:
    rng = np.random.default_rng(16)
    clicks = sightings(rng, np.array([0.0, 1.0]), np.array([LANDMARK, TARGET]))
    tie = tied(clicks[0], LANDMARK, rng)
    for other in (dataclasses.replace(clicks[1], vehicle="other"), dataclasses.replace(clicks[1], session=8)):
        before, after = fuse([other]), fuse([other], [tie])
        assert after.lat_deg == before.lat_deg and after.tied == 0


def test_a_tie_without_a_height_leaves_the_height_and_moves_the_place() -> None:
    rng = np.random.default_rng(17)
    clicks = sightings(rng, np.array([0.0, 1.0]), np.array([LANDMARK, TARGET]))
    tie = dataclasses.replace(tied(clicks[0], LANDMARK, rng), height_m=None, sigma_height_m=None)
    assert judge(tie, []).freedom == 2
    place = fuse([clicks[1]], [tie])
    full = fuse([clicks[1]], [tied(clicks[0], LANDMARK, rng)])
    assert full.sigma_height_m < place.sigma_height_m


@pytest.mark.parametrize(
    "change",
    [
        {"sigma_m": 0.0}, {"sigma_m": float("nan")}, {"datum": "egm"}, {"lat_deg": 91.0}, {"sigma_height_m": None},
        {"click": PinClick.entered(1.0, 2.0, sigma_m=3.0)},
    ],
)  # fmt: skip
def test_a_tie_that_makes_no_sense_is_refused(change: dict[str, object]) -> None:
    (click,) = sightings(np.random.default_rng(18), np.zeros(1), LANDMARK[None])
    tie = dataclasses.replace(tied(click, LANDMARK, None), **change)
    with pytest.raises(InputError):
        Tie.from_dict(tie.to_dict())
