"""Base maps as their users make them: small MBTiles and PMTiles files of one rendered tile, over the whole earth."""

import io
import json
import sqlite3
import struct
from pathlib import Path

from PIL import Image, ImageDraw

COLOUR = (230, 120, 20)
REGION = (148.710938, -43.834527, 149.414062, -43.325178)  # west, south, east, north: two by two tiles of zoom 10
DEEPEST = 4  # the page shows these tiles larger where it is closer


def rendered_tile() -> bytes:
    """PNG, 256 x 256, of one colour with a dark edge."""
    tile = Image.new("RGB", (256, 256), COLOUR)
    ImageDraw.Draw(tile).rectangle((0, 0, 255, 255), outline=(60, 30, 0), width=2)
    out = io.BytesIO()
    tile.save(out, "PNG")
    return out.getvalue()


def write_region(path: Path) -> None:
    """Tiles of REGION in the zooms 10 to 12, and of nothing else, as the name's ending says."""
    if path.suffix == ".pmtiles":
        _write_pmtiles(path, 10, 12, REGION)
        return
    tiles = []
    for z in (10, 11, 12):
        side = 1 << (z - 10)  # of a tile of zoom 10, in tiles of this one
        tiles += [(z, x, y) for x in range(935 * side, 937 * side) for y in range(373 * side, 375 * side)]
    _write_mbtiles(path, {}, tiles)


def write_mbtiles(path: Path) -> None:
    """MBTiles 1.3 of the whole world."""
    about = {"minzoom": "0", "maxzoom": str(DEEPEST), "attribution": "<b>us</b>"}
    _write_mbtiles(path, about, [(z, x, y) for z in range(DEEPEST + 1) for x in range(1 << z) for y in range(1 << z)])


def _write_mbtiles(path: Path, more: dict[str, str], tiles: list[tuple[int, int, int]]) -> None:
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
        base.execute("CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)")
        base.executemany("INSERT INTO metadata VALUES (?, ?)", {"name": "drawn", "format": "png", **more}.items())
        tile = rendered_tile()
        base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", ((*at, tile) for at in tiles))


def write_pmtiles(path: Path) -> None:
    """PMTiles 3 of the whole world."""
    _write_pmtiles(path, 0, DEEPEST, (-180.0, -85.0, 180.0, 85.0))


def _write_pmtiles(path: Path, least: int, most: int, bounds: tuple[float, float, float, float]) -> None:
    """With one entry that runs through all tiles of the zooms; nothing compressed."""
    tile = rendered_tile()
    first, count = sum(4**z for z in range(least)), sum(4**z for z in range(least, most + 1))
    # One directory entry: the first tile's id, run length, tile length, offset + 1.
    root = b"".join(_varint(number) for number in (1, first, count, len(tile), 1))
    metadata = json.dumps({"name": "drawn"}).encode()
    root_at = 127
    metadata_at = root_at + len(root)
    leaves_at = tile_at = metadata_at + len(metadata)
    head = b"PMTiles" + struct.pack(
        "<B11Q6B4iB2i",
        3, root_at, len(root), metadata_at, len(metadata), leaves_at, 0, tile_at, len(tile), count, 1, 1,
        1, 1, 1, 2, least, most, *(round(degrees * 1e7) for degrees in bounds), least, 0, 0,
    )  # fmt: skip
    assert len(head) == root_at
    path.write_bytes(head + root + metadata + tile)


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    out.append(number)
    return bytes(out)
