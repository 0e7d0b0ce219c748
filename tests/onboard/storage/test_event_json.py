"""Events in a recording, and what Foxglove is shown of them: round trips and published schemas."""

import base64
import io
import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from PIL import Image

from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.locate import Locator
from onboard.events.types import (
    Attitude,
    FilterStatus,
    Frame,
    GimbalAttitude,
    GpsQuality,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)
from onboard.storage import foxglove_schemas
from onboard.storage.event_json import CHANNELS, NAV_EVENTS, event_json, event_schema, frame_event, nav_event
from onboard.storage.mcap_writer import SessionRecorder, encode_picture
from tests.contract.sets import plain_set

STAMPS = st.integers(0, 2**63 - 1)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
MAYBE = st.none() | NUMBERS
THREE, FOUR = st.tuples(NUMBERS, NUMBERS, NUMBERS), st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
EVENTS = st.one_of(
    st.builds(PositionFix, STAMPS, NUMBERS, NUMBERS, NUMBERS, st.none() | THREE, MAYBE),
    st.builds(GpsQuality, STAMPS, st.integers(0, 8), st.none() | st.integers(0, 99), MAYBE, MAYBE, MAYBE, MAYBE),
    st.builds(Attitude, STAMPS, FOUR, st.none() | THREE),
    st.builds(FilterStatus, STAMPS, st.booleans(), st.booleans()),
    st.builds(GimbalAttitude, STAMPS, FOUR, st.sampled_from(["vehicle", "earth"])),
    st.builds(RangeFinder, STAMPS, NUMBERS, THREE, MAYBE),
    st.builds(Zoom, STAMPS, NUMBERS, st.sampled_from(["times", "percent", "focal_px", "hfov_deg"])),
)


@given(EVENTS)
def test_an_event_comes_back_bit_for_bit_and_keeps_to_its_schema(event: NavEvent) -> None:
    written = event_json(event)
    back = nav_event(NAV_EVENTS[CHANNELS[type(event)]], written)
    assert back == event and type(back) is type(event)
    assert repr(back) == repr(event)  # -0.0 and 0.0 too
    name, schema = event_schema(type(event))
    assert name == f"pointclick.{type(event).__name__}"
    jsonschema.validate(json.loads(written), json.loads(schema))


@given(st.builds(Frame, STAMPS, st.integers(0, 2**32 - 1), st.none(), st.text(max_size=40)))
def test_a_frame_comes_back_with_its_name(frame: Frame) -> None:
    back, picture, _ = frame_event(event_json(frame))
    assert (back.stamp_ns, back.index, back.name) == (frame.stamp_ns, frame.index, frame.name)
    assert picture == "undecodable"


@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode), st.sampled_from(sorted(NAV_EVENTS)))
def test_what_is_no_event_is_refused(data: bytes, channel: str) -> None:
    with pytest.raises(InputError):
        nav_event(NAV_EVENTS[channel], data)
    with pytest.raises(InputError):
        frame_event(data)


@given(st.data())
def test_a_field_of_another_kind_is_named_and_one_that_is_new_is_passed_over(data: st.DataObject) -> None:
    event = data.draw(EVENTS)
    content = json.loads(event_json(event))
    kind = NAV_EVENTS[CHANNELS[type(event)]]
    assert nav_event(kind, json.dumps({**content, "added_later": 1}).encode()) == event
    field = data.draw(st.sampled_from(sorted(content)))
    with pytest.raises(InputError, match=field):
        nav_event(kind, json.dumps({**content, field: {"what": "ever"}}).encode())


