"""The page's pure modules under Node, against what Python says."""

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet, HeightDatum, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_so3
from ground.web.view import MESH, camera_view, frame_view, mesh, placed_in
from tests.contract.sets import plain_set
from tests.ground.seen.levels import level_set
from tests.web.served import ROOT


def projection_cases(path: Path) -> None:
    """Places about cameras of all attitudes, every other read row by row in a turn, with where they are seen."""
    rng = np.random.default_rng(5)
    cases, moved_px = [], []
    for k in range(200):
        k1, k2 = rng.uniform(-0.15, 0.02), rng.uniform(-0.02, 0.02)
        camera = Camera(640, 480, 700.0, 690.0, 322.0, 239.0, (k1, k2, 0.001, -0.002, 0.0))
        if k % 4 > 1:
            camera = Camera(640, 480, 250.0, 248.0, 322.0, 239.0, (k1, k2, 0.004, -0.001), "fisheye")
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


def over_a_slope() -> FeatureSet:
    """An oblique picture of ground that rises to the east, of which the plane knows nothing."""
    flat = level_set(tilt_deg=25.0)
    xy = flat.camera.unproject(flat.uv_px)[0][:, :2]
    return replace(flat, inverse_depth_per_m=flat.inverse_depth_per_m * (1.0 + 0.3 * xy[:, 0]), roughness=1e-3)


def ground_cases(path: Path) -> None:
    """Places without a height, or with one that the set's own cannot be compared with, with where they are seen."""
    rng, cases = np.random.default_rng(6), []
    amsl = over_a_slope()
    both, ellipsoid = replace(amsl, undulation_m=48.0), replace(amsl, height_datum=HeightDatum.ELLIPSOID)
    for k in range(60):
        s = (amsl, both, ellipsoid)[k % 3]
        uv = rng.uniform([60.0, 60.0], [580.0, 420.0])
        at = Locator(s).locate(uv)
        assert isinstance(at, Fix)
        heights = ((None, None), (at.height_ellipsoid_m, None), (None, at.height_amsl_m))[k // 3 % 3]
        place = {
            "lat_deg": at.lat_deg,
            "lon_deg": at.lon_deg,
            "height_ellipsoid_m": heights[0],
            "height_amsl_m": heights[1],
        }
        found = placed_in(s, at.lat_deg, at.lon_deg, *heights)
        assert found is not None and np.hypot(*np.subtract(found, uv)) < 1.5
        cases.append({"frame": frame_view(s, [], None, Locator(s)), "place": place, "uv": found})
    path.write_text(json.dumps(cases))


def test_a_place_of_unknown_height_is_in_a_picture_where_its_ground_is() -> None:
    """Of a height in the other datum nothing is made up: 48 m of undulation would be half a picture."""
    flat = level_set(tilt_deg=20.0)
    at = Locator(flat).locate((400.0, 150.0))
    assert isinstance(at, Fix) and at.height_amsl_m is not None
    where = at.lat_deg, at.lon_deg
    for s in (flat, replace(flat, undulation_m=48.0)):
        assert placed_in(s, *where) == pytest.approx((400.0, 150.0), abs=0.1)
        assert placed_in(s, *where, None, at.height_amsl_m) == pytest.approx((400.0, 150.0), abs=0.1)
    assert placed_in(flat, *where, at.height_amsl_m + 48.0, None) == pytest.approx((400.0, 150.0), abs=0.1)
    assert placed_in(flat, where[0] + 0.01, where[1]) is None


def test_a_picture_lies_on_the_ground_as_far_as_it_shows_ground() -> None:
    """A lens whose calibration ends before the corners, and a picture with the horizon in it."""
    folding = Camera(640, 480, 520.0, 520.0, 316.0, 241.0, (0.166, -0.223, -0.0038, 0.0024, -0.608))
    lens, horizon = plain_set(camera=folding), level_set(tilt_deg=80.0)
    for s, least in ((lens, 0.8), (horizon, 0.3)):
        found = mesh(s)
        known = [place is not None for place in found["lonlat"]]
        assert len(known) % found["columns"] == 0
        assert least * len(known) < sum(known) < len(known)
        for (u, v), place in zip(lattice(s), found["lonlat"], strict=True):
            at = Locator(s).locate((u, v))
            if place is not None and isinstance(at, Fix) and s is horizon:
                assert np.hypot(place[0] - at.lon_deg, place[1] - at.lat_deg) < 1e-6 * max(1.0, 480.0 - v)
    assert all(place is not None for place in mesh(plain_set())["lonlat"])


def lattice(s: FeatureSet) -> list[tuple[float, float]]:
    u, v = (np.linspace(-0.5, size - 0.5, count) for size, count in zip(s.camera.size_px, MESH, strict=True))
    return [(float(x), float(y)) for y in v for x in u]


def test_the_pages_own_arithmetic_is_right(tmp_path: Path) -> None:
    if not (ROOT / "frontend" / "node_modules").is_dir():
        pytest.fail("the page's tools are not there: make web")
    cases = tmp_path / "cases.json"
    projection_cases(cases)
    node = shutil.which("node")
    assert node is not None
    on_ground = tmp_path / "ground.json"
    ground_cases(on_ground)
    environment = {**os.environ, "PROJECTION_CASES": str(cases), "GROUND_CASES": str(on_ground)}
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
    assert "# pass 24" in done.stdout


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
