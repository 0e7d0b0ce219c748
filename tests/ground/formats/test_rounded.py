"""Coordinates for people move a place by no more than its accuracy allows, and have no digit more than that takes."""

import re

import numpy as np
import pytest

from contract.answer import ROUNDED_SHARE
from contract.geodesy import LocalFrame
from ground.formats.rounded import decimals, rounded_text, spaced_mgrs, spoken_mgrs


@pytest.mark.parametrize("ce90_m", [0.8, 3.2, 6.0, 25.0, 90.0, 700.0])
def test_rounding_moves_a_place_by_at_most_a_fifth_of_its_radius(ce90_m: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        lat, lon = float(rng.uniform(-60, 60)), float(rng.uniform(-180, 180))
        back = [float(part) for part in rounded_text("degrees", lat, lon, ce90_m).split()]
        east, north, _ = LocalFrame(lat, lon, 0.0).to_enu(back[0], back[1], 0.0)
        assert np.hypot(east, north) <= ROUNDED_SHARE * ce90_m + 0.02
        text = rounded_text("degrees", lat, lon, ce90_m)
        coarser = [round(v, decimals("degrees", ce90_m) - 1) for v in (lat, lon)]
        assert len(text.split()[0].partition(".")[2]) == decimals("degrees", ce90_m)
        assert np.sqrt(0.5) * 111_700.0 * 10.0 ** (1 - decimals("degrees", ce90_m)) > ROUNDED_SHARE * ce90_m, coarser


def test_minutes_and_seconds_never_reach_sixty() -> None:
    assert rounded_text("seconds", -0.99999999, 179.9999999, 700.0) == "01°00'00\"S 180°00'00\"E"
    assert rounded_text("minutes", 0.99999999, -0.9999999, 700.0) == "01°00.0'N 001°00.0'W"


def test_mgrs_is_spaced_cut_and_spelt() -> None:
    assert spaced_mgrs(-43.38012345, 172.40123456, 6.0) == "59G PM 13506 96018"
    assert spaced_mgrs(-43.38012345, 172.40123456, 90.0) == "59G PM 1350 9601"
    assert spoken_mgrs(-43.38012345, 172.40123456, 90.0) == "5 9 Golf, Papa Mike, 1 3 5 0, 9 6 0 1"
    assert re.fullmatch(r"[A-Z] [A-Z]{2} \d{5} \d{5}", spaced_mgrs(89.9, 10.0, None))
