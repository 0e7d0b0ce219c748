"""Files that people bring, damaged: each reader takes them or refuses them in a line, and soon."""

import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from contract.fleet import Fleet, read_fleet
from ground.formats.documents import read_pins_of
from ground.seen.area import read_sectors
from onboard.config.schema import parse_config
from onboard.estimation.boresight import Alignment
from onboard.events.types import PositionFix
from onboard.telemetry.geo_reader import read_geo
from onboard.telemetry.log_files import read_log

CAMERA = Camera.from_field_of_view(640, 480, 60.0)
SRT = (
    "1\n00:00:0{0},000 --> 00:00:0{0},500\n2023-05-12 10:01:0{0}.000\n"
    "[latitude: 47.1] [longitude: 8.2] [abs_alt: 500]\n\n"
)
GPX = '<gpx><wpt lat="47.3" lon="8.6"><ele>430</ele><name>B</name></wpt></gpx>'
KML = (
    "<kml><Document><Placemark><name>B</name><Point><altitudeMode>absolute</altitudeMode><coordinates>8.6,47.3,430"
    "</coordinates></Point></Placemark></Document></kml>"
)
AREA = '{"type": "Polygon", "coordinates": [[[8.5, 47.2], [8.6, 47.2], [8.6, 47.3], [8.5, 47.2]]]}'
POINT = '{"type": "Feature", "geometry": {"type": "Point", "coordinates": [8.6, 47.3, 430]}, "properties": {}}'
COT = '<event uid="a" type="a-u-G" time="2026-01-02T03:04:05Z"><point lat="1" lon="2" hae="3" ce="4" le="5"/></event>'
SEEDS = {
    "camera.json": CAMERA.to_json(),
    "alignment.json": Alignment(0.02, 0.1, 20.0, 0.1, 0.03, camera=CAMERA).to_json(),
    "fleet.toml": Fleet(aircraft=("uav-1",)).to_toml(),
    "config.toml": "[camera]\nrate_hz = 30.0\n[telemetry]\nsystem = 1\n[link]\nlisten = ['tcp/127.0.0.1:7447']\n",
    "area.geojson": AREA,
    "a.geojson": POINT,
    "a.gpx": GPX,
    "a.kml": KML,
    "a.cot": COT,
    "places.csv": "name,lat,lon,height_amsl_m,ce90_m\nB,47.3,8.6,430,3\n",
    "a.srt": "".join(SRT.format(k) for k in range(3)),
    "log.csv": "unix_time_s,lat_deg,lon_deg,height_amsl_m\n1700000000.5,47.1,8.2,500\n1700000001.5,47.1,8.2,501\n",
}
MRK = "{0}\t27024{0}.350537\t[2097]\t -9,N\t 12,E\t 193,V\t47.1,Lat\t8.2,Lon\t500.5,Ellh\t0.010, 0.009, 0.024\t50,Q\n"
LOGS = {
    "log.airdata": "time(millisecond),datetime(utc),latitude,longitude,altitude_above_seaLevel(feet),"
    "gimbal_pitch(degrees)\n0,2026-06-01 10:00:00,47.1,8.2,1650,-60\n100,2026-06-01 10:00:00,47.10001,8.2,1650,-60\n",
    "log.dji": "sep=;\nCUSTOM.date [local];CUSTOM.updateTime [local];OSD.latitude;OSD.longitude;OSD.altitude [m]\n"
    "6/1/2026;7:05:08.97 PM;47,1;8,2;500\n6/1/2026;7:05:09.07 PM;47,10001;8,2;500\n",
    "log.gpx": '<?xml version="1.0"?><gpx><trk><trkseg><trkpt lat="47.1" lon="8.2"><ele>500</ele><hdop>1.2</hdop>'
    "<time>2026-06-01T10:00:00Z</time></trkpt></trkseg></trk></gpx>",
    "log.pos": "%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
    "2026/06/01 10:00:00.000  47.1 8.2 500.5 5 12 0.4 0.4 0.6\n2421 122400.0 47.1 8.2 500.5 5 12 0.4 0.4 0.6\n",
    "log.mrk": MRK.format(1) + MRK.format(2),
    "log.ass": "[Script Info]\n[Events]\nDialogue: 0,0:00:01.00,0:00:02.00,Default,,0,0,0,,2026.6.1 10:00:01\\N"
    "GPS(E: 8.2, N: 47.1, 500.5m) ReH:50.0\n",
    "log.nmea": "$GPRMC,100000.00,A,4700.0000,N,00800.0000,E,9.7,90.0,010626,,,A*60\n"
    "$GPGGA,100000.00,4700.0000,N,00800.0000,E,1,12,0.8,500.0,M,47.0,M,,*6B\n",
}
SEEDS |= LOGS | {"geo.txt": "EPSG:4326\nA.jpg 8.2 47.1 500 0 0 0 2.5 5.0\n"}
ODD = (
    "1e999",
    "-1e999",
    "nan",
    "NaN",
    "9" * 30,
    "9" * 400,
    "9" * 5000,
    "-0",
    "true",
    "null",
    "[]",
    "{}",
    '""',
    "\0",
    "é",
    "",
)


def _fed(name: str, text: str, path: Path) -> None:
    """To the reader of this kind of file."""
    path.write_text(text, encoding="utf-8", errors="replace")
    readers: dict[str, Callable[[], object]] = {
        "camera.json": lambda: Camera.from_json(path),
        "alignment.json": lambda: Alignment(0.02, 0.1, 20.0, 0.1, 0.03, camera=CAMERA).restore(text),
        "fleet.toml": lambda: read_fleet(path),
        "config.toml": lambda: parse_config(text),
        "area.geojson": lambda: read_sectors(path),
        "a.srt": lambda: _read_log(path),
        "log.csv": lambda: _read_log(path),
        "geo.txt": lambda: read_geo(path),
        **{log: lambda: _read_log(path) for log in LOGS},
    }
    readers.get(name, lambda: _read_pins(name, text))()


def _read_log(path: Path) -> None:
    log = read_log(path)
    assert len(log.events) < 200
    for event in log.events:
        if isinstance(event, PositionFix):
            assert all(math.isfinite(x) for x in (event.lat_deg, event.lon_deg, event.height_amsl_m))


def _read_pins(name: str, text: str) -> None:
    for pin in read_pins_of(name, text.encode("utf-8", "replace")).pins:
        json.dumps(pin.to_dict(), allow_nan=False)


@pytest.mark.parametrize("name", SEEDS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused_in_a_line_and_soon(name: str, tmp_path: Path, data: st.DataObject) -> None:
    text = SEEDS[name]
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        end = min(at + data.draw(st.integers(0, 12)), len(text))
        text = text[:at] + data.draw(st.sampled_from((*ODD, text[at:end] * 2))) + text[end:]
    began_s = time.thread_time()
    try:
        _fed(name, text, tmp_path / name)
    except (InputError, ConfigError) as error:
        assert len(str(error).splitlines()) <= 1
    assert time.thread_time() - began_s < 2.0


@pytest.mark.parametrize("name", SEEDS)
def test_the_undamaged_file_is_read(name: str, tmp_path: Path) -> None:
    _fed(name, SEEDS[name], tmp_path / name)
