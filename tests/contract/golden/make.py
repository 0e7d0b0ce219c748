"""Writes the golden payloads and what they must decode to: `python -m tests.contract.golden.make`.

Run only when the wire format itself changes, with its version.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from contract.camera import Camera
from contract.feature_set import ClickedPixel, DepthSource, FeatureSet, HeightDatum, Measured, Status, Swing
from contract.lens import FISHEYE
from contract.rolling_shutter import RollingShutter
from contract.wire.codec import decode, encode
from tests.contract.sets import DISTORTION, FISHEYE_DISTORTION, plain_set

FISHEYE_CAMERA = Camera(640, 480, 330.0, 333.0, 322.0, 236.0, FISHEYE_DISTORTION, FISHEYE)
SWING = Swing(np.array([0.2, 0.4, 0.6, 0.8]), np.array([[3, -40, 1], [-9, -64, 0], [0, 1, -2], [5, 45, 0]]) / 512.0)
HERE = Path(__file__).parent


def cases() -> dict[str, FeatureSet]:
    plain = plain_set(12, seed=1)
    ideal = dataclasses.replace(plain.camera, distortion=(0.0,) * 5)
    return {
        "twelve_features": plain,
        "a_hundred_features": plain_set(100, seed=2),
        "plane_only": dataclasses.replace(
            plain_set(0, seed=3, camera=ideal),
            vehicle="Ærø 7",
            depth_source=DepthSource.PLANE,
            height_datum=HeightDatum.ELLIPSOID,
            undulation_m=math.nan,
            is_keyframe=False,
            revision=0,
        ),
        "rolling_shutter": dataclasses.replace(
            plain_set(12, seed=5),
            shutter=RollingShutter(-0.021, np.array([0.12, -0.31, 0.05]), np.array([3.5, -19.2, 1.1]), 0.0035),
        ),
        "fisheye": plain_set(12, seed=7, camera=FISHEYE_CAMERA),
        "measured_pixel": dataclasses.replace(
            plain_set(12, seed=6), clicked=ClickedPixel(300.5, 211.25, Measured.MEASURED, 0.0041, 1.3e-6)
        ),
        "unmeasured_pixel": dataclasses.replace(
            plain_set(12, seed=6), clicked=ClickedPixel(300.5, 211.25, Measured.REPEATED)
        ),
        "swing": dataclasses.replace(plain_set(12, seed=6), swing=SWING),
        "refused": FeatureSet("uav-1", 5, 6, 1_525_226_625_500_000_000, Status.LOW_PARALLAX, plain.camera, revision=1),
    }


def plain_json(feature_set: FeatureSet) -> dict[str, Any]:
    """Every field as JSON holds it; numbers of arrays in full."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        if dataclasses.is_dataclass(value):
            return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        if isinstance(value, Status | HeightDatum | DepthSource | Measured):
            return value.value
        if isinstance(value, float) and math.isnan(value):
            return None
        return list(value) if isinstance(value, tuple) else value

    out = plain(feature_set)
    assert isinstance(out, dict)
    return out


def main() -> None:
    assert plain_set(0).camera.distortion == DISTORTION
    for name, feature_set in cases().items():
        payload = encode(feature_set)
        (HERE / f"{name}.bin").write_bytes(payload)
        (HERE / f"{name}.json").write_text(json.dumps(plain_json(decode(payload)), indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
