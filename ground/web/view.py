"""The view of a set on a page: its camera, its features with their ground places and paths, the footprint. No I/O.

The camera goes along so that the page itself can draw a pin in any picture; `placed_in` is the same on this side, for
finding the pictures that show a place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.answer import EXPLANATIONS, Fix, time_utc
from contract.circular_error import ce90_m
from contract.feature_set import FeatureSet, HeightDatum
from contract.geodesy import LocalFrame
from contract.kriging import MIN_PLANE_SHARE
from contract.locate import Locator, pixels_of
from ground.seen.picture_cells import GroundPlane, pixel_of
from ground.web.advice import ADVICE

Array = NDArray[np.float64]

# Features of two pictures within this of each other, once one's ground places are seen from the other, are the same.
SAME_FEATURE_PX = 4.0
COMMON_SHIFT_PX = 40.0
EDGE_POINTS = 12  # of the footprint, along each edge of the picture
MESH = 13, 10  # pixels, across and down, under which the page is given the ground, to lay the picture on it


def frame_view(s: FeatureSet, earlier: Sequence[FeatureSet], age_s: float | None, locator: Locator) -> dict[str, Any]:
    """All data of one picture except its image, ready for JSON. `earlier`: sets before it, the nearest first."""
    out: dict[str, Any] = {
        "vehicle": s.vehicle,
        "session": s.session,
        "frame": s.frame,
        "revision": s.revision,
        "status": s.status.value,
        "reason": EXPLANATIONS[s.status],
        "advice": ADVICE[s.status],
        "time_utc": time_utc(s.capture_unix_ns),
        "capture_unix_ns": str(s.capture_unix_ns),
        "age_s": None if age_s is None else round(age_s, 3),
        "width_px": s.camera.width_px,
        "height_px": s.camera.height_px,
        "camera": None,
        "features": {"uv": [], "lonlat": [], "rise_m": [], "paths": []},
        "footprint": [],
        "mesh": None,
        "ce90_centre_m": None,
    }
    if not s.is_ok:
        return out
    out["camera"] = camera_view(s)
    ground, usable = _ground_places(s)
    plane = GroundPlane.of(s)
    places = _ellipsoidal(s).to_geodetic(ground)
    out["features"] = {
        "uv": np.round(s.uv_px[usable], 2).tolist(),
        "lonlat": np.round(places[:, [1, 0]], 8).tolist(),
        "rise_m": [] if plane is None else np.round(plane.rise(ground), 3).tolist(),
        "paths": _paths(s, s.uv_px[usable], earlier),
    }
    out["footprint"], out["mesh"] = footprint(s), mesh(s)
    answer = locator.locate((0.5 * (s.camera.width_px - 1), 0.5 * (s.camera.height_px - 1)))
    if isinstance(answer, Fix):
        out["ce90_centre_m"] = round(ce90_m(answer.covariance_enu_m2[:2, :2]), 1)
    return out


def camera_view(s: FeatureSet) -> dict[str, Any]:
    """The camera of a set with a pose, and how it moved while its rows were read: what `placed_in` needs of it."""
    plane, c, shutter, is_known = GroundPlane.of(s), s.camera, s.shutter, not np.isnan(s.undulation_m)
    return {
        "fx": c.fx_px,
        "fy": c.fy_px,
        "cx": c.cx_px,
        "cy": c.cy_px,
        "model": c.model,
        "distortion": list(c.distortion),
        "max_radius": min(c.max_radius, 1e3),
        "lat_deg": s.camera_lat_deg,
        "lon_deg": s.camera_lon_deg,
        "height_m": s.camera_height_m + _shift_m(s),
        "is_ellipsoidal": _is_ellipsoidal(s),
        "undulation_m": s.undulation_m if is_known else None,
        "ground_per_m": None if plane is None else plane.normal.tolist(),
        "R_enu_cam": np.asarray(s.R_enu_cam, float).ravel().tolist(),
        "shutter": None
        if shutter is None
        else {
            "readout_s": shutter.readout_s,
            "rate_rad_s": np.asarray(shutter.rate_cam_rad_s, float).tolist(),
            "velocity_m_s": np.asarray(shutter.velocity_cam_m_s, float).tolist(),
        },
    }


def footprint(s: FeatureSet) -> list[list[float]]:
    """Outline of the picture on its ground plane as longitude, latitude, closed, without what has no ground."""
    w, h = s.camera.width_px - 0.5, s.camera.height_px - 0.5
    corner_px = np.array([[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]])
    t = np.arange(EDGE_POINTS)[:, None] / EDGE_POINTS
    edge_px = np.concatenate([a + t * (b - a) for a, b in zip(corner_px, np.roll(corner_px, -1, axis=0), strict=True)])
    outline, ok = _on_plane(s, edge_px)
    ring = [p for p, good in zip(outline, ok, strict=True) if good]
    return [*ring, ring[0]] if len(ring) >= 3 else []


def mesh(s: FeatureSet) -> dict[str, Any]:
    """The ground plane's longitude and latitude under a lattice of pixels from edge to edge, row by row.

    None where a pixel has none: beyond what the lens' calibration describes, and at or above the horizon.
    """
    u = np.linspace(-0.5, s.camera.width_px - 0.5, MESH[0])
    v = np.linspace(-0.5, s.camera.height_px - 0.5, MESH[1])
    places, ok = _on_plane(s, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    return {"columns": MESH[0], "lonlat": [p if good else None for p, good in zip(places, ok, strict=True)]}


def placed_in(
    s: FeatureSet,
    lat_deg: float,
    lon_deg: float,
    height_ellipsoid_m: float | None = None,
    height_amsl_m: float | None = None,
) -> list[float] | None:
    """The pixel that shows a place in a set's picture; None where it is not on it.

    A place of which no height is known, or none that the set's can be compared with, is on the ground as the set has
    it.
    """
    if not s.is_ok:
        return None
    height_m = _height_in(s, height_ellipsoid_m, height_amsl_m)
    if height_m is None:
        on_ground = pixel_of(s, lat_deg, lon_deg)
        return None if on_ground is None else list(on_ground)
    enu_m = _ellipsoidal(s).to_enu(lat_deg, lon_deg, height_m)
    (uv,), (usable,) = pixels_of(s, enu_m[None])
    return [float(uv[0]), float(uv[1])] if usable and s.camera.contains(uv) else None


def camera_place(s: FeatureSet) -> list[float] | None:
    """Longitude, latitude of a set's camera; None if it has no pose."""
    return [round(s.camera_lon_deg, 8), round(s.camera_lat_deg, 8)] if s.is_ok else None


