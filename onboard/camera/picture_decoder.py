"""Frames from raw pictures: their times, which were lost, which are worth looking at. No device, no pipe, no clock.

A picture is passed on with no image when it is damaged, and when it repeats the one before to the last bit: a sensor's
noise never does, so a repeat is an old picture under a new time stamp, the one thing that must not be georeferenced.
A repeat that was compressed again differs a little: it is one if next to nothing changed compared with what recently
did.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

from onboard.camera.pixel_formats import Grey, to_grey, to_raw
from onboard.camera.stamp_consistency import StampConsistency
from onboard.camera.thermal_grey import ThermalCounts, ThermalGrey
from onboard.events.session_clock import SessionClock
from onboard.events.types import Frame

STALE_NS = 500_000_000
"""A picture older than this when it is taken waited in the queue while this process did not run: too old to be used."""
FUTURE_NS = 5_000_000
"""A stamp this far ahead of the clock is not the time of a picture that is already here."""
RATE_WINDOW = 60
RATE_SLACK = 0.8
BAD_IN_A_ROW = 5
CHANGES, FEWEST_CHANGES = 30, 10  # pictures whose change is remembered, and that must have been seen to compare with
MOVING_QUANTILE = 0.8  # of changes: also where two pictures of three are repeats, it is one between pictures
STILL_SHARE = 0.2  # of that: two encodings of a picture differ by 0.03 of it, at most 0.3 where a key frame begins


@dataclass(frozen=True)
class RawPicture:
    """A picture as its source hands it on, not decoded yet: whichever way it came, out of a driver or of a pipe."""

    data: bytearray
    fourcc: str  # one of `pixel_formats.DECODERS`
    size_px: tuple[int, int]
    line_bytes: int  # from the beginning of one row to that of the next; 0: no padding
    stamp_ns: int  # on CLOCK_MONOTONIC, if `is_monotonic`; else on a clock that is not known
    sequence: int  # counts modulo 2**32
    is_monotonic: bool = True
    is_damaged: bool = False
    has_waited: bool = False  # it was, or may have been, there before it was taken


@dataclass
class Counts:
    """Since the camera was first opened."""

    pictures: int = 0  # passed on, those without an image included
    lost: int = 0  # gaps in the source's numbers
    skipped: int = 0  # taken too late, or under a time that cannot be
    damaged: int = 0
    repeated: int = 0
    reopened: int = 0


class Pictures:
    """Judges the pictures of one camera; `restart` whenever its stream begins again."""

    def __init__(
        self,
        clock: SessionClock,
        latency_s: float,
        size_px: tuple[int, int],
        rate_hz: float,
        stale_ns: int = STALE_NS,
        numbered_by: str = "driver",
        is_compressed: bool = False,
        thermal: ThermalGrey | None = None,
    ) -> None:
        self.counts = Counts()
        self.delay_ms = 0.0  # of the newest picture, from its stamp until it was taken
        self._clock, self._size_px, self._rate_hz = clock, size_px, rate_hz
        self._stale_ns, self._numbered_by, self._is_compressed = stale_ns, numbered_by, is_compressed
        self._latency_ns = round(latency_s * 1e9)
        self._thermal = thermal  # over restarts: the same sensor
        self._consistency = StampConsistency()  # over restarts: the same camera
        self._last_stamp_ns: int | None = None  # over restarts: stamps never run backwards
        self._begin()

    def _begin(self) -> None:
        self._sequence: int | None = None
        self._is_numbered = True
        self._last: Grey | ThermalCounts | None = None
        self._changes: deque[float] = deque(maxlen=CHANGES)  # mean difference of one picture to the next, grey levels
        self._stamps_ns: deque[int] = deque(maxlen=RATE_WINDOW)
        self._same_since_ns: int | None = None
        self._is_blank = False
        self._damaged_in_a_row = 0
        self._ahead_ns = 0
        self._uses_arrival = False
        self._stale_in_a_row = 0

    def restart(self) -> None:
        """The stream begins again: numbers and repeats start at zero, counts and stamps continue."""
        self._begin()

    def take(self, raw: RawPicture, now_ns: int) -> Frame | None:
        """A picture, and CLOCK_MONOTONIC when it was taken over -> a Frame, or None if it has no usable time."""
        self._count_lost(raw.sequence)
        monotonic_ns = self._capture_time(raw, now_ns)
        if monotonic_ns is None:
            self.counts.skipped += 1
            return None
        stamp_ns = self._clock.from_monotonic_ns(monotonic_ns) - self._latency_ns
        if self._last_stamp_ns is not None and stamp_ns <= self._last_stamp_ns:
            self.counts.skipped += 1
            return None
        self._last_stamp_ns = stamp_ns
        self.delay_ms = (self._clock.from_monotonic_ns(now_ns) - stamp_ns) / 1e6
        self._stamps_ns.append(stamp_ns)
        decoded, counts = self._decoded(raw)
        image = decoded if self._is_fresh(decoded if counts is None else counts, now_ns) else None
        sigma_s = self._consistency.sigma_s(now_ns, now_ns - monotonic_ns)
        frame = Frame(
            stamp_ns,
            self.counts.pictures,
            image,
            stamp_sigma_s=sigma_s,
            counts=None if image is None else counts,
        )
        self.counts.pictures += 1
        return frame

    def _decoded(self, raw: RawPicture) -> tuple[Grey | None, ThermalCounts | None]:
        """The picture, and of a thermal camera its counts; None if it is damaged, or not of the camera file's size."""
        if raw.is_damaged or raw.size_px != self._size_px:
            return None, None
        how = raw.fourcc, raw.data, raw.size_px, raw.line_bytes
        if self._thermal is None:
            return to_grey(*how), None
        deep = to_raw(*how)
        return (None, None) if deep is None else self._thermal.picture(deep)

    def _count_lost(self, sequence: int) -> None:
        if self._sequence is not None:
            step = (sequence - self._sequence) % 2**32
            self._is_numbered = step != 0
            if 0 < step < 2**31:  # else the source has begun to count again
                self.counts.lost += step - 1
        self._sequence = sequence

    def _capture_time(self, raw: RawPicture, now_ns: int) -> int | None:
        """CLOCK_MONOTONIC of the exposure as the source has it, of the arrival if need be, None if neither is."""
        age_ns = now_ns - raw.stamp_ns
        if raw.is_monotonic:
            self._uses_arrival = False
            self._ahead_ns = max(-age_ns, 0) if age_ns < -FUTURE_NS else 0
            is_stale = age_ns > self._stale_ns
            self._stale_in_a_row = self._stale_in_a_row + 1 if is_stale else 0
            return None if is_stale else raw.stamp_ns
        self._uses_arrival = not -FUTURE_NS <= age_ns <= self._stale_ns
        if not self._uses_arrival:
            return raw.stamp_ns
        # Not our clock. The arrival will do, unless the picture lay in the queue for we know not how long.
        return None if raw.has_waited else now_ns

    def _is_fresh(self, image: Grey | ThermalCounts | None, now_ns: int) -> bool:
        """Return whether a picture, as the camera gave it, is neither damaged (None) nor a repeat; count it if so."""
        if image is None:
            self.counts.damaged += 1
            self._damaged_in_a_row += 1
            return False
        self._damaged_in_a_row = 0
        last, self._last = self._last, image
        self._is_blank = bool(image.min() == image.max())
        # A sample first: nearly every picture already differs there.
        if last is None or self._is_blank or not self._repeats(last, image):
            self._same_since_ns = None
            return True
        self.counts.repeated += 1
        if self._same_since_ns is None:
            self._same_since_ns = now_ns
        return False

    def _repeats(self, last: Grey | ThermalCounts, image: Grey | ThermalCounts) -> bool:
        if not self._is_compressed:
            return not (np.any(last[::16, ::16] != image[::16, ::16]) or np.any(last != image))
        change = float(cv2.norm(last[::4, ::4], image[::4, ::4], cv2.NORM_L1)) / last[::4, ::4].size
        self._changes.append(change)
        if change == 0.0:
            return bool(np.all(last == image))
        usual = float(np.quantile(self._changes, MOVING_QUANTILE)) if len(self._changes) >= FEWEST_CHANGES else 0.0
        return change < STILL_SHARE * usual

    def frozen_s(self, now_ns: int) -> float:
        """Return for how long, in s, the same picture has come again and again."""
        return 0.0 if self._same_since_ns is None else (now_ns - self._same_since_ns) / 1e9

    @property
    def rate_hz(self) -> float:
        """Measured over the last pictures, by their stamps; 0 before there are any."""
        stamps_ns = self._stamps_ns  # another thread may ask while `restart` replaces it
        count = len(stamps_ns)
        return (count - 1) * 1e9 / (stamps_ns[-1] - stamps_ns[0]) if count > 1 else 0.0

    def complaints(self) -> list[str]:
        """Return a line for each thing that is not as it should be."""
        found = []
        if self._uses_arrival:
            found.append("stamps are not of CLOCK_MONOTONIC: times of arrival are used, later by an unknown delay")
        if self._ahead_ns:
            found.append(f"stamps lie {self._ahead_ns / 1e6:.0f} ms in the future: calibrate camera.latency_s")
        if self._stale_in_a_row > BAD_IN_A_ROW:
            found.append(f"every picture is older than {self._stale_ns / 1e9:g} s: none is used")
        if not self._is_numbered:
            found.append(f"the {self._numbered_by} does not number its pictures: lost ones cannot be counted")
        if self._damaged_in_a_row >= BAD_IN_A_ROW:
            found.append(f"the last {self._damaged_in_a_row} pictures are damaged")
        if self._is_blank:
            found.append("the picture is a single grey value: lens covered, or exposure far off")
        if len(self._stamps_ns) == RATE_WINDOW and self.rate_hz < RATE_SLACK * self._rate_hz:
            why = ": exposure too long, or bus too slow" if self._numbered_by == "driver" else ""
            found.append(f"{self.rate_hz:.1f} of {self._rate_hz:g} pictures a second{why}")
        return found
