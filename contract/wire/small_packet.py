"""Common parts of the small packets: clicks, tracks, spots. docs/wire-format.md, sections 13 to 15."""

from __future__ import annotations

from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload

HEIGHT_STEP_M = 0.001


def first_byte(payload: bytes, what: str, major: int, oldest: int | None = None) -> int:
    """Check a small packet's first byte, major version and kind of four bits each, and return the kind.

    Versions from `oldest` on are read, if that is not `major`.

    Raises TruncatedPayload, NewerPayload (versions from `major` + 1 on) or CorruptPayload.
    """
    if not payload:
        raise TruncatedPayload("an empty packet")
    version, kind = payload[0] >> 4, payload[0] & 15
    if version > major:
        raise NewerPayload(f"{what} of version {version}; this program reads up to {major}")
    if version < (major if oldest is None else oldest):
        raise CorruptPayload(f"{what} of version {version}")
    return kind


def heights_of(
    height: int, undulation: bytes, has_amsl: bool, has_ellipsoid: bool
) -> tuple[float | None, float | None]:
    """Above mean sea level and above the ellipsoid, m: one is sent, and the way between, if both are known."""
    known = height * HEIGHT_STEP_M
    if has_amsl and has_ellipsoid:
        return known, known + int.from_bytes(undulation, "little", signed=True) * HEIGHT_STEP_M
    return known if has_amsl else None, known if has_ellipsoid else None
