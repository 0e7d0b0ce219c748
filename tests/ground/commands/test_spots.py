"""`pc-ground spots`, and what `watch`, `record` and `cot` have of hot spots: from a recording and from the link."""

import json
import threading
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.spot import SpotReport
from contract.topics import FEATURES, SPOTS
from contract.wire.codec import encode
from contract.wire.message import SPOT_REPORTS
from contract.wire.spot_code import encode_spots
from ground.__main__ import main
from ground.commands.spots import is_news
from ground.formats import cot
from ground.formats.mark import Mark
from ground.link_recorder import LinkRecorder
from ground.pins.machine import click_of, decision, decisions
from ground.pins.store import PinStore
from ground.recording import Recording
from ground.spots.merging import SpotMerger
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.ground.spots.sampled_spots import START_NS, Flight
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

PICTURES = 12


def reports() -> list[SpotReport]:
    """A person who stands, one who walks, and a spot that one picture alone shows."""
    flight = Flight(np.random.default_rng(4), session=plain_set(5).session)

    def things(t: float) -> list[tuple[float, float]]:
        return [(0.0, 0.0), (40.0 + 1.4 * t, 0.0), *([(100.0, 0.0)] if t == 2.0 else [])]

    return list(flight.reports(things, PICTURES))


def recorded(folder: Path) -> Path:
    there = replace(plain_set(5), vehicle="uav-1", capture_unix_ns=START_NS)
    with LinkRecorder(folder) as recorder:
        recorder.take(FEATURES.key("uav-1"), encode(there))
        for report in reports():
            recorder.take(SPOTS.key("uav-1"), encode_spots(report))
        recorder.take(SPOTS.key("uav-1"), b"\xff\xff")
    return folder


def test_what_was_recorded_is_read_again(tmp_path: Path) -> None:
    found = Recording(recorded(tmp_path / "flight")).reports(SPOT_REPORTS, ["uav-1"])
    assert len(found) == PICTURES and [r.frame for r in found] == list(range(PICTURES))
    assert len(found[0].spots) == 2 and len(found[4].spots) == 3 and found[0].vehicle == "uav-1"


def test_each_thing_of_a_flight_is_a_line_and_all_are_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = str(recorded(tmp_path / "flight"))
    assert main(["spots", "--from", flight]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [["spot", "1"], ["spot", "2"]]
    assert "31.0 degC" in lines[0] and f"in {PICTURES} pictures" in lines[0]
    assert main(["spots", "--from", flight, "--all", "--json", "--out", str(tmp_path / "a.geojson")]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["pictures"] for row in rows] == [PICTURES, PICTURES, 1]
    assert rows[0]["temperature_c"] == pytest.approx(31.0) and 2.0 < rows[0]["ellipse"]["semi_major_m"] < 3.5
    saved = json.loads((tmp_path / "a.geojson").read_text())["features"]
    points = [f for f in saved if f["geometry"]["type"] == "Point"]
    assert [f["properties"]["name"] for f in points] == ["spot 1", "spot 2", "spot 3"]
    for name in ("a.kml", "a.csv", "a.gpx"):
        assert main(["spots", "--from", flight, "--out", str(tmp_path / name)]) == 0
        assert "spot 2" in (tmp_path / name).read_text() and "spot 3" not in (tmp_path / name).read_text()


def test_live_a_thing_is_reported_when_it_is_sure_and_again_when_it_has_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint, ended = free_endpoint(), threading.Event()
    sent = reports()
    session = sent[0].session
    with Publisher("uav-1", [endpoint], rate=Rate(max_bit_rate=1e7)) as publisher:

        def publish() -> None:
            """A new flight again and again, for whoever begins to listen meanwhile."""
            for turn in range(10_000):
                for report in sent:
                    publisher.publish(replace(plain_set(5), vehicle="uav-1", session=session + turn))
                    publisher.report(SPOTS, encode_spots(replace(report, session=session + turn)))
                    if ended.wait(0.06):
                        return

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        try:
            received: list[str] = []

            def is_reported() -> bool:
                main(["spots", "--connect", endpoint, "--seconds", "2", "--json"])
                received[:] = capsys.readouterr().out.splitlines()
                return len({json.loads(line)["spot"] for line in received}) >= 2

            assert eventually(is_reported), received
            rows = [json.loads(line) for line in received]
            assert all(row["pictures"] > 1 for row in rows)

            def is_watched() -> bool:
                main(["watch", "--connect", endpoint, "--count", "1", "--period", "1"])
                return "spot 1 31.0 degC" in capsys.readouterr().out

            assert eventually(is_watched)
        finally:
            ended.set()
            thread.join(5.0)


def test_what_is_reported_again_is_another_place_or_heat_or_movement() -> None:
    merger = SpotMerger()
    for report in reports():
        merger.add(report)
    still, walker, _ = merger.things()
    assert is_news(still, None) and not is_news(still, still)
    assert [is_news(replace(still, above_ground_k=k), still) for k in (8.5, 10.0)] == [False, True]
    assert is_news(replace(still, place=walker.place), still)
    assert is_news(replace(still, course=None), still) == (still.course is not None)


def test_a_machines_find_has_its_own_type_until_a_person_decides(tmp_path: Path) -> None:
    merger = SpotMerger()
    for report in reports():
        merger.add(report)
    thing, other, _ = merger.things()
    text = cot.event(Mark.of_found(thing), START_NS, 30.0)
    assert text is not None
    event = ET.fromstring(text)
    assert event.get("type") == "b-m-p-s-p-i" and event.get("how") == "m-r"
    remarks = event.find("detail/remarks")
    assert "unconfirmed" in (remarks.text or "") and "31.0 degC" in (remarks.text or "")
    with PinStore(tmp_path / "pins.sqlite") as store:
        assert decision(thing, decisions(store.everything())) is None
        pin = store.add([click_of(thing, "anna")], name="found by the machine")
        confirmed = decision(thing, decisions(store.everything()))
        assert confirmed.id == pin.id and not confirmed.is_deleted
        assert decision(other, decisions(store.everything())) is None
        store.delete(store.add([click_of(other, "anna")]).id)
        dismissed = decision(other, decisions(store.everything()))
        assert dismissed.is_deleted
        # It stays so when the thing is seen again, in a better picture too.
        for report in reports():
            later = replace(report, capture_unix_ns=report.capture_unix_ns + 10**10, frame=report.frame + 100)
            merger.add(replace(later, spots=tuple(replace(spot, contrast=30.0) for spot in later.spots[:1])))
        again = merger.things()[0]
        assert again.best.frame >= 100
        still_confirmed = decision(again, decisions(store.everything()))
        assert still_confirmed.id == pin.id
