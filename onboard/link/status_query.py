"""A running daemon's own report, asked for over the link on this computer."""

from __future__ import annotations

import re
from collections.abc import Sequence

import zenoh

from contract.link_config import Tls, link_config
from contract.topics import DETAIL_PARAMETER, STATUS

TIMEOUT_S = 2.0
_EVERYWHERE = re.compile(r"/(0\.0\.0\.0|\[::\]):")


def local_endpoints(listen: Sequence[str]) -> list[str]:
    """Where this computer reaches what listens there: "everywhere" is loopback too."""
    return [_EVERYWHERE.sub("/127.0.0.1:", endpoint) for endpoint in listen]


def ask(vehicle: str, listen: Sequence[str], tls: Tls | None = None) -> bytes | None:
    """The daemon's detailed report as it sends it (`onboard.service.reports`); None if nobody answers.

    With `tls`, its own: the daemon lets whoever shows its certificate ask it.
    """
    for endpoint in local_endpoints(listen):
        try:
            session = zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint], tls=tls)))
        except zenoh.ZError:
            continue
        try:
            for reply in session.get(f"{STATUS.key(vehicle)}?{DETAIL_PARAMETER}=1", timeout=TIMEOUT_S):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
        finally:
            session.close()  # type: ignore[no-untyped-call]
    return None
