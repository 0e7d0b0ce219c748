"""XML that is read without the tricks of a hostile file. Standard library."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import lru_cache
from xml.parsers import expat

from contract.errors import InputError

HEAD_BYTES = 65_536


def xml_root(data: bytes, needed: str, kept: str = "") -> ET.Element:
    """Return the root of a document, its tags without their namespaces, but for those of the namespace `kept`.

    Raises InputError for what is no document, and for one that declares entities or a DTD; `needed` states in words
    that such a file needs none.
    """

    def refuse(*_: object) -> None:
        raise InputError(f"declares a document type; {needed}, so this is not read")

    check = expat.ParserCreate()
    check.StartDoctypeDeclHandler = refuse
    try:
        _read_head(check, data)
        root = ET.fromstring(data)
    except (ET.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"not XML ({error})") from error
    for node in root.iter():
        node.tag = _without_namespace(node.tag, kept)
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
def _without_namespace(tag: str, kept: str) -> str:
    namespace, _, name = tag.rpartition("}")
    return tag if kept and namespace == f"{{{kept}" else name
