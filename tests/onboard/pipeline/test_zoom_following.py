"""What is told of a zoom: when the lens moves, where it stands then, and how well that is known."""

import math
from dataclasses import replace

import pytest

from contract.camera import Camera
from contract.zoom_table import ZoomTable
from onboard.events.types import Zoom
from onboard.navigation.limits import LATE_NS, LIKELY_SIGMAS, RECENT_NS
from onboard.pipeline.zoom_following import SAME, ZoomFollowing

S = 1_000_000_000
WIDE = Camera.from_field_of_view(640, 480, 70.0)
F = WIDE.focal_px
ROWS = ((1.0, 6.0), (F, 6.0 * F), (WIDE.cx_px,) * 2, (WIDE.cy_px,) * 2, (0.0, 0.0))
LENS = replace(WIDE, stated_zoom=ZoomTable("times", *ROWS))
LATE_S, SILENT_S = LATE_NS / S, RECENT_NS / S


def fed(
    *reports: tuple[float, float],
    camera: Camera = LENS,
    unit: str = "times",
    step: float = 0.0,
    offset: tuple[float, float] = (0.0, 0.0),
    is_of_picture: bool = False,
) -> ZoomFollowing:
    out = ZoomFollowing(camera, 0.005)
    for moment_s, value in reports:
        out.note(Zoom(round(moment_s * S), value, unit, step, is_of_picture), *offset)
    return out


@pytest.mark.parametrize(
    "reports",
    [
        pytest.param([], id="nothing"),
        pytest.param([(0.0, 1.0), (1.0, 1.0), (2.0, 1.0 + 0.5 * SAME)], id="a lens that stands"),
        pytest.param([(5.0, 1.0), (5.0, 2.0), (4.0, 3.0)], id="twice and backwards"),
        *([(0.0, 1.0), (1.0, bad), (2.0, 1.0)] for bad in (math.nan, math.inf, -2.0, 0.0, 400.0)),
    ],
)
def test_a_lens_of_which_no_zoom_is_reported_is_left_alone(reports: list[tuple[float, float]]) -> None:
    zoom = fed(*reports)
    assert not zoom.is_moving(2 * S) and not zoom.is_moving(5 * S) and zoom.stands(9 * S) is None


def moves(zoom: ZoomFollowing, first_s: float, last_s: float) -> bool:
    inside = all(zoom.is_moving(round(s * S)) for s in (first_s + 0.01, 0.5 * (first_s + last_s), last_s - 0.01))
    return inside and not any(zoom.is_moving(round(s * S)) for s in (first_s - 0.01, last_s + 0.01))


def test_it_may_move_since_the_last_report_of_before_and_for_as_long_as_reports_may_be_late() -> None:
    zoom = fed((0.0, 1.0), (9.8, 1.0), (10.1, 1.5), (10.2, 2.0), (10.3, 2.0), (10.4, 2.0))
    assert moves(zoom, 9.8 - LATE_S, 10.2 + LATE_S)
    assert zoom.stands(round((10.2 + LATE_S) * S)) is None
    stands = zoom.stands(round((10.2 + LATE_S) * S) + 1)
    assert stands[0].focal_px == pytest.approx(2.0 * F)
    assert stands[1] == pytest.approx(math.hypot(0.005, SAME))
    assert zoom.stands(20 * S) is None and not zoom.is_moving(round(10.2 * S))  # told once


def test_a_lens_stands_once_a_report_confirms_it_or_no_more_come() -> None:
    changing = (0.0, 1.0), (9.9, 1.0), (10.0, 1.5)
    assert moves(fed(*changing), 9.9 - LATE_S, 10.0 + SILENT_S)
    assert moves(fed(*changing, (10.8, 1.5)), 9.9 - LATE_S, 10.0 + LATE_S)  # some were lost
    assert moves(fed(*changing, (10.8, 2.0), (10.9, 2.0)), 9.9 - LATE_S, 10.8 + 0.8)  # it took as long


def test_who_tells_of_changes_only_is_believed_to_tell_them_soon() -> None:
    assert moves(fed((0.0, 1.0), (600.0, 2.0)), 600.0 - LATE_S - SILENT_S, 600.0 + SILENT_S)


def test_a_slow_zoom_told_in_steps_moves_between_them() -> None:
    """A step each 0.8 s, told ten times a second."""
    reports = [(0.1 * k, 1.0 + 0.1 * min(k // 8, 4)) for k in range(100)]
    zoom = fed(*reports[:25], step=0.1)
    assert zoom.is_moving(round(2.39 * S)) and zoom.stands(round(2.39 * S)) is None
    assert moves(fed(*reports, step=0.1), 0.7 - LATE_S, 3.2 + 0.8)


@pytest.mark.parametrize(("offset_s", "sigma_s"), [(0.0, 0.0), (0.2, 0.0), (-0.1, 0.05), (0.0, 0.29)])
def test_pictures_may_be_stamped_by_another_clock_than_reports(offset_s: float, sigma_s: float) -> None:
    """A picture's moment is its stamp plus the offset; a report of the camera's own has a picture's stamp."""
    reports = (0.0, 1.0), (9.9, 1.0), (10.0, 1.5), (10.1, 1.5)
    apart_s = LIKELY_SIGMAS * sigma_s
    zoom = fed(*reports, offset=(offset_s, sigma_s))
    assert moves(zoom, 9.9 - LATE_S - offset_s - apart_s, 10.0 + LATE_S - offset_s + apart_s)
    own = fed(*reports, offset=(offset_s, sigma_s), is_of_picture=True)
    assert moves(own, 9.9 - LATE_S, 10.0 + LATE_S)


def test_the_first_report_counts_where_it_is_another_than_the_file() -> None:
    zoom = fed((0.0, 3.0))
    assert zoom.is_moving(0)
    stands = zoom.stands(3 * S)
    assert stands[0].focal_px == pytest.approx(3.0 * F)
    assert fed((0.0, 1.0)).stands(3 * S) is None


def test_a_step_is_an_error_of_any_size_within_it() -> None:
    for position, step in ((2.0, 0.1), (6.0, 0.1)):
        stands = fed((0.0, 1.0), (1.0, position), step=step).stands(9 * S)
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
        assert stands[0].focal_px == pytest.approx(3.0 * F)
    for zoom in (
        fed((0.0, 50.0), unit="percent"),
        fed((0.0, 3.0), camera=WIDE),
        fed((0.0, 180.0), unit="hfov_deg"),
        fed((0.0, hfov), camera=WIDE, unit="hfov_deg"),  # of a lens that does not zoom: somebody's parameter
    ):
        assert zoom.stands(9 * S) is None


def test_of_two_who_tell_differently_the_better_counts_until_it_is_silent() -> None:
    zoom = fed((0.0, 1.0))
    for tenth in range(1, 50):  # an autopilot whose parameter says 30 degrees, whatever the lens does
        zoom.note(Zoom(tenth * S // 10, 30.0, "hfov_deg"))
        zoom.note(Zoom(tenth * S // 10 + 1, 1.0, "times"))
    assert not zoom.is_moving(4 * S) and zoom.stands(9 * S) is None
    zoom.note(Zoom(8 * S, 30.0, "hfov_deg"))
    assert zoom.is_moving(8 * S)
