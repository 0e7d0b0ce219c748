"""Cursor on Target, version 2.0: marks, aircraft, followed things as XML events, as TAK takes them; markers read back.

`ce` and `le` are 90 % figures and `remarks` state so: the schema's text calls them one sigma, ATAK shows CE90, and
a reader that takes a 90 % figure for one sigma is off on the safe side. What is not known is 9999999, and a mark
without a position makes no event.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np

from contract.answer import Fix
from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS, ce90_m, le90_m
from contract.errors import InputError
from contract.feature_set import FeatureSet, HeightDatum
from contract.locate import Locator
from contract.mavlink_camera.messages import fields_of_view_deg
from contract.rotations import R_ENU_NED, R_GIMBAL_CAM, euler_from_matrix
from contract.track import TrackReport, TrackState
from contract.xml_text import element
from ground.formats.imported import Imported, entered_pin, unix_ns_of
from ground.formats.mark import MACHINE, Mark
from ground.formats.xml_text import parsed
from ground.pins.model import Pin

UNKNOWN = "9999999.0"
SPOT = "b-m-p-s-m"
# Points but those where a sensor looks, casualties, emergencies, things on ground or water.
_MARKER = re.compile(r"b-m-p(?!-s-p-i)(-|$)|b-r-|b-a-o-|a-.-[GSU]")
_DELETED = "t-x-d-d"  # what it links to
_DECLARATION = re.compile(r"<\?xml[^>]*\?>")
AIRCRAFT = "a-f-A-M-F-Q"  # friendly, airborne, military-style code for an unmanned aircraft: what TAK shows as a drone
INTEREST = "b-m-p-s-p-i"  # a sensor's: where it looks, and what a program found and no person has confirmed
FOLLOWED = "a-u-G"  # something on the ground that no person has identified
OURS = "__pointclick"  # a pin's own fields; programs ignore details that are unknown to them
# Colours of ATAK's spot map, as signed ARGB.
_UNCONFIRMED = -65281  # magenta
_COLOURS = {"person": -35072, "vehicle": -16776961, "fire": -65536, "hazard": -256, "poi": -1}


def event(mark: Mark, now_unix_ns: int, stale_s: float, is_kept: bool = False) -> str | None:
    """One line of XML; None for a mark without a position: a refusal is never sent as a point.

    `is_kept`: whoever receives it keeps it, as a file's; otherwise it is gone once no one sends it.
    """
    if not mark.is_placed:
        return None
    lat, lon = mark.position
    kind, how = (INTEREST, "m-r") if mark.method == MACHINE else (SPOT, "h-g-i-g-o")
    root = _event(f"pointclick.{mark.id}", kind, how, now_unix_ns, mark.time_unix_ns, stale_s)
    _point(root, lat, lon, mark.height_ellipsoid_m, mark.ce90_m, mark.le90_m)
    detail = element(root, "detail")
    if is_kept:
        element(detail, "archive")
    element(detail, "contact", callsign=mark.title[:100])
    colour = str(_UNCONFIRMED if kind == INTEREST else _COLOURS.get(mark.category, _COLOURS["poi"]))
    element(detail, "usericon", iconsetpath=f"COT_MAPPING_SPOTMAP/{SPOT}/{colour}")
    element(detail, "color", argb=colour)
    element(
        detail, "precisionlocation", altsrc="???" if mark.height_ellipsoid_m is None else "CALC", geopointsrc="CALC"
    )
    seen = f"seen {mark.time_text}" if mark.time_text else ""
    parts = [MACHINE if kind == INTEREST else mark.category, _accuracy(mark), mark.note, seen, mark.vehicle, mark.who]
    element(detail, "remarks", "; ".join(part for part in parts if part))
    element(detail, OURS, name=mark.name, note=mark.note, category=mark.category)
    return ET.tostring(root, encoding="unicode")


def aircraft_events(s: FeatureSet, now_unix_ns: int, stale_s: float) -> list[str]:
    """The aircraft where its picture was taken, with its camera's view, and what is in the middle of that, if it is
    ground; nothing for a set without a position.
    """
    if not s.is_ok:
        return []
    middle = Locator(s).locate((0.5 * (s.camera.width_px - 1), 0.5 * (s.camera.height_px - 1)))
    aircraft = _aircraft_event(s, middle if isinstance(middle, Fix) else None, now_unix_ns, stale_s)
    return [aircraft, *([_interest_event(s, middle, now_unix_ns, stale_s)] if isinstance(middle, Fix) else [])]


def _aircraft_event(s: FeatureSet, middle: Fix | None, now_unix_ns: int, stale_s: float) -> str:
    root = _event(_uid(s), AIRCRAFT, "m-g", now_unix_ns, s.capture_unix_ns, stale_s)
    height: float | None = s.camera_height_m
    if s.height_datum is HeightDatum.AMSL:
        height = None if math.isnan(s.undulation_m) else s.camera_height_m + s.undulation_m
    ce, le = ce90_m(s.common_cov[:2, :2]), le90_m(float(np.sqrt(max(s.common_cov[2, 2], 0.0))))
    _point(root, s.camera_lat_deg, s.camera_lon_deg, height, ce, le)
    detail = element(root, "detail")
    element(detail, "contact", callsign=s.vehicle)
    _sensor(detail, s, middle)
    datum = "AMSL" if s.height_datum is HeightDatum.AMSL else "above the WGS84 ellipsoid"
    element(
        detail, "remarks",
        f"camera of {s.vehicle}; +-{ce:.1f} m (CE90), height {s.camera_height_m:.1f} m {datum} +-{le:.1f} m (LE90)",
    )  # fmt: skip
    return ET.tostring(root, encoding="unicode")


def _uid(s: FeatureSet) -> str:
    return f"pointclick.{s.vehicle}"


def _sensor(detail: ET.Element, s: FeatureSet, middle: Fix | None) -> None:
    """The camera's view, as TAK draws it: angles in degrees, azimuth from true north to where it looks (straight down:
    to the picture's top), elevation above the horizon; the range in metres to what is in its middle, where that is
    known. A lens that is not calibrated out to its edges has no view.
    """
    across, upright = fields_of_view_deg(s.camera)
    if math.isnan(across) or math.isnan(upright):
        return
    roll, elevation, azimuth = np.degrees(euler_from_matrix(R_ENU_NED.T @ s.R_enu_cam @ R_GIMBAL_CAM.T)).tolist()
    range_m = {} if middle is None else {"range": f"{float(np.linalg.norm(middle.offset_enu_m)):.1f}"}
    element(
        detail, "sensor", azimuth=f"{azimuth % 360.0:.2f}", elevation=f"{elevation:.2f}", roll=f"{roll:.2f}",
        fov=f"{across:.2f}", vfov=f"{upright:.2f}", north="0", type="r-e", version="0.6", model="camera", **range_m,
    )  # fmt: skip


def _interest_event(s: FeatureSet, middle: Fix, now_unix_ns: int, stale_s: float) -> str:
    """The event of what is in the middle of an aircraft's picture, linked to the aircraft's own."""
    root = _event(f"{_uid(s)}.SPI1", INTEREST, "m-g", now_unix_ns, s.capture_unix_ns, stale_s)
    p = middle.place
    ce_m = ce90_m(p.ellipse.covariance_en_m2)
    _point(root, p.lat_deg, p.lon_deg, p.height_ellipsoid_m, ce_m, le90_m(p.sigma_height_m))
    detail = element(root, "detail")
    element(detail, "contact", callsign=f"{s.vehicle} view"[:100])
    element(detail, "link", uid=_uid(s), type=AIRCRAFT, relation="p-p", production_time=root.get("start", ""))
    element(detail, "remarks", f"middle of the picture of {s.vehicle}; +-{ce_m:.1f} m (CE90)")
    return ET.tostring(root, encoding="unicode")


def track_event(report: TrackReport, now_unix_ns: int, stale_s: float) -> str | None:
    """The event of a followed thing, with its speed and course; None without a place, or once it is lost.

    `time` and `start` are those of the last look, from which `stale_s` count.
    """
    p, c = report.place, report.course
    if p is None or report.state is TrackState.LOST:
        return None
    uid = f"pointclick.{report.vehicle}.{report.session}.track.{report.number}"
    seen_ns = min(report.seen_unix_ns, now_unix_ns)
    root = _event(uid, FOLLOWED, "m-r", seen_ns, seen_ns, stale_s)
    _point(
        root, p.lat_deg, p.lon_deg, p.height_ellipsoid_m, ce90_m(p.ellipse.covariance_en_m2), le90_m(p.sigma_height_m)
    )
    detail = element(root, "detail")
    element(detail, "contact", callsign=f"{report.vehicle} track {report.number}"[:100])
    if c is not None and c.course_deg is not None:
        element(
            detail, "track", course=f"{c.course_deg:.1f}", speed=f"{c.speed_m_s:.2f}",
            eCourse=f"{c.sigma_course_deg:.1f}", eSpeed=f"{c.sigma_speed_m_s:.2f}",
        )  # fmt: skip
    elif c is not None:
        element(detail, "track", speed="0.00", eSpeed=f"{c.sigma_speed_m_s:.2f}")
    element(detail, "remarks", f"followed by {report.vehicle}: {report.state_text}; {report.course_text}")
    return ET.tostring(root, encoding="unicode")


def read(data: bytes, who: str = "", now_unix_ns: int = 0) -> Imported:
    """Markers of one event or many, one after the other or below a root. Raises InputError for what is no event.

    Of a marker that was sent again the newest event counts, and one that was deleted is none any more. Aircraft,
    drawings, chat, where a camera looks and what else is no place on the ground are left out.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"not Cursor on Target in UTF-8 ({error})") from error
    root = parsed(f"<events>{_DECLARATION.sub('', text)}</events>".encode(), "Cursor on Target")
    events = list(root.iter("event"))
    if not events:
        raise InputError("not Cursor on Target: no event in it")
    out, newest = Imported(), dict[str, ET.Element]()
    for number, found in enumerate(sorted(events, key=lambda event: unix_ns_of(event.get("time", "")) or 0)):
        if found.get("type") == _DELETED:
            for link in found.iter("link"):
                newest.pop(link.get("uid", ""), None)
        elif _MARKER.match(found.get("type", "")) is None:
            out.left_out += 1
        else:
            newest[found.get("uid") or f"event {number}"] = found
    for uid, found in newest.items():
        out.take(f"event {uid[:40]!r}", partial(_pin, found, who, now_unix_ns))
    return out.checked()


