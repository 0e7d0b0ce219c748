"""The common name of a certificate: under which rights are kept, and by which an aircraft knows who asks.

The base install has no library that reads certificates, and the standard library's does not hand out our own.
"""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from pathlib import Path

from contract.errors import LinkError

SEQUENCE, SET, VERSION, OBJECT = 0x30, 0x31, 0xA0, 0x06
COMMON_NAME = bytes([0x55, 0x04, 0x03])  # 2.5.4.3, X.520
TEXTS = {0x0C: "utf-8", 0x13: "ascii", 0x16: "ascii"}  # UTF8String, PrintableString, IA5String


def common_name(certificate: Path | str) -> str:
    """The common name of a PEM file's first certificate (RFC 5280, 4.1). Raises LinkError."""
    try:
        text = Path(certificate).read_text("ascii")
        begin, end = text.index(ssl.PEM_HEADER), text.index(ssl.PEM_FOOTER) + len(ssl.PEM_FOOTER)
        fields = list(_parts(_only(_only(ssl.PEM_cert_to_DER_cert(text[begin:end] + "\n"), SEQUENCE), SEQUENCE)))
        if fields[0][0] == VERSION:
            fields = fields[1:]
        subject = fields[4][1]  # after serial number, signature's algorithm, issuer and validity
        for _, names in _parts(subject):
            for _, named in _parts(names):
                (_, kind), (tag, value) = _parts(named)
                if kind == COMMON_NAME and tag in TEXTS:
                    return value.decode(TEXTS[tag])
    except OSError as error:
        raise LinkError(f"{certificate}: {error.strerror}") from error
    except (ValueError, IndexError) as error:
        raise LinkError(f"{certificate}: no certificate can be read there") from error
    raise LinkError(f"{certificate}: the certificate has no common name")


def _only(data: bytes, tag: int) -> bytes:
    """The content of the first element, which has that tag. Raises ValueError."""
    found, content = next(_parts(data), (None, b""))
    if found != tag:
        raise ValueError("another element was to be here")
    return content


def _parts(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of each element (X.690, DER) of some bytes. Raises ValueError for what is cut off."""
    at = 0
    while at < len(data):
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(data[at : at + size], "big"), at + size
        if at + length > len(data):
            raise ValueError("cut off")
        yield tag, data[at : at + length]
        at += length
