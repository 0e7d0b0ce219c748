"""`pc-onboard setup`: a configuration for this aircraft, found out where that can be and asked for where it cannot.

Every answer can be given as an option, and then nothing is asked: without a terminal, or with --yes, what is neither
given nor the only one found is an error in one line. Nothing is written before everything is known.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from contract.errors import ConfigError, InputError
from contract.rotations import log_so3, mount_rotation
from contract.secrets import without_secrets
from contract.whole_file import save
from onboard.camera.discovery import device_paths
from onboard.camera.helper_launch import libcamera_names
from onboard.camera.known_lenses import GIVEN_SIGMA, Lens, first_camera_file, known_lens, named_lens
from onboard.camera.pixel_formats import DECODERS
from onboard.camera.playback import PREFIX
from onboard.camera.v4l2_device import V4l2Device
from onboard.camera_files.formats import load_camera_file
from onboard.commands import doctor
from onboard.commands.cameras import stable_name
from onboard.commands.checks import CHECKS
from onboard.commands.questions import Terminal
from onboard.commands.replay import recorded_flight
from onboard.commands.telemetry_radios import OTHER_RADIO, RADIOS, ours_of, radio_bit_rate
from onboard.config.files import load_config_files
from onboard.config.recorded import with_secrets_of
from onboard.config.schema import Config, to_toml
from onboard.pipeline.mount_search import MountSearch
from onboard.telemetry.autopilot_search import FoundAutopilot, candidates, is_slow, listen

MOUNTS = {  # roll, pitch, yaw, as `mount.*_deg`
    "down": (0.0, -90.0, 0.0),
    "down, the picture's top to the right": (0.0, -90.0, 90.0),
    "down, the picture's top to the tail": (0.0, -90.0, 180.0),
    "down, the picture's top to the left": (0.0, -90.0, -90.0),
    "forward and down by 45 degrees": (0.0, -45.0, 0.0),
    "forward": (0.0, 0.0, 0.0),
}
OTHER_MOUNT = "in another way, by its angles"
BEST_WIDTH_PX = 1280  # the largest picture that a Pi follows at full rate
SLOW_RATES = {"attitude_rate_hz": 20.0, "position_rate_hz": 5.0}
NONE_FOUND = "another: rtsp://..., gst:PIPELINE, exec:COMMAND or a device"
DOCTOR_S = 8.0
WIRES = ("serial", "udpin", "udpout", "tcp")  # on which MAVLink comes
ASKED, SLOWEST_HZ = 0.95, 0.1  # from this share on it is the rate that was asked for; and what can be configured
SAME_MOUNT_DEG = 30.0  # between the configured mount and the one that was found, which has right angles


@dataclass(frozen=True)
class Found:
    """A camera of this computer: what to write, what it calls itself, and its picture sizes (empty: not known)."""

    device: str
    name: str
    sizes_px: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        return f"{self.device}  {self.name}"


def v4l2_cameras() -> list[Found]:
    """All that can be opened and captures in a format that we read, and libcamera's."""
    out = []
    for path in device_paths():
        try:
            with V4l2Device(path) as device:
                if device.card().can_capture:
                    formats = [device.sizes(f) for f in device.formats() if f in DECODERS]
                    sizes = {size for f in formats for size in (*f.discrete_px, f.most_px) if size != (0, 0)}
                    out.append(Found(stable_name(path), device.card().card, tuple(sorted(sizes))))
        except OSError:
            continue
    names, _ = libcamera_names()
    return out + [Found(f"libcamera:{name}", name) for name in names]


@dataclass(frozen=True)
class Surroundings:
    """The surroundings that are examined; tests have their own."""

    cameras: Callable[[], list[Found]] = v4l2_cameras
    wires: Callable[[], list[str]] = field(default=lambda: list(candidates()))
    listen: Callable[[str], list[FoundAutopilot]] = listen
    check: Callable[[argparse.Namespace], int] = doctor.run
    rate_hz: Callable[[Config], float | None] = doctor.measured_rate_hz


