"""The bench's tests run with `make test-bench` only; those in `inside/` run in the guest, by `test_inside.py`."""

from __future__ import annotations

import os

ON_THE_HOST = os.environ.get("POINTCLICK_BENCH") == "1"
IN_THE_GUEST = os.environ.get("POINTCLICK_IN_GUEST") == "1"

collect_ignore_glob = ["inside/*"] if not IN_THE_GUEST else []
if not ON_THE_HOST:
    collect_ignore_glob.append("test_*.py")
