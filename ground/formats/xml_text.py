"""XML that is read without the tricks of a hostile file. Standard library."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from contract.errors import InputError
from contract.xml_root import xml_root

MAX_BYTES = 200_000_000


def parsed(data: bytes, what: str, kept: str = "") -> ET.Element:
    """The root of a document, its tags without their namespaces: files of places are read whatever theirs is. Only
    those of the namespace `kept` keep it.

    Raises InputError for what is no document, and for one that declares entities or a DTD.
    """
    if len(data) > MAX_BYTES:
        raise InputError(f"{what}: {len(data)} bytes; at most {MAX_BYTES} are read")

    try:
        return xml_root(data, "a file of places needs none", kept)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