def test_an_event_of_an_older_version_takes_defaults_for_what_it_lacks() -> None:
    old = b'{"stamp_ns":5,"q_ned_body":[1.0,0.0,0.0,0.0]}'
    assert nav_event(Attitude, old) == Attitude(5, (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="without q_ned_body"):
        nav_event(Attitude, b'{"stamp_ns":5}')


@pytest.mark.parametrize("size", [(64, 48), (33, 17)])
def test_lossless_pictures_are_lossless_and_jpeg_is_small(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, size, np.uint8)
    encoded, kind = encode_picture(image, "lossless")
    assert kind == "png" and np.array_equal(np.asarray(Image.open(io.BytesIO(encoded))), image)
    encoded, kind = encode_picture(image, "jpeg")
    assert kind == "jpeg" and Image.open(io.BytesIO(encoded)).size == size[::-1]
    assert encode_picture(image, "none") == (b"", "")


# Names and types of the fields as Foxglove publishes them (foxglove-sdk, schemas/jsonschema); the types that a viewer
# relies on, in our own words.
TIME = {"sec": int, "nsec": int}
PUBLISHED: dict[str, dict[str, Any]] = {
    "foxglove.LocationFix": {
        "timestamp": TIME,
        "frame_id": str,
        "latitude": float,
        "longitude": float,
        "altitude": float,
        "position_covariance": list,
        "position_covariance_type": int,
    },
    "foxglove.GeoJSON": {"geojson": str},
    "foxglove.CompressedImage": {"timestamp": TIME, "frame_id": str, "data": str, "format": str},
}


@pytest.fixture
def shown(tmp_path: Path) -> dict[str, list[dict[str, Any]]]:
    """What a viewer finds in a short session, by schema; every message keeps to the schema next to it."""
    path = tmp_path / "session.mcap"
    base = plain_set(50)
    with SessionRecorder(path, "uav-1", pictures="lossless") as out:
        for index in range(20):
            stamp_ns = base.capture_unix_ns + index * 100_000_000
            out.write_event(PositionFix(stamp_ns, -35.0, 149.0, 600.0))
            out.write_event(Frame(stamp_ns, index, np.full((48, 64), index, np.uint8)))
            moved = FeatureSet(**{**vars(base), "frame": index, "capture_unix_ns": stamp_ns})
            out.write_set(moved)
    found: dict[str, list[dict[str, Any]]] = {}
    with path.open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            if schema is not None:
                content = json.loads(message.data)
                jsonschema.validate(content, json.loads(schema.data))
                found.setdefault(schema.name, []).append(content)
    return found


def test_what_foxglove_shows_has_its_published_fields(shown: dict[str, list[dict[str, Any]]]) -> None:
    for name, fields in PUBLISHED.items():
        jsonschema.Draft202012Validator.check_schema(json.loads(foxglove_schemas.schema(name)))
        assert set(json.loads(foxglove_schemas.schema(name))["properties"]) == set(fields)
        assert json.loads(foxglove_schemas.schema(name))["title"] == name
        for message in shown[name]:
            assert set(message) == set(fields)
            for field, kind in fields.items():
                assert isinstance(message[field], dict if isinstance(kind, dict) else kind)
                if isinstance(kind, dict):
                    assert set(message[field]) == set(kind)


def test_views_come_at_their_own_rates_and_pictures_all(shown: dict[str, list[dict[str, Any]]]) -> None:
    assert len(shown["foxglove.LocationFix"]) == 20  # of vehicle and camera, every second of 20 each
    assert len(shown["foxglove.GeoJSON"]) == 2
    pictures = [base64.b64decode(message["data"]) for message in shown["foxglove.CompressedImage"]]
    assert [int(np.asarray(Image.open(io.BytesIO(data)))[0, 0]) for data in pictures] == list(range(20))


def test_features_on_the_map_are_where_a_click_finds_them() -> None:
    base = plain_set(50)
    collection = json.loads(json.loads(foxglove_schemas.features_on_the_map(base))["geojson"])
    points = [feature["geometry"]["coordinates"] for feature in collection["features"]]
    assert len(points) == 50
    locator = Locator(base)
    near = 0
    for (lon, lat, _), uv in zip(points, base.uv_px.tolist(), strict=True):
        answer = locator.locate((uv[0], uv[1]))
        if hasattr(answer, "lat_deg"):
            near += abs(answer.lat_deg - lat) < 1e-4 and abs(answer.lon_deg - lon) < 1e-4
    assert near > 40


def test_the_cameras_place_comes_with_its_covariance() -> None:
    base = plain_set(50)
    place = json.loads(foxglove_schemas.camera_location(base))
    np.testing.assert_allclose(
        np.reshape(place["position_covariance"], (3, 3)), np.asarray(base.common_cov)[:3, :3], rtol=1e-12
    )
    assert place["position_covariance_type"] == 3
    assert (place["latitude"], place["altitude"]) == (base.camera_lat_deg, base.camera_height_m)
