"""A file of places that is read twice makes its pins once."""

from dataclasses import replace
from pathlib import Path

import pytest

from ground.formats.documents import FORMATS, read_pins_of
from ground.formats.mark import Mark
from ground.pins.already_here import without_known
from ground.pins.model import Category, PinClick
from ground.pins.places import Places
from ground.pins.store import PinStore


@pytest.mark.parametrize("kind", ["kml", "gpx", "csv", "geojson", "cot"])
@pytest.mark.parametrize("lat_deg", [-43.123456789, 0.0, 89.9])
def test_our_own_export_read_back_is_known_and_what_differs_is_new(tmp_path: Path, kind: str, lat_deg: float) -> None:
    with PinStore(tmp_path / "pins.sqlite") as store:
        places = Places(store)
        for name, east_deg in (("red jacket", 0.0), ("", 0.0), ("", 1e-3)):
            click = PinClick.entered(lat_deg, -179.999999 + east_deg, seen_unix_ns=5_000_000_000)
            store.add([click], name=name, category=Category.PERSON)
        text = FORMATS[kind].write([Mark.of_pin(pin, places.place(pin)) for pin in store.pins()], None)
        found = read_pins_of(f"own.{kind}", text.encode()).pins
        assert len(found) == 3
        apart = [replace(pin, id=f"new{k}") for k, pin in enumerate(found)]
        assert without_known(apart, store.pins(), places) == []
        others = [
            replace(apart[0], name="blue jacket"), replace(apart[0], category=Category.VEHICLE),
            replace(apart[0], clicks=(replace(apart[0].clicks[0], lat_deg=lat_deg - 1e-5),)),
        ]  # fmt: skip
        assert without_known(others, store.pins(), places) == others
        edited = replace(store.pins()[0], note="seen again")
        assert without_known([edited], store.pins(), places) == [edited]
        assert without_known(found, [], places) == found
