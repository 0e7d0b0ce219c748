"""`pc-onboard check-config`: is the configuration good, and with --fly: is what it names there?

Exit codes: 0 good, 1 with --fly: something that it names is missing (the daemon waits for it), 2 the configuration
itself is at fault.
"""

from __future__ import annotations

import argparse
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from contract.camera import Camera
from contract.errors import ConfigError
from contract.link_config import SECURE
from contract.secrets import without_secrets
from onboard.camera.factory import open_device, second_section
from onboard.camera.helper_launch import helper_launch, unable
from onboard.camera.playback import PREFIX
from onboard.camera.v4l2_device import V4l2Device
from onboard.commands.checks import CHECKS
from onboard.config.files import config_files, load_camera, load_config_files, load_second_camera
from onboard.config.link import check_pointers
from onboard.config.schema import CameraConfig, Config
from onboard.events.session_clock import SessionClock
from onboard.service.readable import Reader
from onboard.telemetry.factory import open_telemetry

DEVICES = ("serial", "nmea")
RECEIVED_IN_FLIGHT = {
    "udpin": "listens there; whether an autopilot sends cannot be known before `run` (then: pc-onboard doctor)",
    "udpout": "sends there; whether an autopilot answers cannot be known before `run` (then: pc-onboard doctor)",
    "tcp": "connects there; whether an autopilot answers cannot be known before `run` (then: pc-onboard doctor)",
}

# No error: rights that are taken away for a while leave it so.
NO_POINTERS = "look.circle_radius_m is set, and link.pointers names no one: this aircraft will not circle"


@dataclass(frozen=True)
class Named:
    """Something that the configuration names: which key names what, whether it is there, and what was seen.

    `check` is the one of CHECKS whose cure helps where it is missing; empty where the text has its own.
    """

    key: str
    value: str
    is_there: bool
    text: str
    check: str = ""

    def __str__(self) -> str:
        words = self.text if self.is_there else f"MISSING: {self.text}"
        cure = f": {CHECKS[self.check].cure}" if self.check and not self.is_there else ""
        return without_secrets(f"{self.key} {self.value}: {words}{cure}")


def run(arguments: argparse.Namespace) -> int:
    """Load a configuration and print which files are good; with --fly, look at what they name as well."""
    config = load_config_files(arguments.config)
    check_pointers(config.link)
    named = look(config) if arguments.fly else []
    for file in config_files(arguments.config):
        print(f"{file}: good")
    if config.look.circle_radius_m is not None and not config.link.pointers:
        print(NO_POINTERS)
    for thing in named:
        print(thing)
    return 0 if all(thing.is_there for thing in named) else 1


def look(config: Config) -> list[Named]:
    """Camera file, camera and telemetry, each looked at without disturbing a daemon that may be using it.

    Raises PointclickError for what no waiting mends.
    """
    camera = load_camera(config)
    open_telemetry(config, SessionClock.start())  # opens nothing yet, but refuses what can never work, as `run` does
    width, height = camera.size_px
    return [
        Named("camera.file", str(config.camera.file), True, f"{width} x {height}"),
        _camera("camera", config.camera, camera),
        *_second(config),
        _telemetry(config.telemetry.url),
        *_files(config),
    ]


def _files(config: Config) -> list[Named]:
    """Files that the daemon reads as its own user: whether it may."""
    link, reader = config.link, Reader.of_the_service()
    keys = {"link.ca": link.ca, "link.certificate": link.certificate, "link.key": link.key}
    missing = [key for key, path in keys.items() if path is None]
    if 0 < len(missing) < len(keys):
        raise ConfigError(f"TLS needs link.ca, link.certificate and link.key together: {', '.join(missing)} not set")
    if any(endpoint.startswith(SECURE) for endpoint in (*link.listen, *link.connect)) and missing:
        raise ConfigError("link.listen or link.connect is encrypted: it needs link.ca, link.certificate and link.key")
    named = {
        **keys, "telemetry.signing_key": config.telemetry.signing_key, "camera.mask": config.camera.mask,
        "terrain.path": config.terrain.path,
    }  # fmt: skip
    complaints = [(key, path, reader.complaint(Path(path))) for key, path in named.items() if path is not None]
    files = [Named(key, path, not why, why or "is there and can be read") for key, path, why in complaints]
    unreadable = reader.complaint(Path(str(config.camera.file)))
    return [*files, *([Named("camera.file", str(config.camera.file), False, unreadable)] if unreadable else [])]


def _second(config: Config) -> list[Named]:
    if not config.camera.thermal.is_live:
        return []
    camera = load_second_camera(config)
    width, height = camera.size_px
    return [
        Named("camera.thermal.file", str(config.camera.thermal.file), True, f"{width} x {height}"),
        _camera("camera.thermal", second_section(config), camera),
    ]


def _camera(section: str, config: CameraConfig, camera: Camera) -> Named:
    key, device = f"{section}.device", config.device
    check = "camera" if section == "camera" else "thermal camera"
    if device.startswith(PREFIX):
        if not Path(device.removeprefix(PREFIX)).exists():
            return Named(key, device, False, "no such file or folder")
        open_device(config, camera, SessionClock.start())  # as `run` does: raises for what cannot be played
        return Named(key, device, True, "recorded pictures")
    launch = helper_launch(config, camera.size_px)
    if launch is not None:
        why = unable(launch)
        return Named(key, launch.name, not why, why or "its program is there; pictures come with `run`")
    try:
        opened = V4l2Device(device)
    except OSError as error:
        return Named(key, device, False, error.strerror or str(error), check)
    try:
        card = opened.card()
    finally:
        opened.close()
    if not card.can_capture:
        return Named(key, device, False, f"{card.card} takes no pictures", check)
    return Named(key, device, True, card.card)


def _telemetry(url: str) -> Named:
    scheme, _, rest = url.partition(":")
    key = "telemetry.url"
    if scheme in RECEIVED_IN_FLIGHT:
        return Named(key, url, True, RECEIVED_IN_FLIGHT[scheme])
    if scheme not in DEVICES:
        return Named(key, url, True, "a recorded log")  # that it is there has been seen
    path = rest.rpartition(":")[0]
    try:
        is_device = stat.S_ISCHR(Path(path).stat().st_mode)
    except OSError as error:
        return Named(key, url, False, error.strerror or str(error), "telemetry")
    if not is_device:
        return Named(key, url, False, "is no serial device", "telemetry")
    if not os.access(path, os.R_OK | os.W_OK):
        return Named(key, url, False, "no permission", "permission")
    return Named(key, url, True, "is there; whether an autopilot sends cannot be known before `run`")
