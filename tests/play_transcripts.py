"""Transcripts of the commands, tests/transcripts/*.txt: what is typed, and all that is printed.

`make transcripts` plays them again and writes what is printed now; the difference is read in review, and the test
compares. In a file: `# ` a remark; `$ ` what is typed, in a folder of its own with the files of `furnish`; indented by
two spaces what goes to standard output, behind `! ` what goes to standard error; and `(exit N)` where that is not 0.
`$ printf '...' > FILE` writes a file and `>>` adds to it, `$ cp` copies one, `$ sed 's/A/B/' FILE > OTHER` copies it
with all A changed to B, `< FILE` is standard input, and `$ ls` shows what is there but for the inputs: that a command
wrote nothing. Words in angle brackets stand for what is another each time. A page of `PAGES` holds what a command
prints of cases that no one can type.
"""

import contextlib
import importlib
import io
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import cv2
import numpy as np
from mcap.writer import Writer
from PIL import Image

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.spot import Spot, SpotReport
from contract.topics import FEATURES, SPOTS
from contract.wire.codec import encode
from contract.wire.spot_code import encode_spots
from ground.link_recorder import LinkRecorder
from tests.ground.recorded import record
from tests.ground.seen.levels import level_set, record_search
from tests.ground.worlds import CAMERA, build
from tests.onboard.commands import doctor_page
from tests.onboard.service import prometheus_page

FOLDER = Path(__file__).parent / "transcripts"
START_NS = 1_700_000_000_250_000_000
PROGRAMS = {"pc-ground": "ground.__main__", "pc-onboard": "onboard.__main__", "simulation.fly": "simulation.fly"}
PAGES = {"pc-onboard-doctor": doctor_page.page, "prometheus": prometheus_page.page}
VOLATILE = (
    (re.compile(r"\b20\d\d-(?<!2023-)\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?(Z| UTC)?"), "<time>"),
    (re.compile(r"\(choose from [^)]*\)"), "(choose from <choices>)"),  # quoted by some versions of Python
    (re.compile(r"\b[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}\b"), "<id>"),
)


