"""The exception tree. Messages carry the offending value and what to do instead.

PointclickError
├── ConfigError            a configuration key or value is wrong
├── InputError             a file, a picture, a log or a recording cannot be used
├── LinkError              the link cannot be opened, or there is no answer on it
└── WireError              a payload is not a feature set this version can read
    ├── CorruptPayload     checksum or content is inconsistent
    ├── TruncatedPayload   shorter than its own header states
    ├── NewerPayload       written by a newer, incompatible version
    └── ForeignMessage     it names another vehicle than the key on which it came

Expected geometric failure (too little parallax, a click at the sky) is a value, a `Status`, never an exception.
"""

from __future__ import annotations

from contract.secrets import without_secrets


class PointclickError(Exception):
    """Base of every error this project raises on purpose. Its message bears no secret of an address."""

    def __init__(self, message: str = "") -> None:
        super().__init__(without_secrets(message))


class ConfigError(PointclickError):
    """A configuration key or value is wrong."""


class InputError(PointclickError):
    """A file, a picture, a log or a recording cannot be used."""


class LinkError(PointclickError):
    """The link cannot be opened, or there is no answer on it."""


class WireError(PointclickError):
    """A payload is not a feature set this version can read."""


class CorruptPayload(WireError):
    """Checksum or content is inconsistent."""


class TruncatedPayload(WireError):
    """Shorter than its own header states."""


class NewerPayload(WireError):
    """Written by a newer, incompatible version."""


class ForeignMessage(WireError):
    """Its content names another vehicle than the key, or the radio's system, on which it came."""
