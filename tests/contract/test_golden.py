"""The wire format of versions 2.0, 3.0 and 4.0, frozen: golden bytes next to what they mean."""

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contract.rotations import exp_so3
from contract.wire.codec import decode, encode
from tests.contract.golden.make import plain_json

GOLDEN = Path(__file__).parent / "golden"
NAMES = sorted(path.stem for path in GOLDEN.glob("*.bin"))


def assert_close(got: Any, want: Any, where: str) -> None:
    """Equal, floating point numbers to a few units in the last place (other machines' exp and log)."""
    if isinstance(want, dict):
        assert list(got) == list(want), where
        for key in want:
            assert_close(got[key], want[key], f"{where}.{key}")
    elif isinstance(want, list):
        np.testing.assert_allclose(np.array(got, float), np.array(want, float), rtol=1e-12, atol=1e-15, err_msg=where)
    elif isinstance(want, float):
        assert got == pytest.approx(want, rel=1e-12), where
    else:
        assert got == want, where


def test_there_are_golden_payloads_of_every_kind() -> None:
    with_features = ["a_hundred_features", "plane_only", "rolling_shutter", "twelve_features"]
    assert sorted(NAMES) == sorted([*with_features, *(f"{name}_4" for name in with_features), "refused"])
    versions = {name: (GOLDEN / f"{name}.bin").read_bytes()[2] for name in NAMES}
    assert {version for name, version in versions.items() if name.endswith("_4")} == {0x40}
    assert versions["rolling_shutter"] == 0x30
    assert {versions[name] for name in ("a_hundred_features", "plane_only", "twelve_features", "refused")} == {0x20}


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_decode_to_what_they_meant(name: str) -> None:
    want = json.loads((GOLDEN / f"{name}.json").read_text())
    assert_close(plain_json(decode((GOLDEN / f"{name}.bin").read_bytes())), want, name)


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith("_4") or name == "refused"])
def test_golden_sets_encode_to_their_bytes(name: str) -> None:
    payload = (GOLDEN / f"{name}.bin").read_bytes()
    assert encode(decode(payload)) == payload


@pytest.mark.parametrize("name", ["a_hundred_features", "plane_only", "rolling_shutter", "twelve_features"])
def test_golden_sets_of_old_versions_mean_the_same_in_the_new_one(name: str) -> None:
    old, new = (decode((GOLDEN / f"{n}.bin").read_bytes()) for n in (name, f"{name}_4"))
    again = decode(encode(old))
    # The old ones of a hundred features had room for coarse steps of shared errors only.
    for one, rounding in ((again, 0.01), (new, 0.05)):
        np.testing.assert_allclose(one.plane_per_m, old.plane_per_m, rtol=1e-12)
        sigma = np.sqrt(np.diag(old.common_cov))
        np.testing.assert_allclose(np.sqrt(np.diag(one.common_cov)), sigma, rtol=rounding)
        assert (one.shutter is None) == (old.shutter is None)
        assert len(one) == len(old)
        # Features are in whole pixels now and in another order; each has one of the old within a pixel.
        if len(one):
            apart = np.abs(one.uv_px[:, None] - old.uv_px).max(axis=2)
            assert apart.min(axis=1).max() <= 0.626


