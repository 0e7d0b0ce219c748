"""The configuration: typed, frozen, every key with its unit, range and default in one place.

`config.toml` in the repository root is generated from this file (`python -m onboard.config.schema > config.toml`) and a
test holds the two together, so a key is added here and nowhere else. A file may name any subset of the keys.
"""

from __future__ import annotations

import inspect
import json
import textwrap
import tomllib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from contract.errors import ConfigError
from contract.near_word import near_word
from contract.thermal_scale import ThermalScale
from onboard.config.delay_prior import delay_prior
from onboard.config.link import Link, Look
from onboard.config.mavlink_camera import MavlinkCamera
from onboard.config.second_camera import BLACK_HOT, BLACK_HOT_AND_SCALE, SecondCamera
from onboard.config.section import Section, choice, quantity


class Vehicle(Section):
    """Who we are."""

    id: str = Field(
        default="uav",
        pattern=r"^[A-Za-z0-9_.-]{1,32}$",
        description="name in the link's topics: 1 to 32 letters, digits, '_', '.' or '-'",
    )


class Mount(Section):
    """How the camera sits in the vehicle, as MAVLink gives a gimbal's attitude in the vehicle's frame.

    Pitch -90 and yaw 0 look straight down with the picture's top towards the nose; yaw -90 then turns the camera's x
    axis towards the nose.
    """

    roll_deg: float = quantity(0.0, -180.0, 180.0, "deg", "roll about the optical axis's forward direction")
    pitch_deg: float = quantity(-90.0, -180.0, 180.0, "deg", "pitch of the optical axis; -90 is straight down")
    yaw_deg: float = quantity(0.0, -360.0, 360.0, "deg", "yaw from the nose, clockwise seen from above")
    gimbal: Literal["auto", "always", "never"] = choice(
        "auto",
        "a gimbal's attitude replaces the angles above: 'auto' (if the pictures confirm it), 'always', 'never'",
    )
    gimbal_component: int = quantity(
        0,
        0,
        255,
        "",
        "whose attitude is the camera's: a gimbal's MAVLink component (154, 171 to 175), or 1, the "
        "autopilot for it; 0: the gimbal's own before the autopilot's",
    )
    gimbal_url: str | None = choice(
        None, "a gimbal that speaks its maker's protocol: siyi:HOST:PORT, such as siyi:192.168.144.25:37260"
    )
    gimbal_yaw_sigma_deg: float = quantity(
        0.0,
        0.0,
        45.0,
        "deg",
        "one sigma of a gimbal's yaw as a whole, where its zero is off or drifts; found by each window",
    )
    sigma_deg: float = quantity(1.0, 0.0, 45.0, "deg", "one sigma of the mount angles above")
    lever_arm_m: tuple[float, float, float] = choice(
        (0.0, 0.0, 0.0), "from the autopilot's reference point to the camera: forward, right, down, m"
    )


