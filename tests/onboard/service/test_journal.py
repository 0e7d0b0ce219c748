"""The service's log, as journald and as a terminal want it."""

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.service.journal import is_journal, set_up
from tests.left_out import NO_PROGRAM
from tests.waiting import PATIENCE_S


@pytest.fixture(autouse=True)
def own_logging() -> Iterator[None]:
    root, house = logging.getLogger(), logging.getLogger("pointclick")
    before = root.handlers[:], root.level, house.level
    yield
    root.handlers[:] = before[0]
    root.setLevel(before[1])
    house.setLevel(before[2])
    logging.captureWarnings(False)


def written(file: Path, environment: dict[str, str]) -> list[str]:
    with file.open("w") as stream:
        if environment:
            status = os.fstat(stream.fileno())
            environment["JOURNAL_STREAM"] = environment["JOURNAL_STREAM"].format(status.st_dev, status.st_ino)
        set_up(stream, environment)
        log = logging.getLogger("pointclick")
        log.debug("not heard")
        log.info("state: %s", "ok")
        log.warning("state: camera lost")
        try:
            raise RuntimeError("two\nlines")
        except RuntimeError as error:
            log.error("the pipeline failed", exc_info=error)
        logging.getLogger("somebody").info("not heard")
        logging.getLogger("somebody").warning("heard")
    return file.read_text().splitlines()


def test_under_journald_every_line_bears_its_priority(tmp_path: Path) -> None:
    lines = written(tmp_path / "log", {"JOURNAL_STREAM": "{}:{}"})
    assert lines[:3] == ["<6>state: ok", "<4>state: camera lost", "<3>the pipeline failed"]
    assert lines[3] == "<3>Traceback (most recent call last):"
    assert lines[-1] == "<4>heard"
    assert all(line.startswith("<3>") for line in lines[2:-1])
    assert "<3>lines" in lines


@pytest.mark.parametrize("environment", [{}, {"JOURNAL_STREAM": "1:2"}])
def test_elsewhere_lines_bear_time_and_level(tmp_path: Path, environment: dict[str, str]) -> None:
    lines = written(tmp_path / "log", environment)
    assert lines[0].endswith("INFO    state: ok")
    assert lines[0].startswith("20")
    assert not any(line.startswith("<") for line in lines)


def test_a_stream_without_a_file_is_no_journal() -> None:
    class Nowhere:
        def fileno(self) -> int:
            raise ValueError("no file")

    assert not is_journal(Nowhere(), {"JOURNAL_STREAM": "1:2"})


TALKS = """
import logging, sys
from pathlib import Path
from onboard.service.journal import set_up

set_up()
log = logging.getLogger("pointclick")
for number in range(2000):  # many times what is held back
    log.warning("state: camera lost, for the %d. time", number)
try:
    raise RuntimeError("a thread's")
except RuntimeError as error:
    log.error("the recording failed", exc_info=error)
Path(sys.argv[1]).write_text("goes on")
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason=f"{NO_PROGRAM} /dev/full here")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_below_the_log_costs_its_lines_and_nothing_else(tmp_path: Path, unbuffered: str) -> None:
    """As `pc-ground live` keeps it, in a file."""
    with Path("/dev/full").open("wb") as full:
        subprocess.run(
            [sys.executable, "-c", TALKS, tmp_path / "after"],
            stdout=full,
            stderr=full,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            check=False,
            timeout=PATIENCE_S,
        )
    assert (tmp_path / "after").read_text() == "goes on"
