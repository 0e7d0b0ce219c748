"""The page's pure modules under Node, against what Python says."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3
from tests.web.served import ROOT


def projection_cases(path: Path) -> None:
    """Places about cameras of all attitudes, with where they are seen."""
    rng = np.random.default_rng(5)
    cases = []
    for _ in range(200):
        k1, k2 = rng.uniform(-0.15, 0.02), rng.uniform(-0.02, 0.02)
        camera = Camera(640, 480, 700.0, 690.0, 322.0, 239.0, (k1, k2, 0.001, -0.002, 0.0))
        frame = LocalFrame(rng.uniform(-80, 80), rng.uniform(-180, 180), rng.uniform(0, 900))
        R = np.diag([1.0, -1.0, -1.0]) @ exp_so3(rng.normal(0.0, 0.15, 3))
        place = frame.to_geodetic(rng.uniform([-120, -120, -300], [120, 120, -200]))
        enu = frame.to_enu(*place)
        uv, seen = camera.project(enu @ R)
        cases.append(
            {
                "camera": {
                    "fx": camera.fx_px, "fy": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
                    "distortion": camera.distortion, "max_radius": camera.max_radius, "lat_deg": frame.lat_deg,
                    "lon_deg": frame.lon_deg, "height_m": frame.height_m, "R_enu_cam": R.ravel().tolist(),
                },
                "width": 640, "height": 480, "lat": place[0], "lon": place[1], "height_m": place[2],
                "enu": enu.tolist(), "uv": uv.tolist() if bool(seen) else None,
            }
        )  # fmt: skip
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
    assert "# pass 9" in done.stdout


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
