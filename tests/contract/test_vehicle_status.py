"""The status payload: small, plain, and nothing of it is used unchecked."""

import json
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.error_sources import Cause
from contract.errors import CorruptPayload, NewerPayload, WireError
from contract.vehicle_status import (
    MAX_BYTES,
    MAX_HEAT,
    MAX_LOOK,
    MAX_REASON,
    VehicleStatus,
    decode_status,
    encode_status,
)

FLYING = VehicleStatus(
    1_700_000_000.125, 1_700_000_000, "ok", "", 912.0, 29.9, 28.5, 27_312, 0.085, 97, 12, 3, True, 61.0
)
COUNTS = st.integers(0, 10**7)
STATUSES = st.builds(
    VehicleStatus,
    unix_s=st.floats(0, 4e9),
    session=st.integers(0, 2**32 - 1),
    state=st.sampled_from(["ok", "unsynchronised", "camera frozen"]),
    reason=st.text(max_size=200),
    up_s=st.floats(0, 1e7),
    camera_hz=st.floats(0, 240),
    ok_hz=st.floats(0, 240),
    frame=st.integers(-1, 2**32 - 1),
    delay_s=st.floats(0, 100),
    tracks=st.integers(0, 255),
    dropped=COUNTS,
    lost=COUNTS,
    recording=st.booleans(),
    cpu_c=st.none() | st.floats(-60, 150),
    follows=st.booleans(),
    looks=st.booleans(),
    look=st.text(max_size=100),
    heat=st.text(max_size=100),
    fix=st.none() | st.integers(-1, 255),
    satellites=st.none() | st.integers(0, 255),
    battery_percent=st.none() | st.integers(-128, 127),
    battery_v=st.none() | st.floats(0, 65.6),
    mode=st.text(max_size=30),
    shares=st.dictionaries(st.sampled_from(list(Cause)).map(str), st.integers(0, 100), max_size=3),
)


def changed(**values: object) -> bytes:
    content = json.loads(encode_status(FLYING)) | values
    return json.dumps({key: value for key, value in content.items() if value is not ...}).encode()


def test_a_status_comes_back_as_it_was() -> None:
    assert decode_status(encode_status(FLYING)) == FLYING


def test_a_usual_status_is_well_under_its_bound() -> None:
    assert 100 < len(encode_status(FLYING)) < 230
    budget = replace(FLYING, shares={"attitude": 55, "gpsnoise": 21, "mount": 15})
    assert len(encode_status(budget)) - len(encode_status(FLYING)) < 60
    assert decode_status(encode_status(budget)).fractions == {"attitude": 0.55, "gpsnoise": 0.21, "mount": 0.15}


def test_the_aircraft_s_own_state_costs_little_and_reads_in_plain_words() -> None:
    flying = replace(FLYING, fix=6, satellites=17, battery_percent=64, battery_v=22.14, mode="AUTO")
    back = decode_status(encode_status(flying))
    assert back == replace(flying, battery_v=22.1)
    assert 60 < len(encode_status(flying)) - len(encode_status(FLYING)) < 90
    assert (back.gps_words, back.battery_words) == ("RTK fixed, 17 satellites", "64 %, 22.1 V")
    assert (FLYING.gps_words, FLYING.battery_words) == ("", "")
    assert replace(FLYING, fix=0, satellites=0).gps_words == "no fix, 0 satellites"
    assert replace(FLYING, fix=9, battery_v=0.06).battery_words == "0.1 V"


def test_a_reason_is_worth_more_than_the_aircraft_s_own_state_and_that_more_than_shares() -> None:
    flying = replace(
        FLYING, fix=6, satellites=17, battery_percent=64, battery_v=22.1, mode="AUTO", shares={"mount": 60}
    )
    crowded = replace(flying, reason="x" * MAX_REASON, look="x" * MAX_LOOK)
    back = decode_status(encode_status(crowded))
    assert back.reason == crowded.reason and not back.shares
    assert (back.satellites, back.battery_percent, back.mode) == (None, 64, "AUTO")


def test_what_no_receiver_and_no_battery_can_have_is_left_out_and_not_sent() -> None:
    odd = replace(FLYING, fix=200, satellites=255, battery_percent=-1, battery_v=float(2**20))
    assert decode_status(encode_status(odd)) == FLYING


