"""Heights as models store them: scaled, in feet, and with voids that are not declared."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from contract.errors import InputError
from contract.geodesy import LocalFrame
from onboard.storage.elevation_files import TerrainFiles

FRAME = LocalFrame(-43.5, 172.5, 0.0)
PIXEL_DEG, SIDE = 0.001, 41


def model(path: Path, stored: NDArray[Any], **more: Any) -> Path:
    """A model about FRAME; `more`: scale, offset, units, nodata."""
    reach_deg = PIXEL_DEG * SIDE / 2
    transform = rasterio.Affine(PIXEL_DEG, 0.0, 172.5 - reach_deg, 0.0, -PIXEL_DEG, -43.5 + reach_deg)
    form = {"driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "crs": "EPSG:4326", "transform": transform}
    with rasterio.open(path, "w", dtype=stored.dtype.name, nodata=more.get("nodata"), **form) as out:
        out.write(stored, 1)
        out.scales, out.offsets = (more.get("scale", 1.0),), (more.get("offset", 0.0),)
        if "units" in more:
            out.units = (more["units"],)
    return path


def heights(path: Path) -> NDArray[np.float64]:
    """ENU heights about FRAME, without the bend of the Earth."""
    terrain = TerrainFiles(path).around(FRAME, np.zeros(3), 300.0, 50.0, 0.0)
    assert terrain is not None
    return terrain.heights_m


def stored(value: float, kind: str = "int16") -> NDArray[Any]:
    return np.full((SIDE, SIDE), value, kind)


@pytest.mark.parametrize(
    ("value", "more", "height_m"),
    [
        (8123, {"scale": 0.1, "offset": 100.0}, 912.3),  # which was 8123 m
        (3000, {"units": "ft"}, 914.4),
        (3000, {"units": "US survey foot"}, 914.4),
        (912, {"units": "metre"}, 912.0),
        (912, {}, 912.0),
        (-410, {}, -410.0),
    ],
)
def test_heights_are_what_a_model_states(tmp_path: Path, value: int, more: dict[str, Any], height_m: float) -> None:
    assert heights(model(tmp_path / "m.tif", stored(value), **more)) == pytest.approx(height_m, abs=0.05)


@pytest.mark.parametrize(
    ("void", "more"),
    [
        (-9999.0, {}),
        (-9999.0, {"scale": 0.1}),  # -999.9 m
        (-9999.0, {"scale": 0.01}),
        (-32768.0, {"scale": 0.01}),
        (32767.0, {"scale": 0.1}),
        (-9999.0, {"nodata": -32768}),
        (0.0, {}),  # of mountains: an aircraft above was taken to be 900 m up
        (0.0, {"scale": 0.1, "offset": 1000.0}),
    ],
)
@pytest.mark.parametrize("kind", ["int16", "float32"])
def test_what_was_not_measured_is_no_height(tmp_path: Path, void: float, more: dict[str, Any], kind: str) -> None:
    values = stored(912.0, kind)
    values[:, : SIDE // 2] = void
    found = heights(model(tmp_path / "m.tif", values, **more))
    known = 912.0 * more.get("scale", 1.0) + more.get("offset", 0.0)
    assert np.isnan(found[:, :6]).all()
    assert found[:, 8:] == pytest.approx(known, abs=0.05)


def test_the_sea_is_a_height(tmp_path: Path) -> None:
    """Its shore shows it, and so does a model that states another value for what it has not."""
    values = stored(30.0)
    values[:, : SIDE // 2] = 0.0
    assert heights(model(tmp_path / "shore.tif", values))[:, :5] == pytest.approx(0.0, abs=0.05)
    cliffs = np.where(values == 0.0, 0.0, 200.0).astype("int16")
    assert heights(model(tmp_path / "cliffs.tif", cliffs, nodata=-9999))[:, :5] == pytest.approx(0.0, abs=0.05)
    assert heights(model(tmp_path / "sea.tif", stored(0.0))) == pytest.approx(0.0, abs=0.05)


def test_units_that_are_no_length_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"m\.tif: heights in 'fathom'"):
        TerrainFiles(model(tmp_path / "m.tif", stored(1.0), units="fathom"))
    with pytest.raises(InputError, match=r"n\.tif: heights with a scale of 0"):
        TerrainFiles(model(tmp_path / "n.tif", stored(1.0), scale=0.0))
