"""How much ground a pixel shows, what stands out of it, and how large it is."""

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.locate import Locator
from onboard.spots.contrast import contrast, in_picture
from onboard.spots.ground_scale import ground_scale
from onboard.spots.regions import about_peak, above, is_cut_off, peaks, region_of
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import BOSON, Scene, ThermalSpec, set_of

GROUND = np.ones((24, 32), bool)


def field(height: int = 240, width: int = 320, seed: int = 0) -> NDArray[np.float32]:
    return (290.0 + np.random.default_rng(seed).normal(0.0, 0.1, (height, width))).astype(np.float32)


def outline_px2(outline: NDArray[np.float64]) -> float:
    x, y = outline.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0])
def test_a_pixels_ground_is_what_clicks_next_to_it_say(tilt_deg: float) -> None:
    its_set = set_of(BOSON, Scene(ThermalSpec(), tilt_deg=tilt_deg).pose(0), 0)
    scale = ground_scale(its_set, (8, 10))
    u, v = (np.arange(10) + 0.5) * 64.0 - 0.5, (np.arange(8) + 0.5) * 64.0 - 0.5
    each = Locator(its_set).answers(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    by_click = np.abs(np.linalg.det(each.by_pixel_m[:, :2]))
    near = each.is_answered & (by_click < 1.0)
    assert near.sum() >= 40
    assert scale.pixel_m2.ravel()[near] == pytest.approx(by_click[near], rel=0.01)


def test_what_shows_no_ground_counts_for_none() -> None:
    flat = Scene(ThermalSpec(), tilt_deg=80.0).pose(0)
    scale = ground_scale(set_of(BOSON, flat, 0), (24, 32))
    assert not scale.is_ground[:6].any() and scale.is_ground[-6:].all()
    assert ground_scale(set_of(BOSON, flat, 0, Status.TURNING), (24, 32)) is None
    up = Pose(np.array([0.0, 0.0, 100.0]), np.eye(3))
    assert ground_scale(set_of(BOSON, up, 0), (24, 32)) is None


def test_a_warm_road_across_a_corner_of_the_picture_is_as_short_as_a_person_and_cut_off() -> None:
    row, column = np.mgrid[:240, :320]
    values = field()
    values[np.abs(row + column - 8.0) <= 2.5] += 3.0  # 11 pixels of it are in the picture
    values[100:104, 200:204] += 8.0
    c = contrast(values, GROUND, 0.6, 0.15)
    largest = contrast(values, GROUND, 2.4, 0.15)
    at = sorted((int(row), int(column)) for row, column in peaks(c, 10.0, 9))
    corner, thing = at[0], at[-1]
    assert sum(corner) < 12 and thing[0] > 70
    assert about_peak(c.excess, corner, 8, 4.0) is not None and about_peak(c.excess, thing, 8, 4.0) is not None
    assert is_cut_off(c, largest, corner, 24) and not is_cut_off(c, largest, thing, 24)
    assert not is_cut_off(c, largest, thing, 150)  # nor where the border is within reach


def test_a_corner_of_what_the_border_cuts_off_is_no_thing_although_it_is_whole_itself() -> None:
    values = field()
    values[222:, 100:112] += 15.0
    c = contrast(values, GROUND, 0.3, 0.15)
    largest = contrast(values, GROUND, 2.4, 0.15)
    wholes = [
        peak
        for peak in ((int(at[0]), int(at[1])) for at in peaks(c, 10.0, 9))
        if (part := about_peak(c.excess, peak, 4, 1.0)) is not None
        and part.up + np.nonzero(part.level > 0.0)[0].max() < 239
    ]
    assert wholes and all(is_cut_off(c, largest, peak, 24) for peak in wholes)


def test_the_middle_and_size_of_a_thing_are_found_below_a_pixel() -> None:
    values = field()
    values[100:106, 200:204] += 8.0
    values[100:106, 204] += 4.0  # half of a pixel more
    c = contrast(values, GROUND, 0.6, 0.15)
    peak = peaks(c, 10.0, 5)
    assert len(peak) >= 1
    part = about_peak(c.excess, tuple(peak[0]), 8, 4.0)
    assert part is not None
    region = region_of(c, part, 30.0)
    assert region.uv_px == pytest.approx([201.75, 102.5], abs=0.25)
    assert outline_px2(region.outline_px) == pytest.approx(27.0, rel=0.25)
    assert region.hottest == pytest.approx(298.0, abs=0.5) and region.above == pytest.approx(8.0, abs=0.5)
    assert not region.is_cut


def test_a_large_thing_is_as_large_in_a_coarser_picture() -> None:
    values = field()
    values[80:110, 100:140] += 5.0
    c = contrast(values, GROUND, 5.0, 0.15)
    assert c.times > 3.0
    peak = peaks(c, 5.0, 3)[0]
    part = about_peak(c.excess, tuple(peak), 5, 2.0)
    assert part is not None
    region = region_of(c, part, 9.0)
    assert region.uv_px == pytest.approx([119.5, 94.5], abs=0.25 * c.times)
    assert outline_px2(region.outline_px) == pytest.approx(1200.0, rel=0.25)


def test_what_goes_on_and_on_is_no_thing() -> None:
    road = field()
    road[118:122] += 8.0
    c = contrast(road, GROUND, 0.6, 0.15)
    tried = [about_peak(c.excess, tuple(peak), 8, 4.0) for peak in peaks(c, 8.0, 20)]
    assert len(tried) > 3 and not any(tried)


def test_a_thing_at_the_edge_is_reported_to_be_cut() -> None:
    values = field()
    values[100:106, 316:] += 8.0
    c = contrast(values, GROUND, 0.6, 0.15)
    part = about_peak(c.excess, tuple(peaks(c, 10.0, 1)[0]), 8, 4.0)
    assert part is not None
    region = region_of(c, part, 9.0)
    assert region.is_cut
    assert region.outline_px[:, 0].max() <= 319.5


def test_warmth_that_changes_slowly_does_not_stand_out() -> None:
    slope = field() + np.linspace(0.0, 20.0, 320, dtype=np.float32)
    assert contrast(slope, GROUND, 0.6, 0.15).in_clutter.max() < 8.0


def test_a_region_as_large_as_half_the_picture_is_found_by_the_whole_picture() -> None:
    values = field()
    values[60:180, 80:200] += 60.0
    size, usual = in_picture(values, GROUND)
    assert usual == pytest.approx(290.0, abs=0.1) and size[100, 100] > 100.0
    assert np.abs(size[:50]).max() < 10.0
    found = above(values, usual, size, size - np.float32(10.0), 4.0)
    assert len(found) == 1
    assert outline_px2(found[0].outline_px) == pytest.approx(120.0 * 120.0, rel=0.03)
    assert found[0].above == pytest.approx(60.0, abs=1.0)
