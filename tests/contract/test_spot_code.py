"""Spots of a picture: at most 200 bytes, read back, golden, and never anything but a WireError."""

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.answer import Ellipse, Place
from contract.errors import CorruptPayload, NewerPayload
from contract.feature_set import Status
from contract.spot import MOST_SPOTS, Spot, SpotReport, ThingKind
from contract.wire.outlines import fitted, outline_bytes
from contract.wire.spot_code import MAX_SPOT_BYTES, decode_spots, encode_spots

REPORT = SpotReport(
    1_700_000_000, 1234, 1_700_000_000_123_450_000, True,
    (
        Spot(
            320.0, 119.5, 12.0, 31.25, 8.4, Status.OK,
            Place(-43.123456789, 172.987654321, 113.444, 123.456, Ellipse(2.5, 1.5, 30.0), 3.0), 0.8, 0.2,
            ((-0.3, -0.4), (0.3, -0.4), (0.3, 0.4), (-0.3, 0.4)),
        ),
        Spot(
            12.25, 500.0, -5.5, 4.0, -3.0, Status.OK,
            Place(-43.123556789, 172.987754321, 112.4, 122.412, Ellipse(3.0, 2.0, 170.0), 3.5), 20.0, 5.0, (), True,
        ),
        Spot(600.0, 3.0, 4.5, 18.0, 2.0, Status.ABOVE_HORIZON),
    ),
    2, 0.95, 0.5, "uav-1",
)  # fmt: skip
GOLDEN = (
    "110f00f15365d204000039d09c359d9a0302f280eb44a4f5f5b120de462824bb01001c27000000040ac0036b710281000000000000655c2b"
    "6938100400e2d81ed81e28e228c06600a40f5150006718fce803f6ff6961f26c60100004c4121c004a68015d"
)

NEAR = st.floats(-0.05, 0.05)
FIGURES = st.floats(0.01, 1000.0)
PARTS_NAMED = st.lists(st.none() | st.floats(0.0, 1.0), min_size=20, max_size=20).map(tuple)
PERSON = st.just((None, ())) | st.tuples(st.floats(0.0, 1.0), PARTS_NAMED)


@st.composite
def reports(draw: st.DrawFn) -> SpotReport:
    """Whatever a camera may see: up to ten spots with outlines of up to sixty points."""
    is_calibrated = draw(st.booleans())
    lat, lon = draw(st.floats(-89.9, 89.9)), draw(st.floats(-180.0, 180.0))
    has_amsl, has_ellipsoid = draw(st.booleans()), draw(st.booleans())
    points = st.lists(st.tuples(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0)), min_size=3, max_size=60)
    spots = []
    for _ in range(draw(st.integers(0, 10))):
        sign = draw(st.sampled_from((-1.0, 1.0)))
        spot = Spot(
            draw(st.floats(-1.0, 8190.0)), draw(st.floats(-1.0, 8190.0)), sign * draw(st.floats(0.5, 900.0)),
            draw(st.floats(-100.0, 1500.0)) if is_calibrated else None,
            sign * draw(st.floats(0.1, 1000.0)) if is_calibrated else None, is_cut=draw(st.booleans()),
            kind=(kind := draw(st.sampled_from([None, *ThingKind]))),
            log_odds=0.0 if kind is None else draw(st.floats(-20.0, 20.0)),
        )  # fmt: skip
        if draw(st.booleans()):
            spots.append(replace(spot, status=draw(st.sampled_from([s for s in Status if s is not Status.OK]))))
            continue
        height = draw(st.floats(-400.0, 2000.0))
        beside = (lon + draw(NEAR) + 180.0) % 360.0 - 180.0
        place = Place(
            lat + draw(NEAR), beside, height if has_amsl else None, height + 12.5 if has_ellipsoid else None,
            Ellipse(draw(FIGURES), draw(FIGURES), draw(st.floats(0.0, 179.99))), draw(FIGURES),
        )  # fmt: skip
        area = draw(FIGURES)
        outline = tuple(draw(points)) if draw(st.booleans()) else ()
        spots.append(
            replace(spot, status=Status.OK, place=place, area_m2=area, sigma_area_m2=0.2 * area, outline_en_m=outline)
        )
    found, named = draw(PERSON)
    return SpotReport(
        draw(st.integers(0, 2**32 - 1)), draw(st.integers(0, 2**32 - 1)), draw(st.integers(0, 2**60)), is_calibrated,
        tuple(spots), draw(st.integers(0, 300)), draw(st.floats(0.0, 1.0)),
        draw(st.floats(0.0, 1.0)), person_found=found, person_named=named,
    )  # fmt: skip


