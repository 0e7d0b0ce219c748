"""Pictures spoilt by lens, air, compression or camera, for a stretch of the flight or all of it: refused, or held."""

from dataclasses import dataclass, replace

import cv2
import pytest

from contract.feature_set import Status
from onboard.vision.contrast_normalisation import Picture
from simulation.session import SessionSpec
from tests.scenarios import sessions
from tests.scenarios.flights import Outcome, click, play, retouched, simulated
from tests.scenarios.spoiling import Change, blur, dirt, fog, jpeg, picture, smeared_along

# Long enough to begin again after the spoilt third and be answered again.
LEG, LARGE = replace(sessions.LEG, seconds=10.0), replace(sessions.LARGE, seconds=8.0)
ANSWERED, EITHER, REFUSED = "answered", "either", "refused"


@dataclass(frozen=True)
class Case:
    """A degradation and what becomes of its pictures, small (320 px) ones unless said."""

    change: Change
    verdict: str
    spec: SessionSpec = LEG


CASES = {
    "blur of 2": Case(blur(2.0), ANSWERED),
    "blur of 4": Case(blur(4.0), ANSWERED),
    "blur of 8": Case(blur(8.0), EITHER),
    "blur of 12": Case(blur(12.0), REFUSED),
    "blur of 20": Case(blur(20.0), REFUSED),
    "blur of 2, large": Case(blur(2.0), ANSWERED, LARGE),
    "blur of 8, large": Case(blur(8.0), ANSWERED, LARGE),
    "blur of 12, large": Case(blur(12.0), EITHER, LARGE),
    "blur of 20, large": Case(blur(20.0), REFUSED, LARGE),
    "10 px of motion": Case(smeared_along(10, False), ANSWERED),
    "20 px of motion": Case(smeared_along(20, True), ANSWERED),
    "40 px of motion": Case(smeared_along(40, False), ANSWERED),
    "JPEG of quality 5": Case(jpeg(5), EITHER),
    "JPEG of quality 20": Case(jpeg(20), ANSWERED),
    "blurred, then JPEG": Case(lambda image: jpeg(50)(blur(8.0)(image)), REFUSED),
    "bilateral filter": Case(lambda image: picture(cv2.bilateralFilter(image, 15, 60.0, 15.0)), ANSWERED),
    "median filter": Case(lambda image: picture(cv2.medianBlur(image, 15)), ANSWERED),
    "fog": Case(fog, ANSWERED),
    "dirt on the lens": Case(dirt, ANSWERED),
}


# Milder than another that is answered, or worse than another that is refused.
CLEAR = {"blur of 2", "blur of 20", "blur of 2, large", "blur of 20, large", "10 px of motion", "20 px of motion"}
# May be answered or refused, as another that is shown.
OPEN = {"blur of 12, large", "JPEG of quality 5"}
# As others that a filter or a lens softens: the bilateral one, 40 px of motion, and a blur of 12 without JPEG.
SOFTENED = {"median filter", "blur of 4", "blurred, then JPEG"}
# As the bilateral filter, and dirt on the lens, hide a part of what there is.
COVERED = {"JPEG of quality 20", "fog"}
# As half of it in pictures half as large.
SCALED = {"blur of 8, large"}
NAMES = [
    pytest.param(name, marks=pytest.mark.long) if name in CLEAR | OPEN | SOFTENED | SCALED | COVERED else name
    for name in CASES
]
# One that is answered and one that is refused: the kinds differ in what they do to a picture, which the flights spoilt
# for a third show too.
FROM_THE_START = ("blur of 12", "40 px of motion")
NAMES_FROM_THE_START = [n if n in FROM_THE_START else pytest.param(n, marks=pytest.mark.long) for n in CASES]


def holds(outcome: Outcome, spoilt: range, verdict: str, may_miss: int) -> None:
    """The truth is inside, and the spoilt pictures are answered or refused as they should be."""
    assert outcome.is_honest(), outcome.reported
    statuses = [outcome.sets[frame].status for frame in spoilt]
    answered = statuses.count(Status.OK)
    if verdict is ANSWERED:
        assert answered >= len(spoilt) - may_miss, outcome.reported
    if verdict is REFUSED:
        assert answered == 0, outcome.reported
        assert set(statuses) <= {Status.FEATURELESS, Status.STARTING, Status.POOR_FIT}, outcome.reported
        assert statuses.count(Status.FEATURELESS) > 0.7 * len(spoilt), outcome.reported


@pytest.mark.parametrize("name", NAMES_FROM_THE_START)
def test_spoilt_from_the_start(name: str) -> None:
    case = CASES[name]
    outcome = play(retouched(simulated(case.spec), case.change))
    holds(outcome, range(len(outcome.sets)), case.verdict, may_miss=2)


@pytest.mark.parametrize("name", NAMES)
def test_spoilt_in_mid_flight(name: str) -> None:
    """A third of the flight. Two pictures are lost where sharp ones are no match for spoilt ones; then again after."""
    case = CASES[name]
    folder = simulated(case.spec)
    count = round(case.spec.seconds * case.spec.rate_hz)
    spoilt = range(count // 3, 2 * count // 3)
    outcome = play(retouched(folder, case.change, spoilt))
    holds(outcome, spoilt, case.verdict, may_miss=3)
    for stretch in (range(spoilt.start), spoilt, range(spoilt.stop, count)):
        part = click(folder, {frame: outcome.sets[frame] for frame in stretch}, None)
        may_be_none = stretch == spoilt and case.verdict is not ANSWERED
        assert part.is_honest() if may_be_none else part.inside_99 >= 0.97, part.reported
    sharp = [outcome.sets[frame].status for frame in range(count) if frame not in spoilt]
    assert sharp.count(Status.OK) >= len(sharp) - 3, outcome.reported


@pytest.mark.parametrize(
    "spec", [pytest.param(LEG, id="small"), pytest.param(LARGE, id="large", marks=pytest.mark.long)]
)
def test_a_picture_repeated_in_other_bytes_is_bad(spec: SessionSpec) -> None:
    """A driver that encodes its last picture again: bad picture, until there are new ones."""
    held: list[Picture] = []

    def repeated(image: Picture) -> Picture:
        held.append(held[0] if held else image)
        return jpeg(60 + len(held))(held[0])

    outcome = play(retouched(simulated(spec), repeated, range(10, 18)))
    statuses = [outcome.sets[frame].status for frame in range(round(spec.seconds * spec.rate_hz))]
    assert outcome.inside_99 >= 0.97, outcome.reported
    assert statuses[11:18] == [Status.BAD_PICTURE] * 7, outcome.reported
    assert statuses[:11] == [Status.OK] * 11, outcome.reported
    assert statuses[22:] == [Status.OK] * len(statuses[22:]), outcome.reported