class CameraConfig(Section):
    """The camera: where it is, how it is set, its clock. Its optics are in the camera file."""

    device: str = choice(
        "/dev/video0",
        "V4L2 device, better a name under /dev/v4l/by-id or by-path; libcamera: or libcamera:ID; rtsp://HOST/PATH; "
        "gst:PIPELINE up to raw video; exec:COMMAND of your own (docs/camera.md)",
    )
    file: str | None = choice(None, "camera file: of `pc-onboard calibrate`, or another tool's (docs/calibrate.md)")
    format: Literal[
        "auto", "GREY", "YUYV", "NV12", "MJPG", "Y16", "UYVY", "YU12", "Y10", "Y12", "GRBG", "RGGB", "GBRG", "BA81"
    ] = choice("auto", "pixel format of a V4L2 device; 'auto' takes the first of these that has size and rate")
    rate_hz: float = quantity(30.0, 0.1, 240.0, "Hz", "pictures asked of the device")
    exposure_us: float | None = quantity(None, 1.0, 1e6, "us", "fixed exposure; left to the camera if not set")
    gain: float | None = quantity(
        None, 0.0, 1e6, "", "fixed gain, in the driver's units; left to the camera if not set"
    )
    focus: float | None = quantity(None, 0.0, 1e6, "", "fixed focus, in the driver's units; untouched if not set")
    white_balance_k: float | None = quantity(None, 1000.0, 20000.0, "K", "fixed white balance; untouched if not set")
    mask: str | None = choice(
        None, "PNG of the picture's size, black where a display or a frame is burned in; features are taken elsewhere"
    )
    lost_after_s: float = quantity(1.5, 0.1, 60.0, "s", "time without a picture that counts as camera lost")
    frozen_after_s: float = quantity(1.0, 0.1, 60.0, "s", "time with the same picture that counts as camera frozen")

    latency_s: float = quantity(
        None, -5.0, 5.0, "s", "capture stamp minus true mid-exposure; if not set 0, of a network stream 0.5"
    )
    sigma_latency_s: float = quantity(
        None,
        0.0,
        2.0,
        "s",
        "one sigma of the camera-to-autopilot time offset; if not set 0.1, of a network stream 0.29 (0 to 1 s)",
    )
    stream_clock: Literal["own", "utc"] = choice(
        "own", "capture times in a stream: of the sender's 'own' clock, or 'utc' where GPS or NTP sets both ends"
    )
    sigma_jitter_s: float = quantity(
        0.003, 0.0, 1.0, "s", "least one sigma of a single stamp, 0.3 where it is cut to the second; estimated upwards"
    )
    sigma_zoom: float = quantity(
        0.005,
        0.0,
        0.2,
        "",
        "one sigma of a reported zoom's focal length, as a share: its steps, its errors",
    )
    readout_s: float = quantity(
        0.0, -0.2, 0.2, "s", "rolling shutter: time in which all rows are read, negative if the last is first; 0: none"
    )
    sigma_readout_s: float = quantity(0.0, 0.0, 0.1, "s", "one sigma of that; above 0 it is estimated in flight")
    thermal: SecondCamera = SecondCamera()

    @model_validator(mode="before")
    @classmethod
    def _delay_by_source(cls, given: Any) -> Any:
        """Fill in the values of the delay that are not stated, by the kind of source of the pictures."""
        if not isinstance(given, dict):
            return given
        device, clock = given.get("device"), given.get("stream_clock")
        prior = delay_prior(device if isinstance(device, str) else "", clock == "utc")
        return {**given, **{key: value for key, value in prior.items() if given.get(key) is None}}

    @property
    def is_rolling(self) -> bool:
        return self.readout_s != 0.0 or self.sigma_readout_s > 0.0


class ThermalConfig(Section):
    """The camera sees heat (docs/thermal.md): its counts are kept, and kelvin = scale * count + offset."""

    enabled: bool = choice(False, "the camera is a thermal one")
    scale: float | None = quantity(
        None, 1e-5, 100.0, "K", "of one count, 0.01 of a radiometric Lepton or Boson; if not set: uncalibrated"
    )
    offset: float = quantity(0.0, -1e5, 1e5, "K", "temperature of count 0, with the scale")
    black_hot: bool = choice(False, BLACK_HOT)

    @model_validator(mode="after")
    def _has_no_scale_if_black_hot(self) -> ThermalConfig:
        if self.black_hot and self.scale is not None:
            raise ValueError(BLACK_HOT_AND_SCALE)
        return self

    @property
    def calibration(self) -> ThermalScale | None:
        """Counts to kelvin; None: uncalibrated."""
        return None if self.scale is None else ThermalScale(self.scale, self.offset)

    @property
    def words(self) -> str:
        """A description of the counts, for people; empty if the camera is no thermal one."""
        if not self.enabled:
            return ""
        if self.scale is None:
            return "thermal, black hot" if self.black_hot else "thermal, uncalibrated"
        return f"thermal, {self.scale:g} K a count"


