"""The wire format of versions 2.0 and 3.0, frozen: golden bytes beside what they mean."""

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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
    assert NAMES == ["a_hundred_features", "plane_only", "refused", "rolling_shutter", "twelve_features"]


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_decode_to_what_they_meant(name: str) -> None:
    want = json.loads((GOLDEN / f"{name}.json").read_text())
    assert_close(plain_json(decode((GOLDEN / f"{name}.bin").read_bytes())), want, name)


@pytest.mark.parametrize("name", NAMES)
def test_golden_sets_encode_to_their_bytes(name: str) -> None:
    payload = (GOLDEN / f"{name}.bin").read_bytes()
    assert encode(decode(payload)) == payload


def test_the_offsets_in_the_document_are_those_of_the_bytes() -> None:
    """Reads a payload with nothing but docs/wire-format.md, sections 2 to 4, in hand."""
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
    """Section 4.5: between the plane's roughness and the fresh sigmas."""
    b = (GOLDEN / "rolling_shutter.bin").read_bytes()
    want = json.loads((GOLDEN / "rolling_shutter.json").read_text())["shutter"]
    assert b[2] == 0x30
    g = 71 + 42
    readout_s, sigma, *steps = struct.unpack_from("<fH6h", b, g)
    assert readout_s == want["readout_s"] == pytest.approx(-0.021, rel=1e-6)
    assert 1e-12 * np.exp(0.0006 * (sigma - 1.0)) == pytest.approx(want["sigma_readout_s"], rel=1e-12)
    assert [x / 2000 for x in steps[:3]] == want["rate_cam_rad_s"] == [0.12, -0.31, 0.05]
    assert [x / 100 for x in steps[3:]] == want["velocity_cam_m_s"] == [3.5, -19.2, 1.1]
