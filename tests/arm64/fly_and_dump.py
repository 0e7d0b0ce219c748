"""Run by an installation's Python, with nothing of ours next to it: a flight folder -> its feature sets, unrounded.

    python fly_and_dump.py FLIGHT OUT.npz

Keys are `FRAME.FIELD`, of each picture's last revision that was answered; `FRAME.clicks` (N, 4) is what clicks on it
get: latitude and longitude (deg), height (m) and the greater half axis of the ellipse (m).
"""

import os
import sys
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as `pc-onboard` does, before NumPy is imported

import cv2
import numpy as np

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.locate import locate
from onboard.config.files import load_config_files
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight

FIELDS = (
    *("camera_lat_deg", "camera_lon_deg", "camera_height_m", "R_enu_cam", "uv_px", "common_cov"),
    *("inverse_depth_per_m", "sigma_inverse_depth_per_m"),
)
CLICKS_PX = tuple((float(u), float(v)) for u in (60, 200, 320, 440, 580) for v in (60, 240, 420))


def clicks(feature_set: FeatureSet) -> list[list[float]]:
    """What clicks on one picture get."""
    fixes = [locate(feature_set, uv) for uv in CLICKS_PX]
    return [[f.lat_deg, f.lon_deg, f.height_amsl_m, f.ellipse.semi_major_m] for f in fixes]


def main(flight: Path, out: Path) -> None:
    """Fly and write."""
    cv2.setNumThreads(1)
    config, camera = load_config_files(flight / "config.toml"), Camera.from_json(flight / "camera.json")
    inputs = Flight.open(config, camera, flight / "frames", flight / "telemetry.tlog", flight / "stamps.csv")
    pipeline = Pipeline(config, camera)
    sets = [s for _, event in inputs.events() for s in pipeline.handle(event)] + pipeline.finish()
    latest = {s.frame: s for s in sets if s.is_ok}.values()
    fields = {f"{s.frame}.{field}": np.asarray(getattr(s, field)) for s in latest for field in FIELDS}
    np.savez(out, **fields, **{f"{s.frame}.clicks": np.array(clicks(s)) for s in latest})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
