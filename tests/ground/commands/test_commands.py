"""The commands next to `click` as their user sees them: arguments in; text, JSON, files and exit status out."""

import contextlib
import csv
import io
import json
import math
import os
import socket
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.wire.codec import decode, encode
from ground.__main__ import COMMANDS, main
from ground.accuracy_figures import coverage_interval, figures
from tests.ground.recorded import record
from tests.ground.worlds import CAMERA, World, build
from tests.waiting import PATIENCE_S

START_NS = 1_700_000_000_250_000_000
ROOT = Path(__file__).resolve().parents[3]


def worlds() -> list[World]:
    rng = np.random.default_rng(0)
    return [build(rng, frame=k, capture_unix_ns=START_NS + k * 10**9) for k in range(12)]


WORLDS = worlds()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> str:
    turning = FeatureSet("uav-1", 7, 12, START_NS + 12 * 10**9, Status.TURNING, CAMERA)
    return record(tmp_path_factory.mktemp("session") / "s.mcap", [*(world.feature_set for world in WORLDS), turning])


@pytest.fixture
def pins(tmp_path: Path) -> str:
    return str(tmp_path / "pins.sqlite")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = main([str(a) for a in arguments])
    printed = capsys.readouterr()
    return status, printed.out, printed.err


def answer(frame: int, u: float, v: float) -> Fix:
    found = Locator(decode(encode(WORLDS[frame].feature_set))).locate((u, v))
    assert isinstance(found, Fix)
    return found


# click


@pytest.mark.parametrize("form", ["text", "json", "geojson", "kml", "gpx", "csv", "cot", "mgrs", "utm", "dms", "dm"])
def test_a_click_in_every_format(session: str, capsys: pytest.CaptureFixture[str], form: str) -> None:
    fix = answer(3, 300.0, 200.0)
    status, out, err = run(capsys, "click", 300, 200, "--frame", 3, "--from", session, "--format", form)
    assert (status, err) == (0, "")
    figures_of = {"mgrs": "55HFA", "utm": "55H ", "dms": "35°21'", "dm": "35°21."}
    # For people as many digits as the ellipse gives meaning to; in files for machines all.
    figures_of["text"] = fix.ellipse.rounded(fix.lat_deg, fix.lon_deg)
    assert len(figures_of["text"].split()[0].partition(".")[2]) == 5 and 1.0 < fix.ellipse.semi_major_m < 50.0
    assert figures_of.get(form, f"{fix.lat_deg:.9f}"[:11]) in out
    if form not in ("text", "json"):
        assert "CE90" in out or "ce90_m" in out
    status, out, err = run(capsys, "click", 300, 200, "--frame", 12, "--from", session, "--format", form)
    assert status == 3
    assert "turning" in (out if form in ("json", "geojson", "csv") else err)
    if form == "cot":
        assert out == ""


def test_lines_of_standard_input_are_answered_one_by_one(
    session: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("300 200\n\n# nothing\n3 300 200  # the tent\n12,1,2\n"))
    status, out, err = run(capsys, "click", "--from", session, "--format", "json")
    printed = [json.loads(line) for line in out.splitlines()]
    assert (status, err) == (0, "")
    assert [(a["status"], a["frame"]) for a in printed] == [("ok", 11), ("ok", 3), ("turning", 12)]
    assert printed[1]["lat_deg"] == pytest.approx(answer(3, 300.0, 200.0).lat_deg, abs=1e-9)


@pytest.mark.parametrize("form", ["csv", "geojson", "kml"])
def test_lines_become_one_document(
    session: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("3 300 200\nthree words here or so\n4 100 100\n12 1 1\n"))
    status, out, err = run(capsys, "click", "--from", session, "--format", form)
    assert status == 2 and "line 2" in err and len([line for line in err.splitlines() if "error" in line]) == 1
    if form == "csv":
        rows = list(csv.DictReader(io.StringIO(out, newline="")))
        assert [row["status"] for row in rows] == ["ok", "ok", "turning"]
    elif form == "geojson":
        features = json.loads(out)["features"]
        assert [f["geometry"] is None for f in features] == [False, False, True]
        assert [f["properties"]["number"] for f in features] == [1, 2, 3]
    else:
        assert len(ET.fromstring(out).findall(".//{*}Point")) == 2


