"""A pin, the clicks it consists of, and a tie to a known place: values, and their JSON without loss.

A click keeps what is needed to compare its errors with other clicks' once its feature set is gone: where its camera
was, and how the session's slow errors act on it (docs/mathematics-pins.md).
"""

from __future__ import annotations

import base64
import json
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.answer import Fix
from contract.errors import InputError
from contract.feature_set import FeatureSet, SharedErrors
from contract.locate import Locator
from ground.pins.reading import Reader
from ground.unmeasured import MOST_CHARACTERS

Array = NDArray[np.float64]

POINTING_PX = 1.0  # one sigma of where a person's click falls about the thing that is meant, along u and along v
ENTERED = "entered"  # method of a position that was typed or imported, not clicked
# Of a click's errors, in the order in which they are written, little-endian float64, row by row.
ARRAYS = {
    "R_enu_cam": (3, 3), "common_cov": (9, 9), "by_nuisance": (9, 13), "alignment_sigma": (4,), "span_s": (2,),
    "offset_enu_m": (3,), "pointing_cov_m2": (3, 3),
}  # fmt: skip
MAX_NAME, MAX_NOTE, MAX_WHO = 200, 10_000, 100
MOST_FORMER = 20  # numbers of a pin that are remembered
MAX_CLICKS, MAX_STAMPS = 1000, 4000  # of a pin; clicks that were taken out have stamps too
Stamp = tuple[int, str]  # when (ns) and by whom a part of a pin was changed last


class Category(Enum):
    """The kind of thing that a pin marks."""

    PERSON = "person"
    VEHICLE = "vehicle"
    FIRE = "fire"
    HAZARD = "hazard"
    POI = "poi"