NOT_THERMAL = ThermalConfig()


class Tracking(Section):
    """Following features from picture to picture."""

    features: int = quantity(100, 20, 200, "", "features kept on each picture")
    min_distance_px: float = quantity(
        0.0, 0.0, 500.0, "px", "least distance between features; 0: from picture size and number of features"
    )


class Solve(Section):
    """The window solve and its sensor set."""

    attitude: Literal["none", "autopilot"] = choice(
        "autopilot", "attitude source: 'none' (direction of travel and level ground) or 'autopilot'"
    )
    velocity: bool = choice(True, "use the velocity of the autopilot's navigation filter")
    level_ground: bool = choice(True, "take the mean ground to be level, which fixes roll when attitude is weak")
    keyframes: int = quantity(10, 3, 30, "", "keyframes in the window")
    pixel_sigma_px: float = quantity(0.3, 0.05, 10.0, "px", "one sigma of a tracked feature")
    # ArduPilot 4.7 against the simulator's truth: tilt 0.2 to 0.35 deg, heading 1 deg, correlated over 8 to 25 s, the
    # white part 0.02 to 0.05 deg. Real compasses and vibration are worse.
    attitude_sigma_deg: float = quantity(0.5, 0.01, 45.0, "deg", "one sigma of roll and pitch, the Gauss-Markov part")
    heading_sigma_deg: float = quantity(2.0, 0.01, 90.0, "deg", "one sigma of heading, the Gauss-Markov part")
    # In the real flight of the tests roll and pitch vary by 0.3 deg from picture to picture, heading by 1 deg.
    attitude_white_sigma_deg: float = quantity(0.15, 0.001, 45.0, "deg", "one sigma of roll and pitch, the white part")
    heading_white_sigma_deg: float = quantity(0.6, 0.001, 45.0, "deg", "one sigma of heading, the white part")
    attitude_correlation_time_s: float = quantity(20.0, 0.1, 10000.0, "s", "correlation time of the Gauss-Markov part")
    level_ground_sigma_deg: float = quantity(3.5, 0.01, 45.0, "deg", "one sigma of the mean ground's slope")
    ground_roughness_sigma_m: float = quantity(
        10.0, 0.0, 1000.0, "m", "ground roughness: one sigma about its mean plane"
    )
    home_level: bool = choice(False, "without parallax and terrain, answer over level ground at home's height")
    home_level_sigma_m: float = quantity(10.0, 0.1, 1000.0, "m", "one sigma of that ground's height")


class TerrainModel(Section):
    """An elevation model of the area, if there is one (needs the extra `terrain`)."""

    path: str | None = choice(None, "GeoTIFF, SRTM .hgt, or a folder of them")
    datum: Literal["amsl", "ellipsoid"] = choice("amsl", "what its heights count from: 'amsl' or 'ellipsoid'")
    sigma_m: float = quantity(3.0, 0.1, 100.0, "m", "one sigma of its heights, from place to place")
    sigma_datum_m: float = quantity(2.0, 0.0, 100.0, "m", "one sigma of its heights as a whole against the GPS's")


