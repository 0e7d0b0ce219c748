"""`pc-onboard ... | head -1`: whoever reads may have seen enough at any time."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from contract.vehicle_status import encode_status
from onboard.__main__ import READER_GONE
from onboard.config.schema import default_toml
from onboard.link.publisher import Publisher
from tests.onboard.commands.test_status import REPORT, STATUS
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S, eventually


def to_no_one(*arguments: object, buffered: bool = True) -> subprocess.CompletedProcess[str]:
    """A command whose output goes into a pipe that no one reads any more."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment |= {} if buffered else {"PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "onboard", *map(str, arguments)]
    reader, writer = os.pipe()
    os.close(reader)
    try:
        return subprocess.run(
            command,
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            timeout=2.0 * PATIENCE_S,
            check=False,
            env=environment,
        )
    finally:
        os.close(writer)


@pytest.mark.parametrize(("buffered", "code"), [(True, 0), (False, READER_GONE)])
def test_status_ends_without_a_word(tmp_path: Path, buffered: bool, code: int) -> None:
    """Its verdict is its exit code where it got as far as that."""
    endpoint = free_endpoint()
    (tmp_path / "config.toml").write_text(f'[vehicle]\nid = "kiwi"\n[link]\nlisten = ["{endpoint}"]\n')
    with Publisher("kiwi", (endpoint,)) as publisher:
        publisher.publish_status(encode_status(STATUS), REPORT.to_json())
        not_running, printed = 3, []

        def is_answered() -> bool:
            """Asked again where a busy machine was too slow to answer."""
            done = to_no_one("status", "--config", tmp_path / "config.toml", buffered=buffered)
            printed.append((done.stderr, done.returncode))
            return done.returncode != not_running

        assert eventually(is_answered)
    assert printed[-1] == ("", code)


def test_help_and_other_commands_do_too(tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text(default_toml())
    done = to_no_one("check-config", "--config", tmp_path / "config.toml")
    assert (done.stderr, done.returncode) == ("", 0)
    assert to_no_one("--help").stderr == to_no_one("--help", buffered=False).stderr == ""


def test_an_error_is_still_reported(tmp_path: Path) -> None:
    done = to_no_one("check-config", "--config", tmp_path / "none.toml")
    assert done.returncode == 2
    assert "none.toml" in done.stderr and done.stderr.count("\n") == 1


def test_more_than_a_pipe_holds_ends_in_the_middle_without_a_verdict(tmp_path: Path) -> None:
    (tmp_path / "config.d").mkdir()
    (tmp_path / "config.toml").write_text(default_toml())
    for number in range(200):
        (tmp_path / "config.d" / f"{number:03d}.toml").write_text("")
    done = to_no_one("check-config", "--config", tmp_path / "config.toml")
    assert (done.stderr, done.returncode) == ("", READER_GONE)
