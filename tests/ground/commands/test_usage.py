"""What a person at the terminal mistypes: one line, no traceback, and nothing made that was not asked for."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ground.__main__ import main
from tests.left_out import NO_PROGRAM

PIN = ("pins", "add", "--at", "-43.38,172.40", "--name", "gate")


@pytest.mark.parametrize("program", ["ground", "onboard"])
def test_both_programs_say_their_version(program: str) -> None:
    done = subprocess.run([sys.executable, "-m", program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"pc-{program} ") and done.stdout.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason=f"{NO_PROGRAM} /dev/full here")
@pytest.mark.parametrize("command", [["ground", "pins", "list"], ["onboard", "check-config"]])
def test_a_full_disk_below_the_output_is_one_line(tmp_path: Path, command: list[str]) -> None:
    config, pins = tmp_path / "config.toml", tmp_path / "pins.sqlite"
    config.write_text("")
    assert main([*PIN, "--pins", str(pins)]) == 0
    more = ["--pins", str(pins)] if command[0] == "ground" else ["--config", str(config)]
    for buffered in ("", "1"):
        with Path("/dev/full").open("w") as full:
            done = subprocess.run(
                [sys.executable, "-m", *command, *more], stdout=full, stderr=subprocess.PIPE, text=True, check=False,
                env={**os.environ, "PYTHONUNBUFFERED": buffered},
            )  # fmt: skip
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert "the output cannot be written: No space left" in done.stderr


def test_the_file_of_pins_may_be_named_before_the_action_or_after(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pins = str(tmp_path / "pins.sqlite")
    assert main(["pins", "--pins", pins, "--who", "ann", *PIN[1:]]) == 0
    assert main(["pins", "--pins", pins, "list", "--format", "json"]) == 0
    printed = capsys.readouterr().out
    assert '"gate"' in printed and '"who": "ann"' in printed
    assert main(["pins", "list", "--pins", pins]) == 0
    assert "gate" in capsys.readouterr().out
