"""Pictures of a camera that looks down at level ground, and how sure each is of where it is."""

from pathlib import Path

import numpy as np

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3
from contract.spot import SpotReport
from contract.topics import SPOTS
from contract.wire.spot_code import encode_spots
from ground.seen.cells import Cells
from ground.seen.picture_cells import picture_cells
from ground.seen.tally import SeenGround
from onboard.storage.mcap_writer import SessionRecorder

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
PLACE = LocalFrame(-43.38, 172.4, 0.0)
HEIGHT_M = 120.0
HOUR_PICTURES = 18_000
CAPTURE_NS = 1_700_000_000_000_000_000


def level_set(
    frame: int = 0,
    *,
    east_m: float = 0.0,
    north_m: float = 0.0,
    sigma_m: float = 0.01,
    tilt_deg: float = 0.0,
    height_m: float = HEIGHT_M,
    at_s: float | None = None,
    revision: int = 0,
    vehicle: str = "uav",
    session: int = 1,
) -> FeatureSet:
    """From a place over PLACE; nothing but its position is uncertain. `tilt_deg`: the camera looks that far north."""
    lat, lon, height = (float(c) for c in PLACE.to_geodetic((east_m, north_m, height_m)))
    R = exp_so3([np.radians(tilt_deg), 0.0, 0.0]) @ np.diag([1.0, -1.0, -1.0])
    uv = np.array([(float(u), float(v)) for u in range(20, 640, 60) for v in range(15, 480, 50)])
    plane = -R[2, [2, 0, 1]] / height_m
    w = plane[0] + CAMERA.unproject(uv)[0][:, :2] @ plane[1:]
    common = np.diag([sigma_m**2] * 3 + [1e-16] * 6)
    return FeatureSet(
        vehicle, session, frame, CAPTURE_NS + round((frame if at_s is None else at_s) * 1e9), Status.OK, CAMERA,
        revision=revision, camera_lat_deg=lat, camera_lon_deg=lon, camera_height_m=height, R_enu_cam=R,
        common_cov=common, plane_per_m=plane, plane_sigma_relative=1e-4, roughness=1e-7, uv_px=uv,
        inverse_depth_per_m=w, sigma_inverse_depth_per_m=np.full(len(uv), 1e-8),
    )  # fmt: skip


def record_search(path: Path, pictures: int, parts: tuple[float, ...]) -> Path:
    """Record looks straight down at one place, at each of which these shares of people in its parts have been named."""
    with SessionRecorder(path, "uav") as out:
        for s in (level_set(frame) for frame in range(pictures)):
            out.write_set(s)
            found = sum(parts) / len(parts)
            report = SpotReport(
                s.session, s.frame, s.capture_unix_ns, True, vehicle="uav", person_found=found, person_named=parts
            )
            out.write_report(SPOTS, s.capture_unix_ns, encode_spots(report))
    return path


def an_hour_over_a_place() -> SeenGround:
    """Five pictures a second of an aircraft that circles over PLACE, all of which show it."""
    seen = SeenGround(5.0)
    seen.cells = cells = Cells.about(PLACE.lat_deg, PLACE.lon_deg, 5.0)
    turn = np.radians(np.arange(0.0, 360.0, 10.0))
    found = [picture_cells(level_set(east_m=20.0 * np.cos(a), north_m=20.0 * np.sin(a)), cells) for a in turn]
    settled = HOUR_PICTURES - 300  # of a minute each revision still counts
    for k in range(settled):
        seen._pictures.add(("uav", 1, k), CAPTURE_NS + k * 200_000_000, found[k % len(found)])
    for k in range(settled, HOUR_PICTURES):
        a = turn[k % len(turn)]
        seen.add(level_set(k, east_m=20.0 * np.cos(a), north_m=20.0 * np.sin(a), at_s=0.2 * k))
    return seen
