"""Feature sets for the codec's tests: hypothesis strategies and one plain builder."""

import math
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import (
    COMMON_STATES,
    NUISANCES,
    DepthSource,
    FeatureSet,
    HeightDatum,
    SharedErrors,
    Status,
    Swing,
)
from contract.lens import FISHEYE, PINHOLE
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_so3

FISHEYE_DISTORTION = (-0.031, 0.012, -0.006, 0.0011)
DISTORTION = (-0.21, 0.052, 0.0007, -0.0004, 0.011)


def random_covariance(rng: np.random.Generator, rank: int, sigmas: NDArray[np.float64]) -> NDArray[np.float64]:
    """A 9 x 9 covariance of the given rank and sigmas."""
    factor = rng.normal(size=(9, rank))
    factor *= (sigmas / np.linalg.norm(factor, axis=1))[:, None]
    return factor @ factor.T


# Of each common state's sigma, what is a set's own.
FRESH = np.array([0.3, 0.3, 0.2, 0.4, 0.4, 0.9, 1.0, 1.0, 1.0])


def typical_shared(rng: np.random.Generator, sigmas: NDArray[np.float64]) -> SharedErrors:
    """As a window shares: position nearly all of its own, rotation by attitude, mount and ground, modes hardly."""
    by_nuisance = np.zeros((COMMON_STATES, NUISANCES))
    by_nuisance[:3, :3] = np.diag(sigmas[:3])
    by_nuisance[3:6, 3:] = 0.4 * sigmas[3:6, None] * rng.normal(size=(3, 10)) * (rng.uniform(size=(3, 10)) < 0.5)
    by_nuisance[6:, 3:] = 0.02 * sigmas[6:, None] * rng.normal(size=(3, 10)) * (rng.uniform(size=(3, 10)) < 0.5)
    return SharedErrors(by_nuisance, 60.0, 20.0, np.array([0.017, 0.017, 0.017, 0.1]), (-4.25, 4.75))


def plain_set(count: int = 100, seed: int = 0, relief: float = 0.03, camera: Camera | None = None) -> FeatureSet:
    """A typical picture from 250 m, obliquely down."""
    rng = np.random.default_rng(seed)
    camera = camera or Camera(640, 480, 879.2, 879.2, 319.5, 239.5, DISTORTION)
    uv = rng.uniform([0.0, 0.0], [camera.width_px - 1, camera.height_px - 1], (count, 2))
    plane = np.array([0.0040, 0.0005, -0.0012])
    flat = plane[0] + camera.unproject(uv)[0][:, :2] @ plane[1:]
    sigma = flat * 0.004 * np.exp(rng.normal(0.0, 0.3, count))
    sigmas = np.array([1.5, 1.6, 2.2, 0.01, 0.012, 0.02, 0.004, 0.003, 0.003])
    shared = typical_shared(rng, sigmas)
    return FeatureSet(
        vehicle="uav-1",
        session=3_000_000_001,
        frame=77,
        capture_unix_ns=1_700_000_000_123_456_789,
        status=Status.OK,
        camera=camera,
        revision=2,
        is_keyframe=True,
        camera_lat_deg=-35.123456789,
        camera_lon_deg=149.165432109,
        camera_height_m=812.345,
        height_datum=HeightDatum.AMSL,
        undulation_m=19.25,
        R_enu_cam=exp_so3(rng.normal(size=3)),
        common_cov=random_covariance(rng, 100, sigmas * FRESH) + shared.by_nuisance @ shared.by_nuisance.T,
        shared=shared,
        depth_source=DepthSource.PARALLAX,
        plane_per_m=plane,
        plane_sigma_relative=0.03,
        roughness=0.012,
        uv_px=uv,
        inverse_depth_per_m=flat * (1.0 + relief * rng.normal(size=count)) + sigma * rng.normal(size=count),
        sigma_inverse_depth_per_m=sigma,
    )