def _pin(found: ET.Element, who: str, now_unix_ns: int) -> Pin:
    """A marker's. Raises ValueError for what is no number, InputError for no place."""
    point, detail = found.find("point"), found.find("detail")  # its own: a detail may hold others, as shapes do
    if point is None:
        raise InputError("no point in it")
    parts = {} if detail is None else {node.tag: node for node in reversed(detail)}
    hae, ce, le = (_known(float(point.get(key, UNKNOWN))) for key in ("hae", "ce", "le"))
    ours, contact, remarks = (parts.get(name, ET.Element(name)) for name in (OURS, "contact", "remarks"))
    return entered_pin(
        lat_deg=float(point.get("lat", "")), lon_deg=float(point.get("lon", "")), height_ellipsoid_m=hae,
        sigma_m=None if ce is None else ce / CE90_SIGMAS, sigma_height_m=None if le is None else le / LE90_SIGMAS,
        name=ours.get("name", contact.get("callsign")), note=ours.get("note", remarks.text),
        category=ours.get("category"), who=who, time_text=found.get("start", ""), now_unix_ns=now_unix_ns,
    )  # fmt: skip


def _known(value: float) -> float | None:
    """A height or an accuracy; None for the numbers that mean unknown, 9999999 or with fewer nines, and for 0, which
    other programs write for it.
    """
    return value if 0.0 < abs(value) < 99_999.0 else None


