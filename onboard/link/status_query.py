"""A running daemon's own report, asked for over the link on this computer."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import zenoh

from contract.errors import LinkError
from contract.link_config import Tls, link_config
from contract.topics import DETAIL_PARAMETER, STATUS

TIMEOUT_S = 2.0
_EVERYWHERE = re.compile(r"/(0\.0\.0\.0|\[::\]):")


def local_endpoints(listen: Sequence[str]) -> list[str]:
    """Where this computer reaches what listens there: "everywhere" is loopback too."""
    return [_EVERYWHERE.sub("/127.0.0.1:", endpoint) for endpoint in listen]


def ask(vehicle: str, listen: Sequence[str], tls: Tls | None = None) -> dict[str, Any] | None:
    """The daemon's detailed report; None if nobody answers. Raises LinkError for an answer that is none.

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
                    return _read(reply.ok.payload.to_bytes())
        finally:
            session.close()  # type: ignore[no-untyped-call]
    return None


def _read(payload: bytes) -> dict[str, Any]:
    try:
        content = json.loads(payload)
    except ValueError as error:
        raise LinkError(f"the daemon's report cannot be read: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("status"), dict):
        raise LinkError("the daemon's report is none; is it of another version?")
    return content