@st.composite
def feature_sets(draw: st.DrawFn) -> FeatureSet:
    """Anything `encode` should accept, hard cases included: singular covariances, half turns, poles, corner pixels."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, height = draw(st.sampled_from([(640, 480), (1920, 1080), (17, 31), (4000, 3000)]))
    pinholes = [(0.0,) * 5, DISTORTION, (1e-50, 0.0, 0.0, 0.0, 0.0), (0.9, -2.0, 0.1, 0.1, 5.0)]
    fisheyes = [(0.0,) * 4, FISHEYE_DISTORTION, (0.9, -2.0, 0.1, 5.0)]
    distortion = draw(st.sampled_from([*pinholes, *fisheyes]))
    model, focal = (FISHEYE, 0.4) if len(distortion) == 4 else (PINHOLE, 1.1)
    f = focal * width
    camera = Camera(width, height, f, 1.1 * f, 0.49 * width, 0.52 * height, distortion, model)
    status = draw(st.sampled_from([Status.OK, Status.OK, Status.OK, Status.TURNING, Status.OUTSIDE_CALIBRATION]))
    identity: dict[str, Any] = {
        "vehicle": draw(st.text(min_size=1, max_size=8)),
        "session": draw(st.integers(0, 2**32 - 1)),
        "frame": draw(st.integers(0, 2**32 - 1)),
        "capture_unix_ns": draw(st.integers(0, 2**63)),
        "revision": draw(st.integers(0, 65535)),
        "is_keyframe": draw(st.booleans()),
    }
    if status is not Status.OK:
        return FeatureSet(status=status, camera=camera, **identity)
    n = draw(st.sampled_from([0, 1, 2, 7, 100, 255]))
    axis = rng.normal(size=3) if draw(st.booleans()) else np.eye(3)[rng.integers(3)]
    angle = draw(st.sampled_from([0.0, 1e-7, 1.0, 3.0, math.pi - 1e-7, math.pi, math.pi + 1e-7]))
    sigmas = 10.0 ** rng.uniform(-6.0, 4.0, 9) * (rng.uniform(size=9) > draw(st.sampled_from([0.0, 0.3, 1.0])))
    fresh = random_covariance(rng, draw(st.sampled_from([1, 2, 5, 9, 20])), sigmas)
    in_sigmas = rng.normal(size=(COMMON_STATES, NUISANCES)) * draw(st.sampled_from([0.0, 0.1, 3.0, 30.0]))
    in_sigmas *= rng.uniform(size=NUISANCES) > draw(st.sampled_from([0.0, 0.5]))
    position_time_s, attitude_time_s = 10.0 ** rng.uniform(-3.0, 3.0, 2) * rng.integers(0, 2, 2)
    shared = SharedErrors(
        sigmas[:, None] * in_sigmas,
        float(position_time_s),
        float(attitude_time_s),
        10.0 ** rng.uniform(-6.0, 1.0, 4) * rng.integers(0, 2, 4),
        (draw(st.floats(-400.0, 400.0)), draw(st.floats(-400.0, 400.0))),
    )
    rolling = RollingShutter(
        float(rng.uniform(-1.0, 1.0)), rng.uniform(-16.0, 16.0, 3), rng.uniform(-320.0, 320.0, 3), float(rng.uniform())
    )
    moments = draw(st.integers(1, 31))
    turned = rng.normal(size=(moments, 3)) * draw(st.sampled_from([0.0, 1e-5, 0.1, 1.0]))
    swing = Swing(np.cumsum(rng.uniform(0.012, 2.0, moments)), turned)
    plane = rng.normal(size=3) * draw(st.sampled_from([0.0, 0.004, 1.0]))
    w = 10.0 ** rng.uniform(-5.0, 0.0, n)
    relative = 10.0 ** rng.uniform(-5.0, 0.0) * np.exp(rng.normal(0.0, 0.3, n))
    return FeatureSet(
        status=status,
        camera=camera,
        camera_lat_deg=draw(st.floats(-90.0, 90.0)),
        camera_lon_deg=draw(st.floats(-180.0, 180.0)),
        camera_height_m=draw(st.floats(-1000.0, 30000.0)),
        height_datum=draw(st.sampled_from(HeightDatum)),
        undulation_m=draw(st.sampled_from([math.nan, 0.0, -105.123456, 85.0])),
        R_enu_cam=exp_so3(axis / np.linalg.norm(axis) * angle),
        common_cov=fresh + shared.by_nuisance @ shared.by_nuisance.T,
        shared=shared,
        depth_source=draw(st.sampled_from(DepthSource)),
        plane_per_m=plane,
        plane_sigma_relative=float(10.0 ** rng.uniform(-4.0, 0.0)),
        roughness=float(10.0 ** rng.uniform(-4.0, 0.0)) * draw(st.sampled_from([0.0, 1.0])),
        uv_px=rng.choice([rng.uniform(size=(n, 2)), rng.integers(0, 2, (n, 2))]) * [width, height] - 0.5,
        inverse_depth_per_m=w,
        sigma_inverse_depth_per_m=np.maximum(w * relative, 1e-9),
        shutter=draw(st.sampled_from([None, rolling])),
        swing=draw(st.sampled_from([None, swing])),
        **identity,
    )
