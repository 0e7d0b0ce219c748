"""The service's log, as journald and as a terminal want it."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.service.journal import is_journal, set_up


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

    assert not is_journal(Nowhere(), {"JOURNAL_STREAM": "1:2"})  # type: ignore[arg-type]
