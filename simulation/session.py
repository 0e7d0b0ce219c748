"""Flies a session into a folder: pictures and what else `replay` reads, and truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.rotations import exp_so3, mount_rotation
from simulation.flight import DescribedSpec, Flight, RecordedSpec, described_flight, recorded_flight
from simulation.heat_truth import write_heat
from simulation.moved_optics import stabilised, zoomed
from simulation.movers import Movers, MoverSpec
from simulation.renderer import MAX_SUB_EXPOSURES, Renderer, RowPoses, SensorSpec
from simulation.rows import RowsOf
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import Texture, TextureSpec
from simulation.thermal import ThermalRenderer, ThermalSpec
from simulation.trajectory import Pose
from simulation.truth import Optics, Truth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SessionSpec:
    """Everything that makes a session. The same spec writes the same bytes.

    `mount_deg` is what the configuration declares; the true mount differs by `boresight_deg`, a rotation vector in
    camera axes. Stamps are the true capture times plus `camera_delay_s` plus white `stamp_jitter_s`.
    """

    flight: RecordedSpec | DescribedSpec
    seconds: float = 30.0
    rate_hz: float = 5.0
    camera: Camera = field(default_factory=lambda: Camera.from_field_of_view(640, 480, 40.0))
    mount_deg: tuple[float, float, float] = (0.0, -90.0, 0.0)
    boresight_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_delay_s: float = 0.0
    stamp_jitter_s: float = 0.0
    terrain: TerrainSpec = field(default_factory=TerrainSpec)
    texture: TextureSpec = field(default_factory=TextureSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    attitude: str = "autopilot"
    velocity: bool = True
    level_ground: bool = False
    clicks_per_frame: int = 12
    picture_format: str = "png"
    seed: int = 0
    filed_camera: Camera | None = None  # what the camera file states, where that is wrong
    readout_s: float = 0.0  # of the rows, positive if the first comes first; declared in the configuration
    stabilised_s: float | None = None  # over which electronic stabilisation smooths rotation; None: there is none
    zoom: tuple[float, float, float] | None = None  # factor, from and until (s after the first picture)
    movers: tuple[MoverSpec, ...] = ()
    thermal: ThermalSpec | None = None  # the camera sees heat; `sensor` and `movers` are then of no effect

    def __post_init__(self) -> None:
        if self.filed_camera is not None and self.filed_camera.size_px != self.camera.size_px:
            raise InputError("session: the camera file must be of pictures of the same size")
        if not 0.0 < self.rate_hz <= 200.0 or not 0.0 < self.seconds <= 3600.0:
            raise InputError("session: the rate must lie within 200 Hz and the length within 3600 s, both above 0")
        if self.picture_format not in ("png", "jpg"):
            raise InputError(f"picture format {self.picture_format!r} is not known; use png or jpg")
        if self.attitude not in ("autopilot", "none"):
            raise InputError(f"attitude {self.attitude!r} is not known; use autopilot or none")


def make_flight(spec: SessionSpec) -> Flight:
    """The flight of a session."""
    if isinstance(spec.flight, RecordedSpec):
        return recorded_flight(spec.flight, spec.seconds)
    return described_flight(spec.flight, spec.seconds)


def fly(spec: SessionSpec, out_dir: Path | str, progress: Callable[[int, int], None] | None = None) -> Truth:
    """Write the session into `out_dir` (made if absent) and return its truth.

    `progress` is called with pictures done and pictures to do.
    Raises InputError before anything is written if the spec cannot be simulated or `out_dir` already holds a session.
    """
    folder = Path(out_dir)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is not an empty folder; name a new one")
    flight = make_flight(spec)
    R_body_cam = mount_rotation(*spec.mount_deg) @ exp_so3(np.radians(spec.boresight_deg))
    terrain = Terrain(spec.terrain)
    renderer = _renderer(spec, spec.camera, flight.start_s, terrain, Texture(spec.texture))

    time = flight.start_s + np.arange(round(spec.seconds * spec.rate_hz)) / spec.rate_hz
    if not len(time):
        raise InputError(f"session: {spec.seconds:g} s at {spec.rate_hz:g} Hz is no picture at all")
    poses = [flight.trajectory.camera_pose(float(t), R_body_cam) for t in time]
    files = [f"{frame:06d}.{spec.picture_format}" for frame in range(len(time))]
    optics = None
    if spec.readout_s or spec.stabilised_s is not None or spec.zoom is not None or spec.filed_camera is not None:
        rows = RowsOf(flight.trajectory, R_body_cam, spec.readout_s)
        optics = Optics(rows, _cameras(spec, flight, R_body_cam, time), time)
    unix_time_s = flight.epoch_unix_s + time
    truth = Truth(spec.camera, terrain, flight.origin, flight.undulation_m, poses, files, unix_time_s, optics)
    _refuse_buried(poses, terrain)

    frames = folder / "frames"
    frames.mkdir(parents=True, exist_ok=True)
    gains = exposure_gains(spec.sensor, time, spec.seed)
    for frame, t in enumerate(time):
        shutter = shutter_poses(flight, R_body_cam, float(t), renderer.sensor.exposure_s, spec.camera, terrain)
        if optics is not None and optics.cameras[frame] != renderer.camera:
            renderer = _renderer(spec, optics.cameras[frame], flight.start_s, terrain, renderer.texture)
        rows_of = _row_poses(optics.rows, renderer.camera, float(t), spec, len(shutter)) if optics else None
        picture = renderer.picture(shutter, float(gains[frame]), frame, float(t), rows_of)
        if not cv2.imwrite(str(frames / files[frame]), picture):
            raise InputError(f"{frames / files[frame]}: the picture cannot be written")
        if progress is not None:
            progress(frame + 1, len(time))

    rng = np.random.default_rng([spec.seed, 707])
    stamps = truth.unix_time_s + spec.camera_delay_s + spec.stamp_jitter_s * rng.standard_normal(len(time))
    lines = ["file,unix_time_s", *(f"{name},{stamp:.6f}" for name, stamp in zip(files, stamps, strict=True))]
    (folder / "stamps.csv").write_text("\n".join(lines) + "\n")
    filed = json.loads((spec.filed_camera or spec.camera).to_json())
    del filed["calibration"]  # as in most camera files: it is not known how right they are
    (folder / "camera.json").write_text(json.dumps(filed, indent=1) + "\n")
    (folder / "telemetry.tlog").write_bytes(flight.telemetry)
    (folder / "config.toml").write_text(config_text(spec))
    truth.write(folder, spec.clicks_per_frame, spec.seed)
    if isinstance(renderer, ThermalRenderer):
        write_heat(folder / "truth_heat.csv", renderer, truth, time - flight.start_s)
    return truth


def _renderer(
    spec: SessionSpec, camera: Camera, first_s: float, terrain: Terrain, texture: Texture
) -> Renderer | ThermalRenderer:
    if spec.thermal is not None:
        return ThermalRenderer(camera, terrain, texture, spec.thermal, spec.seed, first_s)
    movers = Movers(spec.movers, first_s) if spec.movers else None
    return Renderer(camera, terrain, texture, spec.sensor, spec.seed, movers)


def config_text(spec: SessionSpec) -> str:
    """The configuration that `pc-onboard replay` needs for this session."""
    roll, pitch, yaw = spec.mount_deg
    rows = f"[camera]\nreadout_s = {float(spec.readout_s)!r}\n\n" if spec.readout_s else ""
    heat = spec.thermal
    scale = f"scale = {heat.scale.scale!r}\noffset = {heat.scale.offset!r}\n" if heat and heat.is_radiometric else ""
    return (
        (f"[thermal]\nenabled = true\n{scale}\n" if heat else "")
        + rows
        + (
            f"[mount]\nroll_deg = {float(roll)!r}\npitch_deg = {float(pitch)!r}\nyaw_deg = {float(yaw)!r}\n"
            'gimbal = "never"  # these pictures are of a fixed camera, whatever gimbal the recording had\n\n'
            f'[solve]\nattitude = "{spec.attitude}"\n'
            f"velocity = {str(spec.velocity).lower()}\nlevel_ground = {str(spec.level_ground).lower()}\n"
        )
    )


def exposure_gains(sensor: SensorSpec, time_s: Array, seed: int) -> Array:
    """Gain of each picture: an automatic exposure that hunts, within sqrt(swing) either way of 1."""
    rng = np.random.default_rng([seed, 808])
    period = rng.uniform(1.3, 11.0, 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    hunt = np.mean(np.sin(2.0 * np.pi * time_s[:, None] / period + phase), axis=1)
    gains: Array = np.exp(hunt * 0.5 * np.log(sensor.exposure_swing))
    return gains


def shutter_poses(
    flight: Flight, R_body_cam: Array, time_s: float, exposure_s: float, camera: Camera, terrain: Terrain
) -> list[Pose]:
    """Poses within the exposure, mid-exposure at `time_s`, close enough together that no gap shows."""
    middle = flight.trajectory.camera_pose(time_s, R_body_cam)
    if exposure_s <= 0.0:
        return [middle]
    half = 0.5 * exposure_s
    first = flight.trajectory.camera_pose(time_s - half, R_body_cam)
    last = flight.trajectory.camera_pose(time_s + half, R_body_cam)
    height = max(float(middle.centre_m[2]) - terrain.highest_m, 1.0)
    turned = np.linalg.norm(first.R_enu_cam - last.R_enu_cam) / np.sqrt(2.0)
    moved = np.linalg.norm(first.centre_m - last.centre_m) / height
    count = int(np.clip(np.ceil((turned + moved) * camera.focal_px / 0.7), 1, MAX_SUB_EXPOSURES))
    if count == 1:
        return [middle]
    offsets = (np.arange(count) + 0.5) / count * exposure_s - half
    return [flight.trajectory.camera_pose(time_s + float(offset), R_body_cam) for offset in offsets]


def _cameras(spec: SessionSpec, flight: Flight, R_body_cam: Array, time_s: Array) -> list[Camera]:
    """The camera of each picture."""
    if spec.stabilised_s is not None:
        return stabilised(spec.camera, flight.trajectory, R_body_cam, time_s, spec.stabilised_s)
    if spec.zoom is not None:
        factor, from_s, to_s = spec.zoom
        return zoomed(spec.camera, time_s - time_s[0], factor, from_s, to_s)
    return [spec.camera] * len(time_s)


def _row_poses(rows: RowsOf, camera: Camera, time_s: float, spec: SessionSpec, count: int) -> list[RowPoses] | None:
    """The row poses at the moments that `shutter_poses` takes; None of a global shutter."""
    if not spec.readout_s:
        return None
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * spec.sensor.exposure_s

    def of(moment_s: float) -> RowPoses:
        return lambda v_px: rows.poses(camera, moment_s, v_px)

    return [of(time_s + float(offset)) for offset in offsets]


def _refuse_buried(poses: list[Pose], terrain: Terrain) -> None:
    for frame, pose in enumerate(poses):
        east, north, up = pose.centre_m
        if up < float(terrain.height_m(east, north)) + 2.0:
            raise InputError(f"picture {frame} would be taken from within 2 m of the ground or below it; fly higher")
