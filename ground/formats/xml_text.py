"""XML that any text can be put into, and that is read without the tricks of a hostile file. Standard library."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from xml.parsers import expat

from contract.errors import InputError

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
    """With its declaration, indented, one line feed at the end."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def parsed(data: bytes, what: str) -> ET.Element:
    """The root of a document. Raises InputError for what is none, and for one that declares entities or a DTD."""
    if len(data) > MAX_BYTES:
        raise InputError(f"{what}: {len(data)} bytes; at most {MAX_BYTES} are read")

    def refuse(*_: object) -> None:
        raise InputError(f"{what}: declares a document type; a file of places needs none, so this is not read")

    check = expat.ParserCreate()
    check.StartDoctypeDeclHandler = refuse
    try:
        check.Parse(data, True)
        return ET.fromstring(data)
    except (ET.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{what}: not XML ({error})") from error


def local_name(node: ET.Element) -> str:
    """A tag without its namespace."""
    return node.tag.rpartition("}")[2] if isinstance(node.tag, str) else ""


def child_text(node: ET.Element, name: str) -> str:
    """The text of the first child of this name, whatever its namespace; empty if there is none."""
    return next((child.text or "" for child in node if local_name(child) == name), "")
