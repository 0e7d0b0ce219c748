"""Telemetry radios as `pc-onboard setup` offers them, and what of each may be ours."""

from __future__ import annotations

from typing import NamedTuple


class TelemetryRadio(NamedTuple):
    """A kind of radio, and its bit/s to the ground: 0 where there is none."""

    name: str
    bit_rate: float


RADIOS = {
    "none": TelemetryRadio("not needed: the ground is reached by Wi-Fi, LTE or another network", 0.0),
    "sik": TelemetryRadio("SiK or RFD900 at 57600 baud (64 kbit/s in the air)", 57600.0),
    "mlrs": TelemetryRadio("mLRS or another of some 10 kbit/s", 9600.0),
    "elrs": TelemetryRadio("ELRS or another of some 400 bit/s: clicks, but no sets", 400.0),
}
OTHER_RADIO = "another, by its bit rate"
# Of the radio: with it no message of the autopilot's is more than 50 ms later (docs/autopilot-radio.md); and what sets
# need.
SHARE, FOR_SETS = 1.0 / 6.0, 4800.0
LEAST, MOST = 200.0, 1e6  # as of `link.mavlink_bit_rate`


def ours_of(radio_bit_rate: float) -> float:
    """Return the `link.mavlink_bit_rate` for a radio that carries so many bit/s."""
    return min(max(SHARE * radio_bit_rate, FOR_SETS), radio_bit_rate)


def radio_bit_rate(line: str) -> float:
    """Return a radio's bit/s to the ground, by a name of `RADIOS` or as a number; raises ValueError."""
    if line in RADIOS:
        return RADIOS[line].bit_rate
    try:
        value = float(line)
    except ValueError:
        value = 0.0
    if not LEAST <= value <= MOST:
        raise ValueError(f"bit/s from {LEAST:g} to {MOST:g}, or one of {', '.join(RADIOS)}")
    return value