def run(arguments: argparse.Namespace, terminal: Terminal | None = None, around: Surroundings | None = None) -> int:
    """Find out, ask, write and check; the doctor's exit code. Raises ConfigError and InputError before writing."""
    around = around or Surroundings()
    if terminal is None and not arguments.yes and sys.stdin.isatty():
        terminal = Terminal()
    config_path, camera_path = arguments.out, arguments.out.with_name("camera.json")
    _check_free(config_path, arguments.force)
    left: list[str] = []
    if arguments.first_flight is not None:
        config = _with_found_mount(arguments.first_flight)
        if config_path.exists():  # what is in it of addresses, no recording has
            config = with_secrets_of(config, load_config_files(config_path))
        return _finish(config_path, to_toml(config), left, around)
    camera = _camera(arguments, terminal, around)
    camera_file, text = _camera_file(arguments, terminal, camera, camera_path, left)
    telemetry, system = _telemetry(arguments, terminal, around, left)
    mount = _mount(arguments, terminal, left)
    radio = _radio(arguments, terminal, left)
    keys = {
        "vehicle": {"id": arguments.vehicle},
        "mount": dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), mount, strict=True)),
        "camera": {"device": _from_anywhere(camera.device), "file": str(camera_file)},
        "telemetry": {"url": telemetry, "system": system, **(SLOW_RATES if is_slow(telemetry) else {})},
        "link": radio,
        "recording": {"pictures": "jpeg"},  # the first flight's show how the camera sits: the step after this one
    }
    config = _checked(keys)
    if text is not None:
        _check_free(camera_file, arguments.force)
        save(camera_file, text)
        print(f"written: {camera_file}")
    return _finish(config_path, to_toml(_with_measured_rate(config, around)), left, around)


def _with_measured_rate(config: Config, around: Surroundings) -> Config:
    """The rate at which the camera gives pictures as it is set, where that is less than what it is asked for."""
    print(f"looking at {config.camera.device.partition('://')[0]}", flush=True)
    measured_hz = around.rate_hz(config)
    if measured_hz is None or measured_hz >= ASKED * config.camera.rate_hz:
        return config
    rate_hz = max(float(f"{measured_hz:.3g}"), SLOWEST_HZ)
    print(f"the camera gives {rate_hz:g} pictures a second: written as camera.rate_hz")
    return config.model_copy(update={"camera": config.camera.model_copy(update={"rate_hz": rate_hz})})


def _with_found_mount(session: Path) -> Config:
    """The configuration of a recorded session, its camera sitting as the pictures show. Raises InputError."""
    config, camera, flight = recorded_flight(session)
    ranking = MountSearch(config, camera).ranking(flight.events())
    angles = ", ".join(
        f"{'/'.join(f'{a:g}' for a in angles)} ({cost:.0f})"
        for angles, cost in zip(ranking.order[:3], ranking.costs[:3], strict=True)
    )
    print(f"roll/pitch/yaw by how far {ranking.pictures} pictures contradict them: {angles}")
    if ranking.decided is None:
        raise InputError(f"{session}: the pictures do not show how the camera is mounted: fly with turns, above 10 m")
    mount = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), ranking.decided, strict=True))
    declared = config.mount.roll_deg, config.mount.pitch_deg, config.mount.yaw_deg
    apart_rad = np.linalg.norm(log_so3(mount_rotation(*declared).T @ mount_rotation(*ranking.decided)))
    if apart_rad < np.radians(SAME_MOUNT_DEG):
        print("the configured mount is confirmed, and kept")
        return config
    return config.model_copy(update={"mount": config.mount.model_copy(update=mount)})


