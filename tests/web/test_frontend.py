"""The page's pure modules under Node, against what Python says."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_so3
from ground.web.view import camera_view, placed_in
from tests.web.served import ROOT


def projection_cases(path: Path) -> None:
    """Places about cameras of all attitudes, every other read row by row in a turn, with where they are seen."""
    rng = np.random.default_rng(5)
    cases, moved_px = [], []
    for k in range(200):
        k1, k2 = rng.uniform(-0.15, 0.02), rng.uniform(-0.02, 0.02)
        camera = Camera(640, 480, 700.0, 690.0, 322.0, 239.0, (k1, k2, 0.001, -0.002, 0.0))
        lat, lon, height_m = rng.uniform([-80.0, -180.0, 0.0], [80.0, 180.0, 900.0]).tolist()
        R = np.diag([1.0, -1.0, -1.0]) @ exp_so3(rng.normal(0.0, 0.15, 3))
        at_once = FeatureSet(
            "uav-1", 1, k, 1, Status.OK, camera, camera_lat_deg=lat, camera_lon_deg=lon, camera_height_m=height_m,
            undulation_m=0.0, R_enu_cam=R,
        )  # fmt: skip
        shutter = RollingShutter(rng.choice([-0.03, 0.03]), rng.normal(0.0, 0.3, 3), rng.normal(0.0, 10.0, 3))
        s = replace(at_once, shutter=shutter if k % 2 else None)
        frame = LocalFrame(lat, lon, height_m)
        place = [float(c) for c in frame.to_geodetic(rng.uniform([-120, -120, -300], [120, 120, -200]))]
        uv, uv_at_once = placed_in(s, *place), placed_in(at_once, *place)
        if k % 2 and uv is not None and uv_at_once is not None:
            moved_px.append(float(np.hypot(*np.subtract(uv, uv_at_once))))
        cases.append(
            {
                "camera": camera_view(s), "width": 640, "height": 480, "lat": place[0], "lon": place[1],
                "height_m": place[2], "enu": frame.to_enu(*place).tolist(), "uv": uv,
            }
        )  # fmt: skip
    assert max(moved_px) > 3.0
    path.write_text(json.dumps(cases))


def test_the_pages_own_arithmetic_is_right(tmp_path: Path) -> None:
    if not (ROOT / "frontend" / "node_modules").is_dir():
        pytest.fail("the page's tools are not there: make web")
    cases = tmp_path / "cases.json"
    projection_cases(cases)
    node = shutil.which("node")
    assert node is not None
    environment = {**os.environ, "PROJECTION_CASES": str(cases)}
    out = tmp_path / "tests"
    for command in (
        [node, "build.mjs", "--tests", str(out)],
        [node, "--test", str(out / "pure.test.mjs")],
    ):
        done = subprocess.run(
            command, cwd=ROOT / "frontend", env=environment, capture_output=True, text=True, check=False, timeout=60
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert "# fail 0" in done.stdout
    assert "# pass 18" in done.stdout


def test_the_page_is_built_from_what_is_here_and_names_no_other_origin() -> None:
    static = ROOT / "ground" / "web" / "static"
    if not (static / "index.html").is_file():
        pytest.fail("the page was not built: make web")
    page = (static / "index.html").read_text()
    assert "http://" not in page
    assert "https://" not in page
    lock = json.loads((ROOT / "frontend" / "package-lock.json").read_text())["packages"]
    assert (lock["node_modules/maplibre-gl"]["version"], lock["node_modules/pmtiles"]["version"]) == ("6.17.0", "4.5.0")
    package = json.loads((ROOT / "frontend" / "package.json").read_text())
    versions = [*package["dependencies"].values(), *package["devDependencies"].values()]
    assert all(version[0].isdigit() for version in versions)
    total = sum(file.stat().st_size for file in static.iterdir() if file.suffix == ".gz")
    assert total < 700_000
