"""Synthetic feature sets with truth, sampled from exactly the errors they declare."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import NUISANCES, FeatureSet, HeightDatum, SharedErrors, Status
from contract.geodesy import LocalFrame
from contract.kriging import on_plane, stretch
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
ORIGIN = LocalFrame(-35.36, 149.16, 600.0)
COMMON_SIGMAS = np.array([1.2, 1.4, 2.0, 0.006, 0.006, 0.012, 0.008, 0.01, 0.01])


@dataclass(frozen=True, eq=False)
class Errors:
    feature_relative: float = 0.006
    relief_relative: float = 0.02
    roughness: float = 0.004
    common: bool = True
    shared: SharedErrors = dataclasses.field(default_factory=SharedErrors)


@dataclass(frozen=True, eq=False)
class World:
    """A published set, the clicks made on it and where they truly are, in ORIGIN's ENU axes."""

    feature_set: FeatureSet
    clicks_px: Array
    truth_enu_m: Array

    def error(self, index: int, fix: Fix) -> Array:
        assert fix.height_ellipsoid_m is not None
        at: Array = ORIGIN.to_enu(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m)
        return at - self.truth_enu_m[index]


def common_covariance(rng: np.random.Generator) -> Array:
    factor = rng.normal(size=(9, 12))
    return factor @ factor.T / 12.0 * np.outer(COMMON_SIGMAS, COMMON_SIGMAS)


def root(covariance: Array) -> Array:
    """L with L L' = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def relief_at(rng: np.random.Generator, xy: Array, plane: Array, errors: Errors) -> Array:
    """A sample (N,) of the relative inverse depth's deviation: Gaussian, with the variogram the set declares. (9.20)"""
    s2 = errors.relief_relative**2
    if s2 == 0.0:
        return np.zeros(len(xy))
    places = on_plane(xy, plane)
    d = np.linalg.norm(places[:, None] - places[None], axis=-1)
    slope = errors.roughness / stretch(xy, plane)
    root = np.linalg.cholesky(s2 * np.exp(-slope / s2 * d) + 1e-12 * np.eye(len(xy)))
    return root @ rng.normal(size=len(xy))


def build(
    rng: np.random.Generator,
    errors: Errors | None = None,
    *,
    features: int = 100,
    clicks_px: Array | None = None,
    position_enu_m: tuple[float, float, float] = (0.0, 0.0, 250.0),
    draws: Array | None = None,
    fresh: Array | None = None,
    yaw_rad: float | None = None,
    frame: int = 0,
    capture_unix_ns: int = 1_700_000_000_000_000_000,
    pitch_deg: float = -65.0,
) -> World:
    """One picture over ground around height 0; everything it publishes carries the declared errors.

    `draws` (DRAWS,) and `fresh` (9,) are unit draws of what is shared and what is not; sampled here unless given.
    """
    errors = errors or Errors()
    clicks = rng.uniform([100.0, 80.0], [540.0, 400.0], (2, 2)) if clicks_px is None else clicks_px
    uv = np.concatenate([_spread(rng, features), clicks])
    rays = CAMERA.unproject(uv)[0]
    R_true = (
        R_ENU_NED
        @ matrix_from_euler(0.03, -0.02, rng.uniform(0, 6.28) if yaw_rad is None else yaw_rad)
        @ mount_rotation(0.0, pitch_deg, 0.0)
    )
    flat = -(rays @ R_true.T)[:, 2] / position_enu_m[2]  # 1 / depth of the plane at height 0
    level = -R_true[2, [2, 0, 1]] / position_enu_m[2]
    true_w = flat * (1.0 + relief_at(rng, rays[:, :2], level, errors))
    position = np.array(position_enu_m)
    truth = position + (rays @ R_true.T) / true_w[:, None]

    cov = common_covariance(rng) if errors.common else np.zeros((9, 9))
    by_nuisance = errors.shared.by_nuisance
    draws = rng.normal(size=NUISANCES) if draws is None else draws
    error = rng.multivariate_normal(np.zeros(9), cov) if fresh is None else root(cov) @ fresh
    error = error + by_nuisance @ draws

    modes = 1.0 + np.concatenate([np.ones((len(uv), 1)), rays[:, :2]], axis=1) @ error[6:]
    sigma = errors.feature_relative * flat[:features] * np.exp(rng.normal(0.0, 0.3, features))
    w = true_w[:features] * modes[:features] + sigma * rng.normal(size=features)
    design = np.concatenate([np.ones((features, 1)), rays[:features, :2]], axis=1)
    plane = (
        np.linalg.lstsq(design, w, rcond=None)[0]
        if features >= 3
        else np.linalg.lstsq(np.concatenate([np.ones((len(uv), 1)), rays[:, :2]], axis=1), flat * modes, rcond=None)[0]
    )
    lat, lon, height = ORIGIN.to_geodetic(position + error[:3])
    feature_set = FeatureSet(
        vehicle="uav-1",
        session=7,
        frame=frame,
        capture_unix_ns=capture_unix_ns,
        status=Status.OK,
        camera=CAMERA,
        camera_lat_deg=float(lat),
        camera_lon_deg=float(lon),
        camera_height_m=float(height) - 20.0,
        height_datum=HeightDatum.AMSL,
        undulation_m=20.0,
        R_enu_cam=exp_so3(error[3:6]) @ R_true,
        common_cov=cov + by_nuisance @ by_nuisance.T,
        shared=errors.shared,
        plane_per_m=plane,
        plane_sigma_relative=errors.relief_relative,
        roughness=errors.roughness,
        uv_px=uv[:features],
        inverse_depth_per_m=w,
        sigma_inverse_depth_per_m=sigma,
    )
    return World(feature_set, clicks, truth[features:])


def _spread(rng: np.random.Generator, count: int) -> Array:
    """Features spread over the picture as a tracker keeps them: one at random in each cell."""
    if not count:
        return np.zeros((0, 2))
    columns = int(np.ceil(np.sqrt(count * 640 / 480)))
    rows = -(-count // columns)
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    chosen = cells[rng.permutation(len(cells))[:count]]
    return 10.0 + (chosen + rng.uniform(0.1, 0.9, (count, 2))) * [620.0 / columns, 460.0 / rows]
