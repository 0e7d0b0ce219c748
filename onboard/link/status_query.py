"""A running daemon's own report, asked for over the link on this computer."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence

import zenoh

from contract.link_config import Tls, link_config
from contract.topics import DETAIL_PARAMETER, STATUS

TIMEOUT_S = 3.0  # a daemon drops a reply that found no room on the link after 2.8 s
PATIENCE_S = 8.0  # reports are large: at 32 kbit/s, the room that replies have is enough for one in two seconds
_AT_ONCE_S = 1.0  # a server without such a vehicle answers sooner
_EVERYWHERE = re.compile(r"/(0\.0\.0\.0|\[::\]):")


def local_endpoints(listen: Sequence[str]) -> list[str]:
    """Return the endpoints at which this computer reaches what listens there: "everywhere" is loopback too."""
    return [_EVERYWHERE.sub("/127.0.0.1:", endpoint) for endpoint in listen]


def ask(vehicle: str, listen: Sequence[str], tls: Tls | None = None) -> bytes | None:
    """The daemon's detailed report as it sends it (`onboard.service.reports`); None without an answer.

    With `tls`, its own: the daemon answers any program that shows its certificate.
    """
    for endpoint in local_endpoints(listen):
        try:
            session = zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint], tls=tls)))
        except zenoh.ZError:
            continue
        try:
            if (found := _asked(session, f"{STATUS.key(vehicle)}?{DETAIL_PARAMETER}=1")) is not None:
                return found
        finally:
            session.close()  # type: ignore[no-untyped-call]
    return None


def _asked(session: zenoh.Session, question: str) -> bytes | None:
    """Asks again while the daemon is there and only had no time to answer."""
    end_s = time.monotonic() + PATIENCE_S
    while (begin_s := time.monotonic()) < end_s:
        for reply in session.get(question, timeout=TIMEOUT_S):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        if time.monotonic() - begin_s < _AT_ONCE_S:
            return None
    return None
