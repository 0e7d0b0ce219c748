"""A coordinate from a typed or pasted text: degrees, minutes and seconds, MGRS, UTM, geo: links.

Decimal commas are read too. A text that can mean two places is refused, never guessed: a wrong place is worse than a
second try. Everything that `coordinates` writes is read back.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

from contract.errors import InputError
from ground.formats.coordinates import library, utm_to_latlon

MAX_TEXT = 200
METRES_A_DEGREE = 110_500.0  # of latitude, at least
FORMS = "-43.38012, 172.40123 or 43°22'48.4\"S 172°24'4.4\"E, or MGRS, or UTM with its zone"
# What phones and word processors write in place of the plain characters.
_PLAIN = str.maketrans("−‐‑–º˚’‘′´`ʹ”“″ʺ\u00a0\u2009\u202f", "----°°''''''\"\"\"\"   ")
_MGRS = re.compile(r"(\d{1,2}\s*[C-HJ-NP-X]|[ABYZ])\s*([A-Z]{2})\s*(\d*)(?:\s+(\d+))?", re.ASCII)
_METRES = r"(\d+(?:[.,]\d+)?)\s*M?"
_UTM = re.compile(rf"(\d{{1,2}})(\s*)([A-Z])[\s,;]+E?\s*{_METRES}\s*E?[\s,;]+N?\s*{_METRES}\s*N?", re.ASCII)
_BANDS = "CDEFGHJKLMNPQRSTUVWX"
_TOKEN = re.compile(r"(?P<letter>[NSEW])|(?P<number>[+-]?\d+(?:\.\d+)?)|(?P<unit>[°'\"])|\s+", re.ASCII)
_PARTS = {1: "decimal degrees", 2: "degrees and minutes", 3: "degrees, minutes and seconds"}


@dataclass(frozen=True)
class Coordinate:
    """WGS84 degrees, and how the text was read, in words."""

    lat_deg: float
    lon_deg: float
    form: str


def read_coordinate(text: str) -> Coordinate:
    """The place that a text names. Raises InputError, in one line, for no coordinate and for one with two meanings."""
    shown = " ".join(text.split())[:60]
    if len(text) > MAX_TEXT:
        raise InputError(f"{shown!r} ...: longer than {MAX_TEXT} characters")
    try:
        return _read(text.translate(_PLAIN).replace("''", '"').strip().upper())
    except InputError as error:
        raise InputError(f"{shown!r}: {error}") from error


def _read(text: str) -> Coordinate:
    if text.startswith("GEO:"):
        return _geo(text[4:])
    if found := _MGRS.fullmatch(text):
        return _mgrs(*found.groups())
    if found := _UTM.fullmatch(text):
        return _utm(*found.groups())
    return _degrees(text)


def _checked(lat_deg: float, lon_deg: float, form: str) -> Coordinate:
    if not (-90.0 <= lat_deg <= 90.0 and -180.0 <= lon_deg <= 180.0):
        raise InputError("latitude comes first and is -90 to 90, longitude -180 to 180")
    return Coordinate(lat_deg, lon_deg, form)


def _geo(text: str) -> Coordinate:
    """RFC 5870: latitude, longitude, perhaps height; then parameters."""
    place, *parameters = text.split(";")
    if any(p.startswith("CRS=") and p != "CRS=WGS84" for p in parameters):
        raise InputError("a geo: link in another system than WGS84")
    try:
        lat, lon, *_ = (float(number) for number in place.split(","))
    except ValueError as error:
        raise InputError("a geo: link is geo:LATITUDE,LONGITUDE") from error
    return _checked(lat, lon, "geo: link")


def _mgrs(zone: str, square: str, digits: str, more: str | None) -> Coordinate:
    """The centre of the square that the digits name."""
    x, y = (digits, more) if more is not None else (digits[: len(digits) // 2], digits[len(digits) // 2 :])
    if not 0 < len(x) == len(y) <= 5:
        raise InputError("MGRS has one to five digits of the easting, and as many of the northing")
    mgrs, zone = library("mgrs"), zone.replace(" ", "")
    # A further digit 5 is the middle of the square. A metre is written rounded (`mgrs_text`): its corner is the place.
    name = f"{zone}{square}{x}{y}" if len(x) == 5 else f"{zone}{square}{x}5{y}5"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a latitude outside of the band: refused below
            lat, lon = mgrs.MGRS().toLatLon(name)
    except mgrs.core.MGRSError as error:
        raise InputError(f"there is no MGRS square {zone}{square} with these digits") from error
    # Of a square on the border of two bands the middle may be in the other one.
    if zone[0].isdigit() and not _lies_in(lat, zone[-1], 10 ** (5 - len(x))):
        raise InputError(f"the MGRS square {square} of these digits does not lie in band {zone[-1]}")
    return _checked(lat, lon, "MGRS" if len(x) == 5 else f"MGRS, the middle of a square of {10 ** (5 - len(x))} m")


def _utm(number: str, gap: str, band: str, east: str, north: str) -> Coordinate:
    """Read UTM with its band as `utm_text` writes it, or with N or S for the hemisphere where no band can be meant."""
    zone, x, y = int(number), float(east.replace(",", ".")), float(north.replace(",", "."))
    if not (1 <= zone <= 60 and band in _BANDS and 1e5 <= x < 9e5 and y <= 1e7):
        raise InputError("UTM is zone and band, easting, northing in metres: 59G 412345 5197654")
    lat, lon = utm_to_latlon(zone, band >= "N", x, y)
    if _lies_in(lat, band):
        if band == "S" and gap:
            raise InputError(
                "S is a band (32 to 40 N) or the south: without a blank (30S) it is the band, else give that"
            )
        return _checked(lat, lon, f"UTM zone {zone}, band {band}")
    if band not in "NS":
        raise InputError(f"this northing does not lie in band {band}")
    word = "north" if band == "N" else "south"
    return _checked(*utm_to_latlon(zone, band == "N", x, y), f"UTM zone {zone} {word}")


def _lies_in(lat_deg: float, band: str, beyond_m: float = 0.0) -> bool:
    """Return whether a latitude lies in an MGRS band of 8 degrees (X: 12), or up to 10 m and so much outside of it."""
    south, beyond_deg = -80.0 + 8.0 * _BANDS.index(band), 1e-4 + beyond_m / METRES_A_DEGREE
    return south - beyond_deg <= lat_deg <= (84.0 if band == "X" else south + 8.0) + beyond_deg


@dataclass(frozen=True)
class _Half:
    """Latitude or longitude: its numbers, the first with its sign if there is one, and its hemisphere or nothing."""

    numbers: tuple[str, ...]
    letter: str

    @property
    def is_signed(self) -> bool:
        return self.numbers[0][0] in "+-"

    @property
    def value_deg(self) -> float:
        size = sum(abs(float(number)) / 60.0**k for k, number in enumerate(self.numbers))
        return -size if self.letter in ("S", "W") or self.numbers[0][0] == "-" else size


def _degrees(text: str) -> Coordinate:
    if re.search(r"[\d°'\"]\s*O(?![A-Z])|(?<![A-Z])O\s*\d", text):
        raise InputError("O is east in German and west in French and Spanish: write E or W")
    halves = _halves(_without_commas(text))
    letters, is_signed = "".join(h.letter for h in halves), any(h.is_signed for h in halves)
    parts = max(len(h.numbers) for h in halves)
    if letters not in ("", "NE", "NW", "SE", "SW"):
        if letters[::-1] not in ("NE", "NW", "SE", "SW"):
            raise InputError("one number needs N or S, the other E or W")
        halves = halves[::-1]
    if letters and is_signed:
        raise InputError("both a sign and a hemisphere: give one of the two")
    if parts > 1 and not (letters or is_signed):
        raise InputError("which hemisphere? add N or S, and E or W")
    return _checked(halves[0].value_deg, halves[1].value_deg, _PARTS[parts])


def _without_commas(text: str) -> str:
    """Put points for decimal commas and blanks for commas and semicolons that separate. Refuses what may be either."""
    if re.search(r"\d\.\d", text):
        return re.sub("[,;]", " ", text)
    rest = re.sub(r"(?<!\d),|,(?!\d)|;", " ", text).strip()
    numbers = re.findall(r"\d[\d,]*", rest)
    are_decimal = len(numbers) == 2 and all(number.count(",") == 1 for number in numbers)
    has_words, is_mixed = re.search("[NSEW°]", rest), re.search(r"[^\d\s],(?!\s)", text)
    if "," in rest and (is_mixed or not (has_words or are_decimal)):
        raise InputError("are these commas decimal? write points: -43.38, 172.40")
    return rest.replace(",", ".")


def _halves(text: str) -> tuple[_Half, _Half]:
    """Cut between latitude and longitude: by the letters, else in the middle."""
    tokens, at = [], 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:
            raise InputError(f"not a coordinate; write it as {FORMS}")
        if found.lastgroup is not None:
            tokens.append((found.lastgroup, found[0]))
        at = found.end()
    letters = [k for k, (kind, _) in enumerate(tokens) if kind == "letter"]
    numbers = [k for k, (kind, _) in enumerate(tokens) if kind == "number"]
    if len(letters) == 1:
        raise InputError("a hemisphere for one number only: give N or S, and E or W")
    if letters:
        cut = letters[1] if letters[0] == 0 else letters[0] + 1
    elif len(numbers) in (2, 4, 6):
        cut = numbers[len(numbers) // 2]
    else:
        raise InputError(f"not latitude and longitude alone; write it as {FORMS}")
    return _half(tokens[:cut]), _half(tokens[cut:])


def _half(tokens: list[tuple[str, str]]) -> _Half:
    """Degrees, perhaps minutes and seconds, with their units or without, a letter at either end."""
    shape = "".join({"letter": "L", "number": "n"}.get(kind, text) for kind, text in tokens)
    numbers = tuple(text for kind, text in tokens if kind == "number")
    is_shaped = re.fullmatch(r"L?n°?(n'?(n\"?)?)?|n°?(n'?(n\"?)?)?L", shape) is not None
    if not is_shaped or any("." in number for number in numbers[:-1]) or any(n[0] in "+-" for n in numbers[1:]):
        raise InputError(f"not a coordinate; write it as {FORMS}")
    if any(float(number) >= 60.0 for number in numbers[1:]):
        raise InputError("minutes and seconds are below 60")
    return _Half(numbers, next((text for kind, text in tokens if kind == "letter"), ""))
