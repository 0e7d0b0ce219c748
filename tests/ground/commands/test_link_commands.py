"""Commands on a live link: what was recorded from it answers as the link did; watching; TAK over TLS."""

import json
import socket
import ssl
import threading
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from contract.link_config import link_config
from contract.locate import Locator
from contract.spot import SpotReport
from contract.topics import FEATURES, SPOTS, STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from contract.wire.spot_code import encode_spots
from ground.__main__ import main
from ground.commands.watch import _reporting, _row
from ground.link_recorder import LinkRecorder
from ground.recording import Recording
from onboard.link.certificates import make_credentials
from onboard.storage.mcap_writer import SessionRecorder
from tests.ground.worlds import build
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S, eventually

START_NS = 1_700_000_000_250_000_000
SETS = [
    build(np.random.default_rng(k), frame=k, capture_unix_ns=START_NS + k * 250_000_000).feature_set for k in range(8)
]


class Link(str):
    session: zenoh.Session


@pytest.fixture
def link() -> Iterator[Link]:
    """An aircraft that says its sets again and again, and its status; and somebody who says nonsense."""
    endpoint = Link(free_endpoint())
    session = endpoint.session = zenoh.open(zenoh.Config.from_json5(link_config("peer", listen=[endpoint])))
    stop = threading.Event()
    status = VehicleStatus(
        *(START_NS / 1e9, 7, "ok"), tracks=77, cpu_c=51.0, shares={"mount": 60, "gps": 21}, fix=6, satellites=17,
        battery_percent=64, battery_v=22.1, mode="AUTO",
    )  # fmt: skip

    def publish() -> None:
        while not stop.is_set():
            for s in SETS:
                session.put(FEATURES.key("uav-1"), encode(s))
                report = SpotReport(
                    s.session, s.frame, s.capture_unix_ns, True, vehicle="uav-1", person_found=0.9,
                    person_named=(0.9,) * 20,
                )  # fmt: skip
                session.put(SPOTS.key("uav-1"), encode_spots(report))
            session.put(STATUS.key("uav-1"), encode_status(status))
            session.put(FEATURES.key("uav-1"), b"PC nonsense")
            session.put("pc/uav-1/status", b"{" * 50)
            stop.wait(0.1)

    thread = threading.Thread(target=publish)
    thread.start()
    yield endpoint
    stop.set()
    thread.join()
    session.close()


