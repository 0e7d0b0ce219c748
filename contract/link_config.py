"""The zenoh configuration of both ends, as JSON text. Values measured on cut, lossy and thin links (COMPONENTS.md)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

OPEN_TIMEOUT_MS = 2000


def link_config(mode: str, *, listen: Sequence[str] = (), connect: Sequence[str] = (), scouting: bool = False) -> str:
    """Text for `zenoh.Config.from_json5`.

    A "peer" goes on without those it connects to and tries them again every 0.5 to 1 s, for good; a "client" tries
    once and fails at once.
    """
    is_client = mode == "client"
    config: dict[str, Any] = {
        "mode": mode,
        "listen": {"endpoints": list(listen)},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": 0 if is_client else -1,
            "exit_on_failure": is_client,
            "retry": {"period_init_ms": 500, "period_max_ms": 1000, "period_increase_factor": 1},
        },
        "scouting": {"multicast": {"enabled": scouting}},
        # Ten keep-alives in a lease of ten seconds: reconnects within 2.5 s of a cut, and holds at 20 % loss.
        "transport": {
            "unicast": {"open_timeout": OPEN_TIMEOUT_MS},
            "link": {"tx": {"lease": 10000, "keep_alive": 10}},
        },
    }
    return json.dumps(config)
