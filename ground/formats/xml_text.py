"""XML that any text can be put into, and that is read without the tricks of a hostile file. Standard library."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from functools import lru_cache
from xml.parsers import expat

from contract.errors import InputError

# What XML 1.0 cannot hold at all, not even escaped.
_UNWRITABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
MAX_BYTES = 200_000_000
HEAD_BYTES = 65_536


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

    def refuse(*_: object) -> None:
        raise InputError(f"{what}: declares a document type; a file of places needs none, so this is not read")

    check = expat.ParserCreate()
    check.StartDoctypeDeclHandler = refuse
    try:
        _read_head(check, data)
        root = ET.fromstring(data)
    except (ET.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{what}: not XML ({error})") from error
    for node in root.iter():
        node.tag = _without_namespace(node.tag)
    return root


def _read_head(check: expat.XMLParserType, data: bytes) -> None:
    """Read up to the first element. A document type stands before it, or the document is not XML."""
    begun: list[str] = []
    check.StartElementHandler = lambda tag, _: begun.append(tag)
    for start in range(0, len(data), HEAD_BYTES):
        check.Parse(data[start : start + HEAD_BYTES], False)
        if begun:
            return
    check.Parse(b"", True)


@lru_cache(maxsize=1024)
def _without_namespace(tag: str) -> str:
    return tag.rpartition("}")[2]
