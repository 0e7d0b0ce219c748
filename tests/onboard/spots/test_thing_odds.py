"""The odds of a thing by all looks at a place, on looks sampled from the law itself. (25.14) to (25.17)"""

from functools import cache

import numpy as np
import pytest
from scipy.special import ndtri

from contract.spot import ThingKind
from onboard.spots.thing_odds import MISSED, Again, PlaceOdds, ScoreLaw, read_laws

GATE_MPX, PIXEL_M = 3e-4, 0.1
GATE_KM2 = GATE_MPX * PIXEL_M**2
LAW = ScoreLaw(
    np.array([0.05, 0.2, 0.4, 0.6, 1.0]), np.array([0.05, 0.15, 0.3, 0.3]), np.array([40.0, 4.0, 0.4, 0.02]),
    Again(0.5, 0.05), Again(0.85, 0.25), 2.0,
)  # fmt: skip


def odds_of(classes: list[int], law: ScoreLaw = LAW, rate: float = 1.0) -> float:
    odds = PlaceOdds(law)
    for score_class in classes:
        odds.look(score_class, GATE_MPX, GATE_KM2, rate)
    return odds.log_km2


@cache
def sampled(is_thing: bool, places: int, looks: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes (places, looks), and ln of the odds in km2 after each look: of places whose first look has a peak."""
    rng = np.random.default_rng([is_thing, looks])
    again = LAW.found_again if is_thing else LAW.false_again
    shared = again.shared
    each = (
        LAW.found
        if is_thing
        else -np.diff(-np.expm1(-GATE_MPX * np.append(np.cumsum(LAW.false_per_mpx[::-1])[::-1], 0)))
    )
    reached = np.cumsum(each[::-1])[::-1] / (1.0 - again.lost)
    cuts = -ndtri(reached)
    # The first look's latent variate is sampled beyond the least peak's cut, the others given what they share with it.
    first = -ndtri(rng.uniform(0.0, reached[0], places))
    common = np.sqrt(shared) * first + np.sqrt(1.0 - shared) * rng.normal(size=places)
    rest = np.sqrt(shared) * common[:, None] + np.sqrt(1.0 - shared) * rng.normal(size=(places, looks - 1))
    classes = np.searchsorted(cuts, np.column_stack([first, rest])) - 1
    classes[:, 1:][rng.uniform(size=(places, looks - 1)) < again.lost] = MISSED
    logs = np.zeros((places, looks))
    for k in range(places):
        odds = PlaceOdds(LAW)
        for look in range(looks):
            odds.look(int(classes[k, look]), GATE_MPX, GATE_KM2, 1.0)
            logs[k, look] = odds.log_km2
    return classes, logs


def test_one_look_is_the_share_found_over_the_false_of_a_square_kilometre() -> None:
    for k in range(len(LAW.found)):
        assert np.isclose(np.exp(odds_of([k])), LAW.found[k] * PIXEL_M**2 / LAW.false_per_mpx[k], rtol=0.02)
    assert np.isclose(odds_of([2], rate=3.0), odds_of([2]) - np.log(3.0), atol=0.02)


def test_looks_that_have_nothing_in_common_multiply_and_those_that_have_all_count_once() -> None:
    alone = ScoreLaw(LAW.edges, LAW.found, LAW.false_per_mpx, Again(0.0, 0.0), Again(0.0, 0.0), 2.0)
    in_gate = LAW.false_per_mpx[2] * GATE_MPX
    assert np.isclose(odds_of([2, 2], alone) - odds_of([2], alone), np.log(LAW.found[2] / in_gate), atol=0.02)
    same = ScoreLaw(LAW.edges, LAW.found, LAW.false_per_mpx, Again(0.98, 0.0), Again(0.98, 0.0), 2.0)
    assert abs(odds_of([2] * 5, same) - odds_of([2], same)) < 0.5


def test_a_look_that_shows_nothing_speaks_against_a_thing() -> None:
    for first in (0, 3):
        assert np.all(np.diff([odds_of([first] + [MISSED] * n) for n in range(4)]) < -0.05)
    assert np.isclose(odds_of([MISSED, 3]), odds_of([3, MISSED]), atol=1e-9)  # in any order


@pytest.mark.parametrize("looks", [4])
def test_ground_that_resembles_a_thing_reaches_c_in_fewer_than_1_in_c_places_a_km2(looks: int) -> None:
    """Ville's bound, whenever one stops; and the odds are no looser than a few times that."""
    _, logs = sampled(False, 4000, looks)
    per_km2 = GATE_MPX * LAW.false_per_mpx.sum() / GATE_KM2  # places whose first look has a peak
    for c in (3e-3, 3e-2):
        reached = per_km2 * float((logs.max(axis=1) > np.log(c)).mean())
        assert reached < 1.15 / c
    assert per_km2 * float((logs.max(axis=1) > np.log(3e-3)).mean()) > 0.02 / 3e-3


def test_of_places_stated_to_be_likely_so_many_are_things() -> None:
    """Things and ground mixed as densely as the prior has them: calibrated in each fifth that holds enough."""
    _, things = sampled(True, 2000, 3)
    _, ground = sampled(False, 8000, 3)
    things_km2 = 2000 / LAW.found.sum() / 3.0
    area_km2 = 8000 * GATE_KM2 / -np.expm1(-GATE_MPX * LAW.false_per_mpx.sum())
    density = things_km2 * 3.0 / area_km2
    p = [1.0 / (1.0 + np.exp(-logs[:, -1]) / density) for logs in (things, ground)]
    judged = 0
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        inside = [float(((q >= low) & (q < low + 0.2)).sum()) for q in p]
        if sum(inside) < 150:
            continue
        stated = float(np.concatenate([q[(q >= low) & (q < low + 0.2)] for q in p]).mean())
        share = inside[0] / sum(inside)
        assert abs(share - stated) < 0.02 + 3.0 * np.sqrt(stated * (1 - stated) / sum(inside))
        judged += 1
    assert judged >= 3


@pytest.mark.parametrize("kind", ThingKind)
def test_one_look_without_a_peak_neither_rules_a_clear_thing_out_nor_speaks_for_it(kind: ThingKind) -> None:
    """Whatever share of lost looks the calibration's pairs happen to have: none, where those of ground have many."""
    law = read_laws()[kind]
    for k in range(len(law.found)):
        changed = odds_of([k, MISSED], law) - odds_of([k], law)
        assert -np.log(4000.0) < changed < 0.6


def test_the_calibration_of_the_weights_is_a_law_for_each_kind() -> None:
    laws = read_laws()
    assert set(laws) == set(ThingKind)
    for law in laws.values():
        assert len(law.edges) == len(law.found) + 1 == len(law.false_per_mpx) + 1
        assert np.all(np.diff(law.edges) > 0.0) and np.all(law.found >= 0.0) and 0.3 < law.found.sum() <= 1.0
        assert np.all(law.false_per_mpx > 0.0) and law.flights > 0.0
        assert np.all(np.diff(np.log(law.found / law.false_per_mpx)) >= -1e-3)  # a higher score is never less likely
        assert 0.0 <= law.found_again.shared < 1.0 and 0.0 <= law.found_again.lost < 0.7
        assert 0.5 < law.false_again.shared < 1.0 and 0.0 <= law.false_again.lost < 0.7  # once like a thing, so again
        assert law.class_of(1.0) == len(law.found) - 1 and law.class_of(0.0) == MISSED