def _accuracy(mark: Mark) -> str:
    return "CE90 not known" if mark.ce90_m is None else mark.accuracy_text


def _event(uid: str, kind: str, how: str, now_unix_ns: int, start_unix_ns: int | None, stale_s: float) -> ET.Element:
    now = _time(now_unix_ns)
    # A picture of an aircraft whose clock is ahead of ours has not begun later than now.
    start = _time(min(start_unix_ns, now_unix_ns)) if start_unix_ns is not None else now
    stale = _time(now_unix_ns + round(stale_s * 1e9))
    return element(None, "event", version="2.0", uid=uid, type=kind, how=how, time=now, start=start, stale=stale)


def _point(
    root: ET.Element, lat_deg: float, lon_deg: float, hae_m: float | None, ce_m: float | None, le_m: float | None
) -> None:
    element(
        root, "point", lat=f"{lat_deg:.9f}", lon=f"{lon_deg:.9f}", hae=_figure(hae_m), ce=_figure(ce_m),
        le=_figure(le_m if hae_m is not None else None),
    )  # fmt: skip


def _figure(value: float | None) -> str:
    return UNKNOWN if value is None or not abs(value) < 9_999_999.0 else f"{value:.2f}"


def _time(unix_ns: int) -> str:
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=min(unix_ns, 2**62) // 1000)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z"
