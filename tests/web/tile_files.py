"""Base maps as their users make them: small MBTiles and PMTiles files of one drawn tile, over the whole earth."""

from __future__ import annotations

import io
import json
import sqlite3
import struct
from pathlib import Path

from PIL import Image, ImageDraw

COLOUR = (230, 120, 20)
DEEPEST = 4  # the page shows these tiles larger where it is closer


def drawn_tile() -> bytes:
    """PNG, 256 x 256, of one colour with a dark edge."""
    tile = Image.new("RGB", (256, 256), COLOUR)
    ImageDraw.Draw(tile).rectangle((0, 0, 255, 255), outline=(60, 30, 0), width=2)
    out = io.BytesIO()
    tile.save(out, "PNG")
    return out.getvalue()


def write_mbtiles(path: Path) -> None:
    """MBTiles 1.3."""
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
        base.execute("CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)")
        about = {"name": "drawn", "format": "png", "minzoom": "0", "maxzoom": str(DEEPEST), "attribution": "<b>us</b>"}
        base.executemany("INSERT INTO metadata VALUES (?, ?)", about.items())
        tile = drawn_tile()
        rows = ((z, x, y, tile) for z in range(DEEPEST + 1) for x in range(1 << z) for y in range(1 << z))
        base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)


def write_pmtiles(path: Path) -> None:
    """PMTiles 3 with one entry that runs through all tiles; nothing compressed."""
    tile = drawn_tile()
    count = sum(4**z for z in range(DEEPEST + 1))
    # One directory entry: tile id 0, run length, tile length, offset + 1.
    root = b"".join(_varint(number) for number in (1, 0, count, len(tile), 1))
    metadata = json.dumps({"name": "drawn"}).encode()
    root_at = 127
    metadata_at = root_at + len(root)
    leaves_at = tile_at = metadata_at + len(metadata)
    head = b"PMTiles" + struct.pack(
        "<B11Q6B4iB2i",
        3, root_at, len(root), metadata_at, len(metadata), leaves_at, 0, tile_at, len(tile), count, 1, 1,
        1, 1, 1, 2, 0, DEEPEST, -1_800_000_000, -850_000_000, 1_800_000_000, 850_000_000, 2, 0, 0,
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