class Gps(Section):
    """Errors of the position, and when it is not used."""

    # ArduPilot 4.7's GLOBAL_POSITION_INT against the simulator's truth: 40 ms (plane), 28 ms (copter).
    latency_s: float = quantity(0.04, -1.0, 5.0, "s", "age of a position at its own time stamp")
    sigma_latency_s: float = quantity(0.1, 0.0, 5.0, "s", "one sigma of that age; it is estimated in flight")
    sigma_white_m: float = quantity(0.3, 0.001, 100.0, "m", "one sigma of a position, the white part")
    sigma_correlated_horizontal_m: float = quantity(
        1.5, 0.0, 1000.0, "m", "least one sigma of the Gauss-Markov part, horizontal; the receiver may claim more"
    )
    sigma_correlated_vertical_m: float = quantity(
        2.5, 0.0, 1000.0, "m", "least one sigma of the Gauss-Markov part, vertical; the receiver may claim more"
    )
    correlation_time_s: float = quantity(60.0, 1.0, 100000.0, "s", "correlation time of the Gauss-Markov part")
    sigma_velocity_m_s: float = quantity(0.1, 0.001, 100.0, "m/s", "one sigma of velocity, the white part")
    # ArduPilot 4.7 against the simulator's truth: 0.01 to 0.05 m/s in calm flight, 0.3 in wind with poor inertial
    # sensors; PX4 1.17 0.3 m/s, correlated over 6 s.
    sigma_velocity_correlated_m_s: float = quantity(
        0.02, 0.0, 100.0, "m/s", "least one sigma of velocity, the Gauss-Markov part; the receiver may claim more"
    )
    velocity_correlation_time_s: float = quantity(
        8.0, 0.1, 1000.0, "s", "correlation time of velocity's Gauss-Markov part"
    )
    max_gap_s: float = quantity(1.5, 0.1, 10.0, "s", "longest gap between positions that is interpolated")
    quality_timeout_s: float = quantity(2.0, 0.5, 60.0, "s", "silence of the receiver that counts as no GPS")
    recovery_s: float = quantity(1.0, 0.0, 60.0, "s", "time without answers after the fix is back")
    glitch_m: float = quantity(10.0, 1.0, 1000.0, "m", "least jump against velocity that counts as a glitch")
    settle_s: float = quantity(
        5.0, 0.0, 120.0, "s", "time without answers after a glitch, or after a fix that came and went"
    )
    max_slip_m_s: float = quantity(
        1.0, 0.1, 100.0, "m/s", "position moving against velocity faster than this counts as no GPS"
    )
    undulation_m: float | None = quantity(
        None, -120.0, 120.0, "m", "geoid undulation (ellipsoidal minus sea-level height) when the autopilot gives none"
    )


class RangeFinderConfig(Section):
    """A distance sensor (DISTANCE_SENSOR), if there is one."""

    use: bool = choice(False, "take its distance to the ground as a measurement in the window solve")
    sigma_m: float = quantity(
        0.5, 0.01, 100.0, "m", "least one sigma of a distance, its place against the camera included"
    )
    sigma_share: float = quantity(0.02, 0.0, 0.5, "", "one sigma as a share of the distance, added to the above")


class Telemetry(Section):
    """Where the autopilot is, and its clock."""

    url: str = choice(
        "udpin:127.0.0.1:14550",
        "live link: serial:/dev/ttyAMA0:921600, udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, "
        "nmea:/dev/ttyUSB0:9600 or tlog:FILE; `replay` takes a file instead",
    )
    backend: Literal["pymavlink", "mavsdk"] = choice("pymavlink", "library that speaks MAVLink")
    attitude_rate_hz: float = quantity(50.0, 1.0, 400.0, "Hz", "attitude asked of the autopilot, which may give less")
    position_rate_hz: float = quantity(10.0, 1.0, 50.0, "Hz", "position asked of the autopilot, which may give less")
    system: int = quantity(0, 0, 255, "", "the vehicle's MAVLink system number; 0: the only one received, else none")
    component: int = quantity(191, 1, 255, "", "our MAVLink component number in the vehicle's system")
    signing_key: str | None = choice(None, "file with a MAVLink 2 signing key (32 bytes, raw or 64 hex digits)")
    log: str | None = choice(None, "folder for the link's messages as .tlog files; none if not set")
    lost_after_s: float = quantity(2.0, 0.2, 60.0, "s", "silence that counts as telemetry lost")
    clock: Literal["auto", "constant", "drift"] = choice(
        "auto",
        "boot clock against ours in a log, and where TIMESYNC is not answered: 'constant' offset, steady 'drift', or "
        "'auto' (constant unless a drift shows)",
    )
    max_attitude_gap_s: float = quantity(1.0, 0.02, 10.0, "s", "longest gap between attitudes that is interpolated")


