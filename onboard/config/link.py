"""The sections `link` and `look`: who listens, who may ask for what, and what the camera may be sent to look at."""

from __future__ import annotations

from contract.errors import ConfigError
from contract.fleet import NAME
from onboard.config.section import Section, choice, quantity


class Link(Section):
    """zenoh, the link to the ground."""

    listen: tuple[str, ...] = choice(("tcp/127.0.0.1:7447",), "zenoh endpoints to listen on; loopback unless opened")
    connect: tuple[str, ...] = choice((), "zenoh endpoints to connect to")
    scouting: bool = choice(False, "announce and look for peers on the local network by multicast")
    max_bit_rate: float = quantity(
        32000.0, 4000.0, 1e9, "bit/s", "all that is sent keeps below this, link overhead included"
    )
    min_rate_hz: float = quantity(0.2, 0.01, 30.0, "Hz", "feature sets sent at least, while there are any")
    max_rate_hz: float = quantity(
        5.0, 0.01, 30.0, "Hz", "new pictures' feature sets sent at most; older ones' half as often"
    )
    ca: str | None = choice(None, "TLS: certificate of the authority that both ends trust")
    certificate: str | None = choice(None, "TLS: this aircraft's certificate")
    key: str | None = choice(None, "TLS: this aircraft's private key")
    allowed: tuple[str, ...] = choice(
        (), "TLS: common names of the certificates that may listen and ask; empty: every one of the authority's"
    )
    trackers: tuple[str, ...] = choice(
        (), "TLS: common names of the certificates that may begin and end tracks; empty: all that may ask"
    )
    pointers: tuple[str, ...] = choice(
        (), "TLS: common names of the certificates that may have the camera look at a clicked place; empty: no one"
    )
    mavlink: bool = choice(
        False, "answer clicks and send sets through the autopilot's own radio too (pc-ground --connect mavlink:...)"
    )
    mavlink_bit_rate: float = quantity(
        4800.0, 200.0, 1e6, "bit/s", "all that is sent through the autopilot keeps below this, MAVLink's bytes included"
    )
    history_s: float = quantity(600.0, 1.0, 86400.0, "s", "feature sets this young are kept to answer queries")
    history_sets: int = quantity(5000, 1, 100000, "", "at most this many of them")


class Look(Section):
    """Limits of what `link.pointers` may have the camera look at, and the aircraft circle (docs/look-there.md)."""

    max_radius_m: float = quantity(25.0, 0.1, 1000.0, "m", "a place whose 90 % radius is larger is refused")
    max_age_s: float = quantity(60.0, 1.0, 600.0, "s", "a click on a picture that is older is refused")
    circle_radius_m: float | None = quantity(
        None, 20.0, 2000.0, "m", "the radius at which `link.pointers` may have the aircraft circle; unset: no one may"
    )
    circle_clearance_m: float = quantity(
        60.0, 10.0, 2000.0, "m", "a circle less than this above the clicked place is refused"
    )


def check_pointers(link: Link) -> None:
    """Raise ConfigError where `link.pointers` can never work: the files of a configuration are each valid by itself."""
    if not link.pointers:
        return
    if None in (link.ca, link.certificate, link.key):
        raise ConfigError(
            "link.pointers are names of certificates: set link.ca, link.certificate and link.key (docs/look-there.md)"
        )
    if left_out := [name for name in link.pointers if link.allowed and name not in link.allowed]:
        raise ConfigError(
            f"link.pointers: {', '.join(left_out)} must also be in link.allowed, or link.allowed be empty"
        )
    if wrong := [name for name in link.pointers if NAME.fullmatch(name) is None]:
        raise ConfigError(f"link.pointers: {wrong[0]!r} must be 1 to 32 letters, digits, '_', '.' or '-'")