def furnish(folder: Path) -> None:
    """The inputs of the commands: recordings, a camera file, pictures."""
    rng = np.random.default_rng(0)
    sets = [build(rng, frame=i, capture_unix_ns=START_NS + i * 10**9).feature_set for i in range(3)]
    record(folder / "session.mcap", [*sets, FeatureSet("uav-1", 7, 3, START_NS + 3 * 10**9, Status.TURNING, CAMERA)])
    with (folder / "two.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start()
        for name in ("b", "a"):
            channel = writer.register_channel(f"pc/{name}/features", "pointclick", 0)
            writer.add_message(channel, 1, encode(replace(sets[0], vehicle=name)), 1)
        writer.finish()
    shutil.copytree(FOLDER.parent / "data" / "camera_files", folder / "lenses")
    (folder / "camera.json").write_text(Camera.from_field_of_view(640, 480, 60.0).to_json())
    for name, size in (("pictures", (640, 480)), ("small", (64, 48))):
        (folder / name).mkdir()
        Image.new("L", size).save(folder / name / "20260612T101523.25Z.png")
    (folder / "empty").mkdir()
    (folder / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    furnish_searches(folder)
    furnish_flights(folder)


def furnish_searches(folder: Path) -> None:
    """Recordings of searches from above, and a sector that half of one shows."""
    sets = [level_set(frame, east_m=130.0 * (frame % 3), vehicle="uav-1") for frame in range(4)]
    record(folder / "seen.mcap", sets)
    record(folder / "unsure.mcap", [level_set(sigma_m=90.0, vehicle="uav-1")])
    record_search(folder / "thermal.mcap", 4, (0.8,) * 20)
    refused = Spot(10.0, 20.0, 9.0, status=Status.NO_GPS)
    with LinkRecorder(folder / "cold") as recorder:
        recorder.take(FEATURES.key("uav-1"), encode(sets[0]))
        for found in (sets[0], sets[1]):  # by a clock that is months off, which one report alone would not show
            report = SpotReport(1, found.frame, found.capture_unix_ns, False, (refused,))
            recorder.take(SPOTS.key("uav-1"), encode_spots(report))


def furnish_flights(folder: Path) -> None:
    """A flight's pictures with stamps, camera and log; the same with one picture cut; and a video with its log."""
    began_s, flight, stamps = 1_795_217_167.0, folder / "flight", ["file,unix_time_s"]
    for frames in ("flight/frames", "cut"):
        (folder / frames).mkdir(parents=True)
        for index in range(5):
            Image.new("L", (64, 48), index).save(folder / frames / f"{index}.png")
    stamps += [f"{index}.png,{began_s + 2.0 + 0.2 * index:.3f}" for index in range(5)]
    (folder / "untimed").mkdir()
    for name in ("x", "y"):
        Image.new("L", (64, 48)).save(folder / "untimed" / f"{name}.png")
    picture = folder / "cut" / "3.png"
    picture.write_bytes(picture.read_bytes()[:60])
    (flight / "stamps.csv").write_text("\n".join(stamps))
    (flight / "camera.json").write_text(Camera.from_field_of_view(64, 48, 40.0).to_json())
    (flight / "config.toml").write_text("[mount]\nyaw_deg = 90.0\n")
    write_log(flight / "log.csv", began_s)
    began_s = datetime(2026, 6, 12, 10, 15, 23, tzinfo=UTC).timestamp()
    writer = cv2.VideoWriter(str(folder / "video.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (64, 48))
    for index in range(20):
        writer.write(np.full((48, 64, 3), 5 * index, np.uint8))
    writer.release()
    write_log(folder / "log.csv", began_s)


def write_log(path: Path, began_s: float) -> None:
    """A minute's way to the north as our own table."""
    rows = [f"{began_s + k},{-43.38 + 1e-5 * k:.7f},172.4,200.0" for k in range(60)]
    path.write_text("\n".join(["unix_time_s,lat_deg,lon_deg,height_amsl_m", *rows]))


def typed(text: str, furnished: set[str]) -> tuple[str, str, int]:
    """Run a line as a shell would; what goes to standard output and standard error, and the exit code."""
    words = shlex.split(text)
    if words[0] == "printf":
        with Path(words[3]).open("ab" if words[2] == ">>" else "wb") as file:
            file.write(unescaped(words[1]).encode("latin-1"))
        return "", "", 0
    if words[0] == "sed":
        changed = Path(words[2]).read_text(encoding="utf-8")
        for change in unescaped(words[1]).split(";"):
            _, before, after, _ = change.split("/")
            changed = changed.replace(before, after)
        Path(words[4]).write_text(changed, encoding="utf-8")
        return "", "", 0
    if words[0] == "cp":
        Path(words[2]).parent.mkdir(exist_ok=True)
        shutil.copyfile(*words[1:])
        return "", "", 0
    if words[0] == "ls":
        return "\n".join(sorted({path.name for path in Path().iterdir()} - furnished)), "", 0
    given = io.StringIO()
    if "<" in words:
        given = io.StringIO(Path(words.pop()).read_text(encoding="utf-8"))
        words.pop()
    main: Callable[[list[str]], int] = importlib.import_module(PROGRAMS[words[0]]).main
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), mock.patch.object(sys, "stdin", given):
        try:
            code = main(words[1:])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    return out.getvalue(), err.getvalue(), code


def unescaped(text: str) -> str:
    return text.encode("latin-1").decode("unicode_escape")


def played(text: str) -> str:
    """The transcript with what is printed now."""
    lines: list[str] = []
    home = Path.cwd()
    with TemporaryDirectory() as name, mock.patch.dict(os.environ, {"HOME": name, "COLUMNS": "120"}):
        furnish(Path(name))
        furnished = {path.name for path in Path(name).iterdir()}
        os.chdir(name)
        try:
            for line in text.splitlines():
                if line.startswith(("  ", "! ", "(exit ")):
                    continue
                lines.append(line)
                if line.startswith("$ "):
                    out, err, code = typed(line.removeprefix("$ "), furnished)
                    rows = [f"  {row}" for row in out.splitlines()] + [f"! {row}" for row in err.splitlines()]
                    lines += [steady(row.replace(name, "<folder>")) for row in rows]
                    lines += [f"(exit {code})"] if code else []
        finally:
            os.chdir(home)
    return "\n".join(line.rstrip() for line in lines) + "\n"


def steady(printed: str) -> str:
    """Return it with words in the place of what is another each time."""
    for pattern, word in VOLATILE:
        printed = pattern.sub(word, printed)
    return printed


def printed_now(path: Path) -> str:
    """Return what a transcript or a page would be, written now."""
    if path.stem in PAGES:
        return PAGES[path.stem]()
    return played(path.read_text(encoding="utf-8"))


def main() -> None:
    """Write every transcript and every page again."""
    for path in sorted({*FOLDER.glob("*.txt"), *(FOLDER / f"{name}.txt" for name in PAGES)}):
        path.write_text(printed_now(path), encoding="utf-8")


if __name__ == "__main__":
    main()