def is_like(found: float | None, given: float | None, rel: float = 0.0, within: float = 0.0) -> bool:
    if found is None or given is None:
        return found is given
    return math.isclose(found, given, rel_tol=rel, abs_tol=within)


@given(reports())
def test_a_report_is_read_back_from_200_bytes_or_fewer(report: SpotReport) -> None:
    payload = encode_spots(report)
    assert 20 <= len(payload) <= MAX_SPOT_BYTES
    found = decode_spots(payload)
    kept = report.spots[:MOST_SPOTS]
    assert (found.session, found.frame, found.is_calibrated) == (report.session, report.frame, report.is_calibrated)
    assert abs(found.capture_unix_ns - report.capture_unix_ns) <= 10_000
    assert found.more == min(report.more + len(report.spots) - len(kept), 255)
    assert is_like(found.picture_share, report.picture_share, within=0.002)
    assert is_like(found.session_share, report.session_share, within=0.002)
    assert is_like(found.person_found, report.person_found, within=0.002)
    for share, given_share in zip(found.person_named, report.person_named, strict=True):
        assert is_like(share, given_share, within=0.0358)
    for one, other in zip(found.spots, kept, strict=True):
        assert (one.status, one.is_cut, one.kind) == (other.status, other.is_cut, other.kind)
        assert is_like(one.log_odds, min(max(other.log_odds, -15.875), 15.875), within=0.0626)
        assert is_like(one.contrast, other.contrast, rel=0.016)
        assert is_like(one.temperature_c, other.temperature_c, within=0.0251)
        assert is_like(one.above_ground_k, other.above_ground_k, rel=0.021)
        assert is_like(one.u_px, other.u_px, within=0.51) and is_like(one.v_px, other.v_px, within=0.51)
        assert (one.place is None) == (other.place is None)
        if one.place is not None and other.place is not None:
            p, q = one.place, other.place
            assert abs(p.lat_deg - q.lat_deg) <= 1.7e-6 and abs((p.lon_deg - q.lon_deg + 180) % 360 - 180) <= 1.7e-6
            assert is_like(p.ellipse.semi_major_m, q.ellipse.semi_major_m, rel=0.03)
            assert is_like(p.ellipse.semi_minor_m, q.ellipse.semi_minor_m, rel=0.03)
            assert is_like(p.sigma_height_m, q.sigma_height_m, rel=0.03)
            assert is_like(one.area_m2, other.area_m2, rel=0.045)
            assert is_like(one.sigma_area_m2 / one.area_m2, 0.2, within=0.01)
    assert encode_spots(found) == payload  # rounding happens once


@given(reports())
def test_heights_are_those_of_the_datums_that_are_known(report: SpotReport) -> None:
    for one, other in zip(decode_spots(encode_spots(report)).spots, report.spots, strict=False):
        if one.place is not None and other.place is not None:
            assert is_like(one.place.height_amsl_m, other.place.height_amsl_m, within=0.0511)
            assert is_like(one.place.height_ellipsoid_m, other.place.height_ellipsoid_m, within=0.0521)


