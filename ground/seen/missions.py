"""Rows to fly as files: QGroundControl's plan, the waypoint file of MAVLink (QGC WPL 110), and KML.

Plan: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html. Waypoints:
https://mavlink.io/en/file_formats/#mission_plain_text_file. Heights are above the place of take-off. Neither take-off
nor return is in the files: these are the pilot's.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable

from contract.xml_text import KML, document, element
from ground.seen.flight_rows import SPEED_M_S, FlightRows

NAV_WAYPOINT = 16  # MAV_CMD
GLOBAL, RELATIVE = 0, 3  # MAV_FRAME: height above the sea, above home
ABOVE_HOME = 1  # QGroundControl's altitude mode


def plan(rows: FlightRows) -> str:
    """QGroundControl's plan: JSON of version 1, its mission of version 2. By its speeds it computes the time."""
    points = _points(rows)
    items = [
        {
            "type": "SimpleItem", "command": NAV_WAYPOINT, "frame": RELATIVE, "autoContinue": True, "doJumpId": number,
            "params": [0, 0, 0, None, lat, lon, round(rows.height_m, 1)],
            "Altitude": round(rows.height_m, 1), "AltitudeMode": ABOVE_HOME, "AMSLAltAboveTerrain": None,
        }
        for number, (lat, lon) in enumerate(points, 1)
    ]  # fmt: skip
    mission = {
        "version": 2, "firmwareType": 0, "vehicleType": 0, "globalPlanAltitudeMode": ABOVE_HOME,
        "cruiseSpeed": SPEED_M_S, "hoverSpeed": SPEED_M_S, "plannedHomePosition": [*points[0], 0],
        "items": items,
    }  # fmt: skip
    content = {
        "fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": mission,
        "geoFence": {"circles": [], "polygons": [], "version": 2}, "rallyPoints": {"points": [], "version": 2},
    }  # fmt: skip
    return json.dumps(content, indent=1) + "\n"


def waypoints(rows: FlightRows) -> str:
    """MAVLink's plain text: item 0 is home, which an autopilot replaces by its own."""
    points = _points(rows)
    lines = [_line(0, GLOBAL, points[0], 0.0)]
    lines += [_line(number, RELATIVE, point, rows.height_m) for number, point in enumerate(points, 1)]
    return "\n".join(["QGC WPL 110", *lines]) + "\n"


def _line(number: int, frame: int, point: tuple[float, float], height_m: float) -> str:
    is_current = int(number == 0)
    at = f"{point[0]:.8f}", f"{point[1]:.8f}", f"{height_m:.1f}"
    values = [number, is_current, frame, NAV_WAYPOINT, 0, 0, 0, 0, *at, 1]
    return "\t".join(map(str, values))


def kml(rows: FlightRows) -> str:
    """The way as a line, above the ground."""
    ET.register_namespace("", KML)
    root = element(None, f"{{{KML}}}kml")
    place = element(element(root, f"{{{KML}}}Document"), f"{{{KML}}}Placemark")
    element(place, f"{{{KML}}}name", "rows over the gaps")
    element(place, f"{{{KML}}}description", rows.to_text())
    line = element(place, f"{{{KML}}}LineString")
    element(line, f"{{{KML}}}altitudeMode", "relativeToGround")
    corners = (f"{lon:.8f},{lat:.8f},{rows.height_m:.1f}" for lat, lon in _points(rows))
    element(line, f"{{{KML}}}coordinates", " ".join(corners))
    return document(root)


def _points(rows: FlightRows) -> list[tuple[float, float]]:
    return [(round(float(lat), 8), round(float(lon), 8)) for lat, lon in rows.points_deg]


FORMATS: dict[str, Callable[[FlightRows], str]] = {".plan": plan, ".waypoints": waypoints, ".kml": kml}
