"""The wire format of versions 4.0, 4.1, 4.2 and 5.0, frozen: golden bytes next to what they mean."""

import dataclasses
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
    clicked = ["measured_pixel", "unmeasured_pixel"]
    plain = ["a_hundred_features", "plane_only", "refused", "rolling_shutter", "twelve_features"]
    assert sorted(NAMES) == sorted([*plain, *clicked, "fisheye", "swing"])
    assert (GOLDEN / "swing.bin").read_bytes()[2] == 0x42
    assert (GOLDEN / "fisheye.bin").read_bytes()[2] == 0x50
    assert {(GOLDEN / f"{name}.bin").read_bytes()[2] for name in plain} == {0x40}
    assert {(GOLDEN / f"{name}.bin").read_bytes()[2] for name in clicked} == {0x41}


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_decode_to_what_they_meant(name: str) -> None:
    want = json.loads((GOLDEN / f"{name}.json").read_text())
    assert_close(plain_json(decode((GOLDEN / f"{name}.bin").read_bytes())), want, name)


@pytest.mark.parametrize("name", NAMES)
def test_golden_sets_encode_to_their_bytes(name: str) -> None:
    payload = (GOLDEN / f"{name}.bin").read_bytes()
    assert encode(decode(payload)) == payload


def test_the_offsets_in_the_document_are_those_of_the_bytes() -> None:
    """Reads a payload with nothing but docs/wire-format.md, sections 2 to 5, in hand."""
    b = (GOLDEN / "twelve_features.bin").read_bytes()
    want = json.loads((GOLDEN / "twelve_features.json").read_text())
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


def test_the_rows_of_a_rolling_shutter_lie_where_the_document_says() -> None:
    """Section 4.5: before the numbers."""
    b, g = (GOLDEN / "rolling_shutter.bin").read_bytes(), 71 + 79
    want = json.loads((GOLDEN / "rolling_shutter.json").read_text())["shutter"]
    assert b[5] >> 7 == 1
    readout_s, sigma, *steps = struct.unpack_from("<fH6h", b, g)
    assert readout_s == want["readout_s"] == pytest.approx(-0.021, rel=1e-6)
    assert 1e-12 * np.exp(0.0006 * (sigma - 1.0)) == pytest.approx(want["sigma_readout_s"], rel=1e-12)
    assert [x / 2000 for x in steps[:3]] == want["rate_cam_rad_s"] == [0.12, -0.31, 0.05]
    assert [x / 100 for x in steps[3:]] == want["velocity_cam_m_s"] == [3.5, -19.2, 1.1]


def test_a_clicked_pixel_is_appended_where_a_reader_of_4_0_skips_it() -> None:
    """Section 6.1: behind everything that version 4.0 has, which stays what it was byte for byte."""
    measured, unmeasured = ((GOLDEN / f"{name}.bin").read_bytes() for name in ("measured_pixel", "unmeasured_pixel"))
    plain = encode(dataclasses.replace(decode(measured), clicked=None))
    assert plain[2] == 0x40 and (len(measured) - len(plain), len(unmeasured) - len(plain)) == (15, 9)
    assert measured[5:-19] == unmeasured[5:-13] == plain[5:-4]
    assert struct.unpack_from("<Bff", measured, len(measured) - 19) == (1, 300.5, 211.25)
    assert struct.unpack_from("<Bff", unmeasured, len(unmeasured) - 13) == (6, 300.5, 211.25)


def test_a_swing_is_appended_where_readers_of_4_0_and_4_1_skip_it() -> None:
    """Section 6.2: a first byte that states no clicked pixel, then how many moments and the step, then four each."""
    swing = (GOLDEN / "swing.bin").read_bytes()
    plain = encode(dataclasses.replace(decode(swing), swing=None))
    assert plain[2] == 0x40 and len(swing) - len(plain) == 18
    assert swing[5:-22] == plain[5:-4]
    assert (swing[-22], swing[-21]) == (0, 4 | 2 << 5)
    assert struct.unpack_from("<4b", swing, len(swing) - 20) == (25, 3, -40, 1)  # of 8 ms; of 2**-9 rad
    want = json.loads((GOLDEN / "swing.json").read_text())["swing"]
    assert want["turned_cam_rad"][1] == [-9 / 512, -64 / 512, 0.0]
    assert want["before_s"] == pytest.approx([0.2, 0.4, 0.6, 0.8])
