"""The common part of `import-photos` and `import-video`: guessed camera and mount, the log, and the folder written.

Everything that is guessed is a row of the list that is printed, and can be set otherwise by `--set KEY=VALUE`.
"""

from __future__ import annotations

import json
import math
import shlex
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from contract.stated_values import number_or_nan
from onboard.camera.photo_metadata import Focal
from onboard.camera_files.formats import read_camera_file
from onboard.commands.flight_folder import next_to
from onboard.config.schema import Config, parse_config, to_toml, validated
from onboard.events.types import Attitude, GimbalAttitude
from onboard.telemetry.mrk_reader import read_mrk
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog

# One sigma of what is not stated: where the optical axis meets a sensor (share of its width), how straight a lens for
# mapping draws (k1 of lenses as they are sold: within some hundredths), how level a gimbal holds, how well a camera is
# screwed below an aircraft.
SIGMA_STAMPS_S = 0.1  # of a file of every picture's time against the log's clock, beyond which it is searched
SIGMA_CENTRE, SIGMA_K1, SIGMA_GIMBAL_DEG, SIGMA_MOUNT_DEG = 0.01, 0.03, 1.0, 5.0
# A camera that states nothing is given the lenses of small aircraft: 50 to 90 degrees, and their distortion.
UNKNOWN_FOV_DEG, SIGMA_UNKNOWN_FOCAL, SIGMA_UNKNOWN_K1 = 70.0, 0.2, 0.1
SIGMA_GIVEN_FOCAL = 0.03  # of a field of view that a person gives
READOUT_S, SIGMA_READOUT_S = 0.02, 0.02  # of small cameras, which read row by row unless they state otherwise
FOV, CAMERA_FILE, UNDULATION = "camera.fov_deg", "camera.file", "gps.undulation_m"
UNKNOWN = "NOT KNOWN"  # how the row of a widely guessed lens begins; `pc-ground open` looks for it
Row = tuple[str, str]


@dataclass(frozen=True)
class Optics:
    """A camera, the file to write of it, and where it is from."""

    camera: Camera
    file_text: str
    text: str
    is_known: bool = True


@dataclass
class ImportedFlight:
    """An imported flight: configuration by section and key (TOML values), and the list to print."""

    out: Path
    frames: Path
    telemetry: tuple[Path, ...]  # the flight's log, or its two
    optics: Optics
    stamps: list[str]  # lines of stamps.csv, its header first
    sections: dict[str, dict[str, str]] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    replay: list[str] = field(default_factory=list)  # further arguments of the command

    def write(self, settings: dict[str, str]) -> None:
        """The folder's files, after everything has been checked; a thermal camera's are then searched for hot spots.

        Raises ConfigError for a wrong setting.
        """
        config = config_text(self.sections, settings)
        parsed = parse_config(config)
        if parsed.thermal.enabled and parsed.spots.enabled:
            self.replay.append("--spots")
        self.out.mkdir(parents=True, exist_ok=True)
        (self.out / "stamps.csv").write_text("\n".join(self.stamps) + "\n")
        (self.out / "camera.json").write_text(self.optics.file_text)
        (self.out / "config.toml").write_text(config)

    def print_assumed(self) -> None:
        """Print what was assumed, and as the last line the command to run next."""
        width = max(len(name) for name, _ in self.rows)
        print("\n".join(f"{name:<{width}}  {text}" for name, text in self.rows))
        print(f"written: {self.out}; to change what was assumed: --set KEY=VALUE, or edit its config.toml, camera.json")
        files = [
            ("config", self.out / "config.toml"), ("frames", self.frames),
            *(("telemetry", path) for path in self.telemetry),
            ("camera", self.out / "camera.json"), ("stamps", self.out / "stamps.csv"),
            ("out", self.out / "session.mcap"),
        ]  # fmt: skip
        options = [word for name, path in files for word in (f"--{name}", str(path))]
        print(shlex.join(["pc-onboard", "replay", *options, *self.replay]), flush=True)


def rolling_shutter(sections: dict[str, dict[str, str]]) -> Row:
    """Into the configuration: that rows are read one after the other, as small cameras do; estimated in flight."""
    sections.setdefault("camera", {})
    sections["camera"] |= {"readout_s": f"{READOUT_S}", "sigma_readout_s": f"{SIGMA_READOUT_S}"}
    return (
        "rows",
        f"read in {1e3 * READOUT_S:.0f} +-{1e3 * SIGMA_READOUT_S:.0f} ms (rolling shutter), estimated in flight",
    )


