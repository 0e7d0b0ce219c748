"""What the commands print is what their transcripts show; how they are written: tests/play_transcripts.py."""

from pathlib import Path

import pytest

from tests.play_transcripts import FOLDER, PAGES, printed_now

TRANSCRIPTS = sorted(FOLDER.glob("*.txt"))
ERRORS = ("! pc-ground: error: ", "! pc-onboard: error: ", "! simulation.fly: ")


@pytest.mark.parametrize("path", TRANSCRIPTS, ids=lambda path: path.stem)
def test_what_is_printed_is_what_the_transcript_shows(path: Path) -> None:
    """If it should: `make transcripts`, and read the difference."""
    assert printed_now(path) == path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", [p for p in TRANSCRIPTS if p.stem not in PAGES], ids=lambda path: path.stem)
def test_errors_are_one_line_without_a_traceback(path: Path) -> None:
    """Wrong usage and input exit with 2, and print their line and nothing else."""
    answers = path.read_text(encoding="utf-8").split("\n$ ")[1:]
    for answer in answers:
        typed, *printed = answer.strip().splitlines()
        printed = [line for line in printed if line and not line.startswith("# ")]
        assert not any("Traceback" in line for line in printed), typed
        if "(exit 2)" in printed:
            assert len(printed) == 2 and printed[0].startswith(ERRORS), typed
