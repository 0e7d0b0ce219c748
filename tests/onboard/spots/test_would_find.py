"""The places where a person would be found, and named: as people who are put into the picture one at a time are."""

import cv2
import numpy as np
import pytest

from contract.answer import Fix
from contract.locate import Locator
from contract.spot import PERSON_K, PERSON_M2
from onboard.spots.contrast import Contrast, Image, contrast
from onboard.spots.detector import PARTS
from onboard.spots.ground_scale import ground_scale
from onboard.spots.ground_view import GroundView
from onboard.spots.regions import LENS_PX, about_peak, peaks, size_limits
from onboard.spots.tried_people import KEPT_NS, TriedPeople
from onboard.spots.would_find import found_at
from simulation.thermal import ThermalSpec
from tests.onboard.spots.scenes import LEPTON, ORIGIN, STEP_NS, Scene, set_of

PIXEL_M = 0.4
SIZES_M = (0.32, 0.63, 1.26)
EVERYWHERE = np.ones((4, 4), bool)


def contrasts_of(kelvin: Image) -> list[Contrast]:
    return [contrast(kelvin, EVERYWHERE, side_m, PIXEL_M) for side_m in SIZES_M]


@pytest.fixture(scope="module")
def kelvin() -> Image:
    """A picture (120, 160) of ground that varies over two pixels, five times less in its left half."""
    rng = np.random.default_rng(1)
    ground = cv2.GaussianBlur(rng.standard_normal((120, 160)), (0, 0), 1.0)
    ground *= np.where(np.arange(160) < 80, 0.4, 2.0) / ground.std()
    return np.asarray(290.0 + ground + 0.05 * rng.standard_normal(ground.shape), np.float32)


def with_person(kelvin: Image, u: float, v: float) -> Image:
    """Half a metre across with its middle at a pixel (u, v), through the lens."""
    half = 0.5 * np.sqrt(PERSON_M2) / PIXEL_M
    cover = [
        np.clip(np.minimum(np.arange(n) + 0.5, m + half) - np.maximum(np.arange(n) - 0.5, m - half), 0.0, 1.0)
        for n, m in zip(kelvin.shape, (v, u), strict=True)
    ]
    person = cv2.GaussianBlur(np.outer(*cover).astype(np.float32), (0, 0), LENS_PX)
    return np.asarray(kelvin + np.float32(PERSON_K) * person, np.float32)


def is_found(kelvin: Image, u: float, v: float, thresholds: dict[float, float]) -> bool:
    """As the search finds it: a local maximum over the threshold, of the thing's size."""
    for c in contrasts_of(with_person(kelvin, u, v)):
        reach_px, least_px = size_limits(c, PIXEL_M)
        for row, column in peaks(c, thresholds[c.side_m], 400).tolist():
            at = (np.array([column, row]) + 0.5) * c.times - 0.5
            is_it = float(np.hypot(*(at - (u, v)))) < 2.0 * c.times
            if is_it and about_peak(c.excess, (row, column), reach_px, least_px) is not None:
                return True
    return False


@pytest.mark.parametrize("thresholds", [(2.6, 1e9, 1e9), (1e9, 5.0, 1e9), (1e9, 1e9, 5.0), (3.0, 5.5, 6.0)])
def test_as_many_places_find_a_person_as_of_people_who_are_put_there_are_found(
    kelvin: Image, thresholds: tuple[float, ...]
) -> None:
    by_size = dict(zip(SIZES_M, thresholds, strict=True))
    down, across = (np.arange(16) + 0.43) / 16.0, (np.arange(20) + 0.37) / 20.0
    at = np.stack(np.meshgrid(down, across, indexing="ij"), axis=-1).reshape(-1, 2)
    stated = found_at(kelvin, contrasts_of(kelvin), by_size, PIXEL_M, at)[0].reshape(16, 20)
    columns = np.array([stated[:, :8].mean(), stated[:, 12:].mean()])
    rng, found = np.random.default_rng(4), np.zeros((2, 100), bool)
    for side, k in np.ndindex(found.shape):
        found[side, k] = is_found(kelvin, 96.0 * side + rng.uniform(3.0, 60.0), rng.uniform(3.0, 116.0), by_size)
    assert np.abs(columns - found.mean(axis=1)).max() < 0.12  # 2.4 sigmas of 100 people, at half
    assert np.any((columns > 0.1) & (columns < 0.98))