def _shift_m(s: FeatureSet) -> float:
    """The height to add to the set's datum for the ellipsoid, as in `contract.locate`: zero where that is not known."""
    known = s.height_datum is HeightDatum.AMSL and not np.isnan(s.undulation_m)
    return float(s.undulation_m) if known else 0.0


def _is_ellipsoidal(s: FeatureSet) -> bool:
    """Return whether `camera_height_m` and `_shift_m` together are a height above the ellipsoid."""
    return s.height_datum is HeightDatum.ELLIPSOID or not np.isnan(s.undulation_m)


def _height_in(s: FeatureSet, height_ellipsoid_m: float | None, height_amsl_m: float | None) -> float | None:
    """A place's height in the datum of `_ellipsoidal`; None where it is not known in that one."""
    if not _is_ellipsoidal(s):
        return height_amsl_m
    if height_ellipsoid_m is None and height_amsl_m is not None and not np.isnan(s.undulation_m):
        return height_amsl_m + s.undulation_m
    return height_ellipsoid_m


def _ellipsoidal(s: FeatureSet) -> LocalFrame:
    return LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m + _shift_m(s))


def _ground_places(s: FeatureSet) -> tuple[Array, NDArray[np.bool_]]:
    """Offsets of the usable features from the camera (M, 3), ENU m, and which those are (N,)."""
    rays, valid = s.camera.unproject(s.uv_px)
    usable = valid & (s.inverse_depth_per_m > 0.0)
    offsets: Array = (rays[usable] / s.inverse_depth_per_m[usable, None]) @ np.asarray(s.R_enu_cam, float).T
    return offsets, usable


def _on_plane(s: FeatureSet, uv_px: Array) -> tuple[list[list[float]], NDArray[np.bool_]]:
    rays, valid = s.camera.unproject(uv_px)
    plane = s.plane_per_m[0] + rays[:, :2] @ s.plane_per_m[1:]
    own = s.plane_per_m[0] + s.camera.unproject(s.uv_px)[0][:, :2] @ s.plane_per_m[1:]
    floor = MIN_PLANE_SHARE * max(float(np.max(own, initial=0.0)), float(s.plane_per_m[0]))
    ok = valid & (plane > max(floor, 1e-9))
    offsets = (rays / np.where(ok, plane, 1.0)[:, None]) @ np.asarray(s.R_enu_cam, float).T
    places = _ellipsoidal(s).to_geodetic(offsets)
    return np.round(places[:, [1, 0]], 8).tolist(), ok


def _paths(s: FeatureSet, uv_px: Array, earlier: Sequence[FeatureSet]) -> list[list[list[float]]]:
    """The pixels of each feature in the pictures before, the nearest first, without a gap; empty for a new one.

    The wire does not number features, so they are identified by their ground places, each seen from this picture.
    """
    paths: list[list[list[float]]] = [[] for _ in uv_px]
    here = _ellipsoidal(s)
    for before, other in enumerate(earlier):
        if not other.is_ok or not len(other) or not len(uv_px):
            break
        offsets, usable = _ground_places(other)
        there = _ellipsoidal(other)
        moved = here.to_enu(*np.moveaxis(there.to_geodetic(offsets), -1, 0)) @ np.asarray(s.R_enu_cam, float)
        ahead = moved[:, 2] > 1e-6
        xy = moved[:, :2] / np.where(ahead, moved[:, 2], 1.0)[:, None]
        seen = s.camera.pixels(xy)
        # Two sets' positions may differ by more than the distance between features: first remove the shift of all of
        # them.
        for reach_px in (COMMON_SHIFT_PX, SAME_FEATURE_PX):
            distance = np.where(ahead, np.linalg.norm(uv_px[:, None] - seen[None], axis=-1), np.inf)
            nearest, back = np.argmin(distance, axis=1), np.argmin(distance, axis=0)
            pairs = [i for i, j in enumerate(nearest) if back[j] == i and distance[i, j] <= reach_px]
            if not pairs or reach_px == SAME_FEATURE_PX:
                break
            seen = seen + np.median(uv_px[pairs] - seen[nearest[pairs]], axis=0)
        then_px = other.uv_px[usable]
        for i, j in enumerate(nearest):
            if back[j] == i and distance[i, j] <= SAME_FEATURE_PX and len(paths[i]) == before:
                paths[i].append([round(float(then_px[j, 0]), 1), round(float(then_px[j, 1]), 1)])
    return paths
