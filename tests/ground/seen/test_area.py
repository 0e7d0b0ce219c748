"""Areas of files: polygons of one area that overlap are one, and a hole stays a hole."""

import json
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from ground.seen.area import read_sectors, read_woods
from ground.seen.outline import cells_within

FIRST, SECOND = [(2, 2), (12, 2), (12, 12), (2, 12)], [(8, 8), (18, 8), (18, 18), (8, 18)]
HOLE = [(4, 4), (6, 4), (6, 6), (4, 6)]
# Cells that lie in either square: the common part, 4 x 4, counts once.
BOTH = 100 + 100 - 16


def closed(ring: list[tuple[int, int]]) -> list[list[int]]:
    return [list(corner) for corner in [*ring, ring[0]]]


def polygon(*rings: list[tuple[int, int]]) -> dict[str, object]:
    return {"type": "Polygon", "coordinates": [closed(ring) for ring in rings]}


def kml(*polygons: tuple[list[tuple[int, int]], ...]) -> str:
    def ring(kind: str, corners: list[tuple[int, int]]) -> str:
        places = " ".join(f"{x},{y},0" for x, y in closed(corners))
        return f"<{kind}><LinearRing><coordinates>{places}</coordinates></LinearRing></{kind}>"

    parts = "".join(
        "<Polygon>" + "".join(ring("innerBoundaryIs" if k else "outerBoundaryIs", r) for k, r in enumerate(rings))
        + "</Polygon>"
        for rings in polygons
    )  # fmt: skip
    return (
        f"<kml><Document><Placemark><name>4</name><MultiGeometry>{parts}</MultiGeometry></Placemark></Document></kml>"
    )


GEOMETRIES = {
    "multi.geojson": {"type": "MultiPolygon", "coordinates": [[closed(FIRST), closed(HOLE)], [closed(SECOND)]]},
    "collection.geojson": {"type": "GeometryCollection", "geometries": [polygon(FIRST, HOLE), polygon(SECOND)]},
}


@pytest.mark.parametrize("name", [*GEOMETRIES, "area.kml"])
def test_polygons_that_overlap_are_one_area(tmp_path: Path, name: str) -> None:
    """What two of them have in common was in neither: rings were counted together, and even is outside."""
    path = tmp_path / name
    path.write_text(kml((FIRST, HOLE), (SECOND,)) if name.endswith("kml") else json.dumps(GEOMETRIES[name]))
    (sector,) = read_sectors(path)
    inside = cells_within(sector.polygons, 20, 20)
    assert np.count_nonzero(inside) == BOTH - 4
    assert inside[9, 9] and not inside[5, 5] and len(sector.rings) == 3


def test_a_polygon_within_the_hole_of_another_is_there(tmp_path: Path) -> None:
    outer = [(0, 0), (20, 0), (20, 20), (0, 20)]
    shape = {"type": "MultiPolygon", "coordinates": [[closed(outer), closed(FIRST)], [closed(HOLE)]]}
    path = tmp_path / "woods.geojson"
    path.write_text(json.dumps({"type": "Feature", "properties": {"canopy": 0.8}, "geometry": shape}))
    (woods,) = read_woods(path)
    assert np.count_nonzero(cells_within(woods.polygons, 20, 20)) == 400 - 100 + 4


@pytest.mark.parametrize(
    ("properties", "names"),
    [
        ([{"title": "2", "class": "Shape"}, {"title": "1"}], ["2", "1"]),  # CalTopo's
        ([{"Name": "S7", "fid": 3}, {"NAME": 8}], ["S7", "8"]),  # QGIS's
        ([{}, {"name": None}], ["1", "2"]),
        ([{"name": "2"}, {}], ["2", "without a name (2)"]),
        ([{"name": "4"}, {"name": "4"}], ["4", "4 (2)"]),
    ],
)
def test_a_sector_has_its_own_name_and_never_another_s(
    tmp_path: Path, properties: list[dict[str, object]], names: list[str]
) -> None:
    """The first of two sectors that CalTopo calls 2 and 1 was stated as sector 1."""
    features = [{"type": "Feature", "properties": p, "geometry": polygon(FIRST)} for p in properties]
    path = tmp_path / "sectors.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert [sector.name for sector in read_sectors(path)] == names


def test_an_area_of_another_system_is_named(tmp_path: Path) -> None:
    """Degrees of another datum were taken for WGS84, some 200 m away."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4272"}}
    feature = {"type": "Feature", "properties": {"canopy": 0.5}, "geometry": polygon(FIRST)}
    path = tmp_path / "area.geojson"
    for content in ({"type": "FeatureCollection", "crs": crs, "features": [feature]}, feature | {"crs": crs}):
        path.write_text(json.dumps(content))
        for read in (read_sectors, read_woods):
            with pytest.raises(InputError, match="are of urn:ogc:def:crs:EPSG::4272, and WGS84 is needed"):
                read(path)
