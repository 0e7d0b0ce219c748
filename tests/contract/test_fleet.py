"""The list of who takes part at a router: written, read back, refused where it contradicts itself."""

import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import InputError
from contract.fleet import MAX_BYTES, Fleet, read_fleet
from contract.whole_file import save

NAMES = st.text(string.ascii_letters + string.digits + "_.-", min_size=1, max_size=32)


@given(
    st.lists(NAMES, unique=True, min_size=1, max_size=12),
    st.lists(st.text(st.characters(exclude_categories=["C"]), max_size=20), max_size=3),
    st.floats(0.0, 1000.0),
)
def test_a_list_that_is_written_is_read_back_as_it_was(names: list[str], listen: list[str], sets_hz: float) -> None:
    import tempfile  # noqa: PLC0415  hypothesis makes a folder of its own for each example

    router, *others = names
    third = len(others) // 3
    aircraft, operators, viewers = others[:third], others[third : 2 * third], others[2 * third :]
    fleet = Fleet(
        router, tuple(listen), (), sets_hz, tuple(aircraft), tuple(operators), tuple(viewers), pins=tuple(operators)
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        save(path, fleet.to_toml())
        assert read_fleet(path) == fleet
        assert [file.name for file in Path(folder).iterdir()] == ["fleet.toml"]


def test_a_list_without_end_is_refused(tmp_path: Path) -> None:
    """Others that are refused: tests/transcripts/pc-onboard-make-credentials.txt."""
    (tmp_path / "fleet.toml").write_text("#" * (MAX_BYTES + 1))
    with pytest.raises(InputError, match="more than 1000000 bytes"):
        read_fleet(tmp_path / "fleet.toml")


def test_what_is_left_out_has_its_default_and_who_shares_pins_may_also_be_a_person(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('operators = ["anna"]\npins = ["anna", "desk"]\n')
    assert read_fleet(path) == Fleet(operators=("anna",), pins=("anna", "desk"))
    with pytest.raises(InputError, match="No such file"):
        read_fleet(tmp_path / "none.toml")


def test_more_names_are_added_once_and_contradictions_are_not() -> None:
    fleet = Fleet(operators=("anna",)).with_more(aircraft=("uav1",), operators=("anna", "ben"))
    assert fleet.aircraft == ("uav1",) and fleet.operators == ("anna", "ben")
    with pytest.raises(InputError, match="'uav1' is named twice"):
        fleet.with_more(viewers=("uav1",))
