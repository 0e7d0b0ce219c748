"""Configuration -> the camera that `camera.device` names."""

from __future__ import annotations

import os
from collections.abc import Sequence

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.camera.helper_camera import HelperCamera
from onboard.camera.helper_launch import helper_launch, private_paths
from onboard.camera.playback import PREFIX, PlayedCamera
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.config.schema import NOT_THERMAL, CameraConfig, Config, ThermalConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import Source


def open_camera(config: Config, camera: Camera, clock: SessionClock) -> Source:
    """The camera that `camera.device` names. Raises ConfigError where its form is wrong."""
    return open_device(config.camera, camera, clock, config.thermal, private_paths(config, os.environ))


def second_section(config: Config) -> CameraConfig:
    """The second camera's section as if it were the first's. Raises ConfigError where it names no device."""
    second = config.camera.thermal
    if second.device is None:
        raise ConfigError("camera.thermal.device is not set: name the second camera's, or leave camera.thermal out")
    return CameraConfig(
        device=second.device, file=second.file, format=second.format, rate_hz=second.rate_hz, latency_s=second.latency_s
    )


def open_second_camera(config: Config, camera: Camera, clock: SessionClock) -> Source:
    """The thermal camera that `camera.thermal.device` names. Raises ConfigError."""
    return open_device(second_section(config), camera, clock, config.heat, private_paths(config, os.environ))


def open_device(
    config: CameraConfig,
    camera: Camera,
    clock: SessionClock,
    thermal: ThermalConfig = NOT_THERMAL,
    closed: Sequence[str] = (),
) -> Source:
    """The camera that a section `camera` names, for pictures of the camera file's size. Raises ConfigError.

    A program of ours that it needs cannot open the files and folders in `closed`.
    """
    device = config.device
    if device.startswith(PREFIX):
        return PlayedCamera(device.removeprefix(PREFIX), camera, clock, config.latency_s, thermal)
    launch = helper_launch(config, camera.size_px, closed)
    if launch is not None:
        return HelperCamera(config, camera, clock, launch, thermal)
    return V4l2Camera(config, camera, clock, thermal)
