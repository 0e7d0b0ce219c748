"""Status of a live camera: its figures, and a stream that has stopped or repeats one picture."""

from __future__ import annotations

from onboard.camera.picture_decoder import Pictures
from onboard.config.schema import CameraConfig
from onboard.events.source import SourceStatus, State

PERIODS = 3.0
"""At low rates so many periods without a picture, if that is more than `lost_after_s`, count as lost."""


def patience_s(config: CameraConfig) -> float:
    """Return how long, in s, a camera that has sent pictures may be silent before it counts as lost."""
    return max(config.lost_after_s, PERIODS / config.rate_hz)


def figures(pictures: Pictures, is_open: bool) -> dict[str, float]:
    """Rate and delay of the newest pictures, and counts since the camera was first opened."""
    rate_hz = pictures.rate_hz if is_open else 0.0
    return {"rate_hz": rate_hz, "delay_ms": pictures.delay_ms, **vars(pictures.counts)}


def stopped(
    name: str, silent_s: float, frozen_s: float, config: CameraConfig, shown: dict[str, float]
) -> SourceStatus | None:
    """LOST or FROZEN, with `shown` as figures; None if new pictures come."""
    if silent_s > patience_s(config):
        return SourceStatus(State.LOST, f"{name}: no picture for {silent_s:.1f} s", shown)
    if frozen_s >= config.frozen_after_s:
        return SourceStatus(State.FROZEN, f"{name}: the same picture for {frozen_s:.1f} s", shown)
    return None