def test_other_coordinates(session: str, capsys: pytest.CaptureFixture[str]) -> None:
    fix = answer(3, 300.0, 200.0)
    common = ("click", 300, 200, "--frame", 3, "--from", session)
    crs = json.loads(run(capsys, *common, "--crs", "EPSG:28355", "--format", "json")[1])["crs"]
    assert (crs["name"], crs["x_axis"], crs["y_axis"]) == ("EPSG:28355", "E", "N")
    assert 600_000 < crs["x"] < 750_000 and 6_000_000 < crs["y"] < 6_100_000
    local = json.loads(run(capsys, *common, "--local", "-35.36,149.16", "--format", "json")[1])["crs"]
    at = LocalFrame(-35.36, 149.16, fix.height_ellipsoid_m or 0.0)
    enu = at.to_enu(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m or 0.0)
    assert (local["x"], local["y"]) == pytest.approx((enu[0], enu[1]), abs=2e-3)
    assert run(capsys, *common, "--local", "-35.36,149.16")[1].startswith("east ")
    status, _, err = run(capsys, *common, "--crs", "EPSG:1")
    assert status == 2 and "EPSG:2193" in err and len(err.splitlines()) == 1
    for wrong in ("1", "91,0", "x,y", "1,2,3"):
        with pytest.raises(SystemExit):
            main([*map(str, common), "--local", wrong])


# measure


def test_measuring_in_one_picture_and_in_two(session: str, capsys: pytest.CaptureFixture[str]) -> None:
    def between(*arguments: object) -> dict[str, float]:
        status, out, err = run(capsys, "measure", *arguments, "--from", session, "--json")
        assert (status, err) == (0, "")
        return json.loads(out)

    a, b, c = answer(3, 150.0, 150.0), answer(3, 500.0, 300.0), answer(5, 500.0, 300.0)
    same, other = between(150, 150, 500, 300, "--frame", 3), between(150, 150, 500, 300, "--frame", 3, "--frame2", 5)
    for found, two in ((same, b), (other, c)):
        d = LocalFrame(a.lat_deg, a.lon_deg, a.height_ellipsoid_m or 0.0).to_enu(
            two.lat_deg, two.lon_deg, a.height_ellipsoid_m or 0.0
        )
        assert found["distance_m"] == pytest.approx(math.hypot(d[0], d[1]), abs=0.05)
        assert found["bearing_deg"] == pytest.approx(math.degrees(math.atan2(d[0], d[1])) % 360.0, abs=0.05)
        assert found["height_difference_m"] == pytest.approx(
            (two.height_amsl_m or 0) - (a.height_amsl_m or 0), abs=0.05
        )
    # One picture's camera is in one place: what both clicks share cancels.
    assert 0.05 < same["sigma_distance_m"] < other["sigma_distance_m"]
    out = run(capsys, "measure", 150, 150, 500, 300, "--from", session)[1]
    assert "bearing" in out and "(one sigma)" in out
    assert run(capsys, "measure", 150, 150, 9999, 300, "--from", session)[0] == 3
    assert run(capsys, "measure", 1, 2, 3, 4, "--frame2", 5, "--from", session)[0] == 2


# pins


