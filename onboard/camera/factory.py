"""Configuration -> the camera that `camera.device` names."""

from __future__ import annotations

from contract.camera import Camera
from onboard.camera.playback import PREFIX, PlayedCamera
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Source


def open_camera(config: Config, camera: Camera, clock: SessionClock) -> Source:
    """The camera that `camera.device` names."""
    device = config.camera.device
    if device.startswith(PREFIX):
        return PlayedCamera(device.removeprefix(PREFIX), camera, clock, config.camera.latency_s)
    return V4l2Camera(config.camera, camera, clock)