def test_what_was_recorded_from_the_link_answers_like_the_aircraft(
    link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tries = iter(range(1000))
    folder, printed = tmp_path, ""

    def is_all_there() -> bool:
        """In little more than a second; into another folder, where a busy machine received less by then."""
        nonlocal folder, printed
        folder = tmp_path / f"new {next(tries)}" / "folder"
        assert main(["record", "--out", str(folder), "--seconds", "1.2", "--connect", link]) == 0
        printed = capsys.readouterr().out
        return (
            "none of ours" in printed and any(folder.iterdir()) and len(Recording(folder).frames("uav-1")) == len(SETS)
        )

    assert eventually(is_all_there)
    assert "uav-1-7.001.mcap" in printed
    assert [p.name for p in folder.iterdir()] == ["uav-1-7.001.mcap"]
    recording = Recording(folder)
    assert recording.frames("uav-1") == list(range(8)) and not recording.damage
    for s in SETS:
        got = recording.by_frame("uav-1", s.frame)
        assert got is not None and encode(got) == encode(s)
    assert main(["click", "320", "240", "--frame", "5", "--from", str(folder), "--format", "json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    expected = Locator(SETS[5]).locate((320.0, 240.0))
    assert answer["lat_deg"] == pytest.approx(expected.lat_deg, abs=1e-6)
    # Begun again: another part of the same session, read together with the first.
    again = ["record", "--out", str(folder), "--seconds", "0.7", "--connect", link]
    assert eventually(lambda: main(again) == 0 and len(list(folder.iterdir())) > 1)
    assert len(list(folder.iterdir())) == 2 and Recording(folder).frames("uav-1") == list(range(8))


def test_a_recording_has_no_name_that_leads_elsewhere(tmp_path: Path) -> None:
    """Whoever publishes may call himself anything that a key can hold."""
    status = encode_status(VehicleStatus(START_NS / 1e9, 7, "ok"))
    with LinkRecorder(tmp_path / "d") as recorder:
        for vehicle in ("..", "..\\..\\x", "a b;rm -rf ~", "\U0001f525" * 100, ".hidden", "x" * 300):
            recorder.take(STATUS.key(vehicle), status)
        recorder.take("pc/../../../etc/features", encode(SETS[0]))
        recorder.take("elsewhere", b"x")
        recorder.take("pc/new/other", b"before any session")
        for k in range(200):  # an invented vehicle each
            recorder.take(STATUS.key(f"v{k}"), status)
    found = list((tmp_path / "d").iterdir())
    assert sorted(tmp_path.iterdir()) == [tmp_path / "d"]
    assert 40 < len(found) <= 50 and all(p.is_file() and not p.name.startswith(".") for p in found)


def test_a_killed_recorder_loses_nothing(tmp_path: Path) -> None:
    recorder = LinkRecorder(tmp_path)
    for s in SETS:
        recorder.take(FEATURES.key("uav-1"), encode(s))
    assert Recording(tmp_path).frames("uav-1") == list(range(8))  # not closed
    recorder.__exit__(None, None, None)


def test_a_folder_that_cannot_be_used_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("x")
    assert main(["record", "--out", str(tmp_path / "file" / "below"), "--connect", "tcp/127.0.0.1:9"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def answers(query: zenoh.Query) -> None:
    """The newest set, and how old its picture is, by the aircraft's own clock, which is years behind."""
    with query:
        query.reply(FEATURES.key("uav-1"), encode(SETS[-1]), attachment=b'{"age_s":0.1}')


def test_watching_shows_state_age_rate_position_and_accuracy(link: Link, capsys: pytest.CaptureFixture[str]) -> None:
    rows: list[dict[str, Any]] = []
    link.session.declare_queryable(FEATURES.key("uav-1"), answers)

    def is_shown() -> bool:
        """In the second of two tables, or once more where a busy machine received too little by then."""
        assert main(["watch", "--json", "--count", "2", "--period", "0.6", "--connect", link]) == 0
        rows.extend(json.loads(line) for line in capsys.readouterr().out.splitlines())
        return bool(rows) and rows[-1]["state"] == "ok" and rows[-1]["age_s"] < 2.0 and rows[-1]["rate_hz"] > 2.0

    assert eventually(is_shown), rows
    row = rows[-1]
    assert (row["vehicle"], row["state"], row["tracks"], row["cpu_c"]) == ("uav-1", "ok", 77, 51.0)
    assert row["aircraft"] == "RTK fixed, 17 satellites; battery 64 %, 22.1 V; mode AUTO"
    assert (row["fix"], row["satellites"], row["battery_percent"], row["battery_v"]) == (6, 17, 64, 22.1)
    assert row["radius"] == "mostly the camera's mount (60 %): fly one circle"
    assert 1.0 < row["ce90_m"] < 50.0
    assert row["lat_deg"] == pytest.approx(-35.36, abs=0.01)
    out: list[str] = []

    def is_a_table() -> bool:
        assert main(["watch", "--count", "1", "--period", "0.6", "--connect", link]) == 0
        out[:] = capsys.readouterr().out.splitlines()
        return len(out) > 1 and "fly one circle; a person" in out[1]

    assert eventually(is_a_table), out
    assert out[0].split()[:4] == ["vehicle", "state", "age", "rate"] and out[1].startswith("uav-1")


def test_a_second_camera_that_is_lost_is_in_the_row_next_to_the_reason() -> None:
    status = VehicleStatus(START_NS / 1e9, 7, "turning", "too fast", heat="lost: unplugged")
    assert _row("uav-1", None, status, 0.1, None).reason == "too fast; no hot spots: thermal camera lost: unplugged"


@pytest.mark.parametrize(
    ("behind_s", "silent_s", "words"),
    [(0.0, 0.5, "no fix; battery 9 %"), (9.0, 9.0, "no fix; battery 9 %"), (12.0, 0.5, ""), (0.0, 12.0, "")],
)
def test_a_battery_is_stated_as_of_now_only_while_statuses_come(behind_s: float, silent_s: float, words: str) -> None:
    status = VehicleStatus(SETS[-1].capture_unix_ns / 1e9 - behind_s, 7, "no gps", fix=1, battery_percent=9)
    row = _reporting(_row("uav-1", SETS[-1], status, 0.1, None), SETS[-1], status, silent_s)
    assert row.aircraft == words and row.battery_percent == (9 if words else None)


def test_what_was_seen_is_counted_from_the_link(link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each picture once, however often its set comes; of the sets of another aircraft nothing."""
    kept = tmp_path / "same.mcap"
    with SessionRecorder(kept, "uav-1") as out:
        for s in SETS:
            out.write_set(s)
    assert main(["seen", "--from", str(kept), "--cell", "4"]) == 0
    recorded = capsys.readouterr().out
    live = ["seen", "--connect", link, "--vehicle", "uav-1", "--seconds", "3", "--cell", "4"]
    assert eventually(lambda: main(live) == 0 and capsys.readouterr().out == recorded)
    assert f"in {len(SETS)} pictures of uav-1" in recorded
    searched = f"{len(SETS)} of {len(SETS)} pictures searched"
    assert eventually(lambda: main([*live, "--pod"]) == 0 and searched in capsys.readouterr().out)


def test_lines_are_answered_from_the_link(
    link: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No one answers queries there: one line says so, for each line asked."""
    import io  # noqa: PLC0415

    def is_reported() -> bool:
        monkeypatch.setattr("sys.stdin", io.StringIO("1 2\n"))
        assert main(["click", "--connect", link]) == 2
        return "line 1: no aircraft answers" in capsys.readouterr().err

    assert eventually(is_reported)


def test_events_reach_a_tak_server_over_tls_and_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_credentials(tmp_path / "keys", ["server"], [], ["127.0.0.1"], 10.0)
    server = tmp_path / "keys" / "server"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(server / "certificate.pem", server / "key.pem")
    got: list[bytes] = []
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(PATIENCE_S)
    port = listener.getsockname()[1]

    def serve() -> None:
        for _ in range(2):
            plain, _ = listener.accept()
            try:
                with context.wrap_socket(plain, server_side=True) as client:
                    while part := client.recv(65536):
                        got.append(part)
            except (ssl.SSLError, OSError):
                plain.close()

    thread = threading.Thread(target=serve)
    thread.start()
    pins = str(tmp_path / "pins.sqlite")
    main(["pins", "add", "--at", "1.0,2.0", "--ce90", "5", "--name", "p", "--pins", pins])
    capsys.readouterr()
    send = ["cot", "--to", f"tls://127.0.0.1:{port}", "--once", "--only-pins", "--pins", pins]
    assert main(send) == 2  # an authority that no one here knows
    assert "authority" in capsys.readouterr().err
    assert main([*send, "--to-ca", str(server / "ca.pem")]) == 0
    thread.join(PATIENCE_S)
    listener.close()
    (event,) = b"".join(got).splitlines()
    assert ET.fromstring(event).find("point").get("ce") == "5.00"
