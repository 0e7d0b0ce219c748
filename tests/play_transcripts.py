"""Transcripts of the commands, tests/transcripts/*.txt: what is typed, and all that is printed.

`make transcripts` plays them again and writes what is printed now; the difference is read in review, and the test
compares. In a file: `# ` a remark; `$ ` what is typed, in a folder of its own with the files of `furnish`; indented by
two spaces what goes to standard output, behind `! ` what goes to standard error; and `(exit N)` where that is not 0.
`$ printf '...' > FILE` writes a file, and `< FILE` is standard input. Words in angle brackets stand for what is
another each time. A page of `PAGES` holds what a command prints of cases that no one can type.
"""

import contextlib
import importlib
import io
import os
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np
from mcap.writer import Writer
from PIL import Image

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.wire.codec import encode
from tests.ground.recorded import record
from tests.ground.worlds import CAMERA, build
from tests.onboard.commands import doctor_page

FOLDER = Path(__file__).parent / "transcripts"
START_NS = 1_700_000_000_250_000_000
PROGRAMS = {"pc-ground": "ground.__main__", "pc-onboard": "onboard.__main__"}
PAGES = {"pc-onboard-doctor": doctor_page.page}
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
    (folder / "camera.json").write_text(Camera.from_field_of_view(640, 480, 60.0).to_json())
    for name, size in (("pictures", (640, 480)), ("small", (64, 48))):
        (folder / name).mkdir()
        Image.new("L", size).save(folder / name / "20260612T101523.25Z.png")
    (folder / "empty").mkdir()
    (folder / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")


def typed(text: str) -> tuple[str, str, int]:
    """Run a line as a shell would; what goes to standard output and standard error, and the exit code."""
    words = shlex.split(text)
    if words[0] == "printf":
        Path(words[3]).write_text(words[1].encode().decode("unicode_escape"), encoding="utf-8")
        return "", "", 0
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


def played(text: str) -> str:
    """The transcript with what is printed now."""
    lines: list[str] = []
    home = Path.cwd()
    with TemporaryDirectory() as name, mock.patch.dict(os.environ, {"HOME": name, "COLUMNS": "120"}):
        furnish(Path(name))
        os.chdir(name)
        try:
            for line in text.splitlines():
                if line.startswith(("  ", "! ", "(exit ")):
                    continue
                lines.append(line)
                if line.startswith("$ "):
                    out, err, code = typed(line.removeprefix("$ "))
                    lines += [f"  {row}" for row in out.splitlines()] + [f"! {row}" for row in err.splitlines()]
                    lines += [f"(exit {code})"] if code else []
        finally:
            os.chdir(home)
    printed = "\n".join(line.rstrip() for line in lines).replace(name, "<folder>") + "\n"
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
