"""A camera that is a folder of pictures or a video, played in real time: `camera.device = "replay:FOLDER"`.

For tests and benches without a camera. Where stamps lie ahead on the session's clock, those pictures come at their own
stamps and the earlier ones are gone, so that an autopilot played at the same time stays in step, even over a restart.
Otherwise the first comes at once and the others as long after it as they were taken; where a log is played with them
they begin when that does, in step with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.picture_files import open_frames
from onboard.config.schema import NOT_THERMAL, ThermalConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, SourceStatus, State, Stop

PREFIX = "replay:"
STAMPS = "stamps.csv"
LOOK_S = 0.05
"""The time between two looks at whether the log plays, s."""


class PlayedCamera:
    """`path` is a folder or a video, with `stamps.csv` in it or next to it if needed. Raises InputError if unusable."""

    def __init__(
        self,
        path: Path | str,
        camera: Camera,
        clock: SessionClock,
        latency_s: float = 0.0,
        thermal: ThermalConfig = NOT_THERMAL,
    ) -> None:
        self._path, self._clock, self._thermal = Path(path), clock, thermal
        next_to_it = [p for p in (self._path / STAMPS, self._path.parent / STAMPS) if p.is_file()]
        stamps = next_to_it[0] if next_to_it else None
        self._source = open_frames(
            self._path, camera, stamps, latency_s, is_thermal=thermal.enabled, black_hot=thermal.black_hot
        )
        self._health = SourceStatus(State.STARTING, "not playing yet")
        self.log_shift_ns: Callable[[], int | None] | None = None
        """The session's clock less the pictures', ns, as the log has it that is played with them, once it plays."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """The capture times of the first and the last picture, by their own clock, ns."""
        return self._source.stamps_ns[0], self._source.stamps_ns[-1]

    def run(self, emit: Emit, stop: Stop) -> None:
        """Play once, then be a lost camera until `stop`."""
        shift_ns = self._shift_ns(stop)
        if shift_ns is None:
            return
        first_ns, shown = 0, 0
        try:
            for frame in self._source.frames():
                early_ns = frame.stamp_ns + shift_ns - self._clock.now_ns()
                if shown == 0 and early_ns < 0 and shift_ns == 0:
                    continue
                if stop.wait(early_ns / 1e9) if early_ns > 0 else stop.is_set():
                    return
                now_ns = self._clock.now_ns()
                first_ns, shown = first_ns or now_ns, shown + 1
                rate_hz = (shown - 1) / max((now_ns - first_ns) / 1e9, 1e-3)
                self._health = SourceStatus(State.OK, self._thermal.words, {"rate_hz": rate_hz, "lost": 0.0})
                emit(now_ns, replace(frame, stamp_ns=frame.stamp_ns + shift_ns))
        except InputError as error:
            self._health = SourceStatus(State.LOST, str(error))
        else:
            self._health = SourceStatus(State.LOST, f"{self._path} has been played to its end")
        stop.wait()

    def _shift_ns(self, stop: Stop) -> int | None:
        """Return the session's clock less the pictures', ns; None where `stop` came before the log began."""
        if self.log_shift_ns is not None:
            while (shift_ns := self.log_shift_ns()) is None:
                if stop.wait(LOOK_S):
                    return None
            return shift_ns
        begin_ns, end_ns = self.span_ns
        now_ns = self._clock.now_ns()
        return 0 if end_ns > now_ns else now_ns - begin_ns

    def health(self) -> SourceStatus:
        """STARTING, OK while pictures come, LOST after the last."""
        return self._health
