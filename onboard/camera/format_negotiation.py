"""Choice among a device's formats, and the report when it has none that fits."""

from __future__ import annotations

from collections.abc import Sequence

from contract.errors import ConfigError
from onboard.camera.pixel_formats import DECODERS
from onboard.camera.v4l2_device import Device, Granted, Sizes

ENOUGH = 0.95
"""A rate this share of what was asked for is as asked: 29.97 for 30."""
_SHOWN = 8


def choose_format(
    device: Device, path: str, size_px: tuple[int, int], format_: str, rate_hz: float, first: Sequence[str] = ()
) -> Granted:
    """Set the best format that has the camera file's size; 'auto' prefers the rate, then the cheapest decoder.

    Those of `first` that have the size go before all others, whatever their rate.
    Raises ConfigError, one line with what the device offers, if there is none; OSError from the driver.
    """
    offered = device.formats()
    wanted = [fourcc for fourcc in DECODERS if fourcc in offered and format_ in {"auto", fourcc}]
    if not wanted:
        what = f"no {format_}" if format_ != "auto" else f"none of {', '.join(DECODERS)}"
        raise ConfigError(f"camera.device {path}: {what} in what it offers: {offer(device)}")
    sizes = {fourcc: device.sizes(fourcc) for fourcc in wanted}
    fitting = [fourcc for fourcc in wanted if not sizes[fourcc].is_known or sizes[fourcc].has(size_px)]
    reach = {fourcc: max(device.rates_hz(fourcc, size_px), default=rate_hz) for fourcc in fitting}
    for fourcc in sorted(fitting, key=lambda f: (f not in first, -min(reach[f], rate_hz * ENOUGH))):
        granted = device.set_format(fourcc, size_px)
        if (granted.fourcc, granted.width_px, granted.height_px) == (fourcc, *size_px):
            return granted
    raise ConfigError(
        f"camera.device {path}: no {size_px[0]}x{size_px[1]} (the camera file's size) "
        f"in {' or '.join(wanted)}; it offers {offer(device)}"
    )


def offer(device: Device) -> str:
    """Formats and sizes of a device in one line."""
    parts = [f"{fourcc} {sizes_text(device.sizes(fourcc))}".strip() for fourcc in device.formats()]
    # Formats that we can decode come first.
    parts.sort(key=lambda part: part.split()[0] not in DECODERS)
    more = f"; and {len(parts) - _SHOWN} more formats" if len(parts) > _SHOWN else ""
    return "; ".join(parts[:_SHOWN]) + more if parts else "nothing"


def sizes_text(sizes: Sizes) -> str:
    """'320x240, 640x480', '16x16 to 1920x1080', or nothing where the driver does not report it."""
    if sizes.discrete_px:
        shown = ", ".join(f"{w}x{h}" for w, h in sizes.discrete_px[:_SHOWN])
        return shown + (f" and {len(sizes.discrete_px) - _SHOWN} more" if len(sizes.discrete_px) > _SHOWN else "")
    if not sizes.is_known:
        return ""
    return f"{sizes.least_px[0]}x{sizes.least_px[1]} to {sizes.most_px[0]}x{sizes.most_px[1]}"
