"""What flew live, in threads and in time, comes out of its recording byte for byte."""

from pathlib import Path

import pytest

from onboard.__main__ import main
from tests.onboard.service.air import take_off


@pytest.mark.long  # short: a session with its pictures: test_rotating_recorder.py
def test_a_live_session_replays_to_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    air = take_off(tmp_path, seconds=14.0, config={"recording": {"pictures": "lossless", "keep_free_mb": 1.0}})
    assert air.code == 0
    # What would make a radius smaller goes out with the status, and is computed only now and then.
    shares = [status.shares for _, status in air.statuses if status.shares]
    assert shares and all(100 >= next(iter(some.values())) >= 5 for some in shares)
    assert air.reports[-1].budget is None or air.reports[-1].budget.percent == air.reports[-1].status.shares
    assert len({str(some) for some in shares}) <= 3
    capsys.readouterr()
    assert main(["replay", str(tmp_path / "recordings"), "--config", str(air.folder / "config.toml")]) == 0
    reported = capsys.readouterr().out
    (line,) = [line for line in reported.splitlines() if line.startswith("as recorded: ")]
    same, of, every, *_ = line.removeprefix("as recorded: ").split()
    assert of == "of" and same == every and int(every) > 50, line
    assert line.endswith("sets byte for byte"), line  # and none besides
    assert "not exactly" not in reported
