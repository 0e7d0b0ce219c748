"""All tracks of a flight, at most so many, over one row of pictures that they share."""

from __future__ import annotations

import numpy as np

from contract.feature_set import FeatureSet
from contract.locate import Locator
from contract.track import MOST_TRACKS, TrackReport, TrackState, Unseen
from contract.track_age import SILENT_S, as_of
from onboard.events.types import Frame
from onboard.tracks.ground_steps import Pictures, Seen
from onboard.tracks.track import Track

REPORT_LOST_S = 5.0  # that a lost track is still reported


class TrackBook:
    """Fed with every picture that has a set. Without tracks a picture costs nothing but its place in the row."""

    def __init__(self, vehicle: str, pictures: Pictures | None = None) -> None:
        self._vehicle = vehicle
        self._pictures = Pictures() if pictures is None else pictures
        self._tracks: dict[int, Track] = {}
        self._lost_ns: dict[int, int] = {}
        self._session = 0

    @property
    def numbers(self) -> tuple[int, ...]:
        return tuple(n for n, track in self._tracks.items() if not track.is_lost)

    @property
    def frames(self) -> frozenset[int]:
        """The pictures in which a track may begin."""
        return frozenset(seen.frame for seen in self._pictures)

    def picture(self, frame: Frame, its_set: FeatureSet) -> None:
        """The next picture; one that is older than the newest, or has no image, is passed over."""
        newest = max(self.frames, default=-1) if its_set.session == self._session else -1
        if frame.image is None or frame.index <= newest:
            return
        if its_set.session != self._session:
            self._session = its_set.session
            self._tracks.clear()
            self._lost_ns.clear()
            self._pictures.clear()
        seen = Seen(frame.index, frame.stamp_ns, frame.image, its_set)
        self._pictures.add(seen)
        active = [track for track in self._tracks.values() if not track.is_lost]
        if active:
            self._pictures.join()
            locator = _locator(seen)
            for track in active:
                track.take(seen, locator)
        self._forget(seen.stamp_ns)

    def start(self, number: int, uv_px: tuple[float, float], frame: int | None) -> bool:
        """Follow what is at a pixel of a kept picture, through all those since. Whether there was anything there."""
        kept = list(self._pictures)
        clicked = self._pictures.by_frame(max(self.frames, default=-1) if frame is None else frame)
        if clicked is None or len(self.numbers) >= MOST_TRACKS:
            return False
        self._pictures.join()
        track = Track(number, self._pictures, clicked, np.asarray(uv_px, float), _locator(clicked))
        if not track.follower.has_look:
            return False
        for seen in kept[kept.index(clicked) + 1 :]:
            track.take(seen, _locator(seen))
        self._tracks[number] = track
        return True

    def stop(self, number: int) -> bool:
        """End a track; return whether there was such a track."""
        self._lost_ns.pop(number, None)
        return self._tracks.pop(number, None) is not None

    def reports(self, silent_s: float = 0.0) -> list[TrackReport]:
        """Return a report of each track; where no picture has come for SILENT_S, as of `silent_s` after the newest."""
        out = []
        age_s = silent_s if silent_s > SILENT_S else 0.0
        for track in self._tracks.values():
            report = as_of(track.report(self._session, self._vehicle), age_s, silent_s, Unseen.NO_PICTURE)
            if report.state is TrackState.LOST:
                track.end()
            out.append(report)
        if age_s > 0.0 and out:
            self._forget(max(report.capture_unix_ns for report in out))
        return out

    def _forget(self, now_ns: int) -> None:
        for number, track in list(self._tracks.items()):
            if track.is_lost and now_ns - self._lost_ns.setdefault(number, now_ns) > REPORT_LOST_S * 1e9:
                self.stop(number)


def _locator(seen: Seen) -> Locator | None:
    """Return the locator of the picture's set, made once for all tracks; None where the set gives no place."""
    if seen.its_set is None or not seen.its_set.is_ok:
        return None
    if seen.locator is None:
        seen.locator = Locator(seen.its_set)
    return seen.locator
