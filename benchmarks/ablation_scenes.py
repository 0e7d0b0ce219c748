"""The flights of `benchmarks.ablation`: ordinary ones, and for each mechanism the one that it exists for.

Recorded telemetry of real autopilot software over simulated ground (`autopilots`), simulated flights
(`sampled_flight`), and three kinds of simulated flight that only the ablation needs: rows that vibrate, ground that
moves, a gimbal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.autopilots import SENSORS, STARTS, ReplayedFlight, ReplayedTracker, Scene
from benchmarks.platform_faults import BELIEVED, FAULTS
from benchmarks.sampled_flight import FlightInSight, Mask, SampledFlight, SampledSpec, SampledTracker, replace_section
from contract.camera import Camera
from contract.rotations import exp_so3, matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, Event, GimbalAttitude
from onboard.pipeline.pipeline import Pipeline
from onboard.vision.klt_tracker import Tracks
from simulation.paths import PathSpec
from simulation.rows import RowsOf

Array = NDArray[np.float64]
AnyFlight = ReplayedFlight | SampledFlight

SECONDS, ORDINARY_SECONDS, WARM_S = 75.0, 50.0, 20.0
DEFAULTS = parse_config("")
# A filter whose delays are known: with the default of 100 ms a simulated one is off so much in turns that its position
# and its velocity contradict each other (`rolling_shutter`), and what is then doubted would hide everything else.
TIMED = replace_section(DEFAULTS, "gps", sigma_latency_s=0.02)
SWING_HZ, SWING_RAD = 297.3, 0.003  # nine swings while the rows are read, two pixels
FLEX_RAD, FLEX_S = np.radians(2.0), 80.0
WATER_M_S = np.array([0.9, -0.6])
# Of the coarse flow against the fine one, over the motion: between the whole of it, as in theory, and the third that
# simulated seas show at least.
DISAGREEMENT = 0.5
LEVEL = matrix_from_euler(0.0, -np.pi / 2, 0.0)
FLAWED_LENS = 0.004  # of the focal length, in a file that claims to be exact


@dataclass(frozen=True)
class Trial:
    """One kind of flight: its name, how one is made of a seed, and how its features are found."""

    name: str
    flight: Callable[[int], AnyFlight]
    tracker: Callable[[Any], SampledTracker] = SampledTracker
    seed: int = 3
    warm_s: float = WARM_S  # clicks from then on

    def pipeline(self, flight: AnyFlight) -> Pipeline:
        """A pipeline that is to fly it, with its features found as they are here."""
        spec = flight.spec
        out = Pipeline(spec.config, spec.camera_file or spec.camera, None)
        out.tracker = self.tracker(flight)
        return out


def recorded(
    name: str,
    sensors: str = "full",
    fault: str = "none",
    note: str = "",
    seconds: float = SECONDS,
    **sections: dict[str, float],
) -> Trial:
    """A recorded autopilot with a fault of `platform_faults`, and `sections` of the configuration put over it."""
    config = replace_section(DEFAULTS, "solve", **SENSORS[sensors])
    config = replace_section(config, "camera", **BELIEVED.get(fault, {}))
    for section, values in sections.items():
        config = replace_section(config, section, **values)
    scene = replace(Scene(name, config, STARTS[name], seconds), **FAULTS[fault])
    words = [name, "camera + GPS" if sensors == "gps" else "", "" if fault == "none" else fault, note]
    return Trial(", ".join(w for w in words if w), lambda seed: ReplayedFlight(scene, seed), ReplayedTracker)


def sampled(
    name: str,
    kind: type[SampledFlight] = SampledFlight,
    config: Config = TIMED,
    **spec: Any,
) -> Trial:
    """Errors sampled as declared."""
    made = SampledSpec(config, **{"seconds": SECONDS, "rate_hz": 2.0, **spec})
    tracker = WaterTracker if kind is WaterFlight else SampledTracker
    return Trial(name, lambda seed: kind(made, seed), tracker)


class VibratingFlight(SampledFlight):
    """A propeller swings the camera while its rows are read."""

    def __init__(self, spec: SampledSpec, seed: int) -> None:
        super().__init__(spec, seed)
        self._rows = VibratingRows(self.trajectory, self._rows.R_body_cam, spec.readout_s)


class VibratingRows(RowsOf):
    """Rows of such a camera."""

    def poses(self, camera: Camera, time_s: float, v_px: Array) -> tuple[Array, Array]:
        """The poses of a camera that only flies, and swung."""
        R_enu_cam, centres = super().poses(camera, time_s, v_px)
        share = np.clip(v_px, 0.0, camera.height_px) / camera.height_px - 0.5
        swing = SWING_RAD * np.sin(2.0 * np.pi * SWING_HZ * (time_s + self.readout_s * share))
        return R_enu_cam @ exp_so3(swing[:, None] * np.array([1.0, 0.6, 0.0])), centres


class OtherAttitudes(SampledFlight):
    """Sends something else for each attitude."""

    def events(self) -> Iterator[Event]:
        """All others as they are."""
        for event in super().events():
            yield from self.sent(event, event.stamp_ns / 1e9 % 1e4) if isinstance(event, Attitude) else (event,)

    def sent(self, attitude: Attitude, time_s: float) -> tuple[Event, ...]:
        """The events that are sent for an attitude."""
        return (attitude,)


class FlexingFlight(OtherAttitudes):
    """A mount that flexes slowly, and so far that windows disagree about where it is."""

    def sent(self, attitude: Attitude, time_s: float) -> tuple[Event, ...]:
        """An attitude that parts from the camera's as the mount does."""
        phase = 2.0 * np.pi * time_s / FLEX_S
        off = FLEX_RAD * np.array([np.sin(phase), 0.7 * np.sin(0.83 * phase + 1.0), 0.0])
        R = matrix_from_quaternion(attitude.q_ned_body) @ exp_so3(off)
        return (replace(attitude, q_ned_body=_quaternion(R)),)


