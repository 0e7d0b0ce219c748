"""The demo on a busy machine: it waits for what happens, however long that takes, and no longer for what cannot."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from contract.errors import InputError
from demo import processes
from demo.processes import STUCK_S, Aircraft

NOT_LISTENING = (2, "pc-ground: error: no aircraft answers")
NOT_YET = (3, json.dumps({"status": "unknown_frame"}))
LOW = (3, json.dumps({"status": "low_parallax"}))
FEATURELESS = (3, json.dumps({"status": "featureless"}))
OK = (0, json.dumps({"status": "ok"}))
FRAME, PICTURES = 3, 6
STEP_S = 45.0  # that the clock moves by at each look at it


class Programs:
    """A pc-onboard that waits, and a pc-ground whose answers are lists by frame, the last of which stays."""

    def __init__(self, folder: Path, onboard: str) -> None:
        self._folder = folder
        (folder / "config.toml").write_text("")
        self._write("pc-onboard", onboard)
        self._write(
            "pc-ground",
            f"""
cd {folder}
frame=$5
line=$(head -n 1 answers.$frame)
[ "$(wc -l < answers.$frame)" = 1 ] || sed -i 1d answers.$frame
echo $frame >> asked
echo "${{line#* }}"
echo "${{line#* }}" >&2
exit ${{line%% *}}
""",
        )

    def __call__(self, name: str) -> str:
        return str(self._folder / name)

    def answer(self, frame: int, *answers: tuple[int, str]) -> None:
        (self._folder / f"answers.{frame}").write_text("".join(f"{code} {text}\n" for code, text in answers))

    def asked(self) -> list[int]:
        return [int(line) for line in (self._folder / "asked").read_text().split()]

    def _write(self, name: str, script: str) -> None:
        (self._folder / name).write_text(f"#!/bin/sh\n{script}")
        (self._folder / name).chmod(0o755)


def programs_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, onboard: str = "exec sleep 600") -> Programs:
    made = Programs(tmp_path, onboard)
    clock = SimpleNamespace(now_s=0.0)

    def monotonic() -> float:
        clock.now_s += STEP_S
        return float(clock.now_s)

    monkeypatch.setattr(processes, "time", SimpleNamespace(monotonic=monotonic, sleep=lambda _: None))
    monkeypatch.setattr(processes, "program", made)
    return made


def test_it_waits_until_the_aircraft_listens_and_the_picture_has_come_and_is_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = programs_of(tmp_path, monkeypatch)
    programs.answer(FRAME, *[NOT_LISTENING] * 9, *[NOT_YET] * 9, *[LOW] * 9, OK)
    programs.answer(PICTURES - 1, NOT_YET)
    with Aircraft(tmp_path, tmp_path / "session.mcap", 3.0, PICTURES) as aircraft:
        assert aircraft.click(10, 20, FRAME) == {"status": "ok"}
    assert len([frame for frame in programs.asked() if frame == FRAME]) == 28


def test_a_refusal_counts_once_the_last_picture_has_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs = programs_of(tmp_path, monkeypatch)
    programs.answer(FRAME, NOT_YET, LOW, LOW, FEATURELESS)
    programs.answer(PICTURES - 1, NOT_LISTENING, NOT_YET, NOT_YET, OK)
    with Aircraft(tmp_path, tmp_path / "session.mcap", 3.0, PICTURES) as aircraft:
        assert aircraft.click(10, 20, FRAME) == {"status": "featureless"}


def test_programs_that_stand_still_are_not_waited_for_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs = programs_of(tmp_path, monkeypatch)
    programs.answer(FRAME, NOT_LISTENING)
    with (
        Aircraft(tmp_path, tmp_path / "session.mcap", 3.0, PICTURES) as aircraft,
        pytest.raises(InputError, match="no aircraft answers"),
    ):
        aircraft.click(10, 20, FRAME)
    assert STUCK_S / STEP_S - 3 <= len(programs.asked()) <= STUCK_S / STEP_S + 3


def test_an_aircraft_that_has_ended_is_reported_at_once_with_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = programs_of(tmp_path, monkeypatch, onboard="echo port is taken >&2; exit 2")
    programs.answer(FRAME, *[NOT_LISTENING] * 200)
    with (
        Aircraft(tmp_path, tmp_path / "session.mcap", 3.0, PICTURES) as aircraft,
        pytest.raises(InputError, match="pc-onboard ended with 2: port is taken"),
    ):
        aircraft._process.wait(60.0)
        aircraft.click(10, 20, FRAME)
