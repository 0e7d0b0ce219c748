"""`python -m simulation.fly`: fly a simulated session into a folder."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

from contract.camera import Camera
from contract.errors import InputError
from simulation.flight import DescribedSpec, RecordedSpec
from simulation.heat_sources import HeatSource
from simulation.ordinary import ordinary
from simulation.paths import KINDS, PathSpec
from simulation.renderer import SensorSpec
from simulation.session import SessionSpec, fly
from simulation.telemetry import TelemetrySpec
from simulation.terrain import TerrainSpec
from simulation.texture import STYLES, TextureSpec
from simulation.thermal import ThermalSpec

EXAMPLES = """examples:
  python -m simulation.fly --recorded plane_clean --start 192 --seconds 20 --out /tmp/leg
  python -m simulation.fly --path straight --height-m 250 --crab-deg 15 --mount 0 -90 90 --out /tmp/crab
  python -m simulation.fly --path turns --autopilot ordinary --seed 4 --seconds 120 --out /tmp/ordinary
  python -m simulation.fly --path survey --thermal radiometric --size 640x512 --person 40 20 8 --out /tmp/hot
  python -m simulation.fly --path waypoints --waypoint 0 0 --waypoint 0 400 --waypoint 500 400 --out /tmp/corner

The folder then holds what `pc-onboard replay` reads (frames/, stamps.csv, camera.json, telemetry.tlog, config.toml) and
the truth (truth.csv, truth_clicks.csv, world.json; of a thermal camera truth_heat.csv).
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m simulation.fly",
        description="Fly a simulated session with known truth into a folder.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--out", required=True, metavar="DIR", help="folder to write; must be new or empty")
    add("--seed", type=int, default=0, help="everything random follows from it (default 0)")
    add("--seconds", type=float, default=30.0, metavar="S", help="length (default 30)")
    add("--rate-hz", type=float, default=5.0, metavar="HZ", help="pictures a second (default 5)")
    add("--quiet", action="store_true", help="print no progress")

    which = parser.add_argument_group("which flight (one of)").add_mutually_exclusive_group(required=True)
    which.add_argument(
        "--recorded", metavar="NAME", help="recording in tests/data or ../shared/data/sitl, or a path to one"
    )
    which.add_argument("--path", choices=KINDS, help="described path; its telemetry is written too")

    add = parser.add_argument_group("recorded flights").add_argument
    add("--start", type=float, metavar="S", help="seconds into the recording (default: once at its usual height)")
    add(
        "--log",
        choices=("whole", "part"),
        default="whole",
        help="copy the whole log (default), or the simulated part +-10 s",
    )

    add = parser.add_argument_group("described paths").add_argument
    add("--height-m", type=float, metavar="M", help="above the ground (default 250)")
    add("--speed-m-s", type=float, metavar="M", help="over the ground (default 20)")
    add("--heading-deg", type=float, metavar="DEG", help="first direction of travel (default 30)")
    add("--crab-deg", type=float, metavar="DEG", help="the nose points this much right of travel (default 0)")
    add("--pitch-deg", type=float, metavar="DEG", help="mean pitch of the body (default 2)")
    add("--wobble-deg", type=float, metavar="DEG", help="unrest of roll and pitch, one sigma (default 0.6)")
    add("--bank-deg", type=float, metavar="DEG", help="bank of turns (default 25)")
    add("--leg-m", type=float, metavar="M", help="length of a leg of turns and survey (default 400)")
    add("--spacing-m", type=float, metavar="M", help="between survey legs (default 150)")
    add("--radius-m", type=float, metavar="M", help="of the orbit (default 200)")
    add(
        "--waypoint",
        type=float,
        nargs=2,
        action="append",
        metavar=("EAST", "NORTH"),
        help="metres; for --path waypoints",
    )

    add = parser.add_argument_group("place").add_argument
    add("--ground-amsl-m", type=float, default=100.0, metavar="M", help="level of the ground (default 100)")
    add(
        "--undulation-m",
        type=float,
        metavar="M",
        help="ellipsoid over sea level height (default recorded 0, described 11)",
    )

    add = parser.add_argument_group("telemetry of described paths").add_argument
    add("--autopilot", choices=("declared", "ordinary"),
        help="declared: errors as the configuration declares them (default); ordinary: an ordinary autopilot's, "
        "sampled by --seed (simulation/ordinary.py). The options below change single ones of either")  # fmt: skip
    add("--position-hz", type=float, metavar="HZ", help="GLOBAL_POSITION_INT (default 10)")
    add("--gps-hz", type=float, metavar="HZ", help="GPS_RAW_INT (default 5)")
    add("--attitude-hz", type=float, metavar="HZ", help="0: none (default 25)")
    add(
        "--attitude-message",
        choices=("euler", "quaternion", "both"),
        help="ATTITUDE (default), ATTITUDE_QUATERNION or both",
    )
    add("--gps-white-m", type=float, nargs=2, metavar=("H", "V"), help="new in every message (default 0.05 0.05)")
    add("--gps-slow-m", type=float, nargs=2, metavar=("H", "V"), help="Gauss-Markov part (default 0.8 1.2)")
    add("--gps-time-constant-s", type=float, metavar="S", help="correlation time (default 60)")
    add("--position-age-s", type=float, metavar="S", help="age of a position at its own stamp (default 0)")
    add("--velocity-noise-m-s", type=float, metavar="M", help="(default 0.1)")
    add("--attitude-white-deg", type=float, metavar="DEG", help="(default 0.05)")
    add("--attitude-slow-deg", type=float, metavar="DEG", help="Gauss-Markov part (default 0.5)")
    add("--latency-s", type=float, metavar="S", help="of the link, least (default 0.03)")
    add("--jitter-s", type=float, metavar="S", help="of the link, mean (default 0.02)")

    add = parser.add_argument_group("ground").add_argument
    add("--relief-m", type=float, default=0.0, metavar="M", help="highest hill over deepest valley (default 0: level)")
    add("--wavelength-m", type=float, default=250.0, metavar="M", help="of the hills (default 250)")
    add("--obstacles", choices=("none", "boxes", "bumps"), default="none", help="houses or tree crowns (default none)")
    add("--obstacle-height-m", type=float, default=8.0, metavar="M", help="the tallest (default 8)")
    add("--texture", choices=STYLES, default="land", help="(default land)")
    add("--contrast", type=float, default=1.0, help="of the ground; 0.1 is bland (default 1)")

    add = parser.add_argument_group("camera").add_argument
    add("--camera", metavar="JSON", help="camera file with distortion, instead of --hfov-deg and --size")
    add("--hfov-deg", type=float, metavar="DEG", help="horizontal field of view (default 40)")
    add("--size", metavar="WxH", help="pixels (default 640x480)")
    add("--mount", type=float, nargs=3, default=(0.0, -90.0, 0.0), metavar=("ROLL", "PITCH", "YAW"),
        help="degrees, as MAVLink gives a gimbal (default 0 -90 0: down, picture's top to the nose)")  # fmt: skip
    add("--boresight-deg", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
        help="hidden mount error, rotation in camera axes; Z turns the picture (default none)")  # fmt: skip
    add("--camera-delay-s", type=float, default=0.0, metavar="S", help="stamps are this late, undeclared (default 0)")
    add("--stamp-jitter-s", type=float, default=0.0, metavar="S", help="(default 0)")
    add("--noise", type=float, default=1.5, metavar="GREY", help="sensor noise, grey levels (default 1.5)")
    add("--exposure-s", type=float, default=0.002, metavar="S", help="shutter; long ones blur (default 0.002)")
    add("--exposure-swing", type=float, default=1.15, metavar="RATIO", help="brightest over darkest (default 1.15)")
    add("--vignetting", type=float, default=0.15, help="loss of light in the corner (default 0.15)")
    add("--filed-camera", metavar="JSON", help="the wrong camera file to write (default: the camera as it is)")
    add("--readout-s", type=float, default=0.0, metavar="S",
        help="rolling shutter: time to read all rows, negative if the last is first (default 0)")  # fmt: skip
    add("--stabilised-s", type=float, metavar="S", help="EIS that smooths rotation over so long (default: none)")
    add("--zoom", type=float, nargs=3, metavar=("FACTOR", "FROM", "TO"), help="zooms in between, s (default: not)")
    add("--thermal", choices=("radiometric", "agc"), help="a thermal camera: 16 bits of 0.01 K, or 8 by its own gain")
    add("--person", type=float, nargs=3, action="append", default=[], metavar=("EAST", "NORTH", "K"),
        help="of --thermal: stands there, so much warmer than the ground")  # fmt: skip
    add("--rocks-km2", type=float, default=0.0, metavar="N", help="of --thermal: rocks that the sun warmed (default 0)")
    add("--shutter", type=float, action="append", default=[], metavar="S", help="of --thermal: its shutter closes then")
    add("--format", choices=("png", "jpg"), default="png", help="of the pictures (default png)")

    add = parser.add_argument_group("written into config.toml").add_argument
    add("--attitude", choices=("autopilot", "none"), default="autopilot", help="solve.attitude (default autopilot)")
    add("--no-velocity", action="store_true", help="solve.velocity = false")
    add("--level-ground", action="store_true", help="solve.level_ground = true")
    return parser


