"""Columns next to latitude and longitude that decide where a row is: minutes, seconds, hemisphere, system."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from contract.errors import InputError
from ground.formats.coordinate_text import read_coordinate

HALVES = ("lat_deg", "lon_deg")
_SIDES = {"lat_deg": r"(?:gps)?lat(?:itude)?", "lon_deg": r"(?:gps)?(?:lon(?:g(?:itude)?)?|lng)"}
_PARTS = {
    "minutes": r"min(?:ute)?s?",
    "seconds": r"sec(?:ond)?s?",
    "letter": r"(?:dir(?:ection)?|ref|hem(?:i(?:sphere)?)?|ns|ew|cardinal)",
}
# Names that need no word for the half that they are of.
_LETTERS = {"lat_deg": {"ns", "northsouth", "nors"}, "lon_deg": {"ew", "eastwest", "eorw"}}
_SYSTEM = {"crs", "srs", "srid", "epsg", "datum", "geodeticdatum", "horizontaldatum", "mapdatum", "coordinatesystem"}
# How WGS84 latitude and longitude are named, in capital letters and digits alone.
_WGS84 = re.compile("WGS|WGS(19)?84.*|4326|4979|.*CRS84|.*EPSG(4326|4979)")


@dataclass(frozen=True)
class SplitColumns:
    """Indexes of such columns: of each half its parts, and of what names the system."""

    parts: dict[str, dict[str, int]] = field(default_factory=lambda: {half: {} for half in HALVES})
    systems: tuple[int, ...] = ()

    @classmethod
    def of(cls, names: Sequence[str], columns: Mapping[str, int], rows: Sequence[Sequence[str]] = ()) -> SplitColumns:
        """Find them by their names; `columns` are those that are known. A part that does not name its half is of the
        one right before it; but a hemisphere has no digits, and such a column of `rows` (headings, numbers of
        sectors) is none.
        """
        found, systems, before = cls(), [], ""
        half_at = {columns[half]: half for half in HALVES}
        for index, name in enumerate(names):
            if index in half_at:
                before = half_at[index]
                continue
            word = re.sub("[^a-z]", "", name.lower())
            half, part = _part_of(word, before)
            if part == "letter" and not _part_of(word, "")[1] and any(_has_digit(row, index) for row in rows):
                part = ""
            if part:
                found.parts[half].setdefault(part, index)
            elif word in _SYSTEM:
                systems.append(index)
            before = half if part else ""
        # Of a table of ours they name the system of its columns x and y.
        is_ours = {"x", "y", "crs"} <= set(columns)
        return cls(found.parts, () if is_ours else tuple(systems))

    def check_system(self, cells: Sequence[str]) -> None:
        """Raise InputError for a row in another system than WGS84."""
        for index in self.systems:
            name = cells[index].strip() if index < len(cells) else ""
            if name and not _WGS84.fullmatch(re.sub("[^A-Z0-9]", "", name.upper())):
                raise InputError(f"its coordinates are of {name[:40]!r}, and WGS84 is needed")

    def place(self, cells: Sequence[str], degrees: Mapping[str, str]) -> tuple[float, float] | None:
        """Latitude and longitude of a row whose cells hold more than the degrees; None where they do not.

        Raises InputError.
        """
        each = {half: _cells_of(self.parts[half], cells) for half in HALVES}
        if not any(each.values()):
            return None
        read = read_coordinate(" ".join(_text(degrees[half], each[half]) for half in HALVES))
        return read.lat_deg, read.lon_deg


def _has_digit(row: Sequence[str], index: int) -> bool:
    return index < len(row) and re.search(r"\d", row[index]) is not None


def _part_of(word: str, before: str) -> tuple[str, str]:
    """The half and the part that a column's name means, both empty for any other; `before`: of the column before it."""
    named = next((half for half, letters in _LETTERS.items() if word in letters), "")
    if named:
        return named, "letter"  # whatever it stands next to
    for half, side in _SIDES.items():
        for part, name in _PARTS.items():
            if re.fullmatch(f"{side}{name}|{name}{side}", word) or (before == half and re.fullmatch(name, word)):
                return half, part
    return "", ""


def _cells_of(parts: Mapping[str, int], cells: Sequence[str]) -> dict[str, str]:
    """The parts of one half that a row states, without what is empty."""
    return {part: cells[k].strip() for part, k in parts.items() if k < len(cells) and cells[k].strip()}


def _text(degrees: str, given: Mapping[str, str]) -> str:
    """One half as people write it. Raises InputError for seconds without minutes, and for no hemisphere."""
    letter = given.get("letter", "")[:1].upper()
    if "letter" in given and (letter not in "NSEW" or not given["letter"].isalpha()):
        raise InputError(f"{given['letter'][:20]!r} is no hemisphere")
    if "seconds" in given and "minutes" not in given:
        raise InputError("seconds without minutes")
    whole = degrees.strip()
    if letter in ("S", "W"):
        whole = whole.removeprefix("-")  # both ways of saying south agree
    numbers = [whole, given.get("minutes", ""), given.get("seconds", "")]
    numbers = [re.sub(r"\.0+$", "", number.replace(",", ".")) for number in numbers if number]
    return " ".join([*numbers, letter]).strip()
