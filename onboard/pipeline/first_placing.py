"""Which pictures get a set at once: those that could be sent.

The link takes a few sets a second, and of those that wait for their turn the newest. Where the camera is faster, most
pictures would be placed without use, and again when the window is past them. They are placed only then: once,
and as well as they ever are.
"""

from __future__ import annotations

from onboard.config.schema import Config

PLACED_A_SET = 4.0  # pictures placed for each set that the link may send: what it sends is at most so much older


class FirstPlacing:
    """Remembers the newest picture that was placed at once."""

    def __init__(self, config: Config) -> None:
        self._interval_ns = round(1e9 / (PLACED_A_SET * config.link.max_rate_hz))
        self._newest_ns: int | None = None  # None: the last one could not be placed

    def may_wait(self, stamp_ns: int, has_newer: bool) -> bool:
        """Whether a picture's first set may be its last. `has_newer`: a newer one can be placed with what has come.

        Only while placing succeeds: that pictures are refused must be known at once, and what is refused costs little.
        """
        newest_ns = self._newest_ns
        return newest_ns is not None and (has_newer or 0 <= stamp_ns - newest_ns < self._interval_ns)

    def note(self, stamp_ns: int, is_placed: bool) -> None:
        """What became of a picture that did not wait."""
        self._newest_ns = stamp_ns if is_placed else None
