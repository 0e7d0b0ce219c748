"""The section `camera.thermal`: a thermal camera next to the first one."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from onboard.config.section import Section, choice, quantity

BLACK_HOT = "its pictures of 8 bits are dark where it is hot, and are turned round"
BLACK_HOT_AND_SCALE = "black_hot is of pictures of 8 bits, which have no scale: leave one of them out"


class SecondCamera(Section):
    """A thermal camera next to the first: hot spots are looked for in its pictures, poses come from the first's.

    Its angles turn it from where the first camera looks: 0, 0, 0 looks the same way. docs/thermal.md.
    """

    device: str | None = choice(None, "as camera.device; no second camera if not set")
    file: str | None = choice(None, "its camera file (optics)")
    format: Literal["auto", "Y16", "GREY", "YUYV", "UYVY", "NV12", "MJPG"] = choice(
        "auto", "pixel format of a V4L2 device; 'auto' takes sixteen bits where the device has them"
    )
    rate_hz: float = quantity(9.0, 0.1, 240.0, "Hz", "pictures asked of the device")
    scale: float | None = quantity(
        None, 1e-5, 100.0, "K", "of one count, 0.01 of a radiometric Lepton or Boson; if not set: uncalibrated"
    )
    offset: float = quantity(0.0, -1e5, 1e5, "K", "temperature of count 0, with the scale")
    black_hot: bool = choice(False, BLACK_HOT)
    roll_deg: float = quantity(0.0, -180.0, 180.0, "deg", "clockwise about the optical axis, seen from behind")
    pitch_deg: float = quantity(0.0, -90.0, 90.0, "deg", "towards the top of the first camera's picture")
    yaw_deg: float = quantity(0.0, -180.0, 180.0, "deg", "towards the right of the first camera's picture")
    sigma_deg: float = quantity(2.0, 0.01, 20.0, "deg", "one sigma of each of these angles")
    latency_s: float = quantity(
        0.0,
        -5.0,
        5.0,
        "s",
        "its capture stamp minus true mid-exposure, the first camera's stamps less their latency being true",
    )
    sigma_latency_s: float = quantity(0.05, 0.0005, 1.0, "s", "one sigma of that")

    @model_validator(mode="after")
    def _has_no_scale_if_black_hot(self) -> SecondCamera:
        if self.black_hot and self.scale is not None:
            raise ValueError(BLACK_HOT_AND_SCALE)
        return self

    @property
    def is_stated(self) -> bool:
        return self.file is not None

    @property
    def is_live(self) -> bool:
        return self.device is not None
