"""A camera file's zoom table: read, written, between its rows and beyond them."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.camera import Camera
from contract.errors import InputError
from contract.zoom_table import ZoomTable

WIDE = Camera(1280, 720, 900.0, 890.0, 640.0, 358.0, (-0.2, 0.03, 0.001, 0.0, 0.0))
ROWS: dict[str, Any] = {
    "unit": "times",
    "position": [1.0, 2.0, 6.0],
    "focal_px": [900.0, 1900.0, 5200.0],
    "cx_px": [640.0, 644.0, 652.0],
    "cy_px": [358.0, 357.0, 350.0],
    "k1": [-0.2, -0.05, 0.1],
}
TABLE = ZoomTable.from_json(ROWS, "here")
PERCENT = ZoomTable.from_json({**ROWS, "unit": "percent", "position": [0.0, 40.0, 100.0]}, "here")
LENS = replace(WIDE, stated_sigma=(0.003, 0.002, 0.001, 0.01, 0.02), stated_zoom=TABLE)


def test_a_camera_file_keeps_its_table_and_is_the_same_camera_with_it(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(LENS.to_json())
    read = Camera.from_json(path)
    assert read == LENS == WIDE and read.zoom == TABLE
    assert read.sigma == pytest.approx(LENS.sigma)
    assert WIDE.zoom is None and "zoom" not in json.loads(WIDE.to_json())


@pytest.mark.parametrize("row", [0, 1, 2])
def test_at_its_rows_the_table_is_its_rows(row: int) -> None:
    for table in (TABLE, PERCENT):
        log_focal = table.log_focal(table.position[row])
        assert log_focal is not None
        camera = replace(WIDE, stated_zoom=table).zoomed(log_focal)
        assert camera.focal_px == pytest.approx(ROWS["focal_px"][row])
        assert (camera.cx_px, camera.cy_px, camera.distortion[0]) == pytest.approx(
            (ROWS["cx_px"][row], ROWS["cy_px"][row], ROWS["k1"][row])
        )
        assert camera.fx_px / camera.fy_px == pytest.approx(900.0 / 890.0)
        assert camera.distortion[1:] == WIDE.distortion[1:] and camera.zoom == table


@given(st.floats(1.0, 6.0), st.floats(1.0, 6.0))
def test_between_rows_everything_lies_between_and_focal_lengths_rise(one: float, other: float) -> None:
    low, high = sorted((one, other))
    at, above = TABLE.log_focal(low), TABLE.log_focal(high)
    assert at <= above
    assert math.log(900.0) - 1e-9 <= at and above <= math.log(5200.0) + 1e-9
    cx, _, k1 = TABLE.at(at)
    assert 640.0 <= cx <= 652.0 and -0.2 <= k1 <= 0.1


def test_halfway_in_the_logarithm_is_halfway_in_the_other_columns() -> None:
    middle = 0.5 * (math.log(1900.0) + math.log(5200.0))
    assert TABLE.at(middle) == pytest.approx((648.0, 353.5, 0.025))
    assert TABLE.log_focal(math.sqrt(12.0)) == pytest.approx(middle)
    assert PERCENT.log_focal(70.0) == pytest.approx(middle)


@pytest.mark.parametrize("position", [math.nan, math.inf, -1.0, 0.0, 0.5, 20.0])
def test_a_magnification_that_the_lens_cannot_have_is_none(position: float) -> None:
    assert TABLE.log_focal(position) is None
    assert PERCENT.log_focal(-1.0) is None and PERCENT.log_focal(101.0) is None
    beyond = TABLE.log_focal(6.6)
    assert beyond == pytest.approx(math.log(5200.0 * 1.1))


def test_the_principal_point_s_sigma_stays_what_it_is_in_pixels() -> None:
    camera = LENS.zoomed(math.log(LENS.focal_px * 5.0))
    assert camera.sigma == pytest.approx((0.003, 0.0004, 0.0002, 0.01, 0.02))


def test_a_missing_column_is_named() -> None:
    with pytest.raises(InputError, match="'cy_px' is missing"):
        ZoomTable.from_json({key: value for key, value in ROWS.items() if key != "cy_px"}, "here")
    with pytest.raises(InputError, match="zoom needs a unit"):
        ZoomTable.from_json([1, 2], "here")