def _finish(config_path: Path, written: str, left: list[str], around: Surroundings) -> int:
    """Write the configuration, have the doctor look, print what is left."""
    _write_config(
        config_path, "# Made by `pc-onboard setup`.\n" + written, has_password=without_secrets(written) != written
    )
    print(f"written: {config_path}\n")
    code = around.check(argparse.Namespace(config=config_path, seconds=DOCTOR_S, json=False, explain=False))
    _print_what_is_left(config_path, left)
    return code


def _write_config(path: Path, text: str, *, has_password: bool) -> None:
    """Write it with owner and mode of the file that it replaces; only the owner can read a new one with a password."""
    if path.exists():
        was = path.stat()
        save(path, text, was.st_mode & 0o777, (was.st_uid, was.st_gid))
    else:
        save(path, text, 0o600 if has_password else 0o666)


def _check_free(path: Path, force: bool) -> None:
    if not path.parent.is_dir():
        raise InputError(f"{path}: no such folder as {path.parent}")
    if path.exists() and not force:
        raise InputError(f"{path} is there already and is kept; --force replaces it")


def _checked(keys: dict[str, dict[str, Any]]) -> Config:
    """Raises ConfigError, one line that names the key at fault."""
    try:
        return Config.model_validate(keys)
    except ValueError as error:
        raise ConfigError(f"setup: {' '.join(str(error).split())}") from error


def _camera(arguments: argparse.Namespace, terminal: Terminal | None, around: Surroundings) -> Found:
    found = around.cameras()
    if arguments.camera is not None:
        return next((f for f in found if f.device == arguments.camera), Found(arguments.camera, arguments.camera))
    if terminal is None:
        if len(found) == 1:
            return found[0]
        which = "no camera found" if not found else f"several cameras: {', '.join(f.device for f in found)}"
        raise ConfigError(f"setup: {which}; name one: --camera DEVICE (`pc-onboard cameras`)")
    terminal.show("Camera:" if found else "Camera: none found on this computer.")
    at = terminal.choose("which", [*map(str, found), NONE_FOUND]) if found else len(found)
    if at < len(found):
        return found[at]
    device = terminal.ask("camera.device", _not_empty)
    return Found(device, device)


def _from_anywhere(device: str) -> str:
    """A camera.device whose folder is found from any working directory: the service starts in another than this."""
    return PREFIX + str(Path(device.removeprefix(PREFIX)).resolve()) if device.startswith(PREFIX) else device


def _camera_file(
    arguments: argparse.Namespace, terminal: Terminal | None, camera: Found, path: Path, left: list[str]
) -> tuple[Path, str | None]:
    """Return the path of the camera file, and its text if it is to be written."""
    if arguments.camera_file is not None:
        load_camera_file(arguments.camera_file)
        return arguments.camera_file.resolve(), None
    size_px, lens = _size(arguments, terminal, camera), _lens(arguments, terminal, camera)
    left.append(
        f"calibrate the lens, whose field of view ({lens.hfov_deg:.0f} deg, +-{100 * lens.sigma:.0f} %, by "
        f"{lens.source}) is only a beginning: "
        f"pc-onboard calibrate --device '{camera.device}' --size {size_px[0]}x{size_px[1]} --out {path}, or fly with "
        f"turns and climbs and: pc-onboard calibrate --from SESSION.mcap --out {path}"
    )
    return path.resolve(), first_camera_file(size_px, lens.hfov_deg, lens.name, lens.sigma)


def _lens(arguments: argparse.Namespace, terminal: Terminal | None, camera: Found) -> Lens:
    """Return the lens as given, else as known from the driver's name, else as the person at the terminal states."""
    if arguments.fov_deg is not None:
        return _stated(arguments.fov_deg)
    try:
        lens = known_lens(camera.name) if arguments.lens is None else named_lens(arguments.lens)
    except ValueError as error:
        raise ConfigError(f"setup: --lens {arguments.lens}: {error}") from error
    if lens is None and terminal is None:
        raise ConfigError(
            "setup: the lens is not known: --camera-file CAMERA.json, --lens NAME, or --fov-deg DEGREES (horizontal)"
        )
    if lens is None:
        assert terminal is not None
        return terminal.ask("field of view from left to right, degrees, or the camera's name", seen, "60")
    if terminal is not None:
        terminal.show(f"Lens: {lens.name}, {lens.hfov_deg:.1f} degrees from left to right ({lens.source}).")
    return lens