def test_what_a_net_takes_a_spot_for_is_two_bytes_more_of_each_spot_and_nothing_where_all_are_only_hot() -> None:
    first, *others = REPORT.spots
    plain = encode_spots(replace(REPORT, spots=(first,)))
    b = encode_spots(replace(REPORT, spots=(replace(first, kind=ThingKind.VEHICLE, log_odds=-2.25),)))
    assert plain[1] == 0x0F and b[1] == 0x1F
    assert b[:1] + b[2:47] + b[49:] == plain[:1] + plain[2:47] + plain[47:]
    assert b[47:49] == bytes([2, 256 - 18])
    mixed = decode_spots(encode_spots(replace(REPORT, spots=(replace(first, kind=ThingKind.PERSON), *others))))
    assert [spot.kind for spot in mixed.spots] == [ThingKind.PERSON, None, None]
    for kind, steps, error in [(4, 0, NewerPayload), (0, 1, CorruptPayload), (1, 128, CorruptPayload)]:
        with pytest.raises(error):
            decode_spots(b[:47] + bytes([kind, steps]) + b[49:])


def test_no_odds_are_stated_as_certain() -> None:
    for log_odds, stated in ((800.0, 0.99), (-800.0, 0.01), (0.0, 0.5)):
        spot = replace(REPORT.spots[0], kind=ThingKind.PERSON, log_odds=log_odds)
        assert spot.to_dict()["probability"] == pytest.approx(stated, abs=1e-3)
        assert f"a person, {round(100.0 * stated)} % likely" in spot.to_text()


def test_who_would_have_been_found_is_eleven_bytes_behind_the_head_of_a_packet_of_version_2() -> None:
    parts = (0.0, 1.0, None, 0.5, *[0.96] * 16)
    plain, b = encode_spots(REPORT), encode_spots(replace(REPORT, person_found=0.2, person_named=parts))
    assert (b[0], b[1]) == (0x21, plain[1] | 0x40) and b[2:20] + b[31:] == plain[2:]
    assert b[20:31] == bytes.fromhex("33e07fdddddddddddddddd")
    for share, wrong in ((0.2, parts[:19]), (0.2, (*parts, 0.1)), (None, parts), (0.2, ())):
        with pytest.raises(ValueError, match="parts of a picture"):
            encode_spots(replace(REPORT, person_found=share, person_named=wrong))


@pytest.mark.parametrize(("flag", "person"), [(0x20, "33"), (0x40, "3f" + 9 * "33")])
def test_what_one_picture_finds_as_it_was_recorded_before_names_no_one(flag: int, person: str) -> None:
    plain = encode_spots(REPORT)
    found = decode_spots(plain[:1] + bytes([plain[1] | flag]) + plain[2:20] + bytes.fromhex(person) + plain[20:])
    assert found.person_found == pytest.approx(0.2 if flag == 0x20 else 3.0 / 14.0)
    assert found.person_named == () and found.spots == decode_spots(plain).spots


def test_the_bytes_are_those_of_the_document() -> None:
    b = encode_spots(REPORT)
    assert (b[0], b[1]) == (0x11, 0x0F)
    assert int.from_bytes(b[2:6], "little") == 1_700_000_000 and int.from_bytes(b[6:10], "little") == 1234
    assert int.from_bytes(b[10:16], "little") == 170_000_000_012_345
    assert (b[16], b[17]) == (3, 2) and (b[18], b[19]) == (round(0.95 * 255), round(0.5 * 255))
    assert int.from_bytes(b[20:25], "little", signed=True) == -43_123_456_789
    assert int.from_bytes(b[25:30], "little", signed=True) == 172_987_654_321
    assert int.from_bytes(b[30:34], "little") == 113_444 and int.from_bytes(b[34:37], "little") == 10_012 and b[37] == 0
    first, second, third = b[38:], b[69:], b[91:]
    assert first[0] == 0 and int.from_bytes(first[1:5], "little") == 2564 + (960 << 16)
    assert first[5] == 1 + round(math.log(12.0 / 0.5) / 0.03) and int.from_bytes(first[6:8], "little") == 625
    assert first[8] == 1 + round(math.log(8.4 / 0.05) / 0.04) and first[9:15] == bytes(6)
    assert first[15] == 1 + round(math.log(2.5 / 0.01) / 0.055) and first[17] == round(30.0 * 256 / 180)
    assert first[19] == 1 + round(math.log(0.8 / 0.01) / 0.08) and first[20] == 16
    assert first[21] == 4 and first[22] == 0 and first[23:31] == bytes([226, 216, 30, 216, 30, 40, 226, 40])
    assert second[0] == 0xC0 and int.from_bytes(second[9:11], "little", signed=True) == -1000 and second[21] == 0
    assert int.from_bytes(second[11:13], "little", signed=True) == 1000
    assert int.from_bytes(second[13:15], "little", signed=True) == -10
    assert third[0] == Status.ABOVE_HORIZON.code and len(third) == 9


