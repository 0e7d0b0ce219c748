"""TAK data packages: placed pins as Cursor on Target, the pictures around their clicks attached, in one ZIP.

The manifest is `MissionPackageManifest`, version 2, at `MANIFEST/manifest.xml`. Of each file in the package it has a
`Content`; its parameter `uid` is that of the event in the file or, of a picture, that of the event it is attached to.
"""

from __future__ import annotations

import hashlib
import io
import uuid
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Sequence
from typing import Any

from contract.errors import InputError
from contract.xml_text import document, element
from ground.bounded_picture import decoded
from ground.formats import cot
from ground.formats.mark import Mark

MEDIA_TYPE = "application/zip"
VALID_S = 365 * 86_400.0  # a package is opened when there is time for it
JPEG_QUALITY = 90
MAX_PIXELS = 4_000_000


def write(marks: Sequence[Mark], crop_of: Callable[[str], bytes | None], now_unix_ns: int) -> bytes:
    """The package's content; `crop_of` gives the pictures of the pins' clicks, by click id.

    Raises InputError where no mark has a position, or where there are pictures and no Pillow.
    """
    placed = [(mark, text) for mark in marks if (text := cot.event(mark, now_unix_ns, VALID_S, is_kept=True))]
    if not placed:
        raise InputError("none of the pins has a position: there is nothing to put into a data package")
    root = element(None, "MissionPackageManifest", version="2")
    about, contents = element(root, "Configuration"), element(root, "Contents")
    key = " ".join(sorted(mark.id for mark, _ in placed))  # the same pins again replace the package of before
    _parameter(about, "uid", str(uuid.uuid5(uuid.NAMESPACE_URL, f"pointclick:{key}")))
    _parameter(about, "name", placed[0][0].title[:100] if len(placed) == 1 else f"{len(placed)} pins")
    files: dict[str, bytes] = {}
    for mark, text in placed:
        uid = ET.fromstring(text).get("uid", "")
        entry = f"{_folder(uid.encode())}/{_folder(uid.encode())}.cot"
        files[entry] = f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
        _content(contents, entry, uid, mark.title[:100])
        for number, picture in enumerate(_pictures(mark, crop_of), 1):
            entry = f"{_folder(uid.encode() + picture)}/click-{number}.jpg"
            files[entry] = picture
            _content(contents, entry, uid)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("MANIFEST/manifest.xml", document(root))
        for entry, content in files.items():
            package.writestr(entry, content)
    return out.getvalue()


def _pictures(mark: Mark, crop_of: Callable[[str], bytes | None]) -> list[bytes]:
    """The pin's pictures, the newest click's first, as JPEG, which every TAK shows; what is no picture is left out."""
    crops = [crop for click in reversed(mark.pin.clicks if mark.pin else ()) if (crop := crop_of(click.id)) is not None]
    return [picture for crop in crops if (picture := _jpeg(crop)) is not None]


def _jpeg(crop: bytes) -> bytes | None:
    try:
        return decoded(crop, MAX_PIXELS, _as_jpeg)
    except ImportError as error:
        raise InputError(
            "a data package's pictures need the package Pillow: install pointclick with its extra [web] (README)"
        ) from error


def _as_jpeg(picture: Any) -> bytes:
    out = io.BytesIO()
    picture.convert("RGB").save(out, "JPEG", quality=JPEG_QUALITY)
    return out.getvalue()


def _folder(content: bytes) -> str:
    """A name that no one chose: another's pin may have any id."""
    return hashlib.sha256(content).hexdigest()[:32]


def _content(contents: ET.Element, entry: str, uid: str, name: str = "") -> None:
    made = element(contents, "Content", ignore="false", zipEntry=entry)
    _parameter(made, "uid", uid)
    if name:
        _parameter(made, "name", name)


def _parameter(parent: ET.Element, name: str, value: str) -> None:
    element(parent, "Parameter", name=name, value=value)
