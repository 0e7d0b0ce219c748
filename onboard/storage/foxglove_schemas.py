"""Messages that let Foxglove show a session: where the vehicle and the camera are, features on a map, pictures.

Names and fields as in Foxglove's published schemas, encoded as JSON. For people to look at; nothing reads it back.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from onboard.events.types import PositionFix

LOCATION, GEOJSON, PICTURE = "foxglove.LocationFix", "foxglove.GeoJSON", "foxglove.CompressedImage"
COVARIANCE_UNKNOWN, COVARIANCE_KNOWN = 0, 3

_TEXT, _NUMBER = {"type": "string"}, {"type": "number"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}
_PROPERTIES: dict[str, dict[str, Any]] = {
    LOCATION: {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "latitude": _NUMBER,
        "longitude": _NUMBER,
        "altitude": _NUMBER,
        "position_covariance": {"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
        "position_covariance_type": {"type": "integer", "enum": [0, 1, 2, 3]},
    },
    GEOJSON: {"geojson": _TEXT},
    PICTURE: {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": _TEXT,
    },
}


def schema(name: str) -> str:
    """The JSON Schema of one of the three."""
    return json.dumps({"title": name, "type": "object", "properties": _PROPERTIES[name]}, separators=(",", ":"))


def vehicle_location(fix: PositionFix) -> bytes:
    """The vehicle's location by the navigation filter; `altitude` is above mean sea level."""
    return _location(fix.stamp_ns, "vehicle", fix.lat_deg, fix.lon_deg, fix.height_amsl_m, np.zeros((3, 3)), False)


def camera_location(s: FeatureSet) -> bytes:
    """A set's camera with the covariance of its position (east, north, up); `altitude` in the set's datum."""
    covariance = np.asarray(s.common_cov, float)[:3, :3]
    return _location(
        s.capture_unix_ns, "camera", s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m, covariance, True
    )


def features_on_the_map(s: FeatureSet) -> bytes:
    """A set's features as points of a GeoJSON, each with its height and one sigma along its ray."""
    rays, is_valid = s.camera.unproject(s.uv_px)
    usable = is_valid & (s.inverse_depth_per_m > 0.0)
    depth_m = 1.0 / s.inverse_depth_per_m[usable]
    frame = LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
    places = frame.to_geodetic(rays[usable] * depth_m[:, None] @ np.asarray(s.R_enu_cam).T)
    sigma_m = s.sigma_inverse_depth_per_m[usable] * depth_m**2
    points = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [round(lon, 7), round(lat, 7), round(height, 2)]},
            "properties": {"sigma_m": round(sigma, 2)},
        }
        for (lat, lon, height), sigma in zip(places.tolist(), sigma_m.tolist(), strict=True)
    ]
    collection = {"type": "FeatureCollection", "features": points}
    return _json({"geojson": json.dumps(collection, separators=(",", ":"))})


def picture(stamp_ns: int, encoded: bytes, kind: str) -> bytes:
    """An encoded picture; `kind` is "png" or "jpeg"."""
    data = base64.b64encode(encoded).decode("ascii")
    return _json({"timestamp": _time(stamp_ns), "frame_id": "camera", "data": data, "format": kind})


def _location(
    stamp_ns: int, frame_id: str, lat_deg: float, lon_deg: float, height_m: float, covariance: Any, is_known: bool
) -> bytes:
    return _json(
        {
            "timestamp": _time(stamp_ns),
            "frame_id": frame_id,
            "latitude": lat_deg,
            "longitude": lon_deg,
            "altitude": height_m,
            "position_covariance": covariance.ravel().tolist(),
            "position_covariance_type": COVARIANCE_KNOWN if is_known else COVARIANCE_UNKNOWN,
        }
    )


def _time(stamp_ns: int) -> dict[str, int]:
    sec, nsec = divmod(stamp_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode()
