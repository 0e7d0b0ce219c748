"""What was learned in flight survives until the next one, or the file is refused by name."""

import json
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from onboard.estimation.boresight import Alignment
from onboard.storage.alignment_file import StateFile

MEAN = np.array([0.01, -0.02, 0.005, 0.08, 0.05, -0.03, 0.02, -0.01])


def fresh() -> Alignment:
    return Alignment(0.02, 0.1, 20.0, 0.1, 0.03)


def taught() -> Alignment:
    alignment = fresh()
    alignment.offer(1, 10_000_000_000, MEAN, np.diag([1e-6, 1e-6, 4e-6, 1e-4, 1e-4, 1e-3, 1e-5, 1e-5]))
    return alignment


def test_a_lesson_is_kept_and_widened_at_the_next_start(tmp_path: Path) -> None:
    state = StateFile(tmp_path / "alignment.json")
    state.keep(taught())
    again = fresh()
    state.restore(again)
    assert again.platform.mean == pytest.approx(taught().platform.mean, rel=1e-12)
    assert again.platform.mean[:4] == pytest.approx(MEAN[:4], rel=1e-3)
    assert np.all(again.platform.sigma > taught().platform.sigma)
    assert np.all(again.platform.sigma < fresh().platform.sigma)
    assert [p.name for p in tmp_path.iterdir()] == ["alignment.json"]


def test_what_nothing_confirms_never_reaches_the_file(tmp_path: Path) -> None:
    """A hover once "learned" +0.81 +- 0.12 s against a prior of 0.1, and wrote it."""
    state, alignment = StateFile(tmp_path / "alignment.json"), fresh()
    mean = np.zeros(8)
    mean[3] = 0.81
    covariance = np.diag([1e-5] * 3 + [0.12**2, 1e-3, 1e-3] + [1e-5] * 2)
    assert not alignment.offer(1, 10_000_000_000, mean, covariance)
    assert alignment.unconfirmed is not None
    state.keep(alignment)
    assert list(tmp_path.iterdir()) == []


def test_a_first_flight_and_a_flight_without_lessons_leave_nothing(tmp_path: Path) -> None:
    state = StateFile(tmp_path / "alignment.json")
    untaught = fresh()
    state.restore(untaught)
    state.keep(untaught)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    ["", "{}", '{"boresight_rad": [0, 0, 0], "offset_s": 0, "covariance": [[1]]}', "[1, 2]", '{"offset_s": NaN}'],
)
def test_an_unreadable_state_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "alignment.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"alignment\.json"):
        StateFile(path).restore(fresh())


def written(**changes: object) -> str:
    """A state as older versions wrote it, without a checksum, but for what is given."""
    content = json.loads(taught().to_json())
    content.pop("crc32")
    return json.dumps(content | changes)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"boresight_rad": [0.0, 1.0, 0.0]}, "boresight of 1 radians: beyond 0.785"),
        ({"offset_s": 3600.0}, "time offset of 3.6e.03 seconds"),
        ({"delay_s": -40.0}, "position delay of -40"),
        ({"heading_rad": [0.0, 3.0]}, "heading error of 3"),
        ({"boresigth_rad": [0.0, 0.0, 0.0]}, "unknown key 'boresigth_rad'; did you mean 'boresight_rad'"),
        ({"offset_s": 10**400}, "not readable"),
        ({"crc32": "00000000"}, "damaged or edited"),
        ({"crc32": 0}, "damaged or edited"),
    ],
)
def test_an_estimate_that_cannot_be_is_refused_whatever_its_sigmas(
    tmp_path: Path, changes: dict[str, object], reported: str
) -> None:
    path, alignment = tmp_path / "alignment.json", fresh()
    path.write_text(written(**changes))
    with pytest.raises(InputError, match=reported):
        StateFile(path).restore(alignment)
    assert alignment.platform.mean == pytest.approx(fresh().platform.mean)


def test_one_changed_digit_is_found_and_a_file_of_before_checksums_is_accepted(tmp_path: Path) -> None:
    path, text = tmp_path / "alignment.json", taught().to_json()
    for k in [k for k, c in enumerate(text) if c.isdigit()][::37]:
        path.write_text(text[:k] + str((int(text[k]) + 1) % 10) + text[k + 1 :])
        with pytest.raises(InputError, match=r"alignment\.json"):
            StateFile(path).restore(fresh())
    for good in (text, written()):
        path.write_text(good)
        again = fresh()
        StateFile(path).restore(again)
        assert again.platform.mean == pytest.approx(taught().platform.mean, rel=1e-12)


def test_a_state_file_in_no_folder_is_refused_before_the_flight(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        StateFile(tmp_path / "nowhere" / "alignment.json")
    with pytest.raises(InputError, match="is a folder"):
        StateFile(tmp_path)