_PATH_OPTIONS = {
    "height_m": "height_m", "speed_m_s": "speed_m_s", "heading_deg": "heading_deg", "crab_deg": "crab_deg",
    "pitch_deg": "pitch_deg", "wobble_deg": "wobble_deg", "bank_deg": "bank_deg", "leg_m": "leg_m",
    "spacing_m": "spacing_m", "radius_m": "radius_m",
}  # fmt: skip
_TELEMETRY_OPTIONS = {
    "position_hz": "position_hz", "gps_hz": "gps_hz", "attitude_hz": "attitude_hz",
    "attitude_message": "attitude_message",
    "gps_time_constant_s": "slow_time_constant_s", "position_age_s": "position_age_s",
    "velocity_noise_m_s": "velocity_m_s",
    "attitude_white_deg": "white_attitude_deg", "attitude_slow_deg": "slow_attitude_deg", "latency_s": "latency_s",
    "jitter_s": "jitter_s",
}  # fmt: skip
_RECORDED_ALWAYS = "a recorded flight has its own path and telemetry"


def _given(options: argparse.Namespace, names: dict[str, str]) -> dict[str, object]:
    return {field: getattr(options, name) for name, field in names.items() if getattr(options, name) is not None}


def _camera(options: argparse.Namespace) -> Camera:
    if options.camera is not None:
        if options.size is not None or options.hfov_deg is not None:
            raise InputError("--camera already gives the size and field of view; leave --size and --hfov-deg out")
        return Camera.from_json(options.camera)
    width, cross, height = (options.size or "640x480").partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= 16):
        raise InputError(f"--size {options.size!r} must read like 640x480, at least 16x16")
    hfov_deg = 40.0 if options.hfov_deg is None else options.hfov_deg
    if not 1.0 <= hfov_deg <= 150.0:
        raise InputError(f"--hfov-deg {hfov_deg:g} must lie between 1 and 150")
    return Camera.from_field_of_view(int(width), int(height), hfov_deg)


