"""What a replay prints of pictures that come too slowly; what becomes of them is in test_scenarios.py."""

from pathlib import Path

import pytest

from onboard.__main__ import main
from tests.scenarios.flights import play, simulated
from tests.scenarios.scenario import ANSWERS, why
from tests.scenarios.sessions import apart


@pytest.mark.long
def test_pictures_without_overlap_are_refused_and_the_summary_says_how_often_is_enough() -> None:
    """30 m/s, ten seconds apart, 315 m of ground on a picture: 5 % in common. Every 7.9 s a quarter would be."""
    printed = why(play(simulated(apart(10.0, 8, speed_m_s=30.0))))
    assert "no overlap: pictures 10.0 s apart, at most " in printed
    most_s = float(printed.split("at most ")[1].split()[0])
    assert 7.2 < most_s < 8.4, printed
    ANSWERS.check(play(simulated(apart(most_s, 8, speed_m_s=30.0))))


def replayed(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    named = {"frames": "frames", "telemetry": "telemetry.tlog", "stamps": "stamps.csv", "camera": "camera.json"}
    words = [word for k, v in {**named, "config": "config.toml"}.items() for word in (f"--{k}", str(folder / v))]
    return main(["replay", *words]), capsys.readouterr().out


@pytest.mark.parametrize(("apart_s", "pictures", "exit_code"), [(0.1, 20, 3), (10.0, 6, 0)])
def test_a_replay_that_solves_nothing_exits_with_3_and_prints_the_reason(
    apart_s: float, pictures: int, exit_code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out = replayed(simulated(apart(apart_s, pictures)), capsys)
    assert code == exit_code
    assert [words in out for words in ("nothing solved", "too short", "what to do")] == [exit_code == 3] * 3