def view_of(tilt_deg: float = 0.0, north_m: float = 0.0, height_m: float = 100.0) -> GroundView:
    pose = Scene(ThermalSpec(), LEPTON, height_m, north_m, tilt_deg).pose(1)
    s = set_of(LEPTON, pose, 1)
    ground = ground_scale(s, PARTS)
    assert ground is not None
    return GroundView(s, ground, ORIGIN)


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0])
def test_a_place_is_seen_where_a_click_there_has_it(tilt_deg: float) -> None:
    s = set_of(LEPTON, Scene(ThermalSpec(), LEPTON, 100.0, 30.0, tilt_deg).pose(1), 1)
    view, locator = view_of(tilt_deg, 30.0), Locator(s)
    for uv in ((0.0, 0.0), (159.0, 30.0), (80.0, 119.0)):
        found = locator.locate(uv)
        assert isinstance(found, Fix)
        en_m = ORIGIN.to_enu(found.lat_deg, found.lon_deg, 0.0)[None, :2]
        at, is_shown = view.shares(en_m)
        assert is_shown[0] and at[0] * (120, 160) - 0.5 == pytest.approx(uv[::-1], abs=0.05)
        assert np.all((view.box_m[0] < en_m) & (en_m < view.box_m[1]))


@pytest.mark.parametrize(
    ("pictures", "named"),
    [
        ("ff", 0.0), ("fff", 1.0), ("f-ff", 1.0), ("f--f--f", 0.0), ("f.ff", 1.0), ("f..f", 0.0), ("fff----", 1.0),
        ("ff|ff", 0.0),  # a minute later no look counts any more
    ],
)  # fmt: skip
def test_a_person_is_named_who_was_in_two_of_three_pictures_and_so_twice(pictures: str, named: float) -> None:
    """f: found in the left half, -: not found, .: a picture without a place."""
    people, view, time_ns = TriedPeople(), view_of(), 0
    for what in pictures:
        time_ns += KEPT_NS if what == "|" else STEP_NS
        if what == ".":
            people.missed()
        elif what != "|":
            tried = people.look(view, time_ns, lambda at, f=what == "f": (f & (at[:, 1] < 0.5), at[:, 0] < 0.75))
    assert tried.found == pytest.approx(0.5 if pictures[-1] == "f" else 0.0, abs=0.06)
    rows = [tried.named[5 * row : 5 * row + 5] for row in range(4)]
    assert rows[:3] == [(named, named, pytest.approx(0.5 * named, abs=0.2), 0.0, 0.0)] * 3 and rows[3] == (None,) * 5


def test_what_a_part_states_is_of_those_with_the_most_looks_and_from_another_height_others_are_tried() -> None:
    """Three pictures find everyone, later ones no one: who came into view with the second is in the lowest part too."""
    people, height_px = TriedPeople(), 2.0 * np.tan(np.radians(0.5 * 57.0)) * 0.75  # in heights above the ground
    for k in range(5):
        view = view_of(north_m=0.2 * height_px * 100.0 * k)
        tried = people.look(view, STEP_NS * k, lambda at, f=k < 3: (np.full(len(at), f), np.ones(len(at), bool)))
    assert tried.named == (0.0,) * 15 + (1.0,) * 5
    tried = people.look(view_of(height_m=250.0), 5 * STEP_NS, lambda at: np.ones((2, len(at)), bool))
    assert tried.found == 1.0 and max(tried.named) == 0.0
