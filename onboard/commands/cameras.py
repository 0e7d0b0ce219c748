"""`pc-onboard cameras`: every camera of this computer, what it can do, how it is set, and how it is configured."""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

from onboard.camera.discovery import device_paths, stable_names
from onboard.camera.format_negotiation import sizes_text
from onboard.camera.helper_launch import decoders_text, libcamera_names
from onboard.camera.pixel_formats import DECODERS
from onboard.camera.v4l2_device import Control, Device, Sizes, V4l2Device

# Control types and flags of linux/videodev2.h.
_INTEGER, _BOOLEAN, _MENU, _INTEGER64, _BITMASK, _INTEGER_MENU = 1, 2, 3, 5, 8, 9
_WITH_A_VALUE = {_INTEGER, _BOOLEAN, _MENU, _INTEGER64, _BITMASK, _INTEGER_MENU}
_FLAGS = {0x1: "disabled", 0x2: "grabbed", 0x4: "read-only", 0x10: "inactive", 0x40: "write-only"}
_WRITE_ONLY = 0x40


def run(arguments: argparse.Namespace) -> int:
    """Print the list; 0 if there is a camera, 1 if there is none."""
    cameras, refused = [], []
    for path in device_paths():
        try:
            with V4l2Device(path) as device:
                if device.card().can_capture:
                    cameras.append(describe(path, device))
        except OSError as error:
            refused.append(f"{path}: {error.strerror}")
    names, unlisted = libcamera_names()
    cameras += [
        {"device": f"libcamera:{name}", "names": [], "line": device_line(f"libcamera:{name}")} for name in names
    ]
    if arguments.json:
        listed = json.dumps(cameras, indent=1)
    else:
        listed = "\n\n".join([*map(text, cameras), f"streams: {decoders_text()}"])
    try:
        print(listed, flush=True)
    except BrokenPipeError:  # the reader, for example `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    for line in refused:
        print(line, file=sys.stderr)
    if unlisted:
        print(f"libcamera's cameras are not listed: {unlisted}", file=sys.stderr)
    if not cameras:
        of_both = "" if unlisted else ", and none of libcamera's"
        print(f"no camera: no V4L2 capture device under /dev/video*{of_both}", file=sys.stderr)
    return 0 if cameras else 1


def describe(path: str, device: Device) -> dict[str, Any]:
    """All that is known of an open device, ready for JSON. Raises OSError if it goes away meanwhile."""
    card = device.card()
    return {
        "device": path,
        "line": device_line(stable_name(path)),
        "names": [name for names in stable_names(path).values() for name in names],
        "driver": card.driver,
        "card": card.card,
        "bus": card.bus_info,
        "formats": [_format(device, fourcc) for fourcc in device.formats()],
        "controls": [_control(device, control) for control in device.controls() if control.kind in _WITH_A_VALUE],
    }


def stable_name(path: str) -> str:
    """The name of a V4L2 device that stays when another one is plugged in; its path if it has none."""
    names = stable_names(path)
    return next((name for kind in ("by-id", "by-path") for name in sorted(names.get(kind, ()))), path)


def device_line(device: str) -> str:
    return f"device = {json.dumps(device)}"


def _format(device: Device, fourcc: str) -> dict[str, Any]:
    sizes = device.sizes(fourcc)
    one = [sizes.most_px] if sizes.most_px != (0, 0) else []
    return {
        "format": fourcc,
        "usable": fourcc in DECODERS,
        "sizes": [
            {"size_px": list(size_px), "rates_hz": [round(rate, 3) for rate in device.rates_hz(fourcc, size_px)]}
            for size_px in [*sizes.discrete_px, *one]
        ],
        **({"range": sizes_text(Sizes((), sizes.least_px, sizes.most_px, sizes.step_px))} if one else {}),
    }


def _control(device: Device, control: Control) -> dict[str, Any]:
    value = None
    if not control.flags & _WRITE_ONLY:
        try:
            value = device.get_control(control)
        except OSError:  # some cannot be read at present: reported as unknown
            value = None
    return {
        "name": control.name,
        "id": control.id,
        "minimum": control.minimum,
        "maximum": control.maximum,
        "step": control.step,
        "default": control.default,
        "value": value,
        "flags": [word for bit, word in _FLAGS.items() if control.flags & bit],
        **({"menu": {str(index): name for index, name in control.menu}} if control.menu else {}),
    }


def text(camera: dict[str, Any]) -> str:
    """The same for people. Formats that cannot be used are named only."""
    if "card" not in camera:
        return f"{camera['device']}\n  {camera['line']}"
    lines = [f"{camera['device']}  {camera['card']}  ({camera['driver']}, {camera['bus']})", f"  {camera['line']}"]
    lines += [f"  also {name}" for name in camera["names"]]
    for entry in camera["formats"]:
        if not entry["usable"]:
            continue
        for size in entry["sizes"] or [{"size_px": None, "rates_hz": []}]:
            shape = "any size" if size["size_px"] is None else "x".join(map(str, size["size_px"]))
            shape = entry.get("range", shape)
            rates = ", ".join(f"{rate:g}" for rate in size["rates_hz"])
            lines.append(f"  {entry['format']}  {shape:<12} {rates + ' Hz' if rates else ''}".rstrip())
    if not any(entry["usable"] for entry in camera["formats"]):
        lines.append("  no format of ours: a sensor without its processor, perhaps one of libcamera's below")
    if any(entry["format"] == "Y16" and entry["usable"] for entry in camera["formats"]):
        lines.append("  thermal? [thermal] enabled = true, and its scale, without which it is uncalibrated")
    others = [entry["format"] for entry in camera["formats"] if not entry["usable"]]
    if others:
        lines.append(f"  not used: {' '.join(others)}")
    lines += [f"  {_control_text(entry)}" for entry in camera["controls"]]
    return "\n".join(lines)


def _control_text(entry: dict[str, Any]) -> str:
    value, menu = entry["value"], entry.get("menu", {})
    shown = "?" if value is None else str(value)
    if str(value) in menu:
        shown += f" {menu[str(value)]}"
    step = f" step {entry['step']}" if entry["step"] > 1 else ""
    choices = "; ".join(f"{index} {name}" for index, name in menu.items())
    span = choices or f"{entry['minimum']} to {entry['maximum']}{step}"
    flags = f"  [{', '.join(entry['flags'])}]" if entry["flags"] else ""
    return f"{entry['name']} = {shown}  ({span}; default {entry['default']}){flags}"
