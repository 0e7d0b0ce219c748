"""XML that any text can be put into, and that is read without the tricks of a hostile file. Standard library."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from contract.errors import InputError
from contract.xml_root import xml_root

# What XML 1.0 cannot hold at all, not even escaped.
_UNWRITABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
MAX_BYTES = 200_000_000


def plain(text: str) -> str:
    """A text for an element or an attribute, which ElementTree escapes; a character XML cannot hold becomes U+FFFD."""
    return _UNWRITABLE.sub("\ufffd", text)


def element(parent: ET.Element | None, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    """A new element, below another or by itself."""
    clean = {name: plain(value) for name, value in attributes.items()}
    made = ET.Element(tag, clean) if parent is None else ET.SubElement(parent, tag, clean)
    if text is not None:
        made.text = plain(text)
    return made


def document(root: ET.Element) -> str:
    """The document with its declaration, indented, one line feed at the end."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def parsed(data: bytes, what: str) -> ET.Element:
    """The root of a document, its tags without their namespaces: files of places are read whatever theirs is.

    Raises InputError for what is no document, and for one that declares entities or a DTD.
    """
    if len(data) > MAX_BYTES:
        raise InputError(f"{what}: {len(data)} bytes; at most {MAX_BYTES} are read")

    try:
        return xml_root(data, "a file of places needs none")
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