def test_pins_come_back_from_files_as_they_were(
    session: str, pins: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The words of each action: tests/transcripts/pc-ground-pins.txt."""

    def printed(*arguments: object) -> str:
        status, out, err = run(capsys, "pins", *arguments, "--pins", pins)
        assert status == 0, err
        return out

    def exported() -> list[dict[str, object]]:
        features = json.loads(printed("export"))["features"]
        return [{**f["pointclick"]["pin"], "modified_unix_ns": 0} for f in features]

    printed("add", 300, 200, "--frame", 3, "--from", session, "--name", "tent", "--category", "person")
    printed("add", "--at", "-35.36,149.16", "--name", "=gate")
    printed("add", "--at", "-35.361,149.161", "--ce90", 4, "--name", "hut")
    assert json.loads(printed("list", "--format", "json", "--text", "TENT"))["ce90_m"] > 1.0
    before, files = exported(), [tmp_path / f"all.{kind}" for kind in ("geojson", "kml", "gpx", "csv")]
    for file in files:
        printed("export", file)
    printed("clear")
    assert "3 pins imported" in printed("import", files[0])
    assert exported() == before
    for file in files[1:]:
        assert "0 pins imported; 3 were here already" in printed("import", file)
        printed("clear")
        assert "3 pins imported" in printed("import", file)
        assert "0 pins imported; 3 were here already" in printed("import", file)
    assert len(printed("list").splitlines()) == 3
    assert "nothing to undo" in [printed("undo") for _ in range(20)][-1]


def test_undo_leaves_what_another_has_done(pins: str, capsys: pytest.CaptureFixture[str]) -> None:
    def printed(*arguments: object) -> str:
        status, out, err = run(capsys, "pins", *arguments, "--pins", pins)
        assert status == 0, err
        return out

    printed("add", "--at", "1.0,2.0", "--who", "ann")
    printed("add", "--at", "3.0,4.0", "--who", "ben")
    assert "pin 1 added" in printed("undo", "--who", "ann")
    left = printed("undo", "--who", "ann")
    assert "nothing of yours" in left and "'pin 2 added' by 'ben'" in left and "--who ben" in left
    assert len(printed("list").splitlines()) == 1
    assert "pin 2 added" in printed("undo", "--who", "ben")
    assert printed("undo", "--who", "ben").strip() == "there is nothing to undo"
    assert "nothing of yours to redo" in printed("redo", "--who", "cat")


def test_a_tie_on_the_command_line(session: str, pins: str, capsys: pytest.CaptureFixture[str]) -> None:
    truth = WORLDS[3].truth_enu_m[0]
    u, v = WORLDS[3].clicks_px[0]
    from tests.ground.worlds import ORIGIN  # noqa: PLC0415

    lat, lon, _ = (float(c) for c in ORIGIN.to_geodetic(truth))
    run(capsys, "pins", "add", 300, 200, "--frame", 3, "--from", session, "--pins", pins)
    before = json.loads(run(capsys, "pins", "list", "--format", "json", "--pins", pins)[1])
    tie = ("pins", "tie", u, v, "--frame", 3, "--from", session, "--sigma", 0.5, "--pins", pins)
    status, out, _ = run(capsys, *tie, "--place", f"{lat:.9f},{lon:.9f}")
    assert status == 0 and "1 pins" in out
    after = json.loads(run(capsys, "pins", "list", "--format", "json", "--pins", pins)[1])
    assert after["ties"] == 1 and after["ce90_m"] < 0.8 * before["ce90_m"]
    status, _, err = run(capsys, *tie, "--place", f"{lat + 0.01:.9f},{lon:.9f}")
    assert status == 2 and "tie refused" in err and "would still be accepted" in err
    assert len(run(capsys, "pins", "ties", "--pins", pins)[1].splitlines()) == 1


# cot


class Listener:
    def __init__(self, kind: str) -> None:
        self.data = b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(PATIENCE_S)
        self.url = f"{kind}://127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._take_tcp)
        self._take = self._take_udp if kind == "udp" else self._thread.join
        if kind == "tcp":
            self._socket.listen()
            self._thread.start()

    def _take_tcp(self) -> None:
        client, _ = self._socket.accept()
        while part := client.recv(65536):
            self.data += part
        client.close()

    def _take_udp(self) -> None:
        """What has been sent: it is all there, for on one machine datagrams have no way to go."""
        self._socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self.data += self._socket.recv(65536) + b"\n"

    def lines(self) -> list[bytes]:
        self._take()
        self._socket.close()
        return self.data.splitlines()


@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_pins_and_aircraft_go_out_as_events(
    session: str, pins: str, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    run(capsys, "pins", "add", 300, 200, "--frame", 3, "--from", session, "--pins", pins, "--name", "<tent>")
    listener = Listener(kind)
    assert run(capsys, "cot", "--to", listener.url, "--once", "--from", session, "--pins", pins)[0] == 0
    events = [ET.fromstring(line) for line in listener.lines()]
    assert [e.get("type") for e in events] == ["b-m-p-s-m", "a-f-A-M-F-Q", "b-m-p-s-p-i"]
    for e in events:
        at = e.find("point")
        assert 1.0 < float(at.get("ce", "")) < 100.0
        assert "CE90" in (e.findtext("detail/remarks") or "")
    contact = events[0].find("detail/contact")
    assert contact.get("callsign") == "1 <tent>"


# accuracy


def marks_file(path: Path, shift_m: float = 0.0) -> Path:
    from tests.ground.worlds import ORIGIN  # noqa: PLC0415

    with path.open("w", newline="") as stream:
        out = csv.writer(stream)
        out.writerow(["name", "frame", "u", "v", "lat_deg", "lon_deg", "height_ellipsoid_m", "sigma_m"])
        for world in WORLDS:
            for (u, v), truth in zip(world.clicks_px, world.truth_enu_m, strict=True):
                lat, lon, height = ORIGIN.to_geodetic(truth + [shift_m, 0.0, 0.0])
                out.writerow(["m", world.feature_set.frame, u, v, lat, lon, height, 0.1])
        out.writerow(["turning", 12, 1, 1, -35.0, 149.0, "", ""])
    return path


def test_accuracy_on_marks_sampled_from_the_stated_errors(
    session: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    marks = marks_file(tmp_path / "marks.csv")
    plot = tmp_path / "plot.png"
    status, out, err = run(capsys, "accuracy", "--truth", marks, "--from", session, "--json", "--plot", plot)
    found = json.loads(out)
    assert status == 0 and "turning" in err
    assert (found["marks"], found["refused"]) == (24, 1)
    assert found["coverage_low"] < 0.9 < found["coverage_high"] and "hold what they state" in found["verdict"]
    each = np.array([[e["east_m"], e["north_m"]] for e in found["each"]])
    assert found["rmse_east_m"] == pytest.approx(np.sqrt(np.mean(each[:, 0] ** 2)))
    assert found["rmse_radial_m"] == pytest.approx(np.sqrt(np.mean(each**2) * 2.0))
    assert found["nssda_radial_95_m"] == pytest.approx(2.4477 * (found["rmse_east_m"] + found["rmse_north_m"]) / 2.0)
    assert plot.read_bytes().startswith(b"\x89PNG")
    text = run(capsys, "accuracy", "--truth", marks, "--from", session)[1]
    for word in ("RMSE", "CEP, CE90", "LE90", "ASPRS RMSE_H", "NSSDA", "coverage", "verdict"):
        assert word in text


def test_a_map_that_is_shifted_is_found(session: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    marks = marks_file(tmp_path / "marks.csv", shift_m=-30.0)
    found = json.loads(run(capsys, "accuracy", "--truth", marks, "--from", session, "--json")[1])
    assert found["bias_significant"] and found["bias_east_m"] == pytest.approx(30.0, abs=5.0)
    assert "too small" in found["verdict"]


def test_the_interval_of_a_coverage_is_clopper_and_pearsons() -> None:
    known = {
        (0, 5): (0.0, 0.52182),
        (5, 5): (0.47818, 1.0),
        (90, 100): (0.82378, 0.95099),
        (17, 20): (0.62107, 0.96793),
    }
    for (held, of), bounds in known.items():
        assert coverage_interval(held, of) == pytest.approx(bounds, abs=1e-5)
    low, high = coverage_interval(1800, 2000)
    assert 0.885 < low < 0.888 and 0.912 < high < 0.914
    few = figures(np.zeros((3, 2)), np.zeros(0), [True] * 3, np.zeros(3))
    assert "too few" in few.verdict and few.le90_m is None


# watch, completion, help


def test_watching_a_recording(session: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "watch", "--from", session)
    assert status == 0 and out.splitlines()[0].startswith("vehicle") and "turning" in out
    row = json.loads(run(capsys, "watch", "--from", session, "--json")[1])
    assert (row["vehicle"], row["state"], row["frame"], row["ce90_m"]) == ("uav-1", "turning", 12, None)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_our_commands(shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "completion", shell)
    assert status == 0
    for word in (*COMMANDS, "max-age", "category", "geojson"):
        assert word in out
    if shell == "bash":
        script = tmp_path / "c.bash"
        script.write_text(out)
        ask = f"source {script}; COMP_WORDS=(pc-ground me); COMP_CWORD=1; _shtab_pc_ground; echo ${{COMPREPLY[@]}}"
        done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=False)
        assert done.stdout.split() == ["measure"], done.stderr


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_explains_itself_with_examples(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    out = capsys.readouterr().out
    assert ended.value.code == 0 and "examples:" in out and f"pc-ground {command}" in out


def test_a_reader_that_goes_away_is_no_error(session: str) -> None:
    command = (
        f"yes '3 300 200' | head -2000 | {sys.executable} -m ground click --from {session} --format json | head -1"
    )
    done = subprocess.run(
        ["bash", "-c", command], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False, timeout=60,
    )  # fmt: skip
    assert json.loads(done.stdout)["status"] == "ok" and done.stderr == ""


@pytest.mark.parametrize("command", ["click", "measure", "watch", "pins", "accuracy", "cot"])
def test_a_damaged_or_lying_recording_ends_in_a_line_or_an_answer(
    session: str, tmp_path: Path, pins: str, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """Bytes overwritten anywhere: an answer, a refusal or one line; never a traceback."""
    marks = marks_file(tmp_path / "marks.csv")
    listener = Listener("udp")  # of several datagrams to where no one listens the second is an error
    words: dict[str, tuple[object, ...]] = {
        "click": ("click", 300, 200), "measure": ("measure", 300, 200, 100, 100), "watch": ("watch",),
        "pins": ("pins", "add", 300, 200, "--pins", pins), "accuracy": ("accuracy", "--truth", marks),
        "cot": ("cot", "--to", listener.url, "--once", "--only-aircraft"),
    }  # fmt: skip
    rng = np.random.default_rng(5)
    whole = Path(session).read_bytes()
    path = tmp_path / "damaged.mcap"
    statuses = set()
    for _ in range(6 if command in ("accuracy", "pins") else 15):
        data = bytearray(whole)
        for _ in range(int(rng.integers(1, 4))):
            at, length = int(rng.integers(8, len(data))), int(rng.integers(1, 300))
            data[at : at + length] = rng.integers(0, 256, len(data[at : at + length]), dtype=np.uint8).tobytes()
        path.write_bytes(data)
        status, _, err = run(capsys, *words[command], "--from", path)
        statuses.add(status)
        assert "Traceback" not in err
    listener.lines()
    assert statuses <= {0, 2, 3} and 0 in statuses
