"""The section `mavlink_camera`: a camera component on the autopilot's MAVLink network."""

from __future__ import annotations

from onboard.config.section import Section, choice, quantity


class MavlinkCamera(Section):
    """A MAVLink camera: clicks in a ground station's video (QGroundControl) are answered. docs/mavlink-camera.md.

    On a telemetry radio its heartbeats take 170 bit/s, a click 1.5 kbit, what is followed 0.7 kbit/s, all of it within
    link.mavlink_bit_rate.
    """

    enabled: bool = choice(False, "answer as a camera of the vehicle's; needs telemetry.backend 'pymavlink'")
    component: int = quantity(100, 100, 105, "", "its MAVLink component number, no other camera's on the vehicle")
    video: str | None = choice(
        None,
        "the video that ground stations show, uncropped and of the camera's own shape: rtsp://HOST:PORT/PATH, "
        "tcp://HOST:PORT (MPEG), or h264:PORT, h265:PORT, mpegts:PORT (UDP port of the ground); if not set, theirs",
    )
    delay_s: float = quantity(0.5, 0.0, 10.0, "s", "from a picture's exposure until a click on it arrives here")
    sigma_delay_s: float = quantity(0.3, 0.0, 5.0, "s", "one sigma of that; it is in every answer's accuracy")
