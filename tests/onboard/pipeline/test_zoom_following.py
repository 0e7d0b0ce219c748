"""What is told of a zoom: when the lens moves, where it stands then, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from contract.camera import Camera
from contract.zoom_table import ZoomTable
from onboard.events.types import Zoom
from onboard.pipeline.zoom_following import LATE_NS, SAME, ZoomFollowing

S = 1_000_000_000
WIDE = Camera.from_field_of_view(640, 480, 70.0)
F = WIDE.focal_px
ROWS = ((1.0, 6.0), (F, 6.0 * F), (WIDE.cx_px,) * 2, (WIDE.cy_px,) * 2, (0.0, 0.0))
LENS = replace(WIDE, stated_zoom=ZoomTable("times", *ROWS))
LATE_S = LATE_NS / S


def fed(*reports: tuple[float, float], camera: Camera = LENS, unit: str = "times", step: float = 0.0) -> ZoomFollowing:
    out = ZoomFollowing(camera, 0.005)
    for moment_s, value in reports:
        out.note(Zoom(round(moment_s * S), value, unit, step))  # type: ignore[arg-type]
    return out


def test_a_lens_of_which_nothing_is_told_and_one_that_stands_are_left_alone() -> None:
    for zoom in (fed(), fed((0.0, 1.0), (1.0, 1.0), (2.0, 1.0 + 0.5 * SAME))):
        assert not zoom.is_moving(2 * S) and zoom.stands(9 * S) is None


def test_it_moves_while_reports_change_and_for_as_long_as_they_may_be_late_before_and_after() -> None:
    zoom = fed((0.0, 1.0), (10.0, 1.0), (10.1, 1.5), (10.2, 2.0), (10.3, 2.0), (10.4, 2.0))
    for moment_s, moving in ((9.7, False), (9.8, True), (10.2, True), (10.5, True), (10.6, False)):
        assert zoom.is_moving(round(moment_s * S)) is moving, moment_s
    assert zoom.stands(round((10.2 + LATE_S) * S)) is None
    stands = zoom.stands(round((10.2 + LATE_S) * S) + 1)
    assert stands is not None and stands[0].focal_px == pytest.approx(2.0 * F)
    assert stands[1] == pytest.approx(math.hypot(0.005, SAME))
    assert zoom.stands(20 * S) is None and not zoom.is_moving(round(10.2 * S))  # told once


def test_the_first_report_counts_where_it_is_another_than_the_file() -> None:
    zoom = fed((0.0, 3.0))
    assert zoom.is_moving(0)
    stands = zoom.stands(S)
    assert stands is not None and stands[0].focal_px == pytest.approx(3.0 * F)
    assert fed((0.0, 1.0)).stands(S) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, -2.0, 0.0, 400.0])
def test_what_is_no_zoom_tells_nothing(bad: float) -> None:
    zoom = fed((0.0, 1.0), (1.0, bad), (2.0, 1.0))
    assert zoom.unusable == 1 and not zoom.is_moving(2 * S) and zoom.stands(9 * S) is None


def test_reports_that_come_twice_or_run_backwards_are_passed_over() -> None:
    zoom = fed((5.0, 1.0), (5.0, 2.0), (4.0, 3.0))
    assert not zoom.is_moving(5 * S) and zoom.stands(9 * S) is None


def test_a_step_is_an_error_of_any_size_within_it() -> None:
    for position, step in ((2.0, 0.1), (6.0, 0.1)):
        stands = fed((0.0, 1.0), (1.0, position), step=step).stands(9 * S)
        assert stands is not None
        expected = math.hypot(math.hypot(0.005, SAME), step / position / math.sqrt(12.0))
        assert stands[1] == pytest.approx(expected, rel=0.02)


def test_percent_focal_length_and_field_of_view_tell_the_same_lens() -> None:
    percent = replace(WIDE, stated_zoom=ZoomTable("percent", (0.0, 100.0), *ROWS[1:]))
    hfov = math.degrees(2.0 * math.atan(0.5 * 640 / (3.0 * F)))
    told = [
        fed((0.0, 100.0 * math.log(3.0) / math.log(6.0)), camera=percent, unit="percent"),
        fed((0.0, 3.0 * F), unit="focal_px"),
        fed((0.0, hfov), unit="hfov_deg"),
        fed((0.0, 3.0 * F), camera=WIDE, unit="focal_px"),  # a file without a table
    ]
    for zoom in told:
        stands = zoom.stands(9 * S)
        assert stands is not None and stands[0].focal_px == pytest.approx(3.0 * F)
    for zoom in (
        fed((0.0, 50.0), unit="percent"),
        fed((0.0, 3.0), camera=WIDE),
        fed((0.0, 180.0), unit="hfov_deg"),
        fed((0.0, hfov), camera=WIDE, unit="hfov_deg"),  # of a lens that does not zoom: somebody's parameter
    ):
        assert zoom.unusable == 1 and zoom.stands(9 * S) is None


def test_of_two_who_tell_differently_the_better_counts_until_it_is_silent() -> None:
    zoom = fed((0.0, 1.0))
    for tenth in range(1, 50):  # an autopilot whose parameter says 30 degrees, whatever the lens does
        zoom.note(Zoom(tenth * S // 10, 30.0, "hfov_deg"))
        zoom.note(Zoom(tenth * S // 10 + 1, 1.0, "times"))
    assert not zoom.is_moving(4 * S) and zoom.stands(9 * S) is None
    zoom.note(Zoom(8 * S, 30.0, "hfov_deg"))
    assert zoom.is_moving(8 * S)
