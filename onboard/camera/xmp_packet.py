"""The XMP packet of a photograph as names and texts.

XMP is XML, read by the standard library from its root element on, before which alone a document type could stand.
"""

from __future__ import annotations

from xml.etree import ElementTree

PIX4D = "http://pix4d.com/camera/1.0"
RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"


def read_xmp(packet: bytes) -> dict[str, str]:
    """Attributes and elements by their names without namespace; empty for what is no XMP.

    Those of Pix4D's namespace stand under "Camera:" as well, because light sensors and aircraft have their own `Yaw`;
    the parts of a structure under its name, as in "CameraOrientationNED/Yaw"; lists are joined by commas.
    """
    start, end = packet.find(b"<x:xmpmeta"), packet.rfind(b"</x:xmpmeta>")
    if start < 0 or end < 0:
        return {}
    try:
        root = ElementTree.fromstring(packet[start : end + len(b"</x:xmpmeta>")])
    except ElementTree.ParseError:
        return {}
    found: dict[str, str] = {}
    _collect(root, "", found)
    return found


def _collect(node: ElementTree.Element, parent: str, found: dict[str, str]) -> None:
    is_rdf = node.tag.startswith(RDF) or not node.tag.startswith("{")
    own = "" if is_rdf else _names(node.tag, parent, _text(node), found)
    for name, value in node.attrib.items():
        if not name.startswith(RDF):
            _names(name, own or parent, value.strip(), found)
    for child in node:
        _collect(child, own or parent, found)


def _text(node: ElementTree.Element) -> str:
    items = [item.text.strip() for item in node.iter(f"{RDF}li") if item.text and item.text.strip()]
    return ",".join(items) or (node.text or "").strip()


def _names(tag: str, parent: str, value: str, found: dict[str, str]) -> str:
    """File a value under its names; returns the plain one."""
    space, _, name = tag.rpartition("}")
    if value:
        found[name] = value
        if space.lstrip("{").startswith(PIX4D):
            found[f"Camera:{name}"] = value
        if parent:
            found[f"{parent}/{name}"] = value
    return name