def test_the_offsets_in_the_document_are_those_of_the_bytes() -> None:
    """Reads a payload with nothing but docs/wire-format.md, sections 2 to 5, in hand."""
    b = (GOLDEN / "twelve_features_4.bin").read_bytes()
    want = json.loads((GOLDEN / "twelve_features_4.json").read_text())
    assert (b[0:2], b[2]) == (b"PC", 0x40)
    assert struct.unpack_from("<H", b, 3)[0] == len(b)
    assert b[5] == 0b0100_1101  # geometry, parallax, distortion, undulation, AMSL, keyframe
    g = 71
    assert int.from_bytes(b[g : g + 5], "little", signed=True) == -35123456789
    assert int.from_bytes(b[g + 5 : g + 10], "little", signed=True) == 149165432109
    assert struct.unpack_from("<i", b, g + 10)[0] == 812345
    assert int.from_bytes(b[g + 14 : g + 17], "little", signed=True) == 19250
    rotation = [int.from_bytes(b[g + i : g + i + 3], "little", signed=True) for i in (17, 20, 23)]
    from_log = exp_so3(np.array(rotation) * np.pi / (2**23 - 1))
    np.testing.assert_allclose(from_log, want["R_enu_cam"], atol=1e-12)
    assert list(struct.unpack_from("<3f", b, g + 26)) == want["plane_per_m"]
    by_nuisance, cov = np.array(want["shared"]["by_nuisance"]), np.array(want["common_cov"])
    fresh = cov - by_nuisance @ by_nuisance.T
    sigmas = 1e-12 * np.exp(0.0006 * (np.array(struct.unpack_from("<9H", b, g + 42)) - 1.0))
    np.testing.assert_allclose(sigmas, np.sqrt(np.diag(fresh)), rtol=1e-9)
    assert 1e-12 * np.exp(0.0006 * (struct.unpack_from("<H", b, g + 60)[0] - 1.0)) == pytest.approx(60.0, rel=1e-3)
    assert struct.unpack_from("<2h", b, g + 72) == (-425, 475)
    assert b[g + 76] == 12
    smallest = 1e-12 * np.exp(0.0006 * (struct.unpack_from("<H", b, g + 77)[0] - 1.0))
    assert smallest == pytest.approx(min(want["sigma_inverse_depth_per_m"]), rel=1e-9)
    # Parameters of 14 groups in four bits and of three in six; the fixed parts of all numbers, then the unary ones.
    text = "".join(f"{byte:08b}" for byte in b[g + 79 : -4])
    ks = [int(text[4 * i : 4 * i + 4], 2) for i in range(14)] + [
        int(text[56 + 6 * i : 62 + 6 * i], 2) for i in range(3)
    ]
    groups = [(k, n) for k, n in zip(ks, [36] + [9] * 13 + [12] * 3, strict=True)]
    widths = [15 if k == 15 and i < 14 else k for i, (k, n) in enumerate(groups) for _ in range(n)]
    is_written = [not (k == 15 and i < 14) for i, (k, n) in enumerate(groups) for _ in range(n)]
    at, fixed = 74, []
    for k, written in zip(widths, is_written, strict=True):
        fixed.append(int(text[at : at + k] or "0", 2) if written else 0)
        at += k if written else 0
    numbers = []
    for low, k, written in zip(fixed, widths, is_written, strict=True):
        end = text.index("1", at) if written else at
        numbers.append((end - at << k) + low if written else 0)
        at = end + 1 if written else at
    assert set(text[at:]) <= {"0"} and len(text) - at < 8
    signed = [n // 2 if n % 2 == 0 else -(n + 1) // 2 for n in numbers]
    assert np.tanh(0.05 * signed[0]) == pytest.approx(fresh[1, 0] / np.sqrt(fresh[0, 0] * fresh[1, 1]), rel=1e-6)
    assert by_nuisance[0, 0] == pytest.approx(sigmas[0] * signed[36] / 16.0, rel=1e-9)
    cells = np.cumsum(numbers[153:165])
    np.testing.assert_array_equal(np.stack([cells % 640, cells // 640], axis=1), want["uv_px"])
    own = smallest * np.exp(0.0768 * np.array(numbers[177:]))
    np.testing.assert_allclose(own, want["sigma_inverse_depth_per_m"], rtol=1e-9)
    check_depths(want, cells, np.array(signed[165:177]) * own / 3.0)
    assert struct.unpack_from("<I", b, len(b) - 4)[0] == zlib.crc32(b[:-4])


def check_depths(want: dict[str, Any], cells: Any, off_plane: Any) -> None:
    """Section 6."""
    camera = want["camera"]
    k1, k2, p1, p2, k3 = camera["distortion"]
    a, slope_x, slope_y = want["plane_per_m"]
    for cell, off, w in zip(cells, off_plane, want["inverse_depth_per_m"], strict=True):
        x, y = (cell % 640 - camera["cx_px"]) / camera["fx_px"], (cell // 640 - camera["cy_px"]) / camera["fy_px"]
        r2, across = x * x + y * y, 2 * (p2 * x + p1 * y)
        x, y = x - across * x - p2 * r2, y - across * y - p1 * r2
        r2 = x * x + y * y
        series = -k1, 3 * k1**2 - k2, 8 * k1 * k2 - 12 * k1**3 - k3
        fourth = 55 * k1**4 - 55 * k1**2 * k2 + 5 * k2**2 + 10 * k1 * k3
        grown = 1 + sum(term * r2**i for i, term in enumerate([*series, fourth], 1))
        assert w == pytest.approx(a + grown * (slope_x * x + slope_y * y) + off, rel=1e-9)


def test_the_offsets_of_version_2_in_the_document_are_those_of_the_bytes() -> None:
    """Its appendix."""
    b = (GOLDEN / "twelve_features.bin").read_bytes()
    want = json.loads((GOLDEN / "twelve_features.json").read_text())
    assert (b[0:2], b[2]) == (b"PC", 0x20)
    assert struct.unpack_from("<H", b, 3)[0] == len(b)
    assert b[5] == 0b0100_1101  # geometry, parallax, distortion, undulation, AMSL, keyframe
    assert b[6] == 0
    assert struct.unpack_from("<IIHQ", b, 7) == (want["session"], want["frame"], 2, want["capture_unix_ns"])
    assert b[25] == 5 and b[26:31] == b"uav-1"
    assert struct.unpack_from("<HH", b, 31) == (640, 480)
    assert struct.unpack_from("<4f", b, 35)[0] == want["camera"]["fx_px"]
    assert struct.unpack_from("<5f", b, 51)[0] == want["camera"]["distortion"][0]
    g = 71
    assert int.from_bytes(b[g : g + 5], "little", signed=True) == -35123456789
    assert int.from_bytes(b[g + 5 : g + 10], "little", signed=True) == 149165432109
    assert struct.unpack_from("<i", b, g + 10)[0] == 812345
    assert int.from_bytes(b[g + 14 : g + 17], "little", signed=True) == 19250
    assert list(struct.unpack_from("<3f", b, g + 26)) == want["plane_per_m"]
    by_nuisance, cov = np.array(want["shared"]["by_nuisance"]), np.array(want["common_cov"])
    fresh = cov - by_nuisance @ by_nuisance.T
    sigmas = 1e-12 * np.exp(0.0006 * (np.array(struct.unpack_from("<9H", b, g + 42)) - 1.0))
    np.testing.assert_allclose(sigmas, np.sqrt(np.diag(fresh)), rtol=1e-9)
    assert 1e-12 * np.exp(0.0006 * (struct.unpack_from("<H", b, g + 60)[0] - 1.0)) == pytest.approx(60.0, rel=1e-3)
    assert struct.unpack_from("<2h", b, g + 72) == (-425, 475)
    # Halvings of the step, Rice parameters, the fixed parts of all groups, the unary ones; first column: east.
    bits = np.unpackbits(np.frombuffer(b, np.uint8, offset=g + 76))
    halvings, *ks = (int(k) for k in bits[:60].reshape(15, 4) @ [8, 4, 2, 1])
    assert halvings == 2
    widths = [k for k, n in zip(ks, [36] + [9] * 13, strict=True) if k < 15 for _ in range(n)]
    ends = np.flatnonzero(bits[60 + sum(widths) :])
    first = (int(ends[0]) << ks[0]) + int("".join(map(str, bits[60 : 60 + ks[0]])), 2)
    p = np.tanh(0.05 * (-(first + 1) // 2 if first % 2 else first // 2))
    assert p == pytest.approx(fresh[1, 0] / np.sqrt(fresh[0, 0] * fresh[1, 1]), rel=1e-6)
    at = 36 * ks[0]
    number = (int(ends[36] - ends[35] - 1) << ks[1]) + int("".join(map(str, bits[60 + at : 60 + at + ks[1]])), 2)
    step = -(number + 1) // 2 if number % 2 else number // 2
    assert by_nuisance[0, 0] == pytest.approx(sigmas[0] * 0.25 / 4 * step, rel=1e-9)
    g += 76 + -(-(60 + sum(widths) + int(ends[len(widths) - 1]) + 1) // 8)
    assert b[g] == 12
    assert struct.unpack_from("<I", b, len(b) - 4)[0] == zlib.crc32(b[:-4])


def test_the_rows_of_a_rolling_shutter_lie_where_the_document_says() -> None:
    """Section 4.5: before the numbers; in version 3 between the plane's roughness and the fresh sigmas."""
    for name, version, g in (("rolling_shutter_4", 0x40, 71 + 79), ("rolling_shutter", 0x30, 71 + 42)):
        b = (GOLDEN / f"{name}.bin").read_bytes()
        want = json.loads((GOLDEN / f"{name}.json").read_text())["shutter"]
        assert (b[2], b[5] >> 7) == (version, int(version == 0x40))
        check_shutter(b, g, want)


def check_shutter(b: bytes, g: int, want: dict[str, Any]) -> None:
    readout_s, sigma, *steps = struct.unpack_from("<fH6h", b, g)
    assert readout_s == want["readout_s"] == pytest.approx(-0.021, rel=1e-6)
    assert 1e-12 * np.exp(0.0006 * (sigma - 1.0)) == pytest.approx(want["sigma_readout_s"], rel=1e-12)
    assert [x / 2000 for x in steps[:3]] == want["rate_cam_rad_s"] == [0.12, -0.31, 0.05]
    assert [x / 100 for x in steps[3:]] == want["velocity_cam_m_s"] == [3.5, -19.2, 1.1]