def test_golden_bytes() -> None:
    assert encode_spots(REPORT).hex() == GOLDEN
    found = decode_spots(bytes.fromhex(GOLDEN), "uav-1")
    for one, other in zip(found.spots[0].outline_en_m, REPORT.spots[0].outline_en_m, strict=True):
        assert one == pytest.approx(other)
    assert found.to_text().splitlines()[0] == REPORT.to_text().splitlines()[0]
    assert found.spots[0].above_ground_k == pytest.approx(8.4, rel=0.02)
    read = json.loads(found.to_json())
    assert [spot["status"] for spot in read["spots"]] == ["ok", "ok", "above_horizon"]
    assert read["spots"][0]["lat_deg"] == -43.123456789 and read["more"] == 2 and "\n" not in found.to_json()


@pytest.mark.parametrize(
    "wrong",
    [
        replace(REPORT.spots[0], contrast=math.nan),
        replace(REPORT.spots[0], temperature_c=None),
        replace(REPORT.spots[0], outline_en_m=((0.0, 0.0), (math.inf, 1.0), (1.0, 1.0))),
        replace(REPORT.spots[2], status=Status.OK),
        replace(REPORT.spots[0], area_m2=-1.0),
    ],
)
def test_what_has_no_encoding_is_refused(wrong: Spot) -> None:
    with pytest.raises(ValueError, match="frame 1234"):
        encode_spots(replace(REPORT, spots=(wrong,)))


def circle(count: int, radius_m: float) -> tuple[tuple[float, float], ...]:
    angles = [2.0 * math.pi * i / count for i in range(count)]
    return tuple((radius_m * math.sin(a), radius_m * math.cos(a)) for a in angles)


def area(outline: tuple[tuple[float, float], ...]) -> float:
    return 0.5 * abs(
        sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(outline, outline[1:] + outline[:1], strict=True))
    )


def test_a_fire_alone_fills_the_packet_with_its_outline() -> None:
    fire = replace(REPORT.spots[0], outline_en_m=circle(400, 80.0), area_m2=area(circle(400, 80.0)))
    found = decode_spots(encode_spots(replace(REPORT, spots=(fire,)))).spots[0].outline_en_m
    assert 60 <= len(found) <= 70
    assert area(found) == pytest.approx(fire.area_m2, rel=0.02)


def test_a_fires_outline_takes_the_bytes_before_sparks_do() -> None:
    sparks = [replace(REPORT.spots[0], outline_en_m=circle(12, 0.5)) for _ in range(5)]
    fire = replace(REPORT.spots[0], outline_en_m=circle(200, 40.0))
    found = decode_spots(encode_spots(replace(REPORT, spots=(*sparks, fire))))
    assert len(found.spots) == 6
    assert [len(spot.outline_en_m) for spot in found.spots[:5]] == [0] * 5
    assert len(found.spots[5].outline_en_m) >= 14


@given(st.lists(st.integers(0, 80), min_size=1, max_size=6), st.integers(0, 200))
def test_outlines_fit_and_lose_no_more_than_they_must(counts: list[int], spare: int) -> None:
    outlines = [circle(n, 1.0 + i) if n >= 3 else () for i, n in enumerate(counts)]
    found = fitted(outlines, spare)
    taken = sum(outline_bytes(len(outline)) for outline in found)
    assert taken <= spare
    assert all(len(outline) == 0 or len(outline) >= 3 for outline in found)
    assert all(set(after) <= set(before) for after, before in zip(found, outlines, strict=True))
    if any(len(after) < len(before) for after, before in zip(found, outlines, strict=True)):
        assert taken >= min(spare - 7, sum(outline_bytes(len(outline)) for outline in outlines)) or not any(found)
