"""A session's number is higher than that of any before it, whatever the clock shows at the start."""

from pathlib import Path

import pytest

from onboard.storage.session_number import FILE_NAME, MOST, next_session

NOW_S, UNSET_S = 1_800_000_000, 20


def begun(folder: Path, *clock_s: int) -> list[int]:
    found = [next_session(folder, second * 10**9) for second in clock_s]
    assert all(unkept == "" for _, unkept in found)
    return [number for number, _ in found]


def test_numbers_go_up_though_the_clock_is_set_back_or_the_same_at_every_start(tmp_path: Path) -> None:
    assert begun(tmp_path, UNSET_S, UNSET_S, UNSET_S) == [20, 21, 22]
    assert begun(tmp_path, NOW_S) == [NOW_S]
    assert begun(tmp_path, UNSET_S, NOW_S - 1, NOW_S + 100) == [NOW_S + 1, NOW_S + 2, NOW_S + 100]


@pytest.mark.parametrize("content", ["", "junk", "-5", "99999999999", "\u0663", "1e9"])
def test_a_file_that_is_no_number_is_a_first_session(tmp_path: Path, content: str) -> None:
    (tmp_path / FILE_NAME).write_text(content)
    assert begun(tmp_path, NOW_S, UNSET_S) == [NOW_S, NOW_S + 1]


def test_numbers_stay_what_the_wire_carries(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text(str(MOST))
    assert begun(tmp_path, NOW_S) == [NOW_S]
    assert begun(tmp_path, MOST + 10) == [MOST]
    assert begun(tmp_path, 0) == [1]


def test_where_it_cannot_be_kept_the_clock_s_second_serves_and_the_reason_is_there(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).mkdir()
    number, unkept = next_session(tmp_path, NOW_S * 10**9)
    assert number == NOW_S and FILE_NAME in unkept