class PictureConfig(Section):
    """Small pictures of keyframes over the link, for the ground to click on.

    They get what sets, status and replies leave of `link.max_bit_rate`: with sets at 5 Hz, nothing below 45 kbit/s.
    """

    enabled: bool = choice(False, "send them, while a ground asks for them")
    format: Literal["webp", "jpeg"] = choice("webp", "'webp' (a third of the bytes) or 'jpeg' (a tenth of the time)")
    max_px: int = quantity(480, 64, 2048, "px", "longer side; larger pictures are made smaller")
    quality: int = quantity(30, 1, 95, "", "of the compression")
    rate_hz: float = quantity(0.5, 0.01, 5.0, "Hz", "pictures sent at most")


class TracksConfig(Section):
    """Pictures that are kept: things that move are followed in them (pc-ground track), clicked pixels are measured."""

    enabled: bool = choice(True, "follow what is asked for, and measure clicked pixels")
    keep_mb: float = quantity(48.0, 8.0, 4096.0, "MB", "of pictures kept in memory, so that a click may be seconds old")


class SpotsConfig(Section):
    """Hot spots that a thermal camera sees (thermal.enabled; docs/hot-spots.md)."""

    enabled: bool = choice(True, "look for hot spots, if the camera is a thermal one")
    false_per_km2: float = quantity(
        1.0, 0.001, 1000.0, "1/km2", "spots that are only ground: more of them, and fainter ones are found"
    )
    hotter_than_c: float = quantity(
        100.0, -50.0, 2000.0, "degC", "what is hotter is a spot whatever lies about it; of a calibrated camera"
    )
    smallest_m2: float = quantity(0.1, 0.001, 1000.0, "m2", "on the ground, of a spot")
    largest_m: float = quantity(
        5.0, 0.5, 200.0, "m", "across, of a spot that is found by its surroundings; a larger one by its heat alone"
    )
    rate_hz: float = quantity(2.0, 0.05, 2.0, "Hz", "pictures looked at, at most")
    things: bool = choice(False, "a net also looks for people, vehicles and other things (docs/hot-spots.md)")
    things_per_km2: float = quantity(1.0, 0.001, 1e4, "1/km2", "of each kind, expected before any has been found")


class Recording(Section):
    """What is kept on board: one MCAP file after the other a session."""

    enabled: bool = choice(True, "record events, sets and status")
    folder: str | None = choice(None, "where; if not set, `recordings` in the state directory")
    pictures: Literal["none", "jpeg", "lossless"] = choice(
        "none", "pictures too: 'jpeg' to look at, 'lossless' for a replay that gives the same bytes"
    )
    rotate_mb: float = quantity(512.0, 1.0, 1e6, "MB", "size at which a new file is begun")
    keep_free_mb: float = quantity(1024.0, 1.0, 1e7, "MB", "recording stops when the disk has less free than this")


class Service(Section):
    """The daemon itself."""

    state_dir: str | None = choice(
        None, "where estimates and recordings are kept; if not set, $STATE_DIRECTORY, else ~/.local/state/pointclick"
    )
    max_delay_s: float = quantity(
        1.0, 0.1, 30.0, "s", "pictures that wait longer are dropped; once they queue for so long, a fifth of it"
    )
    prometheus: str | None = choice(None, "HOST:PORT to serve Prometheus text on, such as 127.0.0.1:9464")