class WaterFlight(SampledFlight):
    """The ground's pattern drifts. Clicks ask where a thing is, trackers follow the pattern."""


class _Drifting:
    """A flight as its tracker sees it: places counted from the pattern."""

    def __init__(self, flight: SampledFlight) -> None:
        self.flight, self.rng, self.spec = flight, flight.rng, flight.spec

    def _moved_m(self, frame: int) -> Array:
        return np.append(WATER_M_S * float(self.flight.times_s[frame]), 0.0)

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """Points of the moving pattern at pixels."""
        return self.flight.ground_points(frame, uv_px) - self._moved_m(frame)

    def pixels(self, frame: int, points: Array) -> tuple[Array, Mask]:
        """Pixels of points of the moving pattern, and whether they are seen."""
        return self.flight.pixels(frame, points + self._moved_m(frame))


class WaterTracker(SampledTracker):
    """Follows the pattern, and sees coarse and fine flow disagree."""

    def __init__(self, flight: SampledFlight) -> None:
        seen: FlightInSight = _Drifting(flight)
        super().__init__(seen)
        self._of, self._before = flight, 0

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """Make the last picture the keyframe, and note the disagreement since the keyframe before."""
        out = super().promote(tracks)
        seconds = float(self._of.times_s[self._frame] - self._of.times_s[self._before])
        height_m = float(self._of.centres_enu_m[self._frame, 2])
        self.flow_disagreement_px = DISAGREEMENT * WATER_M_S * seconds * self._of.spec.camera.focal_px / height_m
        self._before = self._frame
        return out


class GimbalFlight(OtherAttitudes):
    """Photographs of a camera that a gimbal holds level under a vehicle that leans forward and rolls slowly."""

    def sent(self, attitude: Attitude, time_s: float) -> tuple[Event, ...]:
        """The attitude of a vehicle that leans, and the given one as that of the gimbal."""
        R_ned_level = matrix_from_quaternion(attitude.q_ned_body)
        body = R_ned_level @ matrix_from_euler(0.05 * np.sin(0.9 * time_s), -0.26, 0.0)
        heading = float(np.arctan2(body[1, 0], body[0, 0]))
        gimbal = matrix_from_euler(0.0, 0.0, heading).T @ R_ned_level @ LEVEL
        vehicle = Attitude(attitude.stamp_ns, _quaternion(body))
        return vehicle, GimbalAttitude(attitude.stamp_ns, _quaternion(gimbal), "vehicle")


def _quaternion(R: Array) -> tuple[float, float, float, float]:
    w, x, y, z = quaternion_from_matrix(R).tolist()
    return w, x, y, z


TURNS = PathSpec("turns", height_m=150.0, bank_deg=30.0, leg_m=200.0)
ORDINARY = (
    recorded("plane_wind_noise", seconds=ORDINARY_SECONDS),
    recorded("plane_breeze", "gps", seconds=ORDINARY_SECONDS),
    sampled("drawn turns", path=TURNS, seconds=ORDINARY_SECONDS),
)
TOO_SURE = {"attitude_sigma_deg": 0.2, "heading_sigma_deg": 0.7}
GPS_ONLY = replace_section(TIMED, "solve", **SENSORS["gps"])
ROLLING = replace_section(TIMED, "camera", readout_s=0.03, sigma_readout_s=0.005)
FIELD = Camera.from_field_of_view(640, 480, 40.0)
LONGER = replace(FIELD, fx_px=(1.0 + FLAWED_LENS) * FIELD.fx_px, fy_px=(1.0 + FLAWED_LENS) * FIELD.fy_px)
CLIMB = PathSpec(speed_m_s=2.0, height_m=30.0, climb_m_s=2.5, wobble_deg=5.0, pitch_deg=0.0)
SURVEY = PathSpec(speed_m_s=10.0, height_m=100.0, wobble_deg=0.3, pitch_deg=0.0)
# A hover, whose heading shows in a metre of travel only; every tenth track is off by 2.5 px at random in each picture.
WRONG_TRACKS: dict[str, Any] = {
    "path": PathSpec("hover", height_m=80.0, wobble_deg=4.0),
    "pixel_sigma_px": 0.15,
    "outlier_share": 0.1,
    "relief_sigma_m": 1.6,
    "relief_wavelength_m": 80.0,
}