@dataclass(frozen=True, eq=False)
class ClickErrors:
    """The part of a click's set that gives its correlation with other clicks' errors. Serves `two_sets.SetErrors`."""

    session: int
    capture_unix_ns: int
    camera_lat_deg: float
    camera_lon_deg: float
    camera_height_m: float
    R_enu_cam: Array  # (3, 3)
    common_cov: Array  # (9, 9)
    shared: SharedErrors
    offset_enu_m: Array  # (3,) the answer, from the camera
    between_features: float  # one sigma of the relative inverse depth, as in `locate.ErrorParts`
    feature_noise: float
    pointing_cov_m2: Array  # (3, 3), what the pointing error adds

    @classmethod
    def of(cls, s: FeatureSet, fix: Fix, uv_px: ArrayLike, pointing_px: float, locator: Locator) -> ClickErrors:
        """The errors of an answered click on a set. Raises InputError if the set does not answer it."""
        parts = locator.error_parts(uv_px)
        if parts is None:
            raise InputError("this set does not answer this click")
        D = pointing_px * parts.by_pixel_m
        return cls(
            s.session, s.capture_unix_ns, s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m,
            s.R_enu_cam, s.common_cov, s.shared, fix.offset_enu_m,
            parts.between_features, parts.feature_noise, D @ D.T,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """JSON; the arrays as one text (`ARRAYS`), a tenth of what lists of numbers take to read."""
        e = self.shared
        arrays = {
            "R_enu_cam": self.R_enu_cam, "common_cov": self.common_cov, "by_nuisance": e.by_nuisance,
            "alignment_sigma": e.alignment_sigma, "span_s": np.array(e.span_s), "offset_enu_m": self.offset_enu_m,
            "pointing_cov_m2": self.pointing_cov_m2,
        }  # fmt: skip
        flat = np.concatenate([np.asarray(arrays[name], np.float64).ravel() for name in ARRAYS])
        return {
            "session": self.session,
            "capture_unix_ns": self.capture_unix_ns,
            "camera_lat_deg": self.camera_lat_deg,
            "camera_lon_deg": self.camera_lon_deg,
            "camera_height_m": self.camera_height_m,
            "position_time_s": e.position_time_s,
            "attitude_time_s": e.attitude_time_s,
            "between_features": self.between_features,
            "feature_noise": self.feature_noise,
            "arrays_f64le_base64": base64.b64encode(flat.astype("<f8").tobytes()).decode("ascii"),
        }

    @classmethod
    def from_dict(cls, content: object) -> ClickErrors:
        """Raises InputError."""
        r = Reader(content, "errors")
        named = r.packed("arrays_f64le_base64", ARRAYS)
        first, last = (float(v) for v in named["span_s"])
        R, offset = named["R_enu_cam"], named["offset_enu_m"]
        if not (-1e7 <= first <= last <= 1e7):
            raise InputError("errors: span_s must not end before it begins")
        if np.max(np.abs(R @ R.T - np.eye(3))) > 1e-3:
            raise InputError("errors: R_enu_cam is no rotation")
        if not float((R.T @ offset)[2]) > 0.0 or np.max(np.abs(offset)) > 1e6:
            raise InputError("errors: offset_enu_m lies behind the camera, or too far")
        if np.max(np.abs(named["by_nuisance"])) > 1e6 or np.min(named["alignment_sigma"]) < 0.0:
            raise InputError("errors: by_nuisance and alignment_sigma cannot be")
        shared = SharedErrors(
            named["by_nuisance"], r.number("position_time_s", 0.0, 1e9), r.number("attitude_time_s", 0.0, 1e9),
            named["alignment_sigma"], (first, last),
        )  # fmt: skip
        return cls(
            r.whole("session"), r.whole("capture_unix_ns"), r.latitude("camera_lat_deg"), r.longitude("camera_lon_deg"),
            r.number("camera_height_m", -1e6, 1e6), R, r.checked("common_cov", named["common_cov"]), shared, offset,
            r.number("between_features", 0.0, 1e3), r.number("feature_noise", 0.0, 1e3),
            r.checked("pointing_cov_m2", named["pointing_cov_m2"]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PinClick:
    """One position of a pin: a click with its answer; or one that was entered, which has no picture.

    Heights are None where they are not known, the covariance where the accuracy is not. `covariance_enu_m2` is the
    answer's, without the pointing error. `capture_unix_ns`: when the thing was seen; None where that is not known.
    """

    lat_deg: float
    lon_deg: float
    height_ellipsoid_m: float | None
    height_amsl_m: float | None
    covariance_enu_m2: Array | None  # (3, 3)
    who: str
    clicked_unix_ns: int
    method: str
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    vehicle: str = ""
    session: int = 0
    frame: int | None = None
    u_px: float | None = None
    v_px: float | None = None
    capture_unix_ns: int | None = None
    errors: ClickErrors | None = None
    above_ground_m: float | None = None  # of what was measured by itself, and its one sigma
    sigma_above_ground_m: float | None = None
    unmeasured: str = ""  # why it was not, where that was asked for

    @classmethod
    def of(
        cls,
        feature_set: FeatureSet,
        fix: Fix,
        uv_px: ArrayLike,
        *,
        who: str = "",
        clicked_unix_ns: int | None = None,
        pointing_px: float = POINTING_PX,
        locator: Locator | None = None,
    ) -> PinClick:
        """A click that was answered. `pointing_px`: one sigma of the pointing, in pixels of the set's camera."""
        u, v = (float(c) for c in np.asarray(uv_px, float))
        errors = ClickErrors.of(feature_set, fix, (u, v), pointing_px, locator or Locator(feature_set))
        return cls(
            fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m, fix.height_amsl_m, fix.covariance_enu_m2,
            who, time.time_ns() if clicked_unix_ns is None else clicked_unix_ns, fix.method,
            vehicle=fix.vehicle, session=feature_set.session, frame=fix.frame, u_px=u, v_px=v,
            capture_unix_ns=fix.capture_unix_ns, errors=errors, above_ground_m=fix.above_ground_m,
            sigma_above_ground_m=fix.sigma_above_ground_m, unmeasured=fix.unmeasured,
        )  # fmt: skip

    @classmethod
    def entered(
        cls,
        lat_deg: float,
        lon_deg: float,
        *,
        height_amsl_m: float | None = None,
        height_ellipsoid_m: float | None = None,
        sigma_m: float | None = None,
        sigma_height_m: float | None = None,
        who: str = "",
        clicked_unix_ns: int | None = None,
        seen_unix_ns: int | None = None,
    ) -> PinClick:
        """A position that was typed or read from a file. `sigma_m` along east and along north; None: not known.

        `clicked_unix_ns`: when it was entered (default: now). `seen_unix_ns`: when the thing was seen, if known.

        Raises InputError for a coordinate that cannot be.
        """
        covariance = None
        if sigma_m is not None:
            if not (0.0 < sigma_m < 1e6 and (sigma_height_m is None or 0.0 < sigma_height_m < 1e6)):
                raise InputError(f"a sigma of {sigma_m:g} m (height {sigma_height_m}) must be above 0")
            height = UNKNOWN_HEIGHT_SIGMA_M if sigma_height_m is None else sigma_height_m
            covariance = np.diag([sigma_m**2, sigma_m**2, height**2])
        named = {
            "lat_deg": lat_deg, "lon_deg": lon_deg, "height_ellipsoid_m": height_ellipsoid_m,
            "height_amsl_m": height_amsl_m, "who": who, "capture_unix_ns": seen_unix_ns,
            "clicked_unix_ns": time.time_ns() if clicked_unix_ns is None else clicked_unix_ns,
        }  # fmt: skip
        r = Reader(named, "click")
        return cls(
            r.latitude("lat_deg"), r.longitude("lon_deg"),
            r.maybe("height_ellipsoid_m", r.height), r.maybe("height_amsl_m", r.height), covariance,
            r.text("who", MAX_WHO), r.whole("clicked_unix_ns"), ENTERED,
            capture_unix_ns=r.maybe("capture_unix_ns", r.whole),
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "lat_deg": self.lat_deg,
            "lon_deg": self.lon_deg,
            "height_ellipsoid_m": self.height_ellipsoid_m,
            "height_amsl_m": self.height_amsl_m,
            "covariance_enu_m2": None if self.covariance_enu_m2 is None else self.covariance_enu_m2.tolist(),
            "who": self.who,
            "clicked_unix_ns": self.clicked_unix_ns,
            "method": self.method,
            "vehicle": self.vehicle,
            "session": self.session,
            "frame": self.frame,
            "u_px": self.u_px,
            "v_px": self.v_px,
            "capture_unix_ns": self.capture_unix_ns,
            "errors": None if self.errors is None else self.errors.to_dict(),
            "above_ground_m": self.above_ground_m,
            "sigma_above_ground_m": self.sigma_above_ground_m,
            "unmeasured": self.unmeasured,
        }

    @classmethod
    def from_dict(cls, content: object) -> PinClick:
        """Raises InputError."""
        r = Reader(content, "click")
        has_errors = r.get("errors") is not None
        return cls(
            r.latitude("lat_deg"), r.longitude("lon_deg"),
            r.maybe("height_ellipsoid_m", r.height), r.maybe("height_amsl_m", r.height),
            r.maybe("covariance_enu_m2", lambda name: r.covariance(name, 3)),
            r.text("who", MAX_WHO), r.whole("clicked_unix_ns"), r.text("method", 40), r.identity("id"),
            r.text("vehicle", MAX_WHO), r.whole("session"), r.maybe("frame", r.whole),
            r.maybe("u_px", r.pixel), r.maybe("v_px", r.pixel), r.maybe("capture_unix_ns", r.whole),
            ClickErrors.from_dict(r.get("errors")) if has_errors else None,
            r.maybe("above_ground_m", r.height), r.maybe("sigma_above_ground_m", lambda name: r.number(name, 0.0, 1e5)),
            r.maybe("unmeasured", lambda name: r.text(name, MOST_CHARACTERS)) or "",
        )  # fmt: skip


UNKNOWN_HEIGHT_SIGMA_M = 1e4  # of an entered position whose height's accuracy is not known


@dataclass(frozen=True, eq=False)
class Pin:
    """A thing that was found. Servers that share it agree on its number, once each has received it.

    `was`: other numbers that it had, by which somebody may have named it on the radio. `stamps`: of parts that were
    changed since it was made (`versions`).
    """

    id: str
    number: int
    name: str
    note: str
    category: Category
    who: str
    created_unix_ns: int
    modified_unix_ns: int
    modified_by: str
    clicks: tuple[PinClick, ...] = ()
    is_deleted: bool = False
    was: tuple[int, ...] = ()
    stamps: Mapping[str, Stamp] = field(default_factory=dict)

    def numbered(self, number: int, was: Iterable[int]) -> Pin:
        """The pin with a number, and others that it had next to those that are known."""
        before = dict.fromkeys((*self.was, *was))
        return replace(self, number=number, was=tuple(n for n in before if n and n != number)[:MOST_FORMER])

    @property
    def seen_unix_ns(self) -> int | None:
        """The moment when the thing was seen last; None where no click states a time."""
        return max((c.capture_unix_ns for c in self.clicks if c.capture_unix_ns is not None), default=None)

    def to_dict(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "number": self.number,
            "name": self.name,
            "note": self.note,
            "category": self.category.value,
            "who": self.who,
            "created_unix_ns": self.created_unix_ns,
            "modified_unix_ns": self.modified_unix_ns,
            "modified_by": self.modified_by,
            "clicks": [click.to_dict() for click in self.clicks],
            "is_deleted": self.is_deleted,
            "was": list(self.was),
            "stamps": {part: list(stamp) for part, stamp in sorted(self.stamps.items())},
        }

    @classmethod
    def from_dict(cls, content: object) -> Pin:
        """Raises InputError."""
        r = Reader(content, "pin")
        clicks = tuple(PinClick.from_dict(click) for click in r.list("clicks", MAX_CLICKS))
        if len({click.id for click in clicks}) != len(clicks):
            raise InputError("pin: two of its clicks have the same id")
        modified_unix_ns = r.whole("modified_unix_ns")
        return cls(
            r.identity("id"), r.whole("number"), r.text("name", MAX_NAME), r.text("note", MAX_NOTE),
            category_of(r.text("category", 40)), r.text("who", MAX_WHO), r.whole("created_unix_ns"),
            modified_unix_ns, r.text("modified_by", MAX_WHO), clicks, r.flag("is_deleted"),
            r.wholes("was", MOST_FORMER), r.stamps("stamps", MAX_STAMPS, MAX_WHO, modified_unix_ns),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Tie:
    """A click on a place whose coordinate is known: what the session's errors are there and then.

    `height_m` in `datum` ("amsl" or "ellipsoid"), None where only the horizontal place is known. Sigmas are one sigma:
    along east and along north, and of the height.
    """

    click: PinClick
    lat_deg: float
    lon_deg: float
    height_m: float | None
    datum: str
    sigma_m: float
    sigma_height_m: float | None
    name: str = ""
    who: str = ""
    created_unix_ns: int = 0
    id: str = field(default_factory=lambda: uuid.uuid4().hex)

    def to_dict(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "click": self.click.to_dict(),
            "lat_deg": self.lat_deg,
            "lon_deg": self.lon_deg,
            "height_m": self.height_m,
            "datum": self.datum,
            "sigma_m": self.sigma_m,
            "sigma_height_m": self.sigma_height_m,
            "name": self.name,
            "who": self.who,
            "created_unix_ns": self.created_unix_ns,
        }

    @classmethod
    def from_dict(cls, content: object) -> Tie:
        """Raises InputError, also where the click's height is not known in the place's datum."""
        r = Reader(content, "tie")
        click = PinClick.from_dict(r.get("click"))
        datum = r.text("datum", 20)
        if datum not in ("amsl", "ellipsoid"):
            raise InputError(f"tie: datum {datum!r} must be amsl or ellipsoid")
        height = r.maybe("height_m", r.height)
        sigma_height = r.maybe("sigma_height_m", lambda name: r.number(name, 1e-3, 1e5))
        if click.errors is None or click.covariance_enu_m2 is None:
            raise InputError("tie: its click must be one on a picture")
        if (height is None) != (sigma_height is None):
            raise InputError("tie: a height and its sigma go together")
        if height is not None and (click.height_amsl_m if datum == "amsl" else click.height_ellipsoid_m) is None:
            raise InputError(f"tie: the click's height ({datum}) is not known; tie without a height")
        return cls(
            click, r.latitude("lat_deg"), r.longitude("lon_deg"), height, datum, r.number("sigma_m", 1e-3, 1e5),
            sigma_height, r.text("name", MAX_NAME), r.text("who", MAX_WHO), r.whole("created_unix_ns"),
            r.identity("id"),
        )  # fmt: skip


def to_text(content: Mapping[str, Any]) -> str:
    """The content of a pin or a tie as it is stored, shared and compared. Raises ValueError for what is not finite."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False)


def category_of(word: str) -> Category:
    """Raises InputError for a word that is none."""
    try:
        return Category(word)
    except ValueError as error:
        words = ", ".join(category.value for category in Category)
        raise InputError(f"category {word[:40]!r} must be one of {words}") from error


def new_pin(
    number: int, clicks: tuple[PinClick, ...], name: str, note: str, category: Category, who: str, now_ns: int
) -> Pin:
    """A pin with an id of its own, checked. Raises InputError."""
    made = Pin(uuid.uuid4().hex, number, name, note, category, who, now_ns, now_ns, who, clicks)
    return check_texts(made)


def check_texts(pin: Pin) -> Pin:
    """The pin, if its texts can be stored. Raises InputError."""
    texts: Mapping[str, Any] = {"name": pin.name, "note": pin.note, "who": pin.who, "modified_by": pin.modified_by}
    r = Reader(texts, "pin")
    for name, most in (("name", MAX_NAME), ("note", MAX_NOTE), ("who", MAX_WHO), ("modified_by", MAX_WHO)):
        r.text(name, most)
    return pin