class Config(Section):
    """The whole configuration."""

    vehicle: Vehicle = Vehicle()
    mount: Mount = Mount()
    camera: CameraConfig = CameraConfig()
    thermal: ThermalConfig = ThermalConfig()
    tracking: Tracking = Tracking()
    solve: Solve = Solve()
    terrain: TerrainModel = TerrainModel()
    gps: Gps = Gps()
    range_finder: RangeFinderConfig = RangeFinderConfig()
    telemetry: Telemetry = Telemetry()
    link: Link = Link()
    look: Look = Look()
    mavlink_camera: MavlinkCamera = MavlinkCamera()
    picture: PictureConfig = PictureConfig()
    tracks: TracksConfig = TracksConfig()
    spots: SpotsConfig = SpotsConfig()
    recording: Recording = Recording()
    service: Service = Service()

    @property
    def heat(self) -> ThermalConfig:
        """The thermal section that describes the counts searched for hot spots: the second camera's if there is one."""
        second = self.camera.thermal
        return (
            ThermalConfig(enabled=True, scale=second.scale, offset=second.offset, black_hot=second.black_hot)
            if second.is_stated
            else self.thermal
        )


def load_config(path: Path | str) -> Config:
    """Read a TOML file; raises ConfigError with one line that names the file, the key and what would be right."""
    return load_table(path)[1]


def load_table(path: Path | str) -> tuple[dict[str, Any], Config]:
    """A TOML file's table, keys under their present names, and the Config that it is; raises ConfigError."""
    try:
        table = parse_table(Path(path).read_bytes().decode("utf-8"))
        return table, validated(table)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: {error.strerror}; pc-onboard setup writes one, or name another") from error
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start})") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def parse_config(text: str) -> Config:
    """TOML text -> Config; raises ConfigError with one line that names the key and what would be right."""
    return validated(parse_table(text))


def parse_table(text: str) -> dict[str, Any]:
    """TOML text -> its table; raises ConfigError."""
    try:
        return tomllib.loads(text)
    except ValueError as error:  # a number of thousands of digits is no error of tomllib's own
        raise ConfigError(f"not TOML: {' '.join(str(error).split())}") from error


def validated(table: dict[str, Any]) -> Config:
    """A table under present names -> Config; raises ConfigError with one line."""
    try:
        return Config.model_validate(table)
    except ValidationError as error:
        raise ConfigError(_first_complaint(error)) from error


def _sections() -> Iterator[tuple[str, type[Section]]]:
    """Every section under its dotted name, those within another after it."""

    def within(name: str, model: type[Section]) -> Iterator[tuple[str, type[Section]]]:
        for key, info in model.model_fields.items():
            if (section := _section_of(info)) is not None:
                yield f"{name}{key}", section
                yield from within(f"{name}{key}.", section)

    return within("", Config)


def _keys(model: type[Section]) -> dict[str, FieldInfo]:
    """A section's own keys, without the sections within it."""
    return {key: info for key, info in model.model_fields.items() if _section_of(info) is None}


def _section_of(info: FieldInfo) -> type[Section] | None:
    """The section that a field is; None where it is a key."""
    kind = info.annotation
    return kind if isinstance(kind, type) and issubclass(kind, Section) else None


def key_table() -> dict[str, FieldInfo]:
    return {f"{name}.{key}": info for name, model in _sections() for key, info in _keys(model).items()}


def _first_complaint(error: ValidationError) -> str:
    """One line for pydantic's first complaint; unknown keys first, because a misspelt key is the likeliest cause."""
    details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    first, others = details[0], len(details) - 1
    parts = [str(part) for part in first["loc"]]
    key, value = ".".join(parts), first["input"]
    if first["type"] == "extra_forbidden":
        message = _unknown_key(key, value)
    elif key in dict(_sections()):
        message = f"'{key}' is a section: write [{key}] on a line of its own, not a value ({value!r})"
    else:
        known = key_table()
        info = next(known[name] for name in (".".join(parts[:n]) for n in (3, 2)) if name in known)
        message = f"{key} = {value!r} is not usable: {_expectation(info)}"
    return message + (f" (and {others} more)" if others else "")


