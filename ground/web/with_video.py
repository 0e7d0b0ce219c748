"""A source with a video of the operator's own downlink: its frames are the pictures of sets that came without one."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from ground.web.source import FrameRow, Picture, Source

MAX_ASPECT_ERROR = 0.01  # 854 x 480 is called 16:9


class Footage(Protocol):
    """A video whose frames were found for sets. Thread-safe."""

    vehicle: str  # whose it is; "" until that is known
    version: int  # grows by how many of the newest rows may have changed

    def has(self, session: int, frame: int) -> bool:
        """Return whether a set has a frame of the video."""

    def picture(self, session: int, frame: int) -> bytes | None:
        """The frame of a set, as JPEG."""

    def notes(self) -> list[str]:
        """The video's state, as a text for users."""

    def close(self) -> None:
        """Close the video."""


class WithVideo:
    """Serves `Source`. What the other source has itself, from the link or recorded, is preferred to the video."""

    def __init__(self, inner: Source, footage: Footage) -> None:
        self._inner = inner
        self._footage = footage
        self.is_live = inner.is_live
        self.measures = inner.measures
        self.name = inner.name
        self.views = inner.views
        # The video has no part in these.
        self.vehicles, self.report = inner.vehicles, inner.report
        self.feature_set, self.age_s, self.measured = inner.feature_set, inner.age_s, inner.measured
        self.unfollowed, self.follow = inner.unfollowed, inner.follow
        self.unlooked, self.look = inner.unlooked, inner.look

    def version(self, vehicle: str) -> int:
        return self._inner.version(vehicle) + (self._footage.version if vehicle == self._footage.vehicle else 0)

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        """The other's, with what the video shows."""
        rows = self._inner.frames(vehicle, newest)
        if vehicle != self._footage.vehicle:
            return rows
        has = self._footage.has
        return [replace(row, has_picture=row.has_picture or has(row.session, row.frame)) for row in rows]

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        """The other's; else the frame of the video."""
        found = self._inner.picture(vehicle, session, frame)
        if found is not None or vehicle != self._footage.vehicle:
            return found
        if session is None:
            rows = self._inner.frames(vehicle, 1)
            session = rows[-1].session if rows else 0
        content = self._footage.picture(session, frame)
        return None if content is None else Picture(content, "image/jpeg", is_unchanging=False)

    def damage(self) -> list[str]:
        return [*self._footage.notes(), *self._inner.damage()]

    def no_pictures(self) -> str:
        """Always empty: the video's frames may still come, and its notes report the progress."""
        return ""

    def close(self) -> None:
        """Both."""
        self._footage.close()
        self._inner.close()


def aspect_trouble(video_size_px: tuple[int, int], camera_size_px: tuple[int, int]) -> str:
    """The reason why a video's shape rules it out as the camera's pictures; empty if it does not."""
    (w, h), (cw, ch) = video_size_px, camera_size_px
    if abs(w * ch / (h * cw) - 1.0) <= MAX_ASPECT_ERROR:
        return ""
    return f"it is {w} x {h}, the camera's pictures are {cw} x {ch}: cut or stretched, it shows other pixels"