def test_a_long_reason_is_worth_more_than_shares() -> None:
    full = replace(
        FLYING,
        reason="x" * MAX_REASON,
        shares={"attitude": 55, "gpsnoise": 21, "mount": 15},
        dropped=10**9,
        lost=10**9,
        look="x" * MAX_LOOK,
    )
    back = decode_status(encode_status(full))
    assert back.reason == full.reason and len(back.shares) < 3
    assert list(back.shares) == ["attitude", "gpsnoise"][: len(back.shares)]


def test_a_second_camera_is_named_where_the_state_has_another_reason() -> None:
    """Before, whoever watched from the ground learned of it only where nothing else was amiss."""
    lost = replace(FLYING, state="turning", reason="too fast", heat="lost: no picture for 3.0 s")
    back = decode_status(encode_status(lost))
    assert back.amiss == "no hot spots: thermal camera lost: no picture for 3.0 s"
    assert replace(back, reason="thermal camera: lost, so no hot spots (x)").amiss == replace(back, heat="").amiss == ""
    with pytest.raises(CorruptPayload, match="heat"):
        decode_status(changed(heat="x" * (MAX_HEAT + 1)))


@pytest.mark.parametrize(
    "shares",
    [[], "mount", {"mount": 1.5}, {"mount": 101}, {"mount": -1}, {"mount": True}, {"": 5}, {"a b": 5}, {"x" * 13: 5},
     {"a": 1, "b": 1, "c": 1, "d": 1}],
)  # fmt: skip
def test_shares_that_cannot_be_are_refused(shares: object) -> None:
    with pytest.raises(CorruptPayload, match="shares"):
        decode_status(changed(shares=shares))


@given(STATUSES)
def test_any_status_fits_and_is_rounded_only_once(status: VehicleStatus) -> None:
    payload = encode_status(status)
    assert len(payload) <= MAX_BYTES
    back = decode_status(payload)
    assert back.frame == status.frame and back.dropped == status.dropped
    assert abs(back.delay_s - status.delay_s) <= 0.0005001
    assert encode_status(back) == payload


def test_a_reason_is_cut_and_made_plain() -> None:
    back = decode_status(encode_status(replace(FLYING, reason='say "no"\n' + "y" * 100)))
    assert back.reason == "say 'no'?" + "y" * (MAX_REASON - 9)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("field", ["unix_s", "up_s", "camera_hz", "ok_hz", "delay_s", "cpu_c"])
def test_a_number_that_is_not_finite_cannot_be_sent(field: str, value: float) -> None:
    with pytest.raises(ValueError, match="not finite"):
        encode_status(replace(FLYING, **{field: value}))


def test_unknown_keys_are_passed_over_and_known_ones_may_be_absent() -> None:
    assert decode_status(changed(mood="fine")) == FLYING
    assert decode_status(b'{"v":1,"unix_s":5,"session":0,"state":"starting"}') == VehicleStatus(5, 0, "starting")


@pytest.mark.parametrize("name", [field.name for field in fields(VehicleStatus)])
@pytest.mark.parametrize("value", [[], {"x": []}, float("inf"), 2**80])
def test_a_wrong_type_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(CorruptPayload, match=name):
        decode_status(changed(**{name: value}))


@pytest.mark.parametrize(
    "values",
    [
        {"v": 0}, {"v": True}, {"v": "1"}, {"v": ...}, {"state": ...}, {"unix_s": ...}, {"tracks": 1.5},
        {"recording": 1}, {"frame": True}, {"state": "x" * 25}, {"reason": "x" * 51}, {"state": "\x1b[2J"},
        {"fix": 16}, {"fix": -1}, {"fix": 3.0}, {"satellites": 255}, {"battery_percent": 101}, {"battery_percent": -1},
        {"battery_percent": True}, {"battery_v": 100.1}, {"battery_v": "22"}, {"mode": "x" * 25}, {"mode": "\x1b[2J"},
    ],
)  # fmt: skip
def test_what_is_no_status_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(CorruptPayload):
        decode_status(changed(**values))


def test_a_newer_version_is_called_that() -> None:
    with pytest.raises(NewerPayload, match="version 2"):
        decode_status(changed(v=2))


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda c: st.lists(c) | st.dictionaries(st.text(), c)
    )
)
def test_any_json_is_a_status_or_a_wire_error(content: object) -> None:
    try:
        decode_status(json.dumps(content).encode())
    except WireError as error:
        assert str(error)
