"""Clicks and their answers in a packet each: short, read back, and never anything but a WireError."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.answer import Ellipse, Fix, Refusal
from contract.feature_set import Status
from contract.wire.click_code import (
    MAX_ANSWER_BYTES,
    MAX_QUESTION_BYTES,
    ClickAnswer,
    ClickQuestion,
    TurnedAway,
    cut_name,
    decode,
    encode_answer,
    encode_question,
)

FIX = Fix(
    lat_deg=-43.123456789,
    lon_deg=172.987654321,
    height_ellipsoid_m=123.456,
    height_amsl_m=113.444,
    ellipse=Ellipse.from_covariance(np.array([[4.0, 1.0], [1.0, 2.0]])),
    sigma_height_m=3.0,
    method="interpolated",
    frame=1234,
    capture_unix_ns=1_700_000_000_123_450_000,
    vehicle="uav-1",
    offset_enu_m=np.array([12.34, -56.78, -250.01]),
    covariance_enu_m2=np.array([[4.0, 1.0, 0.5], [1.0, 2.0, -1.0], [0.5, -1.0, 9.0]]),
    age_s=0.42,
)
MEASURED = replace(FIX, method="measured", above_ground_m=6.13, sigma_above_ground_m=0.42)
PIXELS = st.floats(-1e4, 1e4, width=32)
TIMES_NS = st.integers(0, 4 * 10**18)


def fix_of(payload: bytes) -> Fix:
    found = decode(payload)
    assert isinstance(found, ClickAnswer) and isinstance(found.answer, Fix)
    return found.answer


@given(st.integers(0, 65535), PIXELS, PIXELS, st.none() | st.integers(0, 2**40), st.none() | TIMES_NS)
def test_a_question_is_read_back_from_24_bytes_or_fewer(
    number: int, u_px: float, v_px: float, frame: int | None, time_ns: int | None
) -> None:
    waited_s = 2.9 if frame is None and time_ns is None else 0.0
    question = ClickQuestion(number, u_px, v_px, frame, time_ns if frame is None else None, waited_s)
    payload = encode_question(question)
    assert len(payload) <= MAX_QUESTION_BYTES
    assert decode(payload) == question


@given(
    st.floats(-90.0, 90.0),
    st.floats(-180.0, 180.0),
    st.floats(-500.0, 9000.0),
    st.none() | st.floats(-110.0, 90.0),
    st.floats(0.01, 500.0),
    st.floats(0.01, 1.0),
    st.floats(0.0, 179.99),
    st.floats(0.01, 500.0),
    st.floats(0.0, 0.99),
    st.floats(0.0, 2.0 * math.pi),
    st.sampled_from(["interpolated", "terrain", "plane"]),
    st.none() | st.floats(0.0, 1000.0),
    st.text(max_size=32),
)
def test_an_answer_is_read_back_from_60_bytes_or_fewer(
    lat_deg: float,
    lon_deg: float,
    height_m: float,
    undulation_m: float | None,
    major_m: float,
    ratio: float,
    azimuth_deg: float,
    sigma_height_m: float,
    correlation: float,
    direction: float,
    method: str,
    age_s: float | None,
    vehicle: str,
) -> None:
    angle = math.radians(azimuth_deg)
    axes = np.array([[math.sin(angle), math.cos(angle)], [-math.cos(angle), math.sin(angle)]])
    sigmas = np.array([major_m, major_m * ratio]) / math.sqrt(-2.0 * math.log(0.1))
    vertical = axes.T @ (correlation * np.array([math.cos(direction), math.sin(direction)]) * sigmas * sigma_height_m)
    horizontal = axes.T @ np.diag(sigmas**2) @ axes
    covariance = np.block([[horizontal, vertical[:, None]], [vertical[None], np.array([[sigma_height_m**2]])]])
    ellipsoid_m = None if undulation_m is None else height_m + undulation_m
    reported = replace(
        FIX, lat_deg=lat_deg, lon_deg=lon_deg, height_amsl_m=height_m, height_ellipsoid_m=ellipsoid_m,
        ellipse=Ellipse(major_m, major_m * ratio, azimuth_deg), sigma_height_m=sigma_height_m, method=method,
        age_s=age_s, vehicle=vehicle, covariance_enu_m2=covariance,
    )  # fmt: skip
    payload = encode_answer(ClickAnswer(7, reported))
    assert len(payload) <= MAX_ANSWER_BYTES
    found = fix_of(payload)
    assert abs(found.lat_deg - lat_deg) <= 1e-9 and abs(found.lon_deg - lon_deg) <= 1e-9
    assert abs(found.height_amsl_m - height_m) <= 0.001
    assert (found.height_ellipsoid_m is None) == (ellipsoid_m is None)
    if found.height_ellipsoid_m is not None and ellipsoid_m is not None:
        assert abs(found.height_ellipsoid_m - ellipsoid_m) <= 0.002
    assert found.ellipse.semi_major_m == pytest.approx(major_m, rel=4e-4)
    assert found.ellipse.semi_minor_m == pytest.approx(major_m * ratio, rel=4e-4)
    assert found.sigma_height_m == pytest.approx(sigma_height_m, rel=4e-4)
    turned = abs(found.ellipse.azimuth_deg - azimuth_deg)
    assert min(turned, 180.0 - turned) <= 0.0015
    assert np.linalg.eigvalsh(found.covariance_enu_m2)[0] >= -1e-9 * major_m**2 * max(sigma_height_m, 1.0) ** 2
    assert np.allclose(found.covariance_enu_m2[:2, :2], horizontal, atol=2e-3 * major_m**2)
    assert np.allclose(found.covariance_enu_m2[:2, 2], vertical, atol=0.02 * major_m * sigma_height_m)
    assert (found.frame, found.capture_unix_ns, found.method) == (1234, FIX.capture_unix_ns, method)
    assert (found.age_s is None) == (age_s is None)
    if found.age_s is not None and age_s is not None:
        assert abs(found.age_s - min(age_s, 655.34)) <= 0.006
    assert np.allclose(found.offset_enu_m, FIX.offset_enu_m, atol=0.006)
    assert vehicle.encode().startswith(found.vehicle.encode()) or not vehicle.isprintable()


@pytest.mark.parametrize("fix", [FIX, MEASURED])
def test_rounding_happens_once(fix: Fix) -> None:
    first = fix_of(encode_answer(ClickAnswer(7, fix)))
    assert encode_answer(ClickAnswer(7, first)) == encode_answer(ClickAnswer(7, fix))


@given(st.none() | st.floats(-3000.0, 3000.0), st.floats(0.01, 500.0))
def test_a_measured_answer_keeps_its_height_above_the_ground(above_m: float | None, sigma_m: float) -> None:
    payload = encode_answer(ClickAnswer(7, replace(MEASURED, above_ground_m=above_m, sigma_above_ground_m=sigma_m)))
    found = fix_of(payload)
    assert len(payload) <= MAX_ANSWER_BYTES and (found.method, found.vehicle) == ("measured", "uav-1")
    if above_m is None:
        assert found.above_ground_m is None and found.sigma_above_ground_m is None
    else:
        assert found.above_ground_m == pytest.approx(above_m, abs=0.051)
        assert found.sigma_above_ground_m == pytest.approx(sigma_m, rel=4e-4)


@given(
    st.sampled_from([s for s in Status if s is not Status.OK]), st.none() | st.integers(0, 10**6), st.text(max_size=80)
)
def test_a_refusal_is_read_back_with_as_much_of_its_reason_as_there_is_room_for(
    status: Status, frame: int | None, detail: str
) -> None:
    payload = encode_answer(ClickAnswer(65535, Refusal(status, frame, None, "uav-1", detail, 3.21)))
    found = decode(payload)
    assert len(payload) <= MAX_ANSWER_BYTES
    assert isinstance(found, ClickAnswer) and isinstance(found.answer, Refusal) and found.number == 65535
    a = found.answer
    assert (a.status, a.frame, a.vehicle, a.capture_unix_ns) == (status, frame, "uav-1", None)
    assert a.age_s == pytest.approx(3.21)
    assert len(detail.encode()) > 35 or not detail.isprintable() or a.detail == detail


def test_who_is_turned_away_hears_the_ground_stations_numbers() -> None:
    assert decode(encode_answer(TurnedAway(3, 250, 255))) == TurnedAway(3, 250, 255)


def test_a_long_name_is_cut_between_characters() -> None:
    assert cut_name("northern-flyer") == "northern"
    assert cut_name("äöüäöü") == "äöüä"
    assert cut_name("a€€€") == "a€€"


@pytest.mark.parametrize("spoilt", [{"lat_deg": math.nan}, {"lat_deg": 1e9}, {"frame": -1}, {"sigma_height_m": -1.0}])
def test_an_answer_without_an_encoding_is_a_value_error(spoilt: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"."):
        encode_answer(ClickAnswer(1, replace(FIX, **spoilt)))


@pytest.mark.parametrize("u_px", [math.nan, math.inf, 1e300])
def test_a_pixel_that_is_none_is_a_value_error(u_px: float) -> None:
    with pytest.raises(ValueError, match=r"."):
        encode_question(ClickQuestion(1, u_px, 0.0))


def test_the_bytes_stay_what_they_are() -> None:
    assert encode_question(ClickQuestion(258, 320.5, 240.25, frame=14)).hex() == GOLDEN_QUESTION
    assert encode_answer(ClickAnswer(258, FIX)).hex() == GOLDEN_FIX
    assert encode_answer(ClickAnswer(258, MEASURED)).hex() == GOLDEN_MEASURED
    refusal = Refusal(Status.TURNING, 14, None, "uav-1", "ok: it turns", 0.5)
    assert encode_answer(ClickAnswer(258, refusal)).hex() == GOLDEN_REFUSAL


GOLDEN_QUESTION = "110201010e000000000000000040a04300407043"
GOLDEN_FIX = (
    "12020103d2040039d09c359d9a2a00eb44a4f5f5b120de462824bb01001c2700b3bd5eba00600cbb01dbd20400d2e9ff579eff7561762d31"
)
GOLDEN_MEASURED = (
    "1202010fd2040039d09c359d9a2a00eb44a4f5f5b120de462824bb01001c2700b3bd5eba00600cbb01dbd20400d2e9ff579eff3d003fae75"
    "61762d31"
)
GOLDEN_REFUSAL = "130201070e00000000000000003200057561762d316f6b3a206974207475726e73"