def _flight(options: argparse.Namespace) -> RecordedSpec | DescribedSpec:
    path, telemetry = _given(options, _PATH_OPTIONS), _given(options, _TELEMETRY_OPTIONS)
    for given, pair in ((options.gps_white_m, "white"), (options.gps_slow_m, "slow")):
        if given is not None:
            telemetry[f"{pair}_horizontal_m"], telemetry[f"{pair}_vertical_m"] = given
    if options.waypoint is not None:
        path["waypoints_m"] = tuple((east, north) for east, north in options.waypoint)
    if options.recorded is not None:
        autopilot = _given(options, {"autopilot": "autopilot"})
        if path or telemetry or autopilot:
            names = ", ".join(sorted({**path, **telemetry, **autopilot}))
            raise InputError(f"{names}: only for --path; {_RECORDED_ALWAYS}")
        return RecordedSpec(
            options.recorded,
            options.start,
            ground_amsl_m=options.ground_amsl_m,
            undulation_m=options.undulation_m or 0.0,
            whole_log=options.log == "whole",
        )
    if options.start is not None or options.log != "whole":
        raise InputError("--start and --log belong to --recorded")
    if options.waypoint is not None and options.path != "waypoints":
        raise InputError("--waypoint belongs to --path waypoints")
    return DescribedSpec(
        PathSpec(kind=options.path, **path),  # type: ignore[arg-type]
        replace(ordinary(options.seed) if options.autopilot == "ordinary" else TelemetrySpec(), **telemetry),  # type: ignore[arg-type]
        ground_amsl_m=options.ground_amsl_m,
        undulation_m=11.0 if options.undulation_m is None else options.undulation_m,
        seed=options.seed,
    )


