"""Inside the guest: runs the commands that arrive as JSON lines on a serial line, several at once if asked.

A request is {"job": n, "argv": [...], "cwd": ..., "env": {...}, "timeout_s": ...}; the answers are {"job": n, "text":
...} while it talks and {"job": n, "exit": code} at its end (code null: it was killed for its time). {"job": n, "clock":
true} is answered with {"job": n, "monotonic_ns": ...} and nothing else, for the offset of the two clocks.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import tty
from typing import Any

_sending = threading.Lock()


def main() -> None:
    """Serve the line named by the first argument for as long as the guest runs."""
    line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
    tty.setraw(line)
    _send(line, {"ready": True})
    with os.fdopen(os.dup(line), "rb", buffering=0) as requests:
        pending = b""
        while True:
            pending += requests.read(4096)
            *whole, pending = pending.split(b"\n")
            for raw in whole:
                _begin(line, json.loads(raw))


def _begin(line: int, request: dict[str, Any]) -> None:
    if "clock" in request:
        _send(line, {"job": request["job"], "monotonic_ns": time.monotonic_ns()})
        return
    threading.Thread(target=_run, args=(line, request), daemon=True).start()


def _run(line: int, request: dict[str, Any]) -> None:
    job = request["job"]
    try:
        process = subprocess.Popen(
            request["argv"],
            cwd=request.get("cwd") or "/",
            env={**os.environ, **request.get("env", {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        _send(line, {"job": job, "text": f"{error}\n"})
        _send(line, {"job": job, "exit": 127})
        return
    in_time = threading.Timer(request["timeout_s"], _kill, args=(process,))
    in_time.start()
    assert process.stdout is not None
    while chunk := os.read(process.stdout.fileno(), 2048):
        _send(line, {"job": job, "text": chunk.decode(errors="replace")})
    code = process.wait()
    expired = not in_time.is_alive()
    in_time.cancel()
    _send(line, {"job": job, "exit": None if expired and code == -signal.SIGKILL else code})


def _kill(process: subprocess.Popen[bytes]) -> None:
    os.killpg(process.pid, signal.SIGKILL)


def _send(line: int, answer: dict[str, Any]) -> None:
    raw = json.dumps(answer).encode() + b"\n"
    with _sending:
        while raw:
            raw = raw[os.write(line, raw) :]


if __name__ == "__main__":
    main()
