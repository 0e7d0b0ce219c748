import dataclasses
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.camera import Camera
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload, WireError
from contract.feature_set import FeatureSet, SharedErrors, Status, Swing
from contract.rolling_shutter import RollingShutter
from contract.rotations import log_so3
from contract.wire import codec
from contract.wire.codec import decode, encode, peek
from contract.wire.feature_code import _plane_inverse_depth
from tests.contract.sets import feature_sets, plain_set

PAYLOAD = encode(plain_set())
DEPTHS = "inverse_depth_per_m", "sigma_inverse_depth_per_m"
GOLDEN = Path(__file__).parent / "golden"
KINDS = [PAYLOAD, *((GOLDEN / f"{n}.bin").read_bytes() for n in ("a_hundred_features", "rolling_shutter", "swing"))]


SWING = Swing(np.array([0.21, 0.4]), np.array([[0.1, -0.05, 0.0], [0.002, 0.03, -0.01]]))
NO_FEATURES = {name: getattr(plain_set(0), name) for name in ("uv_px", *DEPTHS)}


def with_checksum(content: bytes) -> bytes:
    """Length and checksum made right again after the content was changed."""
    content = content[:3] + struct.pack("<H", len(content) + 4) + content[5:]
    return content + struct.pack("<I", zlib.crc32(content))


def assert_same(a: FeatureSet, b: FeatureSet) -> None:
    for field in dataclasses.fields(FeatureSet):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if dataclasses.is_dataclass(x) and field.name != "camera":
            for part in dataclasses.fields(x):
                np.testing.assert_array_equal(getattr(x, part.name), getattr(y, part.name), err_msg=part.name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=field.name)


@pytest.mark.parametrize(("relief", "most"), [(0.0, 520), (0.01, 540), (0.03, 560), (0.06, 575)])
def test_what_a_hundred_features_take_and_that_two_hundred_fit_a_packet(relief: float, most: int) -> None:
    """`relief` is white from feature to feature; 0.03 is 7 m from 250 m, rougher than any ground seen."""
    hundred = [len(encode(plain_set(100, seed, relief))) for seed in range(10)]
    two_hundred = [len(encode(plain_set(200, seed, relief))) for seed in range(10)]
    assert min(hundred) > 400 and max(hundred) <= most
    assert min(two_hundred) > 600 and max(two_hundred) <= 1000


@pytest.mark.parametrize("relief", [0.0, 0.06])
def test_shared_errors_are_rounded_to_a_sixteenth_of_what_is_fresh(relief: float) -> None:
    for seed in range(10):
        s = plain_set(100, seed, relief)
        got = decode(encode(s))
        fresh = np.linalg.cholesky(got.common_cov - got.shared.by_nuisance @ got.shared.by_nuisance.T)
        steps = np.linalg.solve(fresh, got.shared.by_nuisance) * 16.0
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
        worst = np.abs(np.linalg.solve(fresh, got.shared.by_nuisance - s.shared.by_nuisance)).max()
        assert 0.01 < worst < 0.5 / 16 * 1.01


def test_two_hundred_features_of_a_large_picture_over_hills_fit_a_packet() -> None:
    camera = Camera(4000, 3000, 5500.0, 5500.0, 1999.5, 1499.5, (-0.2, 0.05, 0.0, 0.0, 0.01))
    assert len(encode(plain_set(200, relief=0.1, camera=camera))) <= 1250


@given(feature_sets())
def test_what_was_decoded_encodes_to_the_same_bytes(feature_set: FeatureSet) -> None:
    payload = encode(feature_set)
    decoded = decode(payload)
    assert encode(decoded) == payload
    assert_same(decode(encode(decoded)), decoded)


