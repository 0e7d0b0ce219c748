"""Events sent to browsers at once: one bounded queue each; one that does not keep up must fetch everything again."""

from __future__ import annotations

import asyncio
import json
from typing import Any

MAX_WAITING = 200
MAX_BROWSERS = 200
_RESYNC = json.dumps({"type": "resync"})


class Hub:
    """Its methods are called in the event loop's thread, but for `send_from_thread`."""

    def __init__(self) -> None:
        self._queues: set[asyncio.Queue[str]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()

    def __len__(self) -> int:
        return len(self._queues)

    def join(self) -> asyncio.Queue[str] | None:
        """A queue for one more browser; None if there are too many."""
        if len(self._queues) >= MAX_BROWSERS:
            return None
        queue: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING)
        self._queues.add(queue)
        return queue

    def leave(self, queue: asyncio.Queue[str]) -> None:
        self._queues.discard(queue)

    def send(self, event: dict[str, Any] | str) -> None:
        """Send an object, or its JSON, to every browser. A full queue is emptied first, and begins with a resync."""
        text = _text(event)
        for queue in self._queues:
            if queue.full():
                while not queue.empty():
                    queue.get_nowait()
                queue.put_nowait(_RESYNC)
            queue.put_nowait(text)

    def send_from_thread(self, event: dict[str, Any] | str) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.send, _text(event))


def _text(event: dict[str, Any] | str) -> str:
    return event if isinstance(event, str) else json.dumps(event, separators=(",", ":"))
