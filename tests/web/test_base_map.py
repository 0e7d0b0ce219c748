"""A base map of the operator's own, seen in the browser."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ground.web.tiles import open_tiles
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import SMALL, opened
from tests.web.tile_files import COLOUR, write_mbtiles, write_pmtiles

pytestmark = pytest.mark.xdist_group("web")

LOOKS = 200


def share_of_tile_colour(page: Any) -> float:
    """Of the map's pixels."""
    picture = page.get_by_test_id("map").screenshot()
    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), float)
    return float(np.mean(np.max(np.abs(pixels - COLOUR), axis=2) < 12.0))


@pytest.mark.parametrize(("name", "write"), [("base.mbtiles", write_mbtiles), ("base.pmtiles", write_pmtiles)])
def test_tiles_of_a_file_lie_under_the_map(
    tmp_path: Path, chromium: Any, name: str, write: Callable[[Path], None]
) -> None:
    page_is_built()
    write(tmp_path / name)
    with Flight(tmp_path / "pins.sqlite", open_tiles(str(tmp_path / name))) as flight:
        page = opened(chromium, flight.url, SMALL)
        try:
            # Looked at until they are there: a map says nothing when it has drawn.
            share = 0.0
            for _ in range(LOOKS):
                share = share_of_tile_colour(page)
                if share > 0.3:
                    break
                page.wait_for_timeout(100)
            assert share > 0.3
        finally:
            page.context.close()
