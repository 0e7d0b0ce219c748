"""Windows that are doubted although they fit.

A lens that nobody has seen zoom, after a sudden loss, until the ground is as deep as it was; a window that fits alone
among those of stabilised video, until two in a row do.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np

from contract.feature_set import Status
from onboard.navigation.limits import LONG_NS
from onboard.pipeline.window_doubt import FrameDoubt, LensDoubt

S = 1_000_000_000


def window(moment_s: float, depth_m: float, up_m: float = 250.0, east_m: float = 0.0, slope: float = 0.0) -> Any:
    points = np.array([[east_m, 0.0, up_m - depth_m + d] for d in (-3.0, 0.0, 4.0)])
    newest = SimpleNamespace(centre_enu_m=np.array([0.0, 0.0, up_m]), nav=SimpleNamespace(stamp_ns=round(moment_s * S)))
    solution = SimpleNamespace(state=SimpleNamespace(points_enu_m=points))
    plane = np.array([up_m - depth_m - slope * east_m, slope, 0.0])
    return SimpleNamespace(keyframes=(newest,), solution=solution, plane=plane)


def flown(held: float = 0.9, overlap: float = 0.9, slope: float = 0.0) -> LensDoubt:
    """A window at 200 m, good tracking, and then nothing any more at 10 s."""
    doubt = LensDoubt()
    assert not doubt.denies(window(9.0, 200.0, slope=slope))
    doubt.tracked(round(100 * held), 100)
    doubt.tracked(3, 100)  # one picture in the middle of the zoom
    doubt.lost(10 * S, overlap)
    return doubt


def test_a_ground_that_looks_six_times_as_near_is_a_zoom_for_as_long_as_it_does() -> None:
    doubt = flown()
    assert doubt.is_open
    for moment_s in (12.0, 20.0, 200.0):
        assert "6.1 times as near" in doubt.denies(window(moment_s, 33.0)) and doubt.is_open
    assert not doubt.denies(window(201.0, 190.0)) and not doubt.is_open


def test_a_ground_as_high_as_before_settles_it_however_high_the_aircraft_is() -> None:
    doubt = flown()
    assert not doubt.denies(window(12.0, 550.0, up_m=620.0)) and not doubt.is_open  # it has climbed
    assert not doubt.denies(window(13.0, 33.0))  # nothing was lost since


def test_a_valley_that_looks_nearer_as_its_slope_leads_to_is_no_zoom() -> None:
    """Recorded: 62 m above one place, 45 m above the next; the level before alone says 1.4 times as near."""
    assert not flown(slope=0.1).denies(window(12.0, 140.0, east_m=500.0))
    assert "1.4 times as near" in flown().denies(window(12.0, 140.0, east_m=500.0))
    assert "6.1 times as near" in flown(slope=0.1).denies(window(12.0, 33.0))


def test_what_fades_or_leaves_the_picture_is_no_zoom() -> None:
    for doubt in (flown(held=0.3), flown(overlap=0.3)):
        assert not doubt.is_open and not doubt.denies(window(12.0, 33.0))


def test_a_window_long_after_has_other_ground_and_being_told_ends_it() -> None:
    later = flown()
    assert not later.denies(window(10.1 + 2 * LONG_NS / S, 33.0)) and not later.is_open
    elsewhere = flown()
    elsewhere.ground = None
    assert not elsewhere.denies(window(12.0, 33.0))
    told = flown()
    told.is_open = False
    assert not told.denies(window(12.0, 33.0))


def denied(*statuses: Status) -> list[bool]:
    doubt = FrameDoubt()
    return [doubt.denies(status) for status in statuses]


def test_windows_that_fit_are_never_denied_before_any_was_stabilised() -> None:
    assert not any(denied(Status.OK, Status.POOR_FIT, Status.OK, Status.ZOOMED, Status.OK, Status.STARTING, Status.OK))


def test_one_that_fits_among_stabilised_ones_is_denied_and_the_second_in_a_row_ends_the_doubt() -> None:
    assert denied(
        Status.STABILISED, Status.OK, Status.STABILISED, Status.OK, Status.OK, Status.POOR_FIT, Status.OK
    ) == [False, True, False, True, False, False, False]


def test_what_says_nothing_does_not_count_as_agreement() -> None:
    """A restart in the turn, as on a recording: a young window then fitted, and its clicks were off by 3.7 radii."""
    assert denied(Status.STABILISED, Status.STARTING, Status.OK, Status.POOR_FIT, Status.OK, Status.OK) == [
        False,
        False,
        True,
        False,
        True,
        False,
    ]