def check_out(out: Path) -> None:
    """Raise InputError unless a new or empty folder can be made there."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not an empty folder; name a new one")
    if not out.parent.is_dir():
        raise InputError(f"{out}: no such folder as {out.parent}")


def settings_of(given: Sequence[str]) -> dict[str, str]:
    """`KEY=VALUE` of the command line -> TOML values by key; a value that is no TOML is a text. Raises ConfigError."""
    out = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or "." not in key or not value.strip():
            raise ConfigError(f"--set {text}: is not SECTION.KEY=VALUE, as in mount.pitch_deg=-45")
        try:
            tomllib.loads(f"x = {value}")
        except ValueError:
            value = json.dumps(value)
        out[key.strip()] = value.strip()
    return out


def options_of(home_amsl_m: float | None, settings: dict[str, str]) -> ReadOptions:
    """Statements about a log, by the take-off's height and what is set. Raises ConfigError for a wrong value."""
    system = settings.get("telemetry.system", "0")
    if not system.isdecimal():
        raise ConfigError(f"--set telemetry.system={system}: is no whole number")
    keys = {UNDULATION: settings[UNDULATION]} if UNDULATION in settings else {}
    undulation_m = with_settings(Config(), keys).gps.undulation_m
    return ReadOptions(home_amsl_m=home_amsl_m, system=int(system), undulation_m=undulation_m)


def with_settings(config: Config, settings: dict[str, str]) -> Config:
    """A configuration with other values of some keys. Raises ConfigError, naming a key that is none."""
    table = tomllib.loads(to_toml(config))
    for key, value in settings.items():
        *sections, name = key.split(".")
        place = table
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise ConfigError(f"--set {key}={value}: {section} is no section of the configuration")
        place[name] = tomllib.loads(f"x = {value}")["x"]
    return validated(table)


def config_text(sections: dict[str, dict[str, str]], settings: dict[str, str]) -> str:
    """The configuration file: what was guessed, under what was set."""
    merged = {name: dict(keys) for name, keys in sections.items()}
    for key, value in settings.items():
        section, _, name = key.partition(".")
        if key not in (FOV, CAMERA_FILE):
            merged.setdefault(section, {})[name] = value
    lines = ["# Made by pc-onboard import; what is not here is the default (config.toml of the sources)."]
    for name, keys in merged.items():
        lines += ["", f"[{name}]", *(f"{key} = {value}" for key, value in keys.items())] if keys else []
    return "\n".join(lines) + "\n"


def optics_of(size_px: tuple[int, int], focal: Focal | None, near: Path, settings: dict[str, str]) -> Optics:
    """The camera: as it was set, else from a camera.json next to the pictures, else as they state, else a wide guess.

    Raises InputError for a camera file that was named and is unusable, ConfigError for a wrong field of view.
    """
    if CAMERA_FILE in settings:
        return _of_file(Path(str(tomllib.loads(f"x = {settings[CAMERA_FILE]}")["x"])), size_px)
    if FOV in settings:
        return _of_focal(size_px, _given(size_px, settings[FOV]))
    if (found := next_to(near, "camera.json")) is not None:
        return _of_file(found, size_px)
    return _of_focal(size_px, focal) if focal is not None else _unknown(size_px)


def _of_file(path: Path, size_px: tuple[int, int]) -> Optics:
    read = read_camera_file(path)
    camera = read.camera
    if camera.size_px != size_px:
        raise InputError(
            f"camera file {path} is for {camera.width_px} x {camera.height_px}, the pictures are {size_px[0]} x "
            f"{size_px[1]}: give another with --set {CAMERA_FILE}=FILE, or a field of view with --set {FOV}=DEGREES"
        )
    text = path.read_text(encoding="utf-8") if read.form is None else camera.to_json()
    return Optics(camera, text, f"{path}: {_width_text(camera)}")


def _given(size_px: tuple[int, int], value: str) -> Focal:
    fov_deg = number_or_nan(value)
    if not 5.0 <= fov_deg <= 150.0:
        raise ConfigError(f"--set {FOV}={value}: the horizontal field of view is 5 to 150 degrees")
    focal_px = 0.5 * size_px[0] / math.tan(math.radians(0.5 * fov_deg))
    return Focal(focal_px, focal_px, SIGMA_GIVEN_FOCAL * focal_px, f"a field of view of {fov_deg:g} deg, as set")


