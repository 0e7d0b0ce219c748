"""XML that any text can be put into. Standard library."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

KML = "http://www.opengis.net/kml/2.2"  # its namespace
# What XML 1.0 cannot hold at all, not even escaped.
_UNWRITABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


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
