"""Keyframes as small images on the link: which picture goes next, made small in a thread of its own.

Making one takes 10 ms (WebP, 480 px) to 25 (640) of a desktop's core, and some times that of a Pi's: nothing for the
pipeline's thread, which only hands references over. Nothing is made that the link would not take at once.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from contract.picture import ImageFormat, LinkPicture
from contract.supervised_thread import SupervisedThread, WokenWork
from onboard.config.schema import PictureConfig
from onboard.events.types import Event, Frame

# Pictures wait here for their set, which states whether they are keyframes: so many bytes, the last few in any case.
HELD_BYTES, HELD_FRAMES = 32_000_000, 4
IDLE_S = 0.25
LOOK_S = 0.1  # between looks whether the link has room again
WARN_AGAIN_S = 60.0

log = logging.getLogger("pointclick")


class PictureLink(Protocol):
    """The part of `onboard.link.publisher.Publisher` that takes pictures."""

    def picture_room(self) -> int:
        """Bytes that a packet may take; 0: no picture is wanted now."""

    def send_picture(self, picture: LinkPicture, piece_bytes: int) -> None:
        """Send one. Raises ValueError if it is too large."""


def small_image(image: NDArray[np.uint8], section: PictureConfig) -> tuple[bytes, int, int]:
    """A grey picture (H, W) compressed as the section specifies; and width and height, px."""
    scale = section.max_px / max(image.shape)
    if scale < 1.0:
        height, width = (max(round(side * scale), 1) for side in image.shape)
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    quality = cv2.IMWRITE_WEBP_QUALITY if section.format == "webp" else cv2.IMWRITE_JPEG_QUALITY
    is_done, encoded = cv2.imencode(f".{section.format}", image, [quality, section.quality])
    assert is_done
    return encoded.tobytes(), image.shape[1], image.shape[0]


class PictureSender(WokenWork):
    """A sink of the daemon: sends the newest keyframe's image, `rate_hz` times a second at most."""

    def __init__(self, section: PictureConfig, link: PictureLink) -> None:
        super().__init__("pictures")
        self._section, self._link = section, link
        self._held: deque[Frame] = deque()
        self._held_bytes = 0
        self._next: tuple[Frame, FeatureSet] | None = None
        self._newest = -1, -1  # session and frame, of what was chosen last
        self._warned_s = -math.inf
        self.spent_s = 0.0  # of a processor, on making images
        self.made = 0

    def event(self, arrival_ns: int, event: Event) -> None:
        """Keep a picture until its set comes."""
        if not isinstance(event, Frame) or event.image is None:
            return
        self._held.append(event)
        self._held_bytes += event.image.nbytes
        while self._held_bytes > HELD_BYTES and len(self._held) > HELD_FRAMES:
            self._forget_first()

    def feature_set(self, output: FeatureSet) -> None:
        """Choose a keyframe's picture when its first set comes, in place of an older one that still waits."""
        identity = output.session, output.frame
        if not output.is_keyframe or identity <= self._newest:
            return
        while self._held and self._held[0].index < output.frame:
            self._forget_first()
        if not self._held or self._held[0].index != output.frame:
            return
        self._newest = identity
        with self._changed:
            self._next = self._held[0], output
            self._changed.notify()

    def _forget_first(self) -> None:
        image = self._held.popleft().image
        self._held_bytes -= 0 if image is None else image.nbytes

    def _run(self, thread: SupervisedThread) -> None:
        due_s = -math.inf
        while not thread.is_set():
            with self._changed:
                wait_s = due_s - time.monotonic()
                if self._next is None or wait_s > 0.0:
                    self._changed.wait(min(wait_s, IDLE_S) if wait_s > 0.0 else IDLE_S)
                    continue
            room = self._link.picture_room()
            if not room:
                thread.wait(LOOK_S)
                continue
            with self._changed:
                chosen, self._next = self._next, None
            if chosen is not None:
                due_s = time.monotonic() + 1.0 / self._section.rate_hz
                self._send(*chosen, room)

    def _send(self, frame: Frame, its_set: FeatureSet, room: int) -> None:
        assert frame.image is not None
        began_s = time.thread_time()
        content, width, height = small_image(frame.image, self._section)
        s, kind = its_set, ImageFormat(self._section.format)
        picture = LinkPicture(s.vehicle, s.session, s.frame, s.capture_unix_ns, width, height, kind, content)
        try:
            self._link.send_picture(picture, room)
        except ValueError as error:
            if time.monotonic() - self._warned_s >= WARN_AGAIN_S:
                self._warned_s = time.monotonic()
                log.warning("picture of frame %d left out: %s; lower picture.max_px or picture.quality", s.frame, error)
        self.spent_s += time.thread_time() - began_s
        self.made += 1
