"""The meaning of each line of `pc-onboard doctor`, and what to do where it is bad."""

from __future__ import annotations

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

# Each line's name has two texts: what is looked at and its limit; then what to do.
MEANING: dict[str, tuple[str, str]] = {
    "state": (
        "The state in a word, as `pc-onboard status` has it: the first finding below that is bad.",
        "If bad: the line below that is bad too gives the reason; docs/faults.md lists every state.",
    ),
    "camera": (
        "Whether pictures come from the configured device.",
        "If bad: check cable and camera.device; `pc-onboard cameras` lists what is there.",
    ),
    "rate": (
        f"Pictures a second over those asked for; at least {100 * RATE_SHARE:.0f} %.",
        "If bad: more light or a shorter exposure, a smaller picture, or a lower camera.rate_hz (`pc-onboard bench`).",
    ),
    "stamps": (
        f"How well each picture's time is known, at most {MAX_STAMP_SIGMA_MS:.0f} ms, and how late all of them are.",
        "If bad: a wired or better link, a sender that writes capture times (MISB 0604), or camera.stream_clock.",
    ),
    "exposure": (
        f"Mean grey above {DARK:.0f}, and not over {100 * MAX_CLIPPED:.0f} % of the picture black or white.",
        "If bad: take off the lens cap, or set camera.exposure_us and camera.gain for the light of the flight.",
    ),
    "decoder": (
        "What decodes a network camera's video, the first that works of those that are installed.",
        "If bad: it never is: what is missing stands in the line camera. In hardware it costs next to no processor.",
    ),
    "thermal camera": (
        "Whether pictures come from the second camera, in which hot spots are looked for.",
        "If bad: check its cable and camera.thermal.device; the flight has no hot spots, and all else as before.",
    ),
    "thermal": (
        "Where the camera is a thermal one: kelvin a count, or that it is not stated.",
        "If bad: it never is. For temperatures state thermal.scale and thermal.offset (docs/thermal.md).",
    ),
    "telemetry": (
        "Whether positions come from the autopilot or receiver.",
        "If bad: check cable, port and baud rate in telemetry.url, and that the autopilot sends MAVLink 2 there.",
    ),
    "rates": (
        f"Positions at {MIN_POSITION_HZ:g} Hz or more, attitudes at {MIN_ATTITUDE_HZ:g} Hz or more.",
        "If bad: raise the stream rates on the autopilot, or the baud rate; docs/telemetry.md.",
    ),
    "time sync": (
        f"How well the autopilot's clock is known: +-{MAX_CLOCK_SIGMA_MS:g} ms and {MAX_ROUND_TRIP_MS:g} ms round trip "
        "at most. 20 ms are 0.4 m at 20 m/s.",
        "If bad: use a wired link, and wait half a minute; a radio in between delays unevenly.",
    ),
    "pipeline": (
        "Whether pictures are worked through, and how long from capture to answer.",
        "If bad: restart the service; the journal has the reason.",
    ),
    "gps": (
        "What the receiver reports: a 3D fix, and how old.",
        "If bad: give the antenna a free view of the sky, and wait for a fix.",
    ),
    "position": (
        "Whether the position may be used: no jump, no outage, filter healthy.",
        "If bad: wait; after a jump it is accepted again when it has been steady for some seconds.",
    ),
    "answers": (
        "How many pictures a second can be clicked. On the ground none can: that is no fault.",
        "If bad in flight: the reason stands in the line; README lists what each word means.",
    ),
    "load": (
        "Whether the computer keeps up with the camera.",
        "If bad: a lower camera.rate_hz or a smaller picture; `pc-onboard bench` shows what this computer can do.",
    ),
    "recording": (
        "Whether the session is written to disk.",
        "If bad: make room, or name another folder in recording.folder.",
    ),
    "threads": (
        "Whether every part of the daemon runs.",
        "If bad: restart the service, and keep the journal: it has the stack of what stopped.",
    ),
    "left out": (
        "What of the picture holds no features, by camera.mask or because it stands still; "
        f"up to {100 * MAX_LEFT_OUT:.0f} %.",
        "If bad: switch the display off, move the camera so that it sees less of the aircraft, or mend camera.mask.",
    ),
    "mount": (
        "The mount's angles, and what the last flights found in addition: no more than three sigma.",
        "If bad: measure the mount again and correct mount.*_deg, or raise mount.sigma_deg.",
    ),
    "relative errors": (
        "How far points seen again lie apart, over what was stated: a variance below 4.",
        "If bad: something moves that is taken as fixed (mount, lens, clock); compare the lines mount and sensors.",
    ),
    "sensors": (
        "Sensors that contradict the pictures, or have larger errors than configured.",
        "If bad: the sensor that is named; its sigma is a key of [gps] or [solve].",
    ),
    "radius": (
        "The longer half axis of a click's 90 % ellipse in the middle of the newest picture, where it comes from, "
        "and what would make it smaller.",
        "If bad: it never is. The advice is against the largest cause; `pc-onboard replay --budget` prints all.",
    ),
    "calibration": (
        "The camera file: its picture size and field of view.",
        "If bad: name it in camera.file; `pc-onboard calibrate` makes one.",
    ),
    "link": (
        "Whether the ground can connect.",
        "If bad: another program has the port, or a certificate is not readable: link.listen, docs/certificates.md.",
    ),
    "radio": (
        f"What the autopilot's radio carries of ours, and of its own buffer at least {LEAST_FREE_PERCENT} % free; only "
        "with link.mavlink.",
        "If bad: slower streams of the autopilot's there, or another link.mavlink_bit_rate (docs/autopilot-radio.md).",
    ),
    "disk": (
        "Free space above what is to be kept free.",
        "If bad: remove old sessions, or lower recording.keep_free_mb.",
    ),
    "processor": (
        "Its temperature, below 80 deg C.",
        "If bad: a heat sink or moving air; above that it slows down.",
    ),
}