def _thermal(options: argparse.Namespace) -> ThermalSpec | None:
    if options.thermal is None:
        if options.person or options.shutter or options.rocks_km2:
            raise InputError("--person, --rocks-km2 and --shutter belong to --thermal")
        return None
    people = tuple(HeatSource.person((east, north), excess_k) for east, north, excess_k in options.person)
    return ThermalSpec(
        rocks_km2=options.rocks_km2, sources=people, shutter_s=tuple(options.shutter), output=options.thermal
    )


def session_spec(arguments: list[str]) -> tuple[SessionSpec, argparse.Namespace]:
    """The session that command-line arguments describe. Raises InputError; argparse itself exits 2 on bad usage."""
    options = _parser().parse_args(arguments)
    for name, value in vars(options).items():
        numbers = value if isinstance(value, (list, tuple)) else [value]
        if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
            raise InputError(f"--{name.replace('_', '-')} must be finite")
    spec = SessionSpec(
        _flight(options),
        seconds=options.seconds,
        rate_hz=options.rate_hz,
        camera=_camera(options),
        mount_deg=tuple(options.mount),
        boresight_deg=tuple(options.boresight_deg),
        camera_delay_s=options.camera_delay_s,
        stamp_jitter_s=options.stamp_jitter_s,
        terrain=TerrainSpec(
            relief_m=options.relief_m,
            wavelength_m=options.wavelength_m,
            obstacles=options.obstacles,
            obstacle_height_m=options.obstacle_height_m,
            seed=options.seed,
        ),
        texture=TextureSpec(options.texture, options.contrast, options.seed),
        sensor=SensorSpec(options.noise, options.vignetting, options.exposure_swing, options.exposure_s),
        attitude=options.attitude,
        velocity=not options.no_velocity,
        level_ground=options.level_ground,
        picture_format=options.format,
        seed=options.seed,
        filed_camera=None if options.filed_camera is None else Camera.from_json(options.filed_camera),
        readout_s=options.readout_s,
        stabilised_s=options.stabilised_s,
        zoom=None if options.zoom is None else tuple(options.zoom),
        thermal=_thermal(options),
    )
    return spec, options


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 written, 2 wrong usage or input, with one line on stderr."""
    try:
        spec, options = session_spec(sys.argv[1:] if arguments is None else arguments)
        on_terminal = sys.stderr.isatty() and not options.quiet

        def report(done: int, of: int) -> None:
            if on_terminal:
                print(f"\rpicture {done} of {of}", end="\n" if done == of else "", file=sys.stderr, flush=True)

        truth = fly(spec, options.out, report)
    except (InputError, OSError) as error:
        print(f"simulation.fly: {error}", file=sys.stderr)
        return 2
    if not options.quiet:
        heights = [pose.centre_m[2] for pose in truth.poses]
        span = f"{min(heights):.0f} to {max(heights):.0f} m above level ground"
        print(f"{Path(options.out)}: {len(truth)} pictures from {span}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