@given(feature_sets())
def test_a_round_trip_stays_within_the_stated_rounding(feature_set: FeatureSet) -> None:
    got, want = decode(encode(feature_set)), feature_set
    for name in ("vehicle", "session", "frame", "capture_unix_ns", "status", "revision", "is_keyframe"):
        assert getattr(got, name) == getattr(want, name)
    assert got.camera.size_px == want.camera.size_px
    assert got.camera.distortion == pytest.approx(want.camera.distortion, rel=1e-7, abs=1e-44)
    assert got.camera.fx_px == pytest.approx(want.camera.fx_px, rel=1e-7)
    if not want.is_ok:
        assert len(got) == 0
        return
    assert got.camera_lat_deg == pytest.approx(want.camera_lat_deg, abs=0.51e-9)
    assert got.camera_lon_deg == pytest.approx(want.camera_lon_deg, abs=0.51e-9)
    assert got.camera_height_m == pytest.approx(want.camera_height_m, abs=0.51e-3)
    assert got.undulation_m == pytest.approx(want.undulation_m, abs=0.51e-3, nan_ok=True)
    assert (got.height_datum, got.depth_source) == (want.height_datum, want.depth_source)
    assert np.linalg.norm(log_so3(got.R_enu_cam @ want.R_enu_cam.T)) < 1e-6
    for name in ("plane_sigma_relative", "roughness"):
        assert getattr(got, name) == pytest.approx(getattr(want, name), rel=3.1e-4)
    shared, sent = got.shared, want.shared
    assert shared.position_time_s == pytest.approx(sent.position_time_s, rel=3.1e-4)
    assert shared.attitude_time_s == pytest.approx(sent.attitude_time_s, rel=3.1e-4)
    assert shared.alignment_sigma == pytest.approx(sent.alignment_sigma, rel=3.1e-4)
    assert shared.span_s == pytest.approx(np.clip(sent.span_s, -327.67, 327.67), abs=0.0051)
    np.testing.assert_allclose(got.plane_per_m, want.plane_per_m, rtol=1e-7)

    size = np.array(want.camera.size_px)
    pixels = np.clip(np.floor(want.uv_px + 0.5), 0, size - 1)
    order = np.argsort(pixels[:, 1] * size[0] + pixels[:, 0], kind="stable")
    sigma = want.sigma_inverse_depth_per_m[order]
    np.testing.assert_array_equal(got.uv_px, pixels[order])
    np.testing.assert_allclose(got.sigma_inverse_depth_per_m, sigma, rtol=0.0395)
    # Inverse depth is that of the same distance off the plane, at the middle of the pixel.
    there, here = (
        _plane_inverse_depth(got.camera, got.plane_per_m.tolist(), np.ascontiguousarray(uv.T))
        for uv in (want.uv_px[order], got.uv_px)
    )
    rounding = np.abs(got.inverse_depth_per_m - here - (want.inverse_depth_per_m[order] - there))
    assert np.all(rounding <= sigma / 6.0 * 1.04 + 1e-12 * (np.abs(here) + np.abs(there)))


@given(feature_sets())
def test_the_decoded_covariance_keeps_its_variances_and_is_positive_semi_definite(feature_set: FeatureSet) -> None:
    after = decode(encode(feature_set))
    got, want = (s.common_cov - s.shared.by_nuisance @ s.shared.by_nuisance.T for s in (after, feature_set))
    np.testing.assert_allclose(
        np.diag(got), np.diag(want), rtol=1e-3, atol=1e-9 * np.diag(feature_set.common_cov).max()
    )
    sigma = np.sqrt(np.diag(want)) + 1e-30
    assert np.linalg.eigvalsh(got / np.outer(sigma, sigma)).min() > -1e-9


def test_correlations_near_one_keep_what_is_left_after_cancelling() -> None:
    """A position error that the attitude error cancels on the ground: the difference is what a click depends on."""
    base = plain_set()
    for left in (0.3, 0.03, 0.01):
        cov = np.diag(np.array([2.0, 2.0, 2.0, 0.008, 0.008, 0.01, 0.01, 0.01, 0.01]) ** 2)
        cov[0, 4] = cov[4, 0] = -2.0 * 0.008 * np.sqrt(1.0 - left**2)
        got = decode(encode(dataclasses.replace(base, common_cov=cov, shared=SharedErrors()))).common_cov
        combination = np.zeros(9)
        combination[[0, 4]] = 0.5, 1.0 / 0.008
        assert combination @ got @ combination == pytest.approx(combination @ cov @ combination, rel=0.05)


def test_features_arrive_sorted_by_row_and_ties_keep_their_order() -> None:
    base = plain_set(100)
    uv = base.uv_px.copy()
    uv[:10] = [300.0, 200.0]
    got = decode(encode(dataclasses.replace(base, uv_px=uv)))
    assert np.all(np.diff(got.uv_px @ [1.0, 640.0]) >= 0.0)
    tied = got.sigma_inverse_depth_per_m[np.all(got.uv_px == [300.0, 200.0], axis=1)]
    np.testing.assert_allclose(tied, base.sigma_inverse_depth_per_m[:10], rtol=0.0395)


def test_a_refused_set_is_small_and_carries_its_reason() -> None:
    base = plain_set(0)
    refused = FeatureSet("uav-1", 1, 2, 3, Status.LOW_PARALLAX, base.camera)
    payload = encode(refused)
    assert len(payload) < 90
    assert decode(payload).status is Status.LOW_PARALLAX


def test_the_identity_is_read_without_decoding() -> None:
    identity = peek(PAYLOAD)
    assert (identity.session, identity.frame, identity.revision) == (3_000_000_001, 77, 2)
    assert identity.capture_unix_ns == 1_700_000_000_123_456_789
    assert identity.status is Status.OK


