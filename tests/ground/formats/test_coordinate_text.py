"""What a person types is read as the one place that it names, or refused; what we print is read back."""

import math

import numpy as np
import pytest

from contract.errors import InputError
from contract.geodesy import LocalFrame
from ground.formats.coordinate_text import read_coordinate
from ground.formats.coordinates import latlon_text, mgrs_text, utm_text
from ground.formats.rounded import rounded_text


@pytest.mark.parametrize(
    "text",
    [
        "-43.38 172.40", "-43.38,172.40", "-43.38, 172.40", "-43,38 172,40", "-43,38; 172,40", "-43,38, 172,40",
        "−43,38 172,40", "43.38S 172.40E", "S43.38 E172.40", "172.40 E 43.38 S", "E172,40 S43,38", "43,38°S 172,40°E",
        "43°22.8'S 172°24'E", "43° 22′ 48″ S, 172° 24′ 00″ E", "43°22'48,0\"S 172°24'0,0\"E", "43 22 48 S 172 24 0 E",
        "-43 22 48 172 24 0", "43,22.8S 172,24.0E", "geo:-43.38,172.40", "geo:-43.38,172.40,105.2;u=9.9",
    ],
)  # fmt: skip
def test_every_usual_way_of_writing_one_place_is_read_as_that_place(text: str) -> None:
    found = read_coordinate(text)
    assert (found.lat_deg, found.lon_deg) == (pytest.approx(-43.38, abs=1e-9), pytest.approx(172.40, abs=1e-9))


def test_a_text_without_end_is_refused_in_a_line() -> None:
    """Texts with two readings or none: tests/transcripts/pc-ground-pins.txt."""
    with pytest.raises(InputError, match="longer") as caught:
        read_coordinate("1 " * 200)
    assert len(str(caught.value).splitlines()) == 1 and len(str(caught.value)) < 200


def test_a_utm_letter_is_the_band_as_we_print_it_or_the_hemisphere_where_no_band_fits() -> None:
    spain = read_coordinate("30S 500000.0 4000000.0")
    assert utm_text(spain.lat_deg, spain.lon_deg) == "30S 500000.0 4000000.0"
    south, north = read_coordinate("59S 412345 5197654"), read_coordinate("33N 412345 5197654")
    assert (round(south.lat_deg), round(north.lat_deg)) == (-43, 47) and south.form == "UTM zone 59 south"
    grouped = read_coordinate("59 G 412345mE 5197654mN")
    assert (grouped.lat_deg, grouped.lon_deg) == (south.lat_deg, south.lon_deg)


def test_fewer_mgrs_digits_are_the_middle_of_their_square() -> None:
    whole, coarse = read_coordinate("59GMM 01235 56785"), read_coordinate("59G MM 0123 5678")
    assert _apart_m(coarse.lat_deg, coarse.lon_deg, whole.lat_deg, whole.lon_deg) < 0.01
    assert coarse.form == "MGRS, the middle of a square of 10 m"


def test_all_that_we_print_is_read_back_anywhere_on_earth() -> None:
    rng = np.random.default_rng(5)
    lats = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 400)))
    lons = rng.uniform(-180.0, 180.0, 400)
    lats[::10] = np.clip(np.round(lats[::10] / 8.0) * 8.0 + rng.uniform(-1e-5, 1e-5, 40), -89.9, 89.9)  # edges of bands
    lons[::7] = np.clip(np.round(lons[::7] / 6.0) * 6.0 + rng.uniform(-1e-6, 1e-6, 58), -180.0, 180.0)  # and of zones
    for lat, lon in zip(lats.tolist(), lons.tolist(), strict=True):
        texts = [(latlon_text(lat, lon, form), 0.05) for form in ("degrees", "minutes", "seconds")]
        texts += [(mgrs_text(lat, lon), 0.75)] + ([(utm_text(lat, lon), 0.1)] if -80.0 <= lat < 84.0 else [])
        for text, limit_m in texts:
            found = read_coordinate(text)
            assert _apart_m(found.lat_deg, found.lon_deg, lat, lon) < limit_m, text


@pytest.mark.parametrize("ce90_m", [0.5, 20.0, 150.0, 900.0, 8000.0])
def test_what_is_handed_on_is_read_back_where_bands_and_zones_end(ce90_m: float) -> None:
    """A square of 1 km on the border of two bands, at 40 N say, was refused: its middle lies in the other band."""
    for lat in (-79.9999, -72.0, -8.0, 0.0, 8.0, 32.0, 40.0, 55.99999, 63.99999, 72.0, 83.99999):
        for lon in (-180.0, -126.0000001, -6.0, 2.99999, 3.0, 11.99999, 126.0, 173.9999999, 180.0):
            for form in ("degrees", "minutes", "seconds", "mgrs", "utm"):
                text = rounded_text(form, lat, lon, ce90_m)
                found = read_coordinate(text)
                assert _apart_m(found.lat_deg, found.lon_deg, lat, lon) < 0.2 * ce90_m + 0.8, (text, lat, lon)


def _apart_m(lat_a: float, lon_a: float, lat_b: float, lon_b: float) -> float:
    east, north, _ = LocalFrame(lat_b, lon_b, 0.0).to_enu(lat_a, lon_a, 0.0)
    return math.hypot(float(east), float(north))