def own() -> dict[str, tuple[Trial, ...]]:
    """The flights that each mechanism exists for, by its name."""
    late = recorded("plane_wind_noise", fault="late", seconds=ORDINARY_SECONDS)
    climb, quadplane = sampled("climb, camera + GPS", config=GPS_ONLY, path=CLIMB), recorded("qp_transition", "gps")
    steep_climb = sampled("steep climb, camera + GPS", config=GPS_ONLY, path=replace(CLIMB, speed_m_s=1.0))
    steep_hills = sampled("steep hills, camera + GPS", config=GPS_ONLY, relief_sigma_m=20.0, relief_wavelength_m=150.0)
    # A mount is chosen once, in the first seconds.
    gimbal = replace(sampled("gimbal, photographs", GimbalFlight, rate_hz=0.7, path=SURVEY, seconds=25.0), warm_s=0.0)
    return {
        "clock profile": (
            sampled("stamps 0.45 s late, turns", path=TURNS, offset_s=0.45, seconds=ORDINARY_SECONDS),
            recorded("plane_wind_noise", fault="stream late", seconds=ORDINARY_SECONDS),
            recorded("plane_log", fault="stream late", seconds=ORDINARY_SECONDS),
            late,
        ),
        "row waves": (sampled("vibrating rows", VibratingFlight, ROLLING, path=TURNS, readout_s=0.03, seconds=36.0),),
        "camera states": (recorded("plane_clean", fault="wrong lens"),),
        "variance components": (
            recorded("plane_wind_noise", note="attitude claimed to 0.2 and 0.7 deg", solve=TOO_SURE),
        ),
        "stamp jitter": (
            sampled("stamps off by 30 ms, turns", path=TURNS, jitter_s=0.03, seconds=ORDINARY_SECONDS),
            recorded("plane_wind_noise", fault="stream late", note="90 s", seconds=90.0),
        ),
        "second weighing": (recorded("plane_breeze", fault="stream early", seconds=90.0),),
        "re-estimated prior": (recorded("plane_breeze", note="mount claimed to 0.3 deg", mount={"sigma_deg": 0.3}),),
        "disagreeing windows": (
            late,
            sampled("mount that flexes by 2 deg", FlexingFlight, path=TURNS),
        ),
        "sensor groups": (recorded("plane_clean", fault="tilt-jump"),),
        "ground slope": tuple(recorded("plane_clean", sensors, fault="slope") for sensors in ("full", "gps")),
        "slope variogram": (
            steep_hills,
            recorded("plane_clean", "gps", fault="rough"),
            recorded("plane_breeze", "gps", fault="hill country"),
        ),
        "wrong tracks": (sampled("hover, a tenth of the tracks wrong", **WRONG_TRACKS),),
        "ground roughness": (sampled("hills of 12 m", path=TURNS, relief_sigma_m=12.0, relief_wavelength_m=80.0),),
        "ground weight": (
            sampled("hills of 8 m, long", path=PathSpec(), relief_sigma_m=8.0, relief_wavelength_m=400.0),
            sampled("hills of 20 m, camera + GPS", config=GPS_ONLY, relief_sigma_m=20.0, relief_wavelength_m=400.0),
            steep_hills,
        ),
        "second start": (
            recorded("plane_log", "gps"),
            quadplane,
            recorded("plane_wind_noise", "gps", seconds=ORDINARY_SECONDS),
            recorded("plane_gps_outage", "gps", seconds=240.0),
            climb,
            sampled("climb straight up, camera + GPS", config=GPS_ONLY, path=replace(CLIMB, speed_m_s=0.7)),
        ),
        "headings all round": (quadplane, climb, steep_climb),
        "reobservation": (
            sampled(
                "lens 0.4 % off, claimed exact",
                path=TURNS,
                camera_file=LONGER,
                pixel_sigma_px=0.1,
                seconds=ORDINARY_SECONDS,
            ),
            recorded("plane_clean", fault="rolling ignored", seconds=ORDINARY_SECONDS),
        ),
        "ground motion": (sampled("water", WaterFlight),),
        "zoom": tuple(
            recorded("plane_clean", sensors, fault=f"zoom{by}") for sensors in ("full", "gps") for by in ("", " 5 %")
        ),
        "moved optics": (recorded("plane_clean", fault="stabilised"),),
        "mount trial": (gimbal,),
        "position doubt": (recorded("plane_clean", fault="position-jump"),),
        "slip test": (recorded("plane_clean", fault="position-drag"),),
    }