@given(st.binary(max_size=900))
def test_any_bytes_are_a_set_or_a_named_error(payload: bytes) -> None:
    for candidate in (payload, b"PC\x20" + payload, b"PC\x40" + payload):
        with pytest.raises(WireError):
            decode(candidate)


@given(st.data())
def test_hostile_content_under_a_right_checksum_is_a_set_or_a_named_error(data: st.DataObject) -> None:
    content = bytearray(data.draw(st.sampled_from(KINDS))[:-4])
    for _ in range(data.draw(st.integers(1, 12))):
        content[data.draw(st.integers(5, len(content) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(30, len(content)))
    try:
        got = decode(with_checksum(bytes(content[: end if data.draw(st.booleans()) else None])))
    except WireError:
        return
    for name in ("uv_px", "inverse_depth_per_m", "sigma_inverse_depth_per_m", "common_cov", "R_enu_cam"):
        assert np.all(np.isfinite(getattr(got, name)))


@given(st.integers(0, len(PAYLOAD) * 8 - 1))
def test_a_flipped_bit_is_a_named_error(position: int) -> None:
    damaged = bytearray(PAYLOAD)
    damaged[position // 8] ^= 1 << position % 8
    with pytest.raises(WireError):
        decode(bytes(damaged))


def test_every_truncation_says_so() -> None:
    for length in range(len(PAYLOAD)):
        with pytest.raises(TruncatedPayload):
            decode(PAYLOAD[:length])


def test_a_longer_payload_than_its_header_says_is_corrupt() -> None:
    with pytest.raises(CorruptPayload, match="header states"):
        decode(PAYLOAD + b"\0")


def test_a_newer_minor_version_is_read_and_what_it_appends_is_skipped() -> None:
    content = PAYLOAD[:2] + bytes([0x40 + codec.MINOR + 1]) + PAYLOAD[3:-4] + b"\0\0news from the future"
    assert_same(decode(with_checksum(content)), decode(PAYLOAD))


def test_the_same_bytes_appended_by_this_version_are_corrupt() -> None:
    with pytest.raises(CorruptPayload, match="left over"):
        decode(with_checksum(PAYLOAD[:-4] + b"news from the past"))


def test_a_newer_major_version_and_an_unknown_status_are_refused_as_newer() -> None:
    newer = PAYLOAD[:2] + b"\x60" + PAYLOAD[3:]
    with pytest.raises(NewerPayload, match=r"6\.0, this program reads 4\.x and 5\.x: update it"):
        decode(newer)
    with pytest.raises(CorruptPayload, match=r"3\.0"):
        decode(PAYLOAD[:2] + b"\x30" + PAYLOAD[3:])
    unknown = bytearray(PAYLOAD[:-4])
    unknown[6] = 200
    with pytest.raises(NewerPayload, match="status 200"):
        decode(with_checksum(bytes(unknown)))


def test_a_set_of_a_rolling_shutter_takes_18_bytes_more() -> None:
    shutter = RollingShutter(0.03, np.array([0.1, -0.2, 0.3]), np.array([20.0, -1.0, 0.5]), 0.002)
    plain = plain_set(100, 4)
    rolling = encode(dataclasses.replace(plain, shutter=shutter))
    assert rolling[2] == encode(plain)[2] == 0x40
    assert len(rolling) - len(encode(plain)) == 18
    got = decode(rolling).shutter
    assert (got.readout_s, got.sigma_readout_s) == (pytest.approx(0.03, rel=1e-6), pytest.approx(0.002, rel=1e-3))
    np.testing.assert_allclose(got.rate_cam_rad_s, shutter.rate_cam_rad_s, atol=0.00025)
    np.testing.assert_allclose(got.velocity_cam_m_s, shutter.velocity_cam_m_s, atol=0.005)
    refused = encode(FeatureSet("uav-1", 5, 6, 7, Status.TURNING, plain.camera, shutter=shutter))
    assert refused[2] == 0x40 and decode(refused).shutter is None


@given(feature_sets().filter(lambda s: s.swing is not None))
def test_a_swing_is_rounded_to_4_ms_and_to_a_64th_of_its_largest_turn_and_takes_4_bytes_a_moment(s: FeatureSet) -> None:
    payload, swing = encode(s), s.swing
    got = decode(payload).swing
    assert swing is not None and got is not None and payload[2] & 15 == 2
    assert len(payload) - len(encode(dataclasses.replace(s, swing=None))) == 2 + 4 * len(swing.before_s)
    np.testing.assert_allclose(got.before_s, swing.before_s, atol=0.004001)
    step = max(np.abs(swing.turned_cam_rad).max() / 63.5, 2.0**-11)
    np.testing.assert_allclose(got.turned_cam_rad, swing.turned_cam_rad, atol=0.501 * step)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shutter": RollingShutter(float("nan"))}, "readout_s"),
        ({"shutter": RollingShutter(0.03, np.array([20.0, 0.0, 0.0]))}, "rate_cam_rad_s"),
        ({"shutter": RollingShutter(0.03, velocity_cam_m_s=np.full(3, np.inf))}, "velocity_cam_m_s"),
        ({"shutter": RollingShutter(0.03, sigma_readout_s=-1.0)}, "sigma_readout_s"),
        ({"vehicle": "a name that is longer than thirty-two"}, "vehicle name"),
        ({"vehicle": ""}, "vehicle name"),
        ({"session": -1}, "session"),
        ({"frame": 2**32}, "frame"),
        ({"revision": 65536}, "revision"),
        ({"capture_unix_ns": -5}, "capture_unix_ns"),
        ({"camera_lat_deg": 91.0}, "latitude"),
        ({"camera_lon_deg": float("nan")}, "latitude"),
        ({"camera_height_m": float("inf")}, "camera_height_m"),
        ({"undulation_m": 1e6}, "undulation_m"),
        ({"R_enu_cam": np.diag([1.0, 1.0, -1.0])}, "not a rotation"),
        ({"R_enu_cam": np.eye(3) * 1.1}, "not a rotation"),
        ({"common_cov": -np.eye(9)}, "less what is shared.*negative variance"),
        ({"common_cov": np.ones((9, 9)) + np.eye(9) * -0.5, "shared": SharedErrors()}, "not a covariance"),
        ({"shared": SharedErrors(np.full((9, 13), np.nan))}, "by_nuisance"),
        ({"shared": SharedErrors(np.full((9, 13), 1e3))}, "less what is shared"),
        ({"shared": SharedErrors(position_time_s=-1.0)}, "position_time_s"),
        ({"shared": SharedErrors(alignment_sigma=np.ones(3))}, "four numbers"),
        ({"shared": SharedErrors(span_s=(0.0, float("nan")))}, "span_s"),
        ({"common_cov": np.full((9, 9), np.nan)}, "finite"),
        ({"common_cov": np.eye(6)}, "9 x 9"),
        ({"plane_per_m": np.array([1.0, np.nan, 0.0])}, "plane_per_m"),
        ({"plane_sigma_relative": -0.1}, "plane_sigma_relative"),
        ({"roughness": float("nan")}, "roughness"),
        ({"camera": Camera(640, 480, 0.0, 500.0, 320.0, 240.0)}, "focal"),
        ({"camera": Camera(0, 480, 500.0, 500.0, 320.0, 240.0)}, "picture size"),
        ({"inverse_depth_per_m": np.array([0.1, np.nan])}, "feature 1 is not finite"),
        ({"sigma_inverse_depth_per_m": np.array([0.1, 0.0])}, "sigma_inverse_depth_per_m"),
        ({"inverse_depth_per_m": np.ones(2), "sigma_inverse_depth_per_m": np.full(2, 2e-12)}, "too small"),
        ({"sigma_inverse_depth_per_m": np.array([0.1])}, "disagree"),
        ({"uv_px": np.array([[1.0, 1.0], [640.0, 1.0]])}, "feature 1 is off"),
        ({"uv_px": np.array([[1.0, 1.0], [np.nan, 1.0]])}, "feature 1 is off"),
        ({"swing": Swing(np.zeros(0), np.zeros((0, 3)))}, "a swing has 1 to 31 moments"),
        ({"swing": Swing(np.array([0.2]), np.full((1, 3), np.nan))}, "a swing has 1 to 31 moments"),
        ({"swing": Swing(np.array([0.2, 0.2]), np.zeros((2, 3)))}, "a swing's moments must rise"),
        ({"swing": Swing(np.array([0.2, 2.5]), np.zeros((2, 3)))}, "a swing's moments must rise"),
        ({"swing": Swing(np.array([np.inf]), np.zeros((1, 3)))}, "a swing's moments must rise"),
        ({"swing": Swing(np.array([0.2]), np.full((1, 3), 8.0))}, "a swing turns by 7.9 rad at most"),
        ({"status": Status.TURNING}, "carries no features"),
        ({"status": Status.TURNING, **NO_FEATURES, "swing": SWING}, "carries neither a clicked pixel nor a swing"),
    ],
)
def test_what_cannot_be_written_is_refused_by_name(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        encode(dataclasses.replace(plain_set(2), **change))


def test_more_features_than_a_byte_counts_are_refused() -> None:
    assert len(decode(encode(plain_set(255)))) == 255
    with pytest.raises(ValueError, match="at most 255"):
        encode(plain_set(256))


def test_the_version_on_the_wire_is_the_documented_one() -> None:
    assert (codec.MAJORS, codec.MINOR) == ({"pinhole": 4, "fisheye": 5}, 2)
    assert PAYLOAD[:3] == b"PC\x40"  # without a clicked pixel it is what 4.0 reads