def _stated(hfov_deg: float) -> Lens:
    return Lens("", "a stated field of view", hfov_deg, "what was stated", GIVEN_SIGMA)


def _size(arguments: argparse.Namespace, terminal: Terminal | None, camera: Found) -> tuple[int, int]:
    if arguments.size is not None:
        width, height = arguments.size
        return width, height
    usable = [size for size in camera.sizes_px if size[0] <= BEST_WIDTH_PX] or list(camera.sizes_px)
    best = max(usable, default=None)
    if terminal is None:
        if best is None:
            raise ConfigError(f"setup: the picture size of {camera.device} is not known: --size WxH")
        return best
    return terminal.ask("picture size", size_of, "1280x720" if best is None else f"{best[0]}x{best[1]}")


def _telemetry(
    arguments: argparse.Namespace, terminal: Terminal | None, around: Surroundings, left: list[str]
) -> tuple[str, int]:
    """The line, and the vehicle's system number: so that nothing else that comes on it is ever taken for ours."""
    given = arguments.telemetry
    is_all_given = given is not None and arguments.system is not None
    received = [] if is_all_given else _received([given] if given is not None else around.wires(), around)
    autopilots = [found for found in received if arguments.system in (None, found.system)]
    if len(autopilots) == 1:
        print(f"Autopilot: {autopilots[0].kind}, system {autopilots[0].system}, on {autopilots[0].url}")
        url, system = autopilots[0].url, autopilots[0].system
    elif autopilots and terminal is not None:
        terminal.show("Autopilots:")
        chosen = autopilots[terminal.choose("which", [str(found) for found in autopilots])]
        url, system = chosen.url, chosen.system
    elif autopilots:
        named = "; ".join(" ".join(str(found).split()) for found in autopilots)
        raise ConfigError(f"setup: several autopilots: {named}; name one: --telemetry URL, --system NUMBER")
    else:
        url, system = _missing(given, terminal), arguments.system or 0
        if not is_all_given and url.partition(":")[0] in WIRES:
            _note_missing(url, system, received, left)
    if is_slow(url):
        left.append(f"{url} is slow: attitude is asked for at 20 Hz; 230400 baud or more carry all of it")
    return url, system


def _received(urls: list[str], around: Surroundings) -> list[FoundAutopilot]:
    """All autopilots on these lines; once one is received on a port, or a host, it is not tried in another way."""
    found: list[FoundAutopilot] = []
    for url in urls:
        if url.partition(":")[0] in WIRES and url.rpartition(":")[0] not in {f.url.rpartition(":")[0] for f in found}:
            print(f"listening: {url}", flush=True)
            found += around.listen(url)
    return found


def _missing(given: str | None, terminal: Terminal | None) -> str:
    """The line, where no autopilot was received on any."""
    if given is not None:
        return given
    if terminal is None:
        raise ConfigError("setup: no autopilot found; name its line: --telemetry serial:/dev/ttyAMA0:921600")
    terminal.show(f"Autopilot: none found: {CHECKS['telemetry'].cure}")
    return terminal.ask("telemetry.url", _not_empty, "udpin:0.0.0.0:14550")


def _note_missing(url: str, system: int, received: list[FoundAutopilot], left: list[str]) -> None:
    others = ", but " + ", ".join(f"{found.system} {found.kind}" for found in received) if received else ""
    which = f"of system {system} " if system else ""
    left.append(f"nothing {which}was received on {url}{others}: {CHECKS['telemetry'].cure}")
    if not system:
        left.append("telemetry.system is open: set it to the autopilot's number, so that no other is taken for it")


