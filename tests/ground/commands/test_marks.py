"""Surveyed marks of a table: what columns next to the degrees state of a place counts, as of a table of pins."""

from pathlib import Path

import pytest

from contract.errors import InputError
from ground.commands.accuracy import read_marks


@pytest.mark.parametrize(
    ("more", "row"),
    [
        ("", "-43.38,172.40"),
        ("lat_min,lon_min", "-43,172,22.8,24.0"),
        ("N/S,E/W", "43.38,172.40,S,E"),
        ("datum", "-43.38,172.40,WGS 84"),
    ],
)
def test_minutes_and_hemispheres_are_part_of_a_mark(tmp_path: Path, more: str, row: str) -> None:
    """Minutes were left out: the mark, and with it the verdict, was 53 km off."""
    path = tmp_path / "marks.csv"
    path.write_text(f"frame,u,v,lat_deg,lon_deg{',' if more else ''}{more}\n3,300,200,{row}\n")
    (mark,) = read_marks(path)
    assert (mark.lat_deg, mark.lon_deg) == pytest.approx((-43.38, 172.40), abs=1e-9)


@pytest.mark.parametrize(
    ("more", "row", "words"),
    [("datum", "-43.38,172.40,NZGD49", "line 2: its coordinates are of 'NZGD49'"), ("ns,ew", "-43.38,172.40,x,E", "x")],
)
def test_a_mark_of_another_datum_is_refused(tmp_path: Path, more: str, row: str, words: str) -> None:
    path = tmp_path / "marks.csv"
    path.write_text(f"frame,u,v,lat_deg,lon_deg,{more}\n3,300,200,{row}\n")
    with pytest.raises(InputError, match=words):
        read_marks(path)
