"""Each bound of the table of scenarios can fail: on a flight of ten pictures with known clicks."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from tests.scenarios.flights import CHI2_90, Outcome
from tests.scenarios.scenario import Expected, either, refused, solved

CAMERA = Camera.from_field_of_view(320, 240, 40.0)
OK, STARTING, NO_GPS, LOW_PARALLAX = Status.OK, Status.STARTING, Status.NO_GPS, Status.LOW_PARALLAX


def outcome(statuses: list[Status], ratios: list[float], **changed: object) -> Outcome:
    """Clicks with an error of 3 m and these ratios to their 90 % ellipses of 5 m, and two that are refused."""
    sets = {k: FeatureSet("uav", 1, k, k, status, CAMERA) for k, status in enumerate(statuses)}
    count = len(ratios)
    plain = Outcome(
        sets, Counter({Status.UNCERTAIN: 2}), Counter({"plane": count}), np.full(count, 3.0),
        CHI2_90 * np.square(ratios), np.full(count, 5.0), None,
    )  # fmt: skip
    return replace(plain, **changed)


FLIGHT = outcome([STARTING, *[OK] * 7, NO_GPS, OK], [0.5] * 8)
WIDE = outcome([STARTING, *[OK] * 7, NO_GPS, OK], [0.5] * 6 + [2.0] * 2)
NONE = outcome([STARTING, STARTING, *[LOW_PARALLAX] * 8], [])


@pytest.mark.parametrize(
    ("flight", "holds", "fails"),
    [
        (FLIGHT, solved(0.8), solved(0.9)),
        (FLIGHT, Expected(solved=(0.0, 0.8)), Expected(solved=(0.0, 0.79))),
        (FLIGHT, Expected(answered=0.8), Expected(answered=0.81)),
        (FLIGHT, Expected(), replace(Expected(), refuses_clicks=True)),
        (WIDE, Expected(inside_99=0.7), Expected(inside_99=0.76)),
        (WIDE, Expected(inside_99=0.7, worst=2.1), Expected(inside_99=0.7, worst=1.9)),
        (FLIGHT, Expected(median_m=3.1), Expected(median_m=2.9)),
        (FLIGHT, Expected(semi_m=(4.9, 5.1)), Expected(semi_m=(5.1, 9.0))),
        (FLIGHT, Expected(semi_m=(4.9, 5.1)), Expected(semi_m=(0.0, 4.9))),
        (FLIGHT, either(NO_GPS), either(LOW_PARALLAX)),
        (FLIGHT, Expected(starting=0.2), Expected(starting=0.1)),
        (FLIGHT, Expected(some=(NO_GPS,)), Expected(some=(LOW_PARALLAX,))),
        (FLIGHT, Expected(counts={NO_GPS: (1, 1)}), Expected(counts={NO_GPS: (2, 9)})),
        (FLIGHT, Expected(stretches=((1, 8, OK),)), Expected(stretches=((0, 8, OK),))),
        (FLIGHT, Expected(ok_from=(1, 0.8)), Expected(ok_from=(1, 0.9))),
        (FLIGHT, Expected(refused_clicks={Status.UNCERTAIN: 0.1}), Expected(refused_clicks={Status.UNCERTAIN: 0.3})),
        (FLIGHT, Expected(methods={"plane": 1.0}), Expected(methods={"terrain": 0.1})),
        (NONE, refused(LOW_PARALLAX), refused(NO_GPS)),
        (NONE, refused(LOW_PARALLAX), refused(LOW_PARALLAX, starting=0.1)),
        (NONE, either(LOW_PARALLAX), Expected(reasons=(LOW_PARALLAX,))),  # fails where nothing was answered
        (NONE, refused(LOW_PARALLAX), solved(0.0)),
        (NONE, replace(refused(LOW_PARALLAX), settles=(LOW_PARALLAX, 2)),
         replace(refused(LOW_PARALLAX), settles=(LOW_PARALLAX, 1))),
    ],
)  # fmt: skip
def test_a_bound_holds_where_it_is_kept_and_fails_where_it_is_not(
    flight: Outcome, holds: Expected, fails: Expected
) -> None:
    holds.check(flight)
    with pytest.raises(AssertionError):
        fails.check(flight)
