"""One list of what is looked at before a flight, each with its cure: for `setup`, `check-config` and `doctor`."""

from __future__ import annotations

from typing import NamedTuple

from onboard.commands.preflight import (
    DARK,
    LEAST_FREE_PERCENT,
    MAX_CLIPPED,
    MAX_CLOCK_SIGMA_MS,
    MAX_LEFT_OUT,
    MAX_ROUND_TRIP_MS,
    MAX_STAMP_SIGMA_MS,
    MIN_ATTITUDE_HZ,
    MIN_POSITION_HZ,
    RATE_SHARE,
)


class Check(NamedTuple):
    """A line of the doctor: what is looked at and its limit, and what to do where it is bad."""

    looks_at: str
    cure: str

    @property
    def sentences(self) -> tuple[str, str]:
        """Both, as `doctor --explain` shows them below a line."""
        return self.looks_at, f"If bad: {self.cure}"


# By the names of the doctor's lines; the last is no line of its own.
CHECKS: dict[str, Check] = {
    "state": Check(
        "The state in a word, as `pc-onboard status` has it: the first finding below that is bad.",
        "the line below that is bad too gives the reason; docs/faults.md lists every state.",
    ),
    "camera": Check(
        "Whether pictures come from the configured device.",
        "check cable and camera.device; `pc-onboard cameras` lists what is there.",
    ),
    "rate": Check(
        f"Pictures a second over those asked for; at least {100 * RATE_SHARE:.0f} %.",
        "more light or a shorter exposure, a smaller picture, or a lower camera.rate_hz (`pc-onboard bench`).",
    ),
    "stamps": Check(
        f"How well each picture's time is known, at most {MAX_STAMP_SIGMA_MS:.0f} ms, and how late all of them are.",
        "a wired or better link, a sender that writes capture times (MISB 0604), or camera.stream_clock.",
    ),
    "exposure": Check(
        f"Mean grey above {DARK:.0f}, and not over {100 * MAX_CLIPPED:.0f} % of the picture black or white.",
        "take off the lens cap, or set camera.exposure_us and camera.gain for the light of the flight.",
    ),
    "decoder": Check(
        "What decodes a network camera's video, the first that works of those that are installed.",
        "it never is: what is missing stands in the line camera. In hardware it costs next to no processor.",
    ),
    "thermal camera": Check(
        "Whether pictures come from the second camera, in which hot spots are looked for.",
        "check its cable and camera.thermal.device; the flight has no hot spots, and all else as before.",
    ),
    "thermal": Check(
        "Where the camera is a thermal one: kelvin a count, or that it is not stated.",
        "spots.things asks for a thermal camera: name one, or take it out. "
        "For temperatures state thermal.scale and thermal.offset (docs/thermal.md).",
    ),
    "telemetry": Check(
        "Whether positions come from the autopilot or receiver.",
        "check power, cable, port and baud rate in telemetry.url, and that the autopilot sends MAVLink 2 there "
        "(docs/telemetry.md).",
    ),
    "rates": Check(
        f"Positions at {MIN_POSITION_HZ:g} Hz or more, attitudes at {MIN_ATTITUDE_HZ:g} Hz or more.",
        "raise the stream rates on the autopilot, or the baud rate; docs/telemetry.md.",
    ),
    "time sync": Check(
        f"How well the autopilot's clock is known: +-{MAX_CLOCK_SIGMA_MS:g} ms and {MAX_ROUND_TRIP_MS:g} ms round trip "
        "at most. 20 ms are 0.4 m at 20 m/s.",
        "use a wired link, and wait half a minute; a radio in between delays unevenly.",
    ),
    "pipeline": Check(
        "Whether pictures are worked through, and how long from capture to answer.",
        "restart the service; the journal has the reason.",
    ),
    "gps": Check(
        "What the receiver reports: a 3D fix, and how old.",
        "give the antenna a free view of the sky, and wait for a fix.",
    ),
    "position": Check(
        "Whether the position may be used: no jump, no outage, filter healthy.",
        "wait; after a jump it is accepted again when it has been steady for some seconds.",
    ),
    "answers": Check(
        "How many pictures a second can be clicked. On the ground none can: that is no fault.",
        "in flight, the reason stands in the line; README lists what each word means.",
    ),
    "load": Check(
        "Whether the computer keeps up with the camera.",
        "a lower camera.rate_hz or a smaller picture; `pc-onboard bench` shows what this computer can do.",
    ),
    "recording": Check(
        "Whether the session is written to disk.",
        "make room, or name another folder in recording.folder.",
    ),
    "threads": Check(
        "Whether every part of the daemon runs.",
        "restart the service, and keep the journal: it has the stack of what stopped.",
    ),
    "left out": Check(
        "What of the picture holds no features, by camera.mask or because it stands still; "
        f"up to {100 * MAX_LEFT_OUT:.0f} %.",
        "switch the display off, move the camera so that it sees less of the aircraft, or mend camera.mask.",
    ),
    "mount": Check(
        "The mount's angles, and what the last flights found in addition: no more than three sigma.",
        "measure the mount again and correct mount.*_deg, or raise mount.sigma_deg.",
    ),
    "relative errors": Check(
        "How far points seen again lie apart, over what was stated: a variance below 4.",
        "something moves that is taken as fixed (mount, lens, clock); compare the lines mount and sensors.",
    ),
    "sensors": Check(
        "Sensors that contradict the pictures, or have larger errors than configured.",
        "the sensor that is named; its sigma is a key of [gps] or [solve].",
    ),
    "radius": Check(
        "The longer half axis of a click's 90 % ellipse in the middle of the newest picture, where it comes from, "
        "and what would make it smaller.",
        "it never is. The advice is against the largest cause; `pc-onboard replay --budget` prints all.",
    ),
    "calibration": Check(
        "The camera file: its picture size and field of view.",
        "name it in camera.file; `pc-onboard calibrate` makes one.",
    ),
    "link": Check(
        "Whether the ground can connect.",
        "another program has the port, or a certificate is not readable: link.listen, docs/certificates.md.",
    ),
    "radio": Check(
        f"What the autopilot's radio carries of ours, and of its own buffer at least {LEAST_FREE_PERCENT} % free; only "
        "with link.mavlink.",
        "slower streams of the autopilot's there, or another link.mavlink_bit_rate (docs/autopilot-radio.md).",
    ),
    "disk": Check(
        "Free space above what is to be kept free.",
        "remove old sessions, or lower recording.keep_free_mb.",
    ),
    "processor": Check(
        "Its temperature, below 80 deg C.",
        "a heat sink or moving air; above that it slows down.",
    ),
    "permission": Check(
        "Whether the daemon's user may open the serial port; of `check-config --fly` alone.",
        "add that user to the group 'dialout' and log in again.",
    ),
}
