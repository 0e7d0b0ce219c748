"""A recorded picture as a browser shows it."""

from __future__ import annotations

import base64
import binascii
import json

from ground.web.source import Picture

# Signatures of what a browser shows; what a recording calls a picture and is none is not sent to one.
_SIGNATURES = ((b"\xff\xd8\xff", "image/jpeg"), (b"\x89PNG\r\n\x1a\n", "image/png"))


def picture_of(message: bytes) -> Picture | None:
    """The picture of a recording's message; None if it is damaged."""
    try:
        encoded = base64.b64decode(json.loads(message)["data"], validate=True)
    except (ValueError, KeyError, TypeError, RecursionError, binascii.Error):
        return None
    media_type = media_type_of(encoded)
    return None if media_type is None else Picture(encoded, media_type)


def media_type_of(content: bytes) -> str | None:
    """JPEG, PNG or WebP by how it begins; None for anything else."""
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    return next((kind for start, kind in _SIGNATURES if content.startswith(start)), None)