def _mount(arguments: argparse.Namespace, terminal: Terminal | None, left: list[str]) -> tuple[float, float, float]:
    if arguments.mount is not None:
        roll, pitch, yaw = arguments.mount
        return roll, pitch, yaw
    names = list(MOUNTS)
    at = 0
    if terminal is not None:
        terminal.show("The camera looks (the picture's top is towards the nose, unless stated otherwise):")
        at = terminal.choose("how", [*names, OTHER_MOUNT])
    else:
        left.append(
            "the camera is taken to look down, the picture's top to the nose: --mount ROLL,PITCH,YAW changes that"
        )
    left.append(
        "fly a minute with turns (pictures are recorded: `recording.pictures`); then `pc-onboard setup --force "
        "--first-flight SESSION.mcap` confirms how the camera sits, or corrects it"
    )
    if at < len(names):
        return MOUNTS[names[at]]
    assert terminal is not None
    return terminal.ask("roll,pitch,yaw, degrees (0,-30,0: ahead, 30 below the horizon)", mount_angles)


def _radio(arguments: argparse.Namespace, terminal: Terminal | None, left: list[str]) -> dict[str, Any]:
    """The keys of `link` for clicks and sets through the autopilot's radio; none where it has no such radio."""
    if arguments.radio is not None:
        try:
            bit_rate = radio_bit_rate(arguments.radio)
        except ValueError as error:
            raise ConfigError(f"setup: --radio {arguments.radio}: {error}") from error
    elif terminal is None:
        left.append("only a network brings sets to the ground; where there is a telemetry radio alone: --radio sik")
        return {}
    else:
        terminal.show("The telemetry radio, through the autopilot, for clicks and sets:")
        at = terminal.choose("which", [*(radio.name for radio in RADIOS.values()), OTHER_RADIO])
        known = [radio.bit_rate for radio in RADIOS.values()]
        bit_rate = known[at] if at < len(known) else terminal.ask("bit/s to the ground", radio_bit_rate)
    if bit_rate == 0.0:
        return {}
    left.append(
        "on the ground: `pc-ground watch --connect mavlink:serial:DEVICE:BAUD`; whether link.mavlink_bit_rate fits the "
        "radio is shown by the line `radio` of `pc-onboard doctor` while a ground listens"
    )
    return {"mavlink": True, "mavlink_bit_rate": ours_of(bit_rate)}


def _print_what_is_left(config: Path, left: list[str]) -> None:
    print("\nLeft to do:")
    for number, what in enumerate(
        [*left, f"start it: pc-onboard run --config {config} (as a service: docs/service.md)"], 1
    ):
        print(f"  {number}. {without_secrets(what)}")


def _not_empty(line: str) -> str:
    if not line:
        raise ValueError("it cannot be empty")
    return line


def seen(line: str) -> Lens:
    """A lens by its horizontal field of view (degrees) or its name; raises ValueError."""
    try:
        value = float(line)
    except ValueError:
        return named_lens(line)
    if not 5.0 <= value <= 150.0:
        raise ValueError("degrees from 5 to 150")
    return _stated(value)


def mount_angles(line: str) -> tuple[float, float, float]:
    """Roll, pitch, yaw as in 0,-30,0, each a blank or a comma apart; raises ValueError."""
    try:
        found = [float(part) for part in line.replace(",", " ").split()]
    except ValueError:
        found = []
    if len(found) != 3 or not all(abs(angle) <= 360.0 for angle in found):
        raise ValueError("three angles as in 0,-30,0")
    return found[0], found[1], found[2]


def size_of(line: str) -> tuple[int, int]:
    """A picture size as in 1280x720; raises ValueError."""
    width, _, height = line.partition("x")
    if not (width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= 16):
        raise ValueError("a size as in 1280x720")
    return int(width), int(height)