def _unknown_key(key: str, value: object) -> str:
    known, sections = key_table(), [name for name, _ in _sections()]
    section, _, name = key.partition(".")
    here = {path.removeprefix(f"{section}."): path for path in known if path.startswith(f"{section}.")}
    if isinstance(value, dict):
        near = near_word(key, sections)
    else:  # the right key elsewhere; or one nearly so in its own section, or in any where that section is not known
        anywhere = {path.split(".", 1)[1]: path for path in known}
        among = here or anywhere
        found = near_word(name or key, among)
        near = anywhere.get(name or key) or (among[found] if found else None)
    kind = "section" if isinstance(value, dict) else "key"
    if near is not None:
        return f"unknown {kind} '{key}'; did you mean '{near}'?"
    is_of_section = here and not isinstance(value, dict)
    listed = f"keys of [{section}]: {', '.join(here)}" if is_of_section else f"known sections: {', '.join(sections)}"
    return f"unknown {kind} '{key}'; {listed}"


def _bounds(info: FieldInfo) -> tuple[float, float] | None:
    """A numeric key's range."""
    limits = {
        name: getattr(item, name)
        for item in info.metadata
        for name in ("ge", "le")
        if getattr(item, name, None) is not None
    }
    return (limits["ge"], limits["le"]) if len(limits) == 2 else None


def _expectation(info: FieldInfo) -> str:
    """The values that a key takes, in words: '-180 to 180 deg', 'true or false', ..."""
    bounds = _bounds(info)
    if bounds is not None:
        extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
        unit = f" {extra['unit']}" if extra.get("unit") else ""
        kind = "a whole number from " if info.annotation is int else ""
        return f"{kind}{bounds[0]:g} to {bounds[1]:g}{unit}"
    if info.annotation is bool:
        return "true or false"
    if info.annotation is str:
        return "text: " + str(info.description) if any(hasattr(m, "pattern") for m in info.metadata) else "text"
    if info.annotation == tuple[str, ...]:
        return "a list of texts"
    return " or ".join(f'"{name}"' for name in getattr(info.annotation, "__args__", ()))


def _literal(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_literal(item) for item in value) + "]"
    if isinstance(value, str):  # JSON's text is TOML's, but for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def to_toml(config: Config) -> str:
    """The keys that differ from their defaults, as a file that `load_config` reads back to the same."""
    lines = []
    for name, model in _sections():
        section, default = attrgetter(name)(config), model()
        # The defaults of a V4L2 device are not those of a network stream, so they are written even if equal.
        stated = name == "camera" and delay_prior(config.camera.device) != delay_prior("")
        keys = [
            key
            for key in _keys(model)
            if getattr(section, key) != getattr(default, key) or (stated and key in delay_prior(""))
        ]
        if keys:
            lines += [f"[{name}]", *(f"{key} = {_literal(getattr(section, key))}" for key in keys), ""]
    return "\n".join(lines)


def default_toml() -> str:
    """The text of `config.toml`: every key at its default under a comment with meaning, range, unit and default."""
    lines = ["# pointclick, aircraft side. Every key is optional; what stands here is the default."]
    lines += ["# Made from onboard/config/schema.py by `python -m onboard.config.schema > config.toml`."]
    for name, model in _sections():
        lines += ["", *(f"# {line}".rstrip() for line in inspect.getdoc(model).splitlines())]  # type: ignore[union-attr]
        lines += [f"[{name}]"]
        for key, info in _keys(model).items():
            literal = "not set" if info.default is None else _literal(info.default)
            takes = f"{_expectation(info)}; default" if _bounds(info) else "default"
            comment = f"{info.description} ({takes} {literal})"
            lines += textwrap.wrap(comment, 118, initial_indent="# ", subsequent_indent="#   ")
            lines.append(f"# {key} =" if info.default is None else f"{key} = {literal}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(default_toml(), end="")