def _of_focal(size_px: tuple[int, int], focal: Focal, sigma_k1: float = SIGMA_K1) -> Optics:
    """Return optics with sigmas in the place where `pc-onboard calibrate` has them: the flight estimates the rest."""
    width, height = size_px
    cx, cy = focal.centre_px or ((width - 1) / 2.0, (height - 1) / 2.0)
    camera = Camera(width, height, focal.fx_px, focal.fy_px, cx, cy, focal.distortion or (0.0, 0.0, 0.0, 0.0, 0.0))
    is_calibrated = focal.distortion is not None
    centre_px = focal.sigma_px if is_calibrated else SIGMA_CENTRE * width
    k1 = 0.1 * SIGMA_K1 if is_calibrated else sigma_k1
    sigma = {"fx": focal.sigma_px, "fy": focal.sigma_px, "cx": centre_px, "cy": centre_px}
    sigma |= {"k1": k1, "k2": k1, "p1": 0.1 * k1, "p2": 0.1 * k1, "k3": k1}
    known = json.loads(camera.to_json())
    known["calibration"] = {
        "verdict": f"guessed from {focal.source}, not calibrated",
        "sigma": {name: float(f"{value:.3g}") for name, value in sigma.items()},
    }
    lens = "distortion as the picture states" if is_calibrated else "no distortion known, taken as none"
    text = (
        f"focal length {focal.fx_px:.0f} +-{focal.sigma_px:.0f} px from {focal.source}, {_width_text(camera)}, {lens}"
    )
    return Optics(camera, json.dumps(known, indent=1) + "\n", text)


def _unknown(size_px: tuple[int, int]) -> Optics:
    focal_px = 0.5 * size_px[0] / math.tan(math.radians(0.5 * UNKNOWN_FOV_DEG))
    focal = Focal(focal_px, focal_px, SIGMA_UNKNOWN_FOCAL * focal_px, "nothing that is known of it")
    optics = _of_focal(size_px, focal, SIGMA_UNKNOWN_K1)
    hint = f"the flight estimates it; where the lens is known: --set {FOV}=DEGREES, or --set {CAMERA_FILE}=FILE"
    text = f"{UNKNOWN}, taken as {UNKNOWN_FOV_DEG:g} deg +-20 %; {hint}"
    return Optics(optics.camera, optics.file_text, text, is_known=False)


def _width_text(camera: Camera) -> str:
    return f"{camera.width_px} x {camera.height_px}, {camera.hfov_deg:.0f} deg wide"


def sections_of(path: Path) -> dict[str, dict[str, str]]:
    """A configuration file's sections and keys as TOML values. Raises ConfigError for what is none."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error
    try:
        parse_config(text)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    found = tomllib.loads(text)
    return {name: {key: _toml(value) for key, value in keys.items()} for name, keys in found.items()}


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(each) for each in value) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def log_rows(paths: Sequence[Path], log: TelemetryLog) -> list[Row]:
    """Return the rows about the flight's logs: their names, and how two were joined."""
    joining = [("logs", log.notes[-1])] if len(paths) > 1 else []
    return [("log", " and ".join(str(path) for path in paths)), *joining]


def shots_in_folder(folder: Path) -> tuple[int, ...]:
    """Return when DJI's file (.MRK) next to photographs states that they were taken (Unix ns); empty without one."""
    found = sorted(entry for entry in folder.iterdir() if entry.suffix.lower() == ".mrk" and entry.is_file())
    return tuple(sorted(shot for path in found for shot in read_mrk(path)))


def mount_by_log(log: TelemetryLog) -> tuple[dict[str, dict[str, str]], Row]:
    """Sections of the configuration, by which angles a log has, and what they assume."""
    kinds = {type(event) for event in log.events}
    # Angles that the camera's own aircraft wrote are its own. Of an autopilot's the pictures must confirm it.
    is_of_camera = any(isinstance(event, GimbalAttitude) and event.is_of_camera for event in log.events)
    if GimbalAttitude in kinds and (is_of_camera or Attitude not in kinds):
        mount = {"pitch_deg": "-90.0", "gimbal": '"always"', "sigma_deg": f"{SIGMA_GIMBAL_DEG}"}
        return {"mount": mount}, ("mount", f"the gimbal's angles as the log states, +-{SIGMA_GIMBAL_DEG:g} deg")
    sections = {"mount": {"pitch_deg": "-90.0", "sigma_deg": f"{SIGMA_MOUNT_DEG}"}}
    if Attitude in kinds:
        how = f"fixed, straight down, top towards the nose, +-{SIGMA_MOUNT_DEG:g} deg"
        return sections, ("mount", f"{how}; if it looked ahead: --set mount.pitch_deg=-45")
    sections["solve"] = {"attitude": '"none"', "level_ground": "true"}
    how = "no angles in the log: looking straight down, over ground level on average"
    return sections, ("mount", f"{how}; if it looked ahead: --set mount.pitch_deg=-45")
