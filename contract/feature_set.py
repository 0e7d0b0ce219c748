"""FeatureSet: what the aircraft publishes about one picture, and all the ground needs to answer a click.

The interpolated quantity is inverse depth over normalised image coordinates (x, y): on a planar facet it is exactly
affine (3.1). A click's position is C + R_enu_cam @ (x, y, 1) / w.

Errors travel in three parts, docs/mathematics.md section 9:
- `common_cov`: what every point of the set shares, 9 states: camera position (east, north, up; m), rotation (rad, a
  left perturbation R <- exp([dtheta]x) R in east-north-up axes) and three dimensionless modes m0, m1, m2 of relative
  inverse depth, dw/w = m0 + m1 x + m2 y;
- `sigma_inverse_depth`: what is each feature's own;
- `shared`: which part of `common_cov` comes from slow errors that the session's other sets have too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import RollingShutter

Array = NDArray[np.float64]

COMMON_STATES = 9


class Status(Enum):
    """The reason why a set or a click has no answer, or OK. Values are the words users see; order, the wire code."""

    OK = "ok"
    STARTING = "starting"
    LOW_PARALLAX = "low_parallax"
    OUTSIDE = "outside"
    ABOVE_HORIZON = "above_horizon"
    STALE = "stale"
    UNSYNCHRONISED = "unsynchronised"
    TURNING = "turning"
    NO_GPS = "no_gps"
    FEATURELESS = "featureless"
    POOR_FIT = "poor_fit"
    UNCERTAIN = "uncertain"
    CAMERA_LOST = "camera_lost"
    UNKNOWN_FRAME = "unknown_frame"
    BAD_PICTURE = "bad_picture"
    OUTSIDE_CALIBRATION = "outside_calibration"
    STABILISED = "stabilised"
    ZOOMED = "zoomed"
    REPETITIVE = "repetitive"
    MIRRORED = "mirrored"
    STRETCHED = "stretched"

    @property
    def code(self) -> int:
        """The number on the wire: the position in this list, which only ever grows at its end."""
        return _CODES[self]


_CODES: dict[Status, int] = {status: code for code, status in enumerate(Status)}


class HeightDatum(Enum):
    """The surface that `camera_height_m` is measured from."""

    AMSL = "amsl"
    ELLIPSOID = "ellipsoid"


class DepthSource(Enum):
    """The origin of the inverse depths."""

    PARALLAX = "interpolated"
    TERRAIN = "terrain"
    PLANE = "plane"


NUISANCES = 13
# Gauss-Markov errors of positions (m) and attitudes (rad), along and about east, north, up
POSITION, ATTITUDE = slice(0, 3), slice(3, 6)
ALIGNMENT = slice(6, 10)  # boresight about camera x, y, z (rad), time offset (s)
GROUND = slice(10, 13)  # errors of the prior ground: height (m), slope east, slope north


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Effects of slow errors on a set: nuisance parameters that other sets of the session have as well. Section 9."""

    # (9, NUISANCES): how far one sigma of each parameter moves the common states; its square is part of common_cov.
    by_nuisance: Array = field(default_factory=lambda: np.zeros((COMMON_STATES, NUISANCES)))
    position_time_s: float = 0.0  # correlation times of the Gauss-Markov errors; 0: not shared
    attitude_time_s: float = 0.0
    alignment_sigma: Array = field(default_factory=lambda: np.zeros(4))  # one sigma of those parameters, rad and s
    span_s: tuple[float, float] = (0.0, 0.0)  # from capture to the first and to the last picture the set is built on


class Measured(Enum):
    """The outcome for a clicked pixel: measured, or why not. Values are the words users see; order, the wire code."""

    MEASURED = "measured"
    NO_PICTURE = "picture not kept"  # the aircraft holds its picture no longer
    BORDER = "border"  # too near to the picture's edge
    FEW_VIEWS = "few views"  # too few other pictures show it from elsewhere
    NO_TEXTURE = "no texture"
    REPEATED = "repeated texture"
    HIDDEN = "hidden"  # too few of them agree: something else is in the way
    EDGE = "edge"  # two surfaces meet there
    MOVES = "moves"
    ROLLING = "rolling rows"

    @property
    def code(self) -> int:
        """The number on the wire: the position in this list, which only ever grows at its end."""
        return _MEASURED_CODES[self]


_MEASURED_CODES: dict[Measured, int] = {measured: code for code, measured in enumerate(Measured)}


@dataclass(frozen=True)
class ClickedPixel:
    """A pixel that was asked for: its own inverse depth, which no other pixel's answer takes part in, or why there is
    none.
    """

    u_px: float
    v_px: float
    measured: Measured
    inverse_depth_per_m: float = 0.0
    sigma_per_m: float = 0.0

    @property
    def is_measured(self) -> bool:
        return self.measured is Measured.MEASURED


@dataclass(frozen=True, eq=False)
class Swing:
    """The camera's turning at K moments before its picture, which sets that come seldom do not show. Section 31."""

    before_s: Array  # (K,) before the capture, rising
    turned_cam_rad: Array  # (K, 3) rotation vectors, camera axes: R_enu_cam exp(turned) then, of the middle row


@dataclass(frozen=True, eq=False)
class FeatureSet:
    """One picture's pose, features and covariances. With `status` other than OK, everything after it may be empty."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    status: Status
    camera: Camera
    revision: int = 0
    is_keyframe: bool = False

    camera_lat_deg: float = 0.0
    camera_lon_deg: float = 0.0
    camera_height_m: float = 0.0
    height_datum: HeightDatum = HeightDatum.AMSL
    undulation_m: float = float("nan")  # ellipsoidal minus AMSL height; nan: unknown
    R_enu_cam: Array = field(default_factory=lambda: np.eye(3))  # ENU axes at the camera's own latitude and longitude
    common_cov: Array = field(default_factory=lambda: np.zeros((COMMON_STATES, COMMON_STATES)))
    shared: SharedErrors = field(default_factory=SharedErrors)

    depth_source: DepthSource = DepthSource.PARALLAX
    plane_per_m: Array = field(default_factory=lambda: np.zeros(3))  # ground plane: w = a + b x + c y, 1/m
    plane_sigma_relative: float = 0.0  # one sigma of w / w_plane - 1 of the ground about that plane
    # Linear variogram slope of r = w / w_plane - 1: E[(r1 - r2)^2] / 2 per unit of (x, y) at the features' mean. (9.20)
    roughness: float = 0.0
    uv_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    inverse_depth_per_m: Array = field(default_factory=lambda: np.zeros(0))
    sigma_inverse_depth_per_m: Array = field(default_factory=lambda: np.zeros(0))
    # None: all rows at once. Else the pose and the features' pixels are those of the middle row's moment.
    shutter: RollingShutter | None = None
    clicked: ClickedPixel | None = None  # in an answer to a question for a pixel
    swing: Swing | None = None  # since the set that was sent before, over a link that carries few

    def __len__(self) -> int:
        return len(self.inverse_depth_per_m)

    @property
    def is_ok(self) -> bool:
        return self.status is Status.OK
