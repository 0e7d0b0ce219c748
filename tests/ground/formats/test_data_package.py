"""TAK data packages: opened again by a reader of their public description; pictures, hostile texts, refusals."""

import io
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
import takproto
from PIL import Image

from contract.errors import InputError
from ground.__main__ import main
from ground.formats import cot, data_package
from ground.formats.mark import Mark
from ground.pins.model import Category, PinClick
from ground.pins.places import Places
from ground.pins.store import PinStore
from tests.ground.formats.packages import Package

NOW_NS = 1_700_000_000_000_000_000


def webp(colour: str) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (160, 160), colour).save(out, "WEBP", lossless=True)
    return out.getvalue()


def filled(folder: Path) -> Path:
    """A file of three pins: two clicks with a picture each, one with what is no picture, one without any."""
    with PinStore(folder / "pins") as store:
        first = PinClick.entered(-43.38, 172.4, sigma_m=2.0, height_ellipsoid_m=120.0)
        tent = store.add([first], name='<tent> & "co"', category=Category.PERSON, crop=webp("red"))
        store.add_click(tent.id, PinClick.entered(-43.38, 172.4, sigma_m=2.0), crop=webp("blue"))
        store.add([PinClick.entered(-43.39, 172.41, sigma_m=3.0)], name="car", crop=b"RIFF no picture")
        store.add([PinClick.entered(-43.40, 172.42)], name="gate")
    return folder / "pins"


def test_pins_and_their_pictures_are_read_again_by_others(tmp_path: Path) -> None:
    pins = filled(tmp_path)
    before = time.time()
    assert main(["pins", "export", str(tmp_path / "all.zip"), "--pins", str(pins)]) == 0
    package = Package((tmp_path / "all.zip").read_bytes())
    assert package.about["name"] == "3 pins"
    tent, car, gate = package.events.values()
    assert tent.find("detail/contact").get("callsign") == '1 <tent> & "co"'
    assert float(tent.find("point").get("lat", "")) == pytest.approx(-43.38, abs=1e-9)
    assert gate.find("point").get("ce") == cot.UNKNOWN
    colours = [picture.convert("RGB").getpixel((80, 80)) for picture in package.pictures[tent.get("uid", "")]]
    assert [[round(part / 255) for part in colour] for colour in colours] == [[0, 0, 1], [1, 0, 0]]
    assert not package.pictures[car.get("uid", "")] and not package.pictures[gate.get("uid", "")]
    for event in package.events.values():
        assert event.find("detail/archive") is not None
        stale = datetime.fromisoformat(event.get("stale", "").replace("Z", "+00:00"))
        assert stale.tzinfo == UTC and stale.timestamp() - before > 364 * 86_400.0
        text = data_package.ET.tostring(event, encoding="unicode")
        takproto.parse_proto(bytearray(takproto.xml2proto(text, takproto.TAKProtoVer.STREAM)))


def test_one_pin_alone_and_the_same_again_replaces_it(tmp_path: Path) -> None:
    pins, file = filled(tmp_path), tmp_path / "car.zip"
    found = []
    for only in (["2"], ["2"], ["3"]):
        assert main(["pins", "export", str(file), "--pin", *only, "--pins", str(pins)]) == 0
        found.append(Package(file.read_bytes()))
    assert [package.about["name"] for package in found] == ["2 car", "2 car", "3 gate"]
    assert found[0].about["uid"] == found[1].about["uid"] != found[2].about["uid"]
    assert found[0].events.keys() == found[1].events.keys() != found[2].events.keys()


def test_others_pins_choose_no_file_names(tmp_path: Path) -> None:
    with PinStore(filled(tmp_path)) as store:
        places = Places(store)
        pin = store.by_number(1)
        mark = Mark.of_pin(pin, places.place(pin))
        hostile = [replace(mark, id=name, name=name) for name in ("../../etc/passwd", "/root/x", "a\0b\n]]>", "C:\\x")]
        package = Package(data_package.write(hostile, store.crop, NOW_NS))
    assert len(package.events) == 4 and all(len(pictures) == 2 for pictures in package.pictures.values())


def test_a_pin_without_a_position_is_in_no_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unplaced = Mark("id", "lost", "contradicting", "two places")
    with pytest.raises(InputError, match="position"):
        data_package.write([unplaced], lambda _: None, NOW_NS)
    placed = Mark("id2", "here", "ok", lat_deg=1.0, lon_deg=2.0)
    assert len(Package(data_package.write([unplaced, placed], lambda _: None, NOW_NS)).events) == 1
    assert main(["pins", "export", "--format", "tak", "--pins", str(filled(tmp_path))]) == 2
    assert "pins.zip" in capsys.readouterr().err
    assert main(["pins", "export", str(tmp_path / "x.zip"), "--pin", "9", "--pins", str(tmp_path / "pins")]) == 2
    assert not (tmp_path / "x.zip").exists()
