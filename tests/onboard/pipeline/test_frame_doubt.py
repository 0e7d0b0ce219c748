"""A window that fits alone among windows of stabilised video is refused; two in a row are answers again."""

from __future__ import annotations

from contract.feature_set import Status
from onboard.pipeline.window_doubt import FrameDoubt


def denied(*statuses: Status) -> list[bool]:
    doubt = FrameDoubt()
    return [doubt.denies(status) for status in statuses]


def test_windows_that_fit_are_never_denied_before_any_was_stabilised() -> None:
    assert not any(denied(Status.OK, Status.POOR_FIT, Status.OK, Status.ZOOMED, Status.OK, Status.STARTING, Status.OK))


def test_one_that_fits_among_stabilised_ones_is_denied_and_the_second_in_a_row_ends_the_doubt() -> None:
    assert denied(
        Status.STABILISED, Status.OK, Status.STABILISED, Status.OK, Status.OK, Status.POOR_FIT, Status.OK
    ) == [
        False,
        True,
        False,
        True,
        False,
        False,
        False,
    ]


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
